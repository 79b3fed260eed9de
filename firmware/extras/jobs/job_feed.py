# mypy: disable-error-code="arg-type, call-overload, operator"
"""Feed: a sender on the board, which streams a file to the machine's main loop.

It is between the loop and its link. While a job runs, the loop reads the file, as much as its ring
has space for, and its answers are counted and not sent. So the lines of a job are executed like
all others, and as fast. Meanwhile the sender's real-time commands work, its read-only commands are
answered, and its other lines are refused. Files are in flash. Reading flash does not delay
interrupts.
"""

from array import array

import micropython
from base import errors
from base import state as st
from base.errors import GrblError
from micropython import const
from motion import layout
from talk.commands import READ_ONLY
from talk.lines import REALTIME
from talk.report import OK

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import IO

    from talk.controller import Controller

_FILE_BYTES = const(512)  # of the file, read at once
_SENDER_BYTES = const(32)  # of the sender, read at once
_FEW_BLOCKS = const(12)  # free ones of the planner: one call of _deliver() may fill as many
_MOST_ANSWERS = const(32)  # to the sender, that may wait
# Bytes of stack that may be in use, beyond the depth at the start of the job, when a hold is noted
# and when the file is read. A file system needs much stack.
_STACK_TO_NOTE = const(1216)
_STACK_TO_READ = const(1664)
_IN_ENGINE_MS = const(40)  # motion that the planner has handed over may last so long

# Indices of the kernels' state, an array of integers.
_LINES_ANSWERED = const(0)  # number of lines answered, those before the first one included
_NOTED_HEAD = const(1)  # row of the planner's ring up to which lines are noted
_NEXT_BYTE = const(2)  # index in _file_bytes of the next byte to deliver
_BYTES_LEFT = const(3)  # bytes to deliver from there on
_LAST_BYTE = const(4)  # the last byte delivered
_EMPTY_RING_BYTES = const(5)  # free bytes of the reader's ring when it is empty

_NEWLINE = const(10)
_RETURN = const(13)
_DOLLAR = const(36)
_READ_ONLY_FLAG = const(0x80)  # in a queued answer, with the letter of a read-only command
_LETTER_O = const(111)  # "o", with which "ok" begins


@micropython.viper
def _deliver(
    file: ptr8, state: ptr32, buf: ptr8, size: int, ring_free: int, kinds: ptr8, flow: ptr32
) -> int:
    """Move bytes of the file into buf. Return their number, at most `size` and `ring_free`.

    file: the bytes read last; state: of the kernels; size: of buf; ring_free: the free bytes of
    the reader's ring, which gets buf; kinds: the kind of each byte value; flow: the planner's
    state. Real-time commands and CR become spaces; a line ends with LF.

    It delivers at most as many lines as blocks are free, and with fewer than _FEW_BLOCKS of these
    only when the ring is empty. So no line waits inside the interpreter, and a hold finds the
    stack nearly empty.
    """
    free_blocks = flow[layout.TAIL] - flow[layout.HEAD] - 1
    if free_blocks < 0:
        free_blocks += flow[layout.ROWS]
    ring_has_bytes = ring_free < state[_EMPTY_RING_BYTES]
    if free_blocks < _FEW_BLOCKS and (free_blocks == 0 or ring_has_bytes):
        return 0
    start = state[_NEXT_BYTE]
    left = state[_BYTES_LEFT]
    most = ring_free
    if most > size:
        most = size
    if most > left:
        most = left
    count = 0
    while count < most:
        c = file[start + count]
        buf[count] = 32 if kinds[c] == REALTIME or c == _RETURN else c
        state[_LAST_BYTE] = c
        count += 1
        if c == _NEWLINE:
            free_blocks -= 1
            if free_blocks == 0:
                most = count  # ends the loop
    state[_NEXT_BYTE] = start + count
    state[_BYTES_LEFT] = left - count
    return count


@micropython.viper
def _note_blocks(state: ptr32, line_of_row: ptr32, flow: ptr32, answers: int) -> int:
    """Note the line of each block planned since the last call. The result is not used.

    state: of the kernels; line_of_row: the number of the line that made each row (block) of the
    planner's ring; flow: the planner's state. answers: number of lines answered now, 1 or 2; 0
    within a line, an arc for example. If two lines have made one block, it is noted as the first
    one's.
    """
    row = state[_NOTED_HEAD]
    head = flow[layout.HEAD]
    rows = flow[layout.ROWS]
    line = state[_LINES_ANSWERED] + 1  # of the first block
    later_line = state[_LINES_ANSWERED] + answers if answers else line  # of all blocks after it
    state[_LINES_ANSWERED] += answers
    while row != head:
        line_of_row[row] = line
        line = later_line
        row += 1
        if row == rows:
            row = 0
    state[_NOTED_HEAD] = row
    return line


class Feed:
    """A Link for the loop.

    on_refusal: called with Grbl's error number when a line of the file is refused. on_hold: called
    in a hold, when its line is known. is_on: a job runs. fault: the error that has ended reading.

    _file: None once all is read; _size, _read_bytes: its bytes, and how many were read.
    _file_bytes, _state: the bytes being delivered, and the kernels' state. _line_of_row: the line
    that made each row of the planner's ring. _line_now, _line_before: line_in_motion() at
    the last look (at _looked_ms), and at the one before it, at least _IN_ENGINE_MS earlier;
    _held_line: the line that on_hold() was called for. _stack_at_start: bytes of stack in use.

    Of the sender: _sender_bytes, just read; _sender_line, its unfinished line, and
    _sender_line_length, which may be more than that holds; _answers, to its lines, _answer_count
    of them.
    """

    def __init__(
        self,
        machine: "Controller",
        on_refusal: "Callable[[int], object]",
        on_hold: "Callable[[], object]",
    ) -> None:
        self._machine = machine
        self._link = machine.protocol.link
        self._read_link = self._link.read_into
        self._write_link = self._link.write
        self._send_error = machine.state.hooks.refuse
        self._on_refusal = on_refusal
        self._on_hold = on_hold
        self._reader = machine.reader
        _, _, _, self._kinds = machine.reader.memory()  # the kind of each byte value
        self._flow = machine.planner.flow
        self._line_of_row = array("i", bytes(4 * self._flow[layout.ROWS]))
        self._state = array("i", bytes(4 * 6))  # see _LINES_ANSWERED
        self._state[_EMPTY_RING_BYTES] = self._reader.free()
        self._file_bytes = bytearray(_FILE_BYTES)
        self._sender_bytes = bytearray(_SENDER_BYTES)
        self._sender_line = bytearray(len(machine.reader.line))
        self._sender_line_length = 0
        self._answers = bytearray(_MOST_ANSWERS)
        self._answer_count = 0
        self._file: "IO[bytes] | None" = None
        self._size = self._read_bytes = 0
        self._looked_ms = self._stack_at_start = 0
        self._line_now = self._line_before = self._held_line = 0
        self.fault: "OSError | None" = None
        self.is_on = False
        # From here on the main loop reads and answers by this object.
        machine.protocol.link = self
        machine.protocol.read_into = self.read_into
        machine.state.hooks.refuse = self._refuse

    # Link

    @micropython.native
    def read_into(self, buf: bytearray) -> int:
        """Read received bytes into buf, or the file's while a job runs; return how many. During a
        job, handle the sender's bytes, and note in _line_now which line is in motion."""
        if not self.is_on:
            return self._read_link(buf)
        count = self._read_link(self._sender_bytes)
        if count:
            self._handle_sender(count)
        if self._state[_NOTED_HEAD] != self._flow[layout.HEAD]:
            _note_blocks(self._state, self._line_of_row, self._flow, 0)  # 0: none answered now
        port = self._machine.port
        if port.elapsed_ms(self._looked_ms) >= _IN_ENGINE_MS:
            self._looked_ms = port.ticks_ms()
            self._line_before, self._line_now = self._line_now, self.line_in_motion()
            state = self._machine.state
            if state.suspend & st.HOLD_COMPLETE and not state.system_motion:  # and not parking
                self._call_on_hold()
        if self._state[_BYTES_LEFT] == 0 and not (self._file and self._read_file()):
            return 0
        free = self._reader.free()
        return _deliver(
            self._file_bytes, self._state, buf, len(buf), free, self._kinds, self._flow
        )

    @micropython.native
    def write(self, data: "bytes | bytearray | memoryview") -> None:
        """Send an answer, but only count an ok to a line of the file, with the block it made.

        The results of startup lines, after $H, are sent.
        """
        if not self.is_on or data[0] != _LETTER_O or self._machine.commands.in_startup:
            self._write_link(data)
        else:
            oks = len(data) >> 2  # it is 1 or 2 times "ok\r\n"
            _note_blocks(self._state, self._line_of_row, self._flow, oks)

    def _refuse(self, code: int) -> None:
        """Handle a refused line: of the file by on_refusal, of the sender by an error."""
        if self.is_on and not self._machine.commands.in_startup:
            self._on_refusal(code)
        else:
            self._send_error(code)

    def discard(self) -> None:
        """Drop received bytes that are not read yet."""
        self._link.discard()

    # The file

    def start(self, file: "IO[bytes]", size: int, line: int = 0) -> None:
        """Start reading a file at its present position. size: see percent().

        `line` lines are before that position. Call it only while the ring is empty.
        """
        state = self._state
        state[_LINES_ANSWERED] = line
        state[_NOTED_HEAD] = self._flow[layout.HEAD]
        state[_BYTES_LEFT] = 0
        state[_LAST_BYTE] = _NEWLINE
        self._file, self._size, self._read_bytes = file, size, file.tell()
        self._line_now = self._line_before = line + 1
        self._held_line = 0
        self._looked_ms = self._machine.port.ticks_ms()
        self._stack_at_start = micropython.stack_use()
        self.fault = None
        self.is_on = True

    def stop_reading(self) -> None:
        """Stop reading the file, and drop its lines that are not executed yet."""
        if self._file:
            self._file.close()
            self._file = None
        self._state[_BYTES_LEFT] = 0
        self._reader.clear()

    def stop(self) -> None:
        """Let the loop read the sender again.

        The sender's unanswered lines are answered. The beginning of an unfinished one goes to the
        reader, where its rest follows.
        """
        self.stop_reading()
        self.answer()
        self.is_on = False
        if self._sender_line_length:
            stored = min(self._sender_line_length, len(self._sender_line))
            self._reader.feed(self._sender_line, stored)
            self._sender_line_length = 0

    def drop(self) -> None:
        """Stop after a reset: drop the sender's unfinished line and unanswered ones."""
        self._sender_line_length = self._answer_count = 0
        self.stop()

    def has_ended(self) -> bool:
        """Return whether all lines have been accepted."""
        return not (self._file or self._state[_BYTES_LEFT] or self._reader.has_line())

    def line(self) -> int:
        """Return the last line that has been answered."""
        return self._state[_LINES_ANSWERED]

    def executed_line(self) -> int:
        """Return the line whose motion was executed some 40 to 80 ms ago."""
        return self._line_before

    def _call_on_hold(self) -> None:
        """Call on_hold() in a complete hold, once per line, if the line is the same at two looks
        and the stack has space."""
        has_settled = self._line_before == self._line_now
        is_noted = self._held_line == self._line_now
        if has_settled and not is_noted and self._has_stack_for(_STACK_TO_NOTE):
            self._held_line = self._line_now
            self._on_hold()

    def _has_stack_for(self, limit: int) -> bool:
        """Return whether fewer bytes of stack than `limit` (_STACK_TO_NOTE, _STACK_TO_READ) are in
        use, beyond those in use at the job's start."""
        return micropython.stack_use() - self._stack_at_start < limit

    def line_in_motion(self) -> int:
        """Return the line of the block that the engine reads now; without blocks the line that
        will be answered next."""
        flow = self._flow
        tail = flow[layout.TAIL]
        if tail == flow[layout.HEAD]:
            return self._state[_LINES_ANSWERED] + 1
        return self._line_of_row[tail]

    def percent(self) -> float:
        """Return the bytes read, in percent of start()'s `size`: that of the whole job file."""
        return min(100 * self._read_bytes / (self._size or 1), 100.0)

    def _read_file(self) -> int:
        """Read the next bytes of the file into _file_bytes, if the stack has space. Return how
        many.

        At the file's end it is one LF if the last line has none.
        """
        state, file = self._state, self._file
        assert file
        if not self._has_stack_for(_STACK_TO_READ):
            return 0
        state[_NEXT_BYTE] = 0
        try:
            state[_BYTES_LEFT] = file.readinto(self._file_bytes)  # type: ignore[attr-defined]
        except OSError as fault:
            self.fault = fault
            self.stop_reading()  # an incomplete line is dropped
            return 0
        self._read_bytes += state[_BYTES_LEFT]
        if state[_BYTES_LEFT] == 0:
            file.close()
            self._file = None
            if state[_LAST_BYTE] != _NEWLINE:
                self._file_bytes[0] = _NEWLINE
                state[_BYTES_LEFT] = 1
        return state[_BYTES_LEFT]

    # The sender, meanwhile

    def _handle_sender(self, count: int) -> None:
        """Handle the first `count` bytes of _sender_bytes: post real-time bytes, store a line,
        queue its answer."""
        for i in range(count):
            c = self._sender_bytes[i]
            if self._kinds[c] == REALTIME:
                self._reader.post(c)
            elif c in b"\r\n":
                self._queue_answer()  # after CR, LF has one of its own, as with Grbl
                self._sender_line_length = 0
            else:
                if self._sender_line_length < len(self._sender_line):
                    self._sender_line[self._sender_line_length] = c
                self._sender_line_length += 1  # more than _sender_line holds: the line is too long

    def has_partial_line(self) -> bool:
        """Return whether the sender has begun a line, while the job runs."""
        return self._sender_line_length > 0

    def drop_partial_line(self) -> None:
        """Drop the sender's unfinished line, because it has gone."""
        self._sender_line_length = 0

    def _queue_answer(self) -> None:
        """Queue the answer to the sender's complete line, for the loop's next turn: an error
        number, 0 for ok to an empty line, or _READ_ONLY_FLAG with a read-only command's letter."""
        line = bytes(self._sender_line[: self._sender_line_length]).upper().strip()
        answer = 0
        if len(line) == 2 and line[0] == _DOLLAR and line[1] in READ_ONLY:
            answer = _READ_ONLY_FLAG | line[1]
        elif line:
            answer = errors.IDLE_ERROR if line[0] == _DOLLAR else errors.SYSTEM_GC_LOCK
        if self._answer_count == _MOST_ANSWERS:
            self._send_error(errors.OVERFLOW)  # such a sender does not count answers
            return
        self._answers[self._answer_count] = answer
        self._answer_count += 1
        self._machine.state.pending[st.ANY] = 1  # so that the loop answers between two lines

    def answer(self) -> None:
        """Answer the sender's lines, and execute its read-only commands. Called between two
        lines."""
        machine = self._machine
        for i in range(self._answer_count):
            answer = self._answers[i]
            try:
                if answer & _READ_ONLY_FLAG:
                    line = bytearray((_DOLLAR, answer & ~_READ_ONLY_FLAG, 0))
                    execute = machine.state.hooks.find_command(line, 2)
                    execute(line, 2)
                elif answer:
                    raise GrblError(answer)
                self._write_link(OK)
            except GrblError as reason:
                self._send_error(reason.code)
        self._answer_count = 0
