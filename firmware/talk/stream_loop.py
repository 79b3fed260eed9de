# mypy: disable-error-code="arg-type, call-overload, has-type, misc, operator"
"""Stream loop: executes move-only lines one after the other, in one call.

From received bytes to planner blocks and their answers, it looks up no name and allocates no
object. All other lines are executed by the main loop (protocol.py).
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

# After so many lines the main loop runs, even if more lines wait: it monitors motion and runs the
# hooks of extras. An even number.
LINES = const(16)
# Bytes to read at once if the ring may not hold all that may arrive.
_LONG = const(64)
_SHORT = const(16)


def kernel_args(
    reader: "LineReader", interpreter: "Interpreter", link: "Link", buffer: bytearray
) -> "tuple[Any, ...]":
    """Return the second argument of run_lines(). buffer: for received bytes."""
    long, short = bytearray(_LONG), bytearray(_SHORT)
    hears = link.read_into, reader.post, len(buffer), buffer, long, short
    modal, machine, memory = interpreter.memory()
    return reader.memory() + (modal, machine, memory, link.write, OK, OK + OK, hears)


@micropython.viper
def run_lines(pending: ptr8, needed: object) -> int:
    """Execute lines until one is not move-only or none is complete, an event is posted, or the
    main loop is due. Returns the last result of clean(), whose line has not been executed.

    needed: kernel_args(). Answers are sent in pairs, because a write takes as long as a third of a
    line: one is owed if an odd number is left.
    """
    ring, places, line, all_kinds, modes, machine, memory, write, one, both, hears = needed
    heard = ptr8(ring)
    at = ptr32(places)
    text = ptr8(line)
    kinds = ptr8(all_kinds)
    modal = ptr32(modes)
    counts = ptr32(machine)
    left = counts[LINES_LEFT]
    if int(has_bytes(at)):  # a ? must not wait for the line that is complete
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
            left = (left - 1) & -2  # a part of a line counts as one line
            counts[LINES_LEFT] = left
            if found or pending[ANY] or int(_receive(pending, hears, heard, at, kinds)) == 0:
                return found
    return NOTHING


@micropython.viper
def _receive(pending: ptr8, hears: object, heard: ptr8, at: ptr32, kinds: ptr8) -> int:
    """Read the bytes received, because a ? after lines must not wait for them.

    It reads no more than the ring has space for, so nothing is lost if a sender does not count.
    After a full piece of _LONG or _SHORT bytes it reads on; a piece that is not full means that
    nothing more has arrived. Returns how many bytes, or 0 if an event is posted.
    """
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
        more = 1 if read == most and most <= _LONG else 0
        free = int(free_space(at))
    return 0 if pending[ANY] else count
