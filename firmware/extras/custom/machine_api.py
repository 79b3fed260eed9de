"""Machine API: m, the argument of each handler of custom.py.

Lengths are mm, rates mm/min, times seconds. While a call waits, `?`, `!`, `~` and Ctrl-X work. A
handler that runs during motion may neither move nor wait: such a call raises RuntimeError. Every
call checks for a reset first, so a handler that has caught Stopped ends at its next call.
"""

import micropython
from base import errors
from base import state as st
from base.axes import LETTERS
from base.errors import GrblError
from base.float32 import vector
from base.text import sanitize, text_of
from control.coords import NAMES
from control.modes import INCHES
from micropython import const

from extras.custom.handlers import Refused
from extras.custom.persistent import PersistentValues
from extras.custom.pin_api import PinApi, Stopped
from extras.custom.positions import ModalState, Position
from extras.gcode_text import clean, code_of, words_of

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable

    from talk.controller import Controller

STATES = {
    st.IDLE: "Idle",
    st.ALARM: "Alarm",
    st.CHECK: "Check",
    st.HOMING: "Home",
    st.RUN: "Run",
    st.HOLD: "Hold",
    st.JOG: "Jog",
    st.DOOR: "Door",
    st.SLEEP: "Sleep",
}
_MM_PER_INCH = 25.4
_MOST_JOGS = const(4)  # requested, not yet started


def _never() -> bool:
    """Return False: the condition of a wait that only its time ends."""
    return False


class MachineApi(PinApi):
    """What a handler may call. outputs, inputs: pins' numbers, by the names of the board file.
    tool: the number of the last T. _open_blocks: m.saved() blocks that have not ended, innermost
    last. _jogs: lines of requested jogs that have not started."""

    def __init__(
        self, machine: "Controller", outputs: "dict[str, int]", inputs: "dict[str, int]"
    ) -> None:
        super().__init__(machine, outputs, inputs)
        self.tool = 0
        self.keep = PersistentValues(machine.saves)
        self._open_blocks: "list[ModalState]" = []
        self._jogs: "list[str]" = []

    # For the firmware, not for handlers

    def _check_may_wait(self) -> None:
        """Check that the handler may move or wait. RuntimeError if it runs during motion."""
        if not self.may_move:
            raise RuntimeError("a handler that runs during motion may neither move nor wait")
        self.check_stopped()

    def _finish_wait(self) -> None:
        """End a wait. Raises Stopped if a reset or an alarm has come meanwhile."""
        self.restart_clock()  # the wait is not the handler's own time
        self.check_stopped()

    def clear_requests(self) -> None:
        """Forget all requests, after a reset."""
        super().clear_requests()
        self._open_blocks.clear()
        self._jogs.clear()

    def has_jogs(self) -> bool:
        """Return whether requested jogs have not started yet."""
        return bool(self._jogs)

    def start_jogs(self) -> None:
        """Start the requested jogs. Call it only between two lines.

        A received line has priority, because it would be refused in state Jog. The jogs are then
        dropped: they are out of date after it. So are they in a state other than Idle or Jog.
        """
        machine, state = self._machine, self._state
        if self._jogs and machine.reader.has_line():
            self._jogs.clear()
        while self._jogs:
            if state.run == st.IDLE and not machine.planner.empty():
                return  # a planned line has not started
            code = self._jogs.pop(0).encode()
            if state.run in (st.IDLE, st.JOG):
                try:
                    machine.interpreter.jog(bytearray(code + b"\0"), len(code))
                except GrblError as reason:
                    self.message("The jog is refused with %d" % reason.code)

    # Motion

    def g(self, text: str) -> None:
        """Execute one or several lines of G-code in the current modes.

        Raises Refused with Grbl's error number.
        """
        for line in text.split("\n"):
            self._execute(line, line)

    def _execute(self, line: str, name: str) -> None:
        """Execute a line of G-code. name: what the message of Refused calls it."""
        machine = self._machine
        self._check_may_wait()
        if self._state.run == st.ALARM:
            raise Refused(errors.SYSTEM_GC_LOCK, name)
        code = clean(line)  # a 0 follows its characters
        if len(code) > len(machine.reader.line):
            raise Refused(errors.OVERFLOW, name)
        if len(code) > 1:
            try:
                machine.state.hooks.execute(code, len(code) - 1)
            except GrblError as reason:
                self.restart_clock()  # as in _finish_wait()
                raise Refused(reason.code, name) from reason
        self._finish_wait()

    def saved(self) -> ModalState:
        """Use `with m.saved():` to work in G21 G90 G17 G94 (mm, absolute, XY plane, mm/min).

        Modes, feed and offsets are restored when the block ends. Spindle with its S, coolant and
        M56 stay as the block has left them.
        """
        return ModalState(self._machine, standard=True, blocks=self._open_blocks)

    def probe(
        self,
        words: str,
        must: bool = True,
    ) -> "Position | None":
        """Probe as G38.2 with `words`, and return the contact position in machine coordinates.

        With G53 in `words` the target is in mm and machine coordinates. No contact is ALARM:5, or
        returns None if `must` is False. A probe that touches already is ALARM:4, before anything
        moves.
        """
        self._check_may_wait()
        with ModalState(self._machine, standard=False, blocks=self._open_blocks):
            self.g("G38.%d%s" % (2 if must else 3, self._to_work_words(words)))
        if not self._state.probe_succeeded:
            return None
        return Position(self._machine.state.hooks.probed_at())

    def _to_work_words(self, words: str) -> str:
        """Return the words without G53, with their positions in work coordinates.

        Words without G53 are returned as they are. With it, G21 and G90 are set.
        """
        text = code_of(words)
        if "G53" not in text:
            return text
        self.g("G21G90")
        converted = ""
        for letter, number in words_of(text.replace("G53", "")):
            axis = LETTERS.find(letter)
            if axis < 0 and letter != "F":
                raise ValueError("m.probe with G53 takes only axes and F, not %s" % letter)
            zero = 0 if letter == "F" else self._zero(axis)
            converted += "%s%.4f" % (letter, number - zero)
        return converted

    def _zero(self, axis: int) -> float:
        """Return work zero of an axis, mm in machine coordinates, tool length included."""
        coords = self._machine.coords
        return coords.work_zero(coords.active, axis)

    def touches(self) -> bool:
        """Return whether the probe touches now."""
        return self._machine.inputs.probe()

    def probing(self) -> bool:
        """Return whether a probing move is running."""
        return self._machine.motor_control.touches is not None

    def set_work(self, at: Position, words: str) -> None:
        """Give a position the work coordinates of `words`, in mm: "Z0" or "X-3 Y-3".

        at: in machine coordinates. The work offset is stored, as by G10 L2.
        """
        coords = self._machine.coords
        axes = ""
        for letter, number in words_of(code_of(words)):
            axis = LETTERS.index(letter)
            # G92 and the tool length are part of work zero, and not of the offset that G10 sets.
            other_offsets = self._zero(axis) - coords.systems[coords.active][axis]
            axes += "%s%.4f" % (letter, at[axis] - number - other_offsets)
        with self.saved():
            self.g("G10L2P0" + axes)

    def set_length(self, mm: float) -> None:
        """Set the tool length offset in mm, as G43.1 does. It holds until a reset or G49."""
        with self.saved():
            self.g("G43.1%s%.4f" % (LETTERS[self._machine.coords.length_axis], mm))
            for block in self._open_blocks:  # the new length stays when they end
                block.keep_length()

    def home(self, axes: str = "") -> None:
        """Home as `$H` does. `axes`: one letter, if the board can home one axis.

        Raises Refused.
        """
        self._check_may_wait()
        self._machine.canon.synchronise()
        line = bytearray(("$H%s\0" % axes).encode())
        length = len(line) - 1
        try:
            execute = self._machine.state.hooks.find_command(line, length)
            execute(line, length)
        except GrblError as reason:
            raise Refused(reason.code, "$H" + axes) from reason
        self._finish_wait()

    def wait_motion(self) -> None:
        """Wait until all planned motion has been executed."""
        self._check_may_wait()
        self._machine.canon.synchronise()
        self._finish_wait()

    def run(self, file: str) -> None:
        """Execute a G-code file that is on the board.

        Raises OSError if the file is missing, and Refused if Grbl refuses a line.
        """
        with open(file, "rb") as lines:
            for number, line_bytes in enumerate(lines, 1):
                line = text_of(line_bytes.rstrip())
                self._execute(line, "%s:%d: %s" % (file, number, line))

    # Motion requests, allowed during other motion too

    def jog(self, axis: str, mm: float, rate: float) -> bool:
        """Request a jog of an axis by `mm` at `rate` mm/min. Return whether it was accepted.

        It returns False in a state other than Idle or Jog, with 4 jogs waiting, and while a
        received line waits. In a handler that runs during motion it also returns False while a
        line is executed. A line that arrives before the jog starts has priority, and the jog is
        dropped.
        """
        self.check_stopped()
        reader = self._machine.reader
        # Only has_line() counts the line in progress, of which a handler that may move is a part.
        has_line = reader.waiting() if self.may_move else reader.has_line()
        if has_line or self._state.run not in (st.IDLE, st.JOG) or len(self._jogs) >= _MOST_JOGS:
            return False
        self._jogs.append("$J=G21G91%s%.4fF%.1f" % (axis.upper(), mm, rate))
        self._state.pending[st.ANY] = 1  # so that the loop starts it between two lines
        return True

    def end_jog(self) -> None:
        """Slow down to a stop if the machine jogs, and drop the requested jogs."""
        self._jogs.clear()
        if self._state.run == st.JOG:
            self._state.post(st.CANCEL_MOTION)

    def hold(self) -> None:
        """Start a feed hold, as `!` does. `~` resumes."""
        self.check_stopped()
        self._state.post(st.FEED_HOLD)

    def stop(self, text: str) -> None:
        """Report `text`, stop the machine and end the handler, with ALARM:34.

        The position is kept; spindle, coolant and outputs are off. In Alarm it only ends the
        handler.
        """
        if self._state.run == st.ALARM:
            raise Stopped
        self.message(text)
        self.halt()

    def halt(self) -> None:
        """Stop the machine from anywhere, with all off and ALARM:34. Raises Abort."""
        machine, state = self._machine, self._state
        # First let a hold that still slows down end, so that the position stays certain.
        while state.run & (st.HOLD | st.DOOR | st.SLEEP) and state.holding:
            machine.motor_control.pump()
            machine.realtime.handle_events()
        machine.canon.stop_with_alarm(errors.ALARM_HANDLER)

    # Waiting

    @micropython.native  # saves stack for a handler that runs during the wait
    def wait(self, seconds: float) -> None:
        """Wait for so many seconds, while motion goes on."""
        self._wait_until(_never, seconds)

    def wait_for(self, name: str, closed: bool = True, seconds: "float | None" = None) -> bool:
        """Wait until an input is closed, or with closed=False until it is open.

        It returns False if that takes longer than `seconds`. None waits without limit. ValueError
        for an unknown name.
        """
        return self._wait_until(lambda: self.pin(name) == closed, seconds)

    @micropython.native
    def _wait_until(self, done: "Callable[[], bool]", seconds: "float | None") -> bool:
        """Wait until done() is true, at most `seconds` (None: no limit). Return its last result.

        Planned motion is started, and goes on meanwhile.
        """
        self._check_may_wait()
        machine = self._machine
        port, service = machine.port, machine.protocol.service
        machine.canon.auto_start()
        since = port.ticks_ms()
        is_done = done()
        while not is_done and (seconds is None or port.elapsed_ms(since) < seconds * 1000):
            service()
            is_done = done()
        self._finish_wait()
        return is_done

    def ask(self, text: str) -> None:
        """Send a message when motion has ended, and hold until cycle start (`~`). RuntimeError in
        an alarm, where nothing holds."""
        self._check_may_wait()
        if self._state.run == st.ALARM:
            raise RuntimeError("m.ask is not possible in an alarm")
        self._machine.canon.synchronise()
        self.restart_clock()
        self.message(text)
        self._machine.canon.pause_program()
        self._finish_wait()

    # State

    def position(self) -> Position:
        """Return the position in machine coordinates, in mm."""
        mm = vector(self._machine.planner.axes)
        self._machine.position(mm)
        return Position(mm)

    def work(self) -> Position:
        """Return the position in work coordinates, in mm."""
        return self._to_work(self.position())

    def target(self) -> Position:
        """Return the target of the last line read, in work coordinates, in mm."""
        return self._to_work(self._machine.modes.position)

    def _to_work(self, mm: "Position | array[float]") -> Position:
        """Convert a position from machine to work coordinates, in mm."""
        work = vector(self._machine.planner.axes)
        for i in range(len(work)):
            work[i] = mm[i] - self._zero(i)
        return Position(work)

    def mm(self, length: float) -> float:
        """Convert a length of the program to mm, from inches if the program is in G20."""
        # Within m.saved() the program's own modes are those from before the outermost block.
        modal = self._open_blocks[0].modal if self._open_blocks else self._machine.modes.modal
        return length * _MM_PER_INCH if modal[INCHES] else length

    def offset(self, name: str) -> Position:
        """Return G54 to G59, G28, G30 or G92 in mm, by name. ValueError for another name."""
        coords = self._machine.coords
        return Position(coords.g92 if name == "G92" else coords.systems[NAMES.index(name)])

    def modes(self) -> "list[str]":
        """Return the words that `$G` reports, as a list."""
        return self._machine.commands.modes().split(" ")

    @property
    def state(self) -> str:
        """The state that `?` reports: Idle, Run, Hold, Alarm and so on."""
        return STATES[self._state.run]

    @property
    def is_laser(self) -> bool:
        """Whether laser mode ($32) is on."""
        return self._machine.spindle.laser

    # Messages

    def message(self, text: str) -> None:
        """Send [MSG:text] to the sender."""
        self.check_stopped()
        self._machine.report.message(sanitize(text))
