# mypy: disable-error-code="arg-type, call-overload, has-type, misc"
"""The rotary axes' kernel: how long the way of a line is beside that of its linear axes.

Viper, for rotary.py; what stands where is told in motion/layout.py.
"""

import micropython
from motion.layout import AXES, HEAD, LENGTH, LIMITS, ROW_SIZE
from motion.minifloat import BIAS, ONE, pack, square_root
from motion.steps import measure, to_steps


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
