# mypy: disable-error-code="arg-type, call-overload, has-type, misc, operator"
"""Stream loop: runs move-only lines one after the other, in one call.

From received bytes to blocks of the planner and their answers nothing is looked up by its name and
no number is made an object. All other lines are the loop's (protocol.py).
"""

import micropython
from base.state import ANY
from language.block_layout import LINES_LEFT
from language.line import execute
from micropython import const

from talk.lines import LINE, NOTHING, clean, feed, free_space, has_bytes
from talk.report import OK

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import Any

    from interfaces import Link
    from language.interpreter import Interpreter

    from talk.lines import LineReader

# Behind so many lines the loop has its turn, however many wait: motion is watched there, and
# whoever has been put around it waits for that. An even number.
LINES = const(16)
# Bytes that are read where there is not room for all that may come.
_LONG = const(64)
_SHORT = const(16)


def kernel_args(
    reader: "LineReader", interpreter: "Interpreter", link: "Link", buffer: bytearray
) -> "tuple[Any, ...]":
    """What run_lines() is called with besides what is posted. buffer: for what is received."""
    long, short = bytearray(_LONG), bytearray(_SHORT)
    hears = link.read_into, reader.post, len(buffer), buffer, long, short
    modal, machine, memory = interpreter.memory()
    return reader.memory() + (modal, machine, memory, link.write, OK, OK + OK, hears)


@micropython.viper
def run_lines(pending: ptr8, needed: object) -> int:
    """Do lines up to one that does more than move, or none, or until something is posted, or for
    as long as the loop may wait. Returns what clean() has found at last, which is not done.

    Answers go out in twos, for to write takes as long as a third of a line: one is owed where an
    odd number is left.
    """
    ring, places, line, all_kinds, modes, machine, memory, write, one, both, hears = needed
    heard = ptr8(ring)
    at = ptr32(places)
    text = ptr8(line)
    kinds = ptr8(all_kinds)
    modal = ptr32(modes)
    counts = ptr32(machine)
    left = counts[LINES_LEFT]
    if int(has_bytes(at)):  # a ? is not to wait behind a line that is there
        _receive(pending, hears, heard, at, kinds)
    while left > 0:
        found = int(clean(heard, at, text, kinds))
        done = 0 if pending[ANY] else found & LINE
        if done:
            done = int(execute(line, found >> 2, modal, counts, memory))
        if done:
            left -= 1
            counts[LINES_LEFT] = left
            if left & 1 == 0:
                write(both)
                _receive(pending, hears, heard, at, kinds)
        else:
            if left & 1:
                write(one)
            left = (left - 1) & -2  # bytes without the end of a line count as one
            counts[LINES_LEFT] = left
            if found or pending[ANY] or int(_receive(pending, hears, heard, at, kinds)) == 0:
                return found
    return NOTHING


@micropython.viper
def _receive(pending: ptr8, hears: object, heard: ptr8, at: ptr32, kinds: ptr8) -> int:
    """Take in what has arrived, as much as fits: who counts nothing must not overrun the ring, and
    a ? that has come behind lines is not to wait for them. Returns whether it is for us to go on
    with."""
    read_into, post, size, piece, long, short = hears
    free = int(free_space(at))
    count = 0
    more = 1
    while more and free >= _SHORT:
        most = int(size)
        if free < most:
            piece = long if free >= _LONG else short
            most = _LONG if free >= _LONG else _SHORT
        read = int(read_into(piece))
        if read:
            feed(ptr8(piece), read, heard, at, kinds, post)
        count += read
        more = 1 if read == most and most <= _LONG else 0  # the end of what has come
        free = int(free_space(at))
    return 0 if pending[ANY] else count
