"""Lines: received bytes become clean lines; real-time bytes are taken off first.

A real-time byte acts wherever it stands, in the middle of a line or of a
comment. Everything else waits in a ring, whose free space is what senders
that count characters rely on, until the main loop asks for a line.
"""

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

_FIRST_EXTENDED = const(0x80)
# Soft reset, status query, cycle start, feed hold.
_REALTIME = b"\x18?~!"

# What take() found.
NOTHING = const(0)
LINE = const(1)
TOO_LONG = const(2)

_IN_PARENTHESES = const(1)
_AFTER_SEMICOLON = const(2)
_OVERFLOW = const(4)


class LineReader:
    """The ring and the line being put together. size: bytes of the ring; longest: of a line."""

    def __init__(self, size: int, longest: int, on_realtime: "Callable[[int], None]") -> None:
        self.line = bytearray(longest + 1)
        self.length = 0
        self._on_realtime = on_realtime
        self._ring = bytearray(size + 1)
        self._head = 0
        self._tail = 0
        self._skipping = 0

    def feed(self, data: bytearray, count: int) -> None:
        """Accept received bytes. Those that do not fit are lost: the sender has miscounted."""
        ring = self._ring
        size = len(ring)
        head = self._head
        for i in range(count):
            c = data[i]
            if c >= _FIRST_EXTENDED or c in _REALTIME:
                self._head = head
                self._on_realtime(c)
                head = self._head
                continue
            following = head + 1
            if following == size:
                following = 0
            if following != self._tail:
                ring[head] = c
                head = following
        self._head = head

    def free(self) -> int:
        """Bytes that may still be sent."""
        size = len(self._ring)
        return size - 1 - (self._head - self._tail) % size

    def waiting(self) -> bool:
        """Bytes have come that take() has not seen."""
        return self._head != self._tail

    def clear(self) -> None:
        """Forget everything received, the line in progress too."""
        self._tail = self._head
        self.next_line()

    def next_line(self) -> None:
        """The line has been dealt with."""
        self.length = 0
        self._skipping = 0

    def take(self) -> int:
        """Go on with the line: LINE when one is complete in line[:length], followed by a 0."""
        ring = self._ring
        size = len(ring)
        line = self.line
        length = self.length
        skipping = self._skipping
        found = NOTHING
        while self._tail != self._head:
            c = ring[self._tail]
            self._tail = self._tail + 1 if self._tail + 1 < size else 0
            if c in (10, 13):
                found = TOO_LONG if skipping & _OVERFLOW else LINE
                break
            if skipping:
                if c == 41 and skipping & _IN_PARENTHESES:
                    skipping &= ~_IN_PARENTHESES
            elif c <= 32 or c == 47:
                pass
            elif c == 40:
                skipping = _IN_PARENTHESES
            elif c == 59:
                skipping = _AFTER_SEMICOLON
            elif length >= len(line) - 1:
                skipping = _OVERFLOW
            else:
                line[length] = c - 32 if 97 <= c <= 122 else c
                length += 1
        line[length] = 0
        self.length = length
        self._skipping = skipping
        return found
