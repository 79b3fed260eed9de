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

from talk.lines import LINE, NOTHING, clean, free_space, has_bytes, take_bytes
from talk.report import OK

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import Any

    from interfaces import Link
    from language.interpreter import Interpreter

    from talk.lines import LineReader

# After so many lines the main loop runs, even if more lines wait: it monitors motion and runs the
# hooks of extras. An even number, because answers are sent in pairs.
LINES = const(16)
_LONG = const(64)  # bytes to read at once if the ring has no space for a full buffer,
_SHORT = const(16)  # and if it has none for _LONG


def kernel_args(
    reader: "LineReader", interpreter: "Interpreter", link: "Link", buffer: bytearray
) -> "tuple[Any, ...]":
    """Return the second argument of run_lines(), a tuple of everything that it uses: the reader's
    memory, the interpreter's, the answers and, for _receive(), the link and three buffers. buffer:
    the largest of these, for received bytes."""
    long, short = bytearray(_LONG), bytearray(_SHORT)
    receiving = link.read_into, reader.post, len(buffer), buffer, long, short
    modal, machine, memory = interpreter.memory()
    return reader.memory() + (modal, machine, memory, link.write, OK, OK + OK, receiving)


@micropython.viper
def run_lines(pending: ptr8, loop_args: object) -> int:
    """Execute lines until one is not move-only or none is complete, an event is posted, or
    LINES_LEFT lines have been executed. Returns clean()'s result for the line that has not been
    executed, length << 2 | LINE or TOO_LONG, or NOTHING.

    pending: State.pending; loop_args: kernel_args(). Answers are sent in pairs, because a write
    takes as long as a third of a line: one is owed while the number of lines left is odd.
    """
    _ring, _reader, line, _kinds, _modal, _machine, memory, write, one_ok, two_oks, receiving = (
        loop_args
    )
    ring = ptr8(_ring)
    reader = ptr32(_reader)
    text = ptr8(line)
    kinds = ptr8(_kinds)
    modal = ptr32(_modal)
    counts = ptr32(_machine)
    lines_left = counts[LINES_LEFT]
    if int(has_bytes(reader)):  # perhaps a line: a ? after it must not wait for it
        _receive(pending, receiving, ring, reader, kinds)
    while lines_left > 0:
        result = int(clean(ring, reader, text, kinds))  # length << 2 | LINE or TOO_LONG; NOTHING
        may_execute = 0 if pending[ANY] else result & LINE  # an event comes before the line
        is_executed = 0  # stays 0 if the line is not move-only, or has to wait
        if may_execute:
            is_executed = int(execute(line, result >> 2, modal, counts, memory))
        if is_executed:
            lines_left -= 1
            counts[LINES_LEFT] = lines_left
            if lines_left & 1 == 0:  # two answers are owed
                write(two_oks)
                _receive(pending, receiving, ring, reader, kinds)
        else:
            if lines_left & 1:
                write(one_ok)
            # This turn counts as one line; & -2 makes the number even: no answer is owed.
            lines_left = (lines_left - 1) & -2
            counts[LINES_LEFT] = lines_left
            if (
                result
                or pending[ANY]
                or int(_receive(pending, receiving, ring, reader, kinds)) == 0
            ):
                return result
    return NOTHING


@micropython.viper
def _receive(pending: ptr8, receiving: object, ring: ptr8, reader: ptr32, kinds: ptr8) -> int:
    """Read the bytes received, because a ? after lines must not wait for them. Returns how many
    bytes, or 0 if an event is posted (ANY).

    It reads no more than the ring has space for, so nothing is lost if a sender does not count.
    The piece to read is the whole buffer; if the ring has less space, _LONG or _SHORT bytes.

    pending: State.pending; receiving: see kernel_args(); ring, reader, kinds: see take_bytes().
    """
    read_into, post, size, piece, long, short = receiving
    free = int(free_space(reader))
    count = 0
    more = 1
    while more and free >= _SHORT:
        piece_size = int(size)
        if free < piece_size:
            piece = long if free >= _LONG else short
            piece_size = _LONG if free >= _LONG else _SHORT
        read = int(read_into(piece))
        if read:
            take_bytes(ptr8(piece), read, ring, reader, kinds, post)
        count += read
        # A small piece was filled: more may wait. After a full buffer the next call reads on.
        more = 1 if read == piece_size and piece_size <= _LONG else 0
        free = int(free_space(reader))
    return 0 if pending[ANY] else count
