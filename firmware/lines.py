"""Lines: received bytes become clean lines; real-time bytes are taken off first.

A real-time byte acts wherever it stands, in the middle of a line or of a
comment. Everything else waits in a ring, whose free space is what senders
that count characters rely on, until the main loop asks for a line.
"""

from array import array

import micropython
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

# What take() found.
NOTHING = const(0)
LINE = const(1)
TOO_LONG = const(2)

# Where the reader is.
_SIZE = const(0)  # of the ring
_HEAD = const(1)
_TAIL = const(2)
_LENGTH = const(3)  # of the line so far
_LONGEST = const(4)
_FIRST_REALTIME = const(5)
_EXTRA_REALTIME = const(6)
_TOO_MUCH = const(7)
_SKIPPING = const(8)  # mask:
_IN_PARENTHESES = const(1)
_AFTER_SEMICOLON = const(2)
_OVERFLOW = const(4)

# What a reader is told: the first of the upper real-time bytes, one more of them, and what is
# to become of the rest of a line too long: _OVERFLOW skips it, 0 makes it a line of its own.
READS = (0x80, 0x84, _OVERFLOW)


@micropython.viper
def fill_ring(data: ptr8, span: int, ring: ptr8, at: ptr32) -> int:
    """Move data[start:count], span = count << 16 | start, into the ring, up to a real-time byte.

    Returns where that is, or count. Bytes that find no room are lost.
    """
    count = span >> 16
    i = span & 0xFFFF
    head = at[_HEAD]
    first = at[_FIRST_REALTIME]
    extra = at[_EXTRA_REALTIME]
    while i < count:
        c = data[i]
        if c >= first or c == 0x18 or c == 0x3F or c == 0x7E or c == 0x21 or c == extra:  # noqa: PLR1714
            break
        following = head + 1
        if following == at[_SIZE]:
            following = 0
        if following != at[_TAIL]:
            ring[head] = c
            head = following
        i += 1
    at[_HEAD] = head
    return i


@micropython.viper
def clean(ring: ptr8, at: ptr32, line: ptr8) -> int:
    """Go on with the line: upper case, no spaces, comments, control characters, slashes."""
    tail = at[_TAIL]
    length = at[_LENGTH]
    skipping = at[_SKIPPING]
    found = NOTHING
    while tail != at[_HEAD]:
        c = ring[tail]
        tail += 1
        if tail == at[_SIZE]:
            tail = 0
        if c == 10 or c == 13:  # noqa: PLR1714 (a viper cannot ask `in`)
            found = TOO_LONG if skipping & _OVERFLOW else LINE
            break
        if skipping:
            if c == 41:
                skipping &= ~_IN_PARENTHESES
        elif c <= 32 or c == 47:
            pass
        elif c == 40:
            skipping = _IN_PARENTHESES
        elif c == 59:
            skipping = _AFTER_SEMICOLON
        elif length >= at[_LONGEST]:
            skipping = at[_TOO_MUCH]
            if skipping == 0:
                found = TOO_LONG
                break
        else:
            line[length] = c - 32 if c >= 97 and c <= 122 else c
            length += 1
    line[length] = 0
    at[_TAIL] = tail
    at[_LENGTH] = length
    at[_SKIPPING] = skipping
    return found


class LineReader:
    """The ring and the line being put together. size: bytes of the ring; longest: of a line."""

    def __init__(
        self,
        size: int,
        longest: int,
        on_realtime: "Callable[[int], None]",
        reads: "tuple[int, int, int]" = READS,
    ) -> None:
        self.line = bytearray(longest + 1)
        self._on_realtime = on_realtime
        self._ring = bytearray(size + 1)
        self._at = array("i", (size + 1, 0, 0, 0, longest) + reads + (0,))  # noqa: RUF005

    @property
    def length(self) -> int:
        """Of the line that take() has found."""
        return self._at[_LENGTH]

    def feed(self, data: bytearray, count: int) -> None:
        """Accept received bytes. Those that do not fit are lost: the sender has miscounted."""
        i = fill_ring(data, count << 16, self._ring, self._at)
        while i < count:
            self._on_realtime(data[i])
            i = fill_ring(data, count << 16 | (i + 1), self._ring, self._at)

    def free(self) -> int:
        """Bytes that may still be sent."""
        at = self._at
        return at[_SIZE] - 1 - (at[_HEAD] - at[_TAIL]) % at[_SIZE]

    def waiting(self) -> bool:
        """Bytes have come that take() has not seen."""
        return self._at[_HEAD] != self._at[_TAIL]

    def clear(self) -> None:
        """Forget everything received, the line in progress too."""
        self._at[_TAIL] = self._at[_HEAD]
        self.next_line()

    def next_line(self) -> None:
        """The line has been dealt with."""
        self._at[_LENGTH] = 0
        self._at[_SKIPPING] = 0

    def take(self) -> int:
        """Go on with the line: LINE when one is complete in line[:length], followed by a 0."""
        return clean(self._ring, self._at, self.line)
