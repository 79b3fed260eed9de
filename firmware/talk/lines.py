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
NOTHING = const(0)
LINE = const(1)
TOO_LONG = const(2)

# Indices into the reader's state, an array of integers.
_SIZE = const(0)  # size of the ring, in bytes; one of them always stays free
HEAD = const(1)  # index in the ring where the next byte is stored
TAIL = const(2)  # and from where the next one is read
LENGTH = const(3)  # length of the line so far
_LONGEST = const(4)  # length that a line may have
_TOO_MUCH = const(5)  # what SKIPPING becomes when a line is longer: _OVERFLOW, or 0
SKIPPING = const(6)  # why bytes are dropped, a mask of:
_IN_PARENTHESES = const(1)
_AFTER_SEMICOLON = const(2)
_OVERFLOW = const(4)  # the line is too long: the rest of it is dropped
COMPLETE = const(8)  # the line is complete: the next call begins another
_ADVERTISED = const(7)  # bytes that a sender may have sent and not had answered

# Kinds of bytes, by value.
_AS_IT_IS = const(0)
REALTIME = const(1)
END = const(2)  # of a line
_NOTHING = const(3)  # dropped
_COMMENT = const(4)  # begins one
_LOWER_CASE = const(5)

_OPENING = const(40)  # (
_CLOSING = const(41)  # )
_TO_UPPER = const(32)  # less, in ASCII

# LineReader's `reads`: the first of the upper real-time bytes; one more real-time byte; and what
# to do with the rest of a line that is too long: _OVERFLOW skips it, 0 makes it a line of its own.
READS = (0x80, 0x84, _OVERFLOW)


@micropython.viper
def clean(ring: ptr8, state: ptr32, line: ptr8, kinds: ptr8) -> int:
    """Continue the line with bytes from the ring: make letters upper case; drop spaces, control
    characters, slashes and comments. A 0 is stored after the line.

    state: the reader's; line: the buffer; kinds: the kind of each byte value. Returns NOTHING if
    the ring is empty before the line ends, else length << 2 | LINE or TOO_LONG. With
    state[_TOO_MUCH] 0 a line is TOO_LONG at once, and its rest is another line; else after its
    end.
    """
    tail = state[TAIL]
    head = state[HEAD]
    size = state[_SIZE]
    length = state[LENGTH]
    skipping = state[SKIPPING]
    if skipping & COMPLETE:
        length = 0
        skipping = 0
    # The length that the line may have; 0 stores nothing.
    room = 0 if skipping else state[_LONGEST]
    result = NOTHING
    while tail != head and result == NOTHING:
        c = ring[tail]
        tail += 1
        if tail == size:
            tail = 0
        kind = kinds[c]
        if kind == _AS_IT_IS and length < room:
            line[length] = c
            length += 1
        elif kind == END:
            result = TOO_LONG if skipping & _OVERFLOW else LINE
        elif skipping:
            if c == _CLOSING and skipping & _IN_PARENTHESES:
                skipping &= ~_IN_PARENTHESES
                room = 0 if skipping else state[_LONGEST]
        elif kind == _NOTHING:
            pass
        elif kind == _COMMENT:
            skipping = _IN_PARENTHESES if c == _OPENING else _AFTER_SEMICOLON
            room = 0
        elif length < room:
            line[length] = c - _TO_UPPER
            length += 1
        else:
            # The line is too long.
            skipping = state[_TOO_MUCH]
            room = 0
            if skipping == 0:
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
def feed(data: ptr8, count: int, ring: ptr8, state: ptr32, kinds: ptr8, post: object) -> int:
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
    kinds = bytearray(bytes([_NOTHING]) * 33 + bytes(223))  # up to the space; then _AS_IT_IS
    kinds[97:123] = bytes([_LOWER_CASE]) * 26  # a to z
    for chars, kind in (
        (b"/", _NOTHING),
        (b"\r\n", END),
        (b"(;", _COMMENT),
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
    0 follows the line. _at: the state, by the indices above.
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
        # By index, from _SIZE to _ADVERTISED.
        self._at = array("i", (len(self._ring), 0, 0, 0, longest, reads[2], 0, size))
        self._kinds = _make_kinds(reads[0], reads[1])

    def memory(self) -> "tuple[bytearray, array[int], bytearray, bytearray]":
        """Return the arguments of clean(): ring, reader's state (indices HEAD, TAIL, …), line,
        kinds of bytes. All are shared, not copied."""
        return self._ring, self._at, self.line, self._kinds

    def feed(self, data: bytearray, count: int) -> None:
        """Accept the first `count` bytes of data. Bytes that do not fit are lost: the sender has
        miscounted."""
        feed(data, count, self._ring, self._at, self._kinds, self.post)

    def free(self) -> int:
        """Return how many bytes a sender may still send."""
        return free_space(self._at)

    def waiting(self) -> bool:
        """Return whether the ring holds bytes that clean() has not read."""
        return self._at[HEAD] != self._at[TAIL]

    def has_line(self) -> bool:
        """Return whether a line is complete or begun, or bytes wait in the ring."""
        state = self._at
        return state[HEAD] != state[TAIL] or state[LENGTH] > 0 or state[SKIPPING] > 0

    def clear(self) -> None:
        """Drop everything received, also the line in progress."""
        self._at[TAIL] = self._at[HEAD]
        self._at[LENGTH] = 0
        self._at[SKIPPING] = 0
