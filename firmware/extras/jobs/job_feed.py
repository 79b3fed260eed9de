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

_BLOCK = const(512)  # bytes of the file that are read at once
_HEARD = const(32)  # bytes of the sender that are read at once
_FEW = const(12)  # blocks: a piece of the file may make as many
_OWED = const(32)  # answers to the sender that may wait
# Bytes of stack that may be in use, beyond the depth at the start of the job, when a hold is noted
# and when the file is read. A file system needs much stack.
_TO_NOTE = const(1216)
_TO_READ = const(1664)
# ms: motion that the planner counts as executed may be in the engine for so long.
_MADE_MS = const(40)

# Indices of the kernels' state, an array of integers.
_ANSWERED = const(0)  # number of lines answered
_NOTED = const(1)  # row of the planner's ring up to which lines are noted
_FROM = const(2)  # index in the file's block of the next byte to deliver,
_LEFT = const(3)  # and number of bytes left
_LAST = const(4)  # the last byte delivered
_ROOM = const(5)  # free bytes of the reader's ring when it is empty

_NEWLINE = const(10)
_RETURN = const(13)
_DOLLAR = const(36)
_READ = const(0x80)  # added to the letter of a read-only command
_O = const(111)  # first letter of the positive answer
_STARTUP = const(62)  # ">", before the result of a startup line


@micropython.viper
def _deliver(
    block: ptr8, state: ptr32, buf: ptr8, size: int, room: int, kinds: ptr8, flow: ptr32
) -> int:
    """Move bytes of the file into buf. Return their number, at most `size` and `room`.

    block: the file's bytes; state: of the kernels; size: of buf; room: the free bytes of the
    reader's ring; kinds: the kind of each byte value; flow: the planner's state. Real-time
    commands and CR become spaces; a line ends with LF.

    With fewer than _FEW free blocks it delivers at most as many lines, and only when the ring is
    empty. So no line waits inside the interpreter, and a hold finds the stack nearly empty.
    """
    free = flow[layout.TAIL] - flow[layout.HEAD] - 1
    if free < 0:
        free += flow[layout.ROWS]
    if free < _FEW and (free == 0 or room < state[_ROOM]):
        return 0
    start = state[_FROM]
    left = state[_LEFT]
    if room > size:
        room = size
    if room > left:
        room = left
    count = 0
    while count < room:
        c = block[start + count]
        buf[count] = 32 if kinds[c] == REALTIME or c == _RETURN else c
        state[_LAST] = c
        count += 1
        if c == _NEWLINE:
            free -= 1
            if free == 0:
                room = count
    state[_FROM] = start + count
    state[_LEFT] = left - count
    return count


@micropython.viper
def _note(state: ptr32, lines: ptr32, flow: ptr32, answers: int) -> int:
    """Note the line of each block planned since the last call. The result is not used.

    state: of the kernels; lines: the line's number of each row of the planner's ring; flow: the
    planner's state. answers: number of lines answered now, 1 or 2; 0 within a line, an arc for
    example. If two lines have made one block, it is noted as the first one's.
    """
    row = state[_NOTED]
    head = flow[layout.HEAD]
    rows = flow[layout.ROWS]
    line = state[_ANSWERED] + 1  # of the first block; the others are of the last line answered
    later = state[_ANSWERED] + answers if answers else line
    state[_ANSWERED] += answers
    while row != head:
        lines[row] = line
        line = later
        row += 1
        if row == rows:
            row = 0
    state[_NOTED] = row
    return line


class Feed:
    """A Link for the loop.

    on_refusal: called with Grbl's error number when a line of the file is refused. on_hold: called
    in a hold, when its line is known. is_on: a job runs. fault: the error that has ended reading.

    _file: None once all is read; _size, _read_bytes: its bytes, and how many were read. _block,
    _at: its bytes being delivered, and the kernels' state. _lines: a line's number per row of the
    planner's ring. _made, _before: the line that the engine was given last, at the last look and
    at the one before, _MADE_MS earlier; _held: the line that on_hold() was called for. _depth:
    bytes of stack in use at the start. Of the sender: _heard, bytes just read; _said, the first
    _said_length bytes of its unfinished line; _owed, answers to its lines, _owed_count of them.
    _is_startup: the next answer is a startup line's.
    """

    def __init__(
        self,
        machine: "Controller",
        on_refusal: "Callable[[int], object]",
        on_hold: "Callable[[], object]",
    ) -> None:
        self._machine = machine
        self._link = machine.protocol.link
        self._read = self._link.read_into
        self._write = self._link.write
        self._error = machine.state.hooks.refuse
        self._on_refusal = on_refusal
        self._on_hold = on_hold
        self._reader = machine.reader
        _, _, _, self._kinds = machine.reader.memory()
        self._flow = machine.planner.flow
        self._lines = array("i", bytes(4 * self._flow[layout.ROWS]))
        self._at = array("i", bytes(24))
        self._at[_ROOM] = self._reader.free()
        self._block = bytearray(_BLOCK)
        self._heard = bytearray(_HEARD)
        self._said = bytearray(len(machine.reader.line))
        self._said_length = 0
        self._owed = bytearray(_OWED)
        self._owed_count = 0
        self._file: "IO[bytes] | None" = None
        self._size = self._read_bytes = 0
        self._is_startup = False
        self._since = self._made = self._before = self._held = self._depth = 0
        self.fault: "OSError | None" = None
        self.is_on = False
        machine.protocol.link = self
        machine.protocol.read_into = self.read_into
        machine.state.hooks.refuse = self._refuse

    # Link

    @micropython.native
    def read_into(self, buf: bytearray) -> int:
        """Read received bytes into buf, or the file's while a job runs; return how many. During a
        job, handle the sender's bytes, and note in _made which line is in motion."""
        if not self.is_on:
            return self._read(buf)
        count = self._read(self._heard)
        if count:
            self._receive(count)
        if self._at[_NOTED] != self._flow[layout.HEAD]:
            _note(self._at, self._lines, self._flow, 0)
        port = self._machine.port
        if port.elapsed_ms(self._since) >= _MADE_MS:
            self._since = port.ticks_ms()
            self._before, self._made = self._made, self.line_in_motion()
            state = self._machine.state
            if state.suspend & st.HOLD_COMPLETE and not state.system_motion:  # and not parking
                self._hold()
        if self._at[_LEFT] == 0 and not (self._file and self._fetch()):
            return 0
        room = self._reader.free()
        return _deliver(self._block, self._at, buf, len(buf), room, self._kinds, self._flow)

    @micropython.native
    def write(self, data: "bytes | bytearray | memoryview") -> None:
        """Send an answer, but only count an ok to a line of the file, with the block it made.

        The results of startup lines, after $H, are sent.
        """
        if not self.is_on or data[0] != _O or self._is_startup:
            self._is_startup = data[0] == _STARTUP
            self._write(data)
        else:
            _note(self._at, self._lines, self._flow, len(data) >> 2)  # 1 or 2 times "ok\r\n"

    def _refuse(self, code: int) -> None:
        """Handle a refused line: of the file by on_refusal, of the sender by an error."""
        if self.is_on and not self._is_startup:
            self._on_refusal(code)
        else:
            self._is_startup = False
            self._error(code)

    def discard(self) -> None:
        """Drop received bytes that are not read yet."""
        self._link.discard()

    # The file

    def start(self, file: "IO[bytes]", size: int, line: int = 0) -> None:
        """Start reading a file of `size` bytes at its present position.

        `line` lines are before that position. Call it only while the ring is empty.
        """
        state = self._at
        state[_ANSWERED] = line
        state[_NOTED] = self._flow[layout.HEAD]
        state[_LEFT] = 0
        state[_LAST] = _NEWLINE
        self._file, self._size, self._read_bytes = file, size, file.tell()
        self._made = self._before = line + 1
        self._held = 0
        self._since = self._machine.port.ticks_ms()
        self._depth = micropython.stack_use()
        self.fault = None
        self.is_on = True

    def stop_reading(self) -> None:
        """Stop reading the file, and drop its lines that are not executed yet."""
        if self._file:
            self._file.close()
            self._file = None
        self._at[_LEFT] = 0
        self._reader.clear()

    def stop(self) -> None:
        """Let the loop read the sender again.

        Its unanswered lines are answered. The beginning of an unfinished line is put before its
        rest.
        """
        self.stop_reading()
        self.answer()
        self.is_on = False
        if self._said_length:
            self._reader.feed(self._said, min(self._said_length, len(self._said)))
            self._said_length = 0

    def drop(self) -> None:
        """Stop after a reset: what the sender has sent before is dropped."""
        self._said_length = self._owed_count = 0
        self.stop()

    def has_ended(self) -> bool:
        """Return whether all lines have been accepted."""
        return not (self._file or self._at[_LEFT] or self._reader.has_line())

    def line(self) -> int:
        """Return the last line that has been answered."""
        return self._at[_ANSWERED]

    def executed_line(self) -> int:
        """Return the line whose motion was executed some 40 to 80 ms ago."""
        return self._before

    def _hold(self) -> None:
        """Call on_hold() in a complete hold, once per line, if the line is the same at two looks
        and the stack has space."""
        at_rest = self._before == self._made != self._held
        if at_rest and self._has_stack(_TO_NOTE):
            self._held = self._made
            self._on_hold()

    def _has_stack(self, more: int) -> bool:
        """Return whether less stack is in use than `more` bytes beyond the job's start."""
        return micropython.stack_use() - self._depth < more

    def line_in_motion(self) -> int:
        """Return the line of the block that the engine was given last; without blocks the line
        that will be answered next."""
        flow = self._flow
        tail = flow[layout.TAIL]
        return self._at[_ANSWERED] + 1 if tail == flow[layout.HEAD] else self._lines[tail]

    def percent(self) -> float:
        """Return how much of the file has been read, in percent."""
        return min(100 * self._read_bytes / (self._size or 1), 100.0)

    def _fetch(self) -> int:
        """Read the next block of the file, if the stack has space. Return its number of bytes.

        At the file's end it is one LF if the last line has none.
        """
        state, file = self._at, self._file
        assert file
        if not self._has_stack(_TO_READ):
            return 0
        state[_FROM] = 0
        try:
            state[_LEFT] = file.readinto(self._block)  # type: ignore[attr-defined]
        except OSError as fault:
            self.fault = fault
            self.stop_reading()  # an incomplete line is dropped
            return 0
        self._read_bytes += state[_LEFT]
        if state[_LEFT] == 0:
            file.close()
            self._file = None
            if state[_LAST] != _NEWLINE:
                self._block[0] = _NEWLINE
                state[_LEFT] = 1
        return state[_LEFT]

    # The sender, meanwhile

    def _receive(self, count: int) -> None:
        """Handle the sender's first `count` bytes of _heard: post real-time bytes, store a line,
        queue its answer."""
        for i in range(count):
            c = self._heard[i]
            if self._kinds[c] == REALTIME:
                self._reader.post(c)
            elif c in b"\r\n":
                self._queue_answer()  # after CR, LF has one of its own, as with Grbl
                self._said_length = 0
            else:
                if self._said_length < len(self._said):
                    self._said[self._said_length] = c
                self._said_length += 1  # more than _said holds: the line is too long

    def has_half(self) -> bool:
        """Return whether the sender has begun a line, while the job runs."""
        return self._said_length > 0

    def drop_half(self) -> None:
        """Drop the sender's unfinished line, because it has gone."""
        self._said_length = 0

    def _queue_answer(self) -> None:
        """Queue the answer to the sender's complete line, for the loop's next turn: an error
        number, 0 for ok to an empty line, or _READ with the letter of a read-only command."""
        line = bytes(self._said[: self._said_length]).upper().strip()
        answer = 0
        if len(line) == 2 and line[0] == _DOLLAR and line[1] in READ_ONLY:
            answer = _READ | line[1]
        elif line:
            answer = errors.IDLE_ERROR if line[0] == _DOLLAR else errors.SYSTEM_GC_LOCK
        if self._owed_count == _OWED:
            self._error(errors.OVERFLOW)  # such a sender does not count answers
            return
        self._owed[self._owed_count] = answer
        self._owed_count += 1
        self._machine.state.pending[st.ANY] = 1  # so that the loop answers between two lines

    def answer(self) -> None:
        """Answer the sender's lines, and execute its read-only commands. Called between two
        lines."""
        machine = self._machine
        for i in range(self._owed_count):
            answer = self._owed[i]
            try:
                if answer & _READ:
                    line = bytearray((_DOLLAR, answer & ~_READ, 0))
                    machine.state.hooks.find_command(line, 2)(line, 2)
                elif answer:
                    raise GrblError(answer)
                self._write(OK)
            except GrblError as reason:
                self._error(reason.code)
        self._owed_count = 0
