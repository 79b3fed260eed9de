"""Lines: turn received bytes into clean lines; real-time bytes are removed first.

A real-time byte acts wherever it stands, also inside a line or a comment. All other bytes wait in
a ring until the main loop asks for a line. Senders that count characters rely on the ring's free
space.
"""

from array import array

import micropython
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

# What clean() found, in the lowest two bits; the length of the line is above them.
NOTHING = const(0)  # the line has not ended yet
LINE = const(1)  # a complete line
TOO_LONG = const(2)  # a line of which bytes were dropped

# Indices into the reader's state, an array of integers.
_SIZE = const(0)  # size of the ring, in bytes; one of them always stays free
HEAD = const(1)  # index in the ring where the next byte is stored
TAIL = const(2)  # and from where the next one is read
LENGTH = const(3)  # length of the line so far
_LONGEST = const(4)  # length that a line may have
_IF_TOO_LONG = const(5)  # what SKIPPING becomes then: _OVERFLOW, or 0: its rest is not skipped
SKIPPING = const(6)  # why bytes are dropped, a mask of:
_IN_PARENTHESES = const(1)  # in a comment that ) ends
_AFTER_SEMICOLON = const(2)  # in a comment that the line's end ends
_OVERFLOW = const(4)  # the line is too long: the rest of it is dropped
COMPLETE = const(8)  # the line is complete: the next call begins another
_ADVERTISED = const(7)  # bytes that a sender may have sent and not had answered

# Kinds of bytes, by value.
_STORED = const(0)  # as it is
REALTIME = const(1)  # never in the ring
END = const(2)  # of a line
_DROPPED = const(3)
_COMMENT_START = const(4)
_LOWER_CASE = const(5)  # stored as upper case

_OPENING = const(40)  # the character (
_CLOSING = const(41)  # the character )
_TO_UPPER = const(32)  # subtracted from a lower-case letter

# LineReader's `reads`: the first of the upper real-time bytes; one more real-time byte; and what
# to do with the rest of a line that is too long: _OVERFLOW skips it, 0 makes it a line of its own.
READS = (0x80, 0x84, _OVERFLOW)


@micropython.viper
def clean(ring: ptr8, state: ptr32, line: ptr8, kinds: ptr8) -> int:
    """Continue the line with bytes from the ring: make letters upper case; drop spaces, control
    characters, slashes and comments. A 0 is stored after the line.

    state: the reader's, by the indices above, with length and SKIPPING of the line so far; line:
    the buffer; kinds: the kind of each byte value. Returns NOTHING if the ring is empty before the
    line ends, else length << 2 | LINE or TOO_LONG. With state[_IF_TOO_LONG] 0 a line is TOO_LONG
    at once, and its rest is another line; else after its end.
    """
    tail = state[TAIL]
    head = state[HEAD]
    size = state[_SIZE]
    length = state[LENGTH]
    skipping = state[SKIPPING]
    if skipping & COMPLETE:
        length = 0
        skipping = 0
    longest = 0 if skipping else state[_LONGEST]  # 0: no more bytes are stored
    result = NOTHING
    while tail != head and result == NOTHING:
        c = ring[tail]
        tail += 1
        if tail == size:
            tail = 0
        kind = kinds[c]
        if kind == _STORED and length < longest:
            line[length] = c
            length += 1
        elif kind == END:
            result = TOO_LONG if skipping & _OVERFLOW else LINE
        elif skipping:
            if c == _CLOSING and skipping & _IN_PARENTHESES:
                skipping &= ~_IN_PARENTHESES
                longest = 0 if skipping else state[_LONGEST]
        elif kind == _DROPPED:
            pass
        elif kind == _COMMENT_START:
            skipping = _IN_PARENTHESES if c == _OPENING else _AFTER_SEMICOLON
            longest = 0
        elif length < longest:
            line[length] = c - _TO_UPPER
            length += 1
        else:  # no space for a byte to store
            skipping = state[_IF_TOO_LONG]
            longest = 0
            if skipping == 0:  # the byte that does not fit is lost
                result = TOO_LONG
    line[length] = 0
    state[TAIL] = tail
    state[LENGTH] = length
    state[SKIPPING] = COMPLETE if result else skipping
    return length << 2 | result if result else NOTHING


@micropython.viper
def free_space(state: ptr32) -> int:
    """Return how many bytes a sender may still send: the advertised number less the bytes in the
    ring; the ring itself may hold more. state: the reader's state."""
    used = state[HEAD] - state[TAIL]
    if used < 0:
        used += state[_SIZE]
    return state[_ADVERTISED] - used if used < state[_ADVERTISED] else 0


@micropython.viper
def has_bytes(state: ptr32) -> int:
    """Return 1 if the ring holds bytes, else 0. state: the reader's state."""
    return 1 if state[HEAD] != state[TAIL] else 0


@micropython.viper
def take_bytes(data: ptr8, count: int, ring: ptr8, state: ptr32, kinds: ptr8, post: object) -> int:
    """Move the first `count` bytes of data into the ring; call post with each real-time byte.
    Bytes that do not fit are lost. Returns 0.

    state: the reader's state; kinds: the kind of each byte value.
    """
    head = state[HEAD]
    tail = state[TAIL]
    size = state[_SIZE]
    for i in range(count):
        c = data[i]
        if kinds[c] == REALTIME:
            state[HEAD] = head  # post may read the state
            post(c)  # type: ignore[operator]
        else:
            following = head + 1
            if following == size:
                following = 0
            if following != tail:  # the ring is not full
                ring[head] = c
                head = following
    state[HEAD] = head
    return 0


def _make_kinds(first: int, extra: int) -> bytearray:
    """Return the kind of each of the 256 byte values. Real-time bytes: those from `first` on, and
    `extra`, in addition to the common ones."""
    kinds = bytearray(bytes([_DROPPED]) * 33 + bytes(223))  # 0 to the space; then _STORED, 0
    kinds[97:123] = bytes([_LOWER_CASE]) * 26  # a to z
    for chars, kind in (
        (b"/", _DROPPED),
        (b"\r\n", END),
        (b"(;", _COMMENT_START),
        (b"\x18?~!", REALTIME),
    ):
        for c in chars:
            kinds[c] = kind
    kinds[first:] = bytes([REALTIME]) * (256 - first)
    kinds[extra] = REALTIME
    return kinds


class LineReader:
    """The ring and the line being read. size: bytes that a sender may have sent and not had
    answered; longest: of a line; on_realtime: called with each real-time byte; reads: see READS;
    more: bytes that the ring holds in addition, for senders that miscount.

    clean(*memory()) continues the line. It returns length << 2 | LINE once the line is complete; a
    0 follows the line. _state: an array of integers, by the indices _SIZE, HEAD, TAIL, LENGTH,
    _LONGEST, _IF_TOO_LONG, SKIPPING, _ADVERTISED.
    """

    def __init__(
        self,
        size: int,
        longest: int,
        on_realtime: "Callable[[int], None]",
        reads: "tuple[int, int, int]" = READS,
        more: int = 0,
    ) -> None:
        self.line = bytearray(longest + 1)
        self.post = on_realtime
        self._ring = bytearray(size + more + 1)
        # In the order of the indices, from _SIZE to _ADVERTISED.
        self._state = array("i", (len(self._ring), 0, 0, 0, longest, reads[2], 0, size))
        self._kinds = _make_kinds(reads[0], reads[1])

    def memory(self) -> "tuple[bytearray, array[int], bytearray, bytearray]":
        """Return the arguments of clean(): ring, reader's state (indices HEAD, TAIL, …), line,
        kinds of bytes. All are shared, not copied."""
        return self._ring, self._state, self.line, self._kinds

    def feed(self, data: bytearray, count: int) -> None:
        """Accept the first `count` bytes of data. Bytes that do not fit are lost: the sender has
        miscounted."""
        take_bytes(data, count, self._ring, self._state, self._kinds, self.post)

    def free(self) -> int:
        """Return how many bytes a sender may still send."""
        return free_space(self._state)

    def waiting(self) -> bool:
        """Return whether the ring holds bytes that clean() has not read."""
        return self._state[HEAD] != self._state[TAIL]

    def has_line(self) -> bool:
        """Return whether a line is complete or begun, or bytes wait in the ring."""
        state = self._state
        return state[HEAD] != state[TAIL] or state[LENGTH] > 0 or state[SKIPPING] > 0

    def clear(self) -> None:
        """Drop everything received, also the line in progress."""
        self._state[TAIL] = self._state[HEAD]
        self._state[LENGTH] = 0
        self._state[SKIPPING] = 0
