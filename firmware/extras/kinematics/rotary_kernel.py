# mypy: disable-error-code="arg-type, call-overload, has-type, misc"
"""The rotary kernel: the ratio of a line's whole length to the length of its linear part.

Viper, for rotary.py. motion/layout.py defines the indices.
"""

import micropython
from motion.layout import AXES, HEAD, LENGTH, LIMITS, ROW_SIZE
from motion.minifloat import BIAS, ONE, pack, square_root
from motion.steps import measure, to_steps


@micropython.viper
def stretch(target: ptr32, table: ptr32, ring: ptr32, flow: ptr32, linear: int) -> int:
    """Return length of all axes / length of the linear axes (a mask), as a real.

    ONE if nothing moves, 0 if no linear axis moves. target: mm or degrees, float32. The
    ring must have a free row, because the line is measured in the next block's row.

    Linear distances are added as squares of 14-bit mantissas with a common exponent, so five axes
    fit 31 bits.
    """
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
