# mypy: disable-error-code="arg-type, call-overload, has-type, misc"
"""The rotary kernel: the ratio of a line's whole length to the length of its linear part.

Viper, for rotary.py. motion/layout.py defines the indices.
"""

import micropython
from micropython import const
from motion.layout import AXES, HEAD, LENGTH, LIMITS, ROW_SIZE
from motion.minifloat import BIAS, ONE, pack, square_root
from motion.steps import measure, to_steps

_DISTANCE = const(5)  # multiple of the number of axes, after LIMITS in the planner's table
_MANTISSA_BITS = const(15)  # of a real; its exponent is above them
_MANTISSA = const(32767)  # mask of a real's mantissa


@micropython.viper
def stretch(target: ptr32, table: ptr32, ring: ptr32, flow: ptr32, linear: int) -> int:
    """Return the length of the line to target, over the length of its part along the linear axes
    (linear: a mask of them), as a real.

    ONE if nothing moves, 0 if no linear axis moves. target: mm or degrees, float32. table, ring,
    flow: the planner's. The ring must have a free row, because the line is measured there.

    Linear distances are added as squares of 14-bit mantissas with a common exponent, so five axes
    fit 31 bits.
    """
    to_steps(target, table)
    at = flow[HEAD] * flow[ROW_SIZE]  # index of the free row
    if int(measure(table, ring, at)) == 0:
        return ONE
    axes = table[AXES]
    distance = LIMITS + _DISTANCE * axes  # measure() has left each axis' distance here, a real
    highest_exponent = 0
    for i in range(axes):
        exponent = table[distance + i] >> _MANTISSA_BITS
        if (linear >> i) & 1 and exponent > highest_exponent:
            highest_exponent = exponent
    squares = 0
    for i in range(axes):
        axis_distance = table[distance + i]
        if (linear >> i) & 1 and axis_distance:
            shift = highest_exponent - (axis_distance >> _MANTISSA_BITS) + 1
            mantissa = (axis_distance & _MANTISSA) >> shift if shift < _MANTISSA_BITS else 0
            squares += mantissa * mantissa
    if squares == 0:
        return 0
    linear_length = int(pack(int(square_root(squares)), highest_exponent + 1))  # + 1 as in shift
    length = ring[at + LENGTH]
    # The quotient of the mantissas has 15 bits more than 1: the exponent has 15 less.
    exponent = (
        (length >> _MANTISSA_BITS) - (linear_length >> _MANTISSA_BITS) + BIAS - _MANTISSA_BITS
    )
    quotient = ((length & _MANTISSA) << _MANTISSA_BITS) // (linear_length & _MANTISSA)
    return int(pack(quotient, exponent))
