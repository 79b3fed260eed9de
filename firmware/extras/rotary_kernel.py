# mypy: disable-error-code="arg-type, call-overload, has-type, misc"
"""The rotary axes' kernel: how long the way of a line is beside that of its linear axes, and lines
that do no more than move.

Viper, for rotary.py; what stands where is told in motion/layout.py and language/fast_kernel.py.
"""

import micropython
from base.f32 import copy
from language import fast_kernel as fk
from language.fast_kernel import line_number
from motion.layout import AXES, HEAD, LENGTH, LIMITS, PLACED, ROW_SIZE
from motion.plan_kernel import plan
from motion.reals import BIAS, ONE, mul, pack, square_root
from motion.steps import measure, to_steps

from extras.line_kernel import take


@micropython.viper
def names_any(text: ptr8, length: int, letters: int) -> int:
    """Whether a line has any of these letters (a mask, A is bit 0)."""
    for i in range(length):
        letter = text[i] - 65
        if letter >= 0 and letter < 26 and (letters >> letter) & 1:
            return 1
    return 0


@micropython.viper
def stretch(target: ptr32, table: ptr32, ring: ptr32, flow: ptr32, linear: int) -> int:
    """How many times as long as the way of the linear axes (a mask) that of all axes is, on a line
    to target: a real; 0 where no linear axis moves, ONE where nothing moves. Wants room in the
    ring, for it measures where the next block will be."""
    to_steps(target, table)
    at = flow[HEAD] * flow[ROW_SIZE]
    if int(measure(table, ring, at)) == 0:
        return ONE
    axes = table[AXES]
    distance = LIMITS + 5 * axes
    top = 0
    for i in range(axes):
        exponent = table[distance + i] >> 15
        if (linear >> i) & 1 and exponent > top:
            top = exponent
    squares = 0
    for i in range(axes):
        mantissa = table[distance + i]
        if (linear >> i) & 1 and mantissa:
            shift = top - (mantissa >> 15) + 1
            mantissa = (mantissa & 32767) >> shift if shift < 15 else 0
            squares += mantissa * mantissa
    if squares == 0:
        return 0
    way = int(pack(int(square_root(squares)), top + 1))
    length = ring[at + LENGTH]
    exponent = (length >> 15) - (way >> 15) + BIAS - 15
    return int(pack(((length & 32767) << 15) // (way & 32767), exponent))


@micropython.viper
def follow_turning(text: ptr8, length: int, memory: object, linear: int) -> int:
    """As fast_kernel.follow_line(), a line with words of rotary axes, in so far as take() takes
    it. linear: mask of axes."""
    seen = int(take(text, length, memory))
    if seen == 0:
        return 0
    modes, position, places, _, axes, ring, queue, speeds, _, _, _, _ = memory
    known = ptr32(modes)
    target = ptr32(places)
    table = ptr32(axes)
    flow = ptr32(queue)
    rate = known[fk.RATE]
    flags = known[fk.FLAGS]
    if known[fk.MODE] == fk.HAS_G1 and known[fk.IS_TIMED] == 0:
        flags |= PLACED
        times = int(stretch(target, table, ptr32(ring), flow, linear))
        if times:
            rate = int(mul(rate, times))
    at = flow[HEAD]
    line = int(line_number(known, seen))
    if int(plan(target, table, ptr32(ring), flow, flags, line, known[fk.POWER], rate)) == 0:
        return 0
    ptr32(speeds)[at] = known[fk.RPM]
    copy(target, ptr32(position), known[fk.AXES])
    return 1
