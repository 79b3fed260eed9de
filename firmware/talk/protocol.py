"""Protocol: the main loop. It reads bytes, hands each line to the interpreter or to commands, and
answers "ok" or "error:n".

pump() reads the link and removes real-time bytes; it decides nothing. service() is pump() plus the
handling of real-time events: code that waits calls it again and again.
"""

from base import errors
from base import state as st
from base.errors import Abort, GrblError
from language.block_layout import ASKED, LINES_LEFT
from micropython import const

from talk.lines import LINE, NOTHING, clean
from talk.report import OK
from talk.stream_loop import LINES, kernel_args, run_lines

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    from interfaces import Link, Machine

_LOCKED = const(st.ALARM | st.JOG)  # states that refuse G-code
_DOLLAR = const(36)  # the character $
_IN_PYTHON = const(2)  # a line executed in Python counts as so many lines of the kernel
_DEAF_MS = const(500)  # nothing is answered for so long after an alarm


class Protocol:
    """The main loop and its buffer.

    echoes: a board option, to send each line back as the parser reads it. restart: prepares the
    machine for lines after power-up or a reset, and greets. _interpret: executes G-code.

    A turn of run() reads one line, or executes many move-only lines in a kernel; handles events
    and hooks if they are due; then executes and answers the line. In run(), result is clean()'s:
    the line's length << 2, and LINE, TOO_LONG or NOTHING in two bits. counts[LINES_LEFT]: lines
    until events and hooks are due. counts[ASKED]: what run_lines() has found in checking the line
    that it returned; 0: that must be checked again. due: values that wait to be stored.
    """

    def __init__(self, machine: "Machine", link: "Link", echoes: bool) -> None:
        self._state = machine.state
        self._reader = machine.reader
        self._report = machine.report
        self._saves = machine.saves
        self._realtime = machine.realtime
        self._motor_control = machine.motor_control
        self._interpreter = machine.interpreter
        self._canon = machine.canon
        self._echoes = echoes
        # The bytes of one read. Large, so that a ? is found at once and does not wait until the
        # lines before it are executed; half the reader's ring, because the ring may already hold
        # a part of a line, and bytes for which it has no space are lost.
        self._buffer = bytearray(machine.reader.free() // 2)
        self._feed = machine.reader.feed
        # Extras may replace these before run().
        self.restart = machine.restart
        self.link = link
        self.read_into = link.read_into

    def pump(self) -> None:
        """Read the bytes received: queue them in the reader, post real-time bytes as events."""
        count = self.read_into(self._buffer)
        if count:
            self._feed(self._buffer, count)

    def service(self) -> None:
        """Do one turn of a wait: read bytes and handle real-time events; return once motion is no
        longer suspended. Raises Abort after a reset."""
        count = self.read_into(self._buffer)  # pump() inlined: it saves a stack frame
        if count:
            self._feed(self._buffer, count)
        self._realtime.handle_events()
        if self._state.suspend:
            self._realtime.wait_suspended()

    def run(self) -> None:
        """Execute and answer lines for ever; a reset (Abort) restarts the loop. It does not call
        execute(), but has its code, because the stack is short."""
        reader, state, pending = self._reader, self._state, self._state.pending
        interpreter, write, due = self._interpreter, self.link.write, self._saves.due
        # Looked up once, because a bound method is a new object each time; and only here, because
        # an extra may have replaced it.
        self._interpret = state.hooks.execute
        interpreter.line = line = reader.line
        loop_args = kernel_args(reader, interpreter, self.link, self._buffer)
        ring, reader_state, _, kinds = reader.memory()
        counts = interpreter.machine  # an array: LINES_LEFT and ASKED, see the class
        echoes = self._echoes
        while True:
            try:
                if self._motor_control.by_pin:  # unread bytes were sent before the reset
                    self._motor_control.by_pin = False
                    self.link.discard()
                self.restart()
                answers_query = 0  # not 0: the last turn has answered a ?
                while True:
                    if echoes or state.suspend or state.run & _LOCKED:
                        result = clean(ring, reader_state, line, kinds)
                        counts[ASKED] = 0
                        if result == NOTHING:
                            self.pump()
                    else:  # executes move-only lines, and returns another one
                        result = run_lines(pending, loop_args)
                    # Events and hooks are handled here, not at each line; always before a $ line,
                    # which may ask about their effect.
                    counts[LINES_LEFT] -= _IN_PYTHON
                    events_due = pending[st.ANY] or state.suspend or counts[LINES_LEFT] <= 0
                    if events_due or result & LINE == 0 or line[0] == _DOLLAR:
                        counts[LINES_LEFT] = LINES
                        # Answer a ? before auto_start(), which delays it, but not twice in a row.
                        answers_query = pending[st.STATUS_REPORT] and not answers_query
                        if result == NOTHING and not answers_query and not reader.waiting():
                            self._canon.auto_start()
                        self._realtime.run()
                        if result == NOTHING:
                            if pending[st.ANY]:  # with an event posted run_lines() reads nothing
                                self.pump()
                            continue
                        counts[ASKED] = 0  # the event may have changed what the line may do
                    if result & LINE == 0:
                        state.hooks.refuse(errors.OVERFLOW)
                        continue
                    length = result >> 2
                    try:  # as in execute(); a pending reset reports the alarm in the outer loop
                        self._find_command(line, length)(line, length)
                        if due:
                            self._save()
                        if state.alarm and not pending[st.RESET]:
                            self._report_alarm()
                    except (GrblError, OSError, Abort) as reason:
                        self._refuse(reason, b"")
                    else:
                        write(OK)
            except Abort:
                self._report_alarm()

    def execute(self, line: bytearray, length: int, before: bytes) -> None:
        """Execute one line, which a 0 ends, and answer it with "ok" or an error. length: without
        the 0; before: text in front of the answer, b"" for none. Raises Abort after a reset."""
        try:
            self._find_command(line, length)(line, length)
            if self._saves.due:
                self._save()
            self._report_alarm()
        except (GrblError, OSError, Abort) as reason:
            self._refuse(reason, before)
        else:
            if before:
                self.link.write(before)
            self.link.write(OK)

    def _save(self) -> None:
        """Write the stored values that the line has changed. A write blocks interrupts, so any
        motion must end first. Raises OSError if they cannot be stored, Abort after a reset."""
        if self._state.run & st.UNDER_WAY:
            self._canon.synchronise()
        self._saves.write_due()

    def _find_command(self, line: bytearray, length: int) -> "Callable[[bytearray, int], None]":
        """Return the function that executes the line, to be called with line and length. Raises
        GrblError if the line is refused."""
        if self._echoes:
            self._report.echo(bytes(line[:length]))
        if length == 0:
            return _pass_over
        if line[0] == _DOLLAR:
            return self._state.hooks.find_command(line, length)
        if self._state.run & _LOCKED:
            raise GrblError(errors.SYSTEM_GC_LOCK)
        return self._interpret

    def _report_alarm(self) -> None:
        """Report a pending alarm, if there is one, then read without answering for half a second;
        after a limit switch or a soft limit, until a reset. Done here because the stack is nearly
        empty here."""
        state, report, motor_control = self._state, self._report, self._motor_control
        code = state.alarm  # Grbl's number
        if code == 0:
            return
        # What caused the alarm may have more to send once it is reported: a probing cycle its
        # contact, an internal fault its text.
        send_details = motor_control.enter_alarm()  # sends nothing itself
        state.hooks.alarm(code)  # sends ALARM:code
        motor_control.wait_unanswered(_DEAF_MS)
        if code in (errors.ALARM_HARD_LIMIT, errors.ALARM_SOFT_LIMIT):
            # Only a reset is accepted: the user must look at the machine first.
            report.message(errors.MSG_CRITICAL_EVENT)
            state.pending[st.RESET] = 0
            while not state.pending[st.RESET]:
                motor_control.wait_unanswered(1)
        state.alarm = 0
        if send_details:
            if not state.pending[st.RESET]:  # else handle_events() raises Abort
                self._realtime.handle_events()
            send_details()

    def _refuse(self, reason: Exception, before: bytes) -> None:
        """Answer a line that raised an exception: an error or, after a reset (Abort), "ok"; then
        Abort is raised again. before: text in front of the answer."""
        self._report_alarm()
        if isinstance(reason, OSError):
            self._report.message(errors.MSG_NOT_KEPT)  # the change is valid until power-off
        if before:
            self.link.write(before)
        if isinstance(reason, GrblError):
            self._state.hooks.refuse(reason.code)
        elif isinstance(reason, OSError):
            self._state.hooks.refuse(errors.SETTING_READ_FAIL)
        else:
            self.link.write(OK)  # the line was accepted; a reset cut it short
            raise reason


def _pass_over(_line: bytearray, _length: int) -> None:
    """Accept an empty line."""
