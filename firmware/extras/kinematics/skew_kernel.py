# mypy: disable-error-code="arg-type, call-overload, has-type, misc"
"""The skew's kernel: from places of the axes to places of their motors, in whole steps.

Viper, for skew.py; what stands where is told in motion/layout.py. The
motor of Y is moved back by what the way of Z's brings along, that of X by what the ways of both
do. Each is rounded once, from steps that are whole already, so the way back is exact: unskew.
"""

import micropython
from micropython import const
from motion.arcs import FAR, KNOWN, LEFT, NOWHERE, SOME, advance
from motion.layout import AXES, HEAD, LIMITS, ROWS, TARGET
from motion.plan_kernel import FULL, OUTSIDE, full, plan

# What a machine's skew is made of: three shears, each a factor + FAR and its power of two, and
# behind them where the motors of the axes were homed, in steps + FAR.
XY = const(0)
XZ = const(2)
YZ = const(4)
HOMED = const(6)
LENGTH = const(9)

_Y = const(1)
_Z = const(2)
_BITS = const(15)  # factors, and ways, are multiplied in two halves
MOST_BITS = const(36)
FEWEST_BITS = const(21)
_PART_BITS = const(6)  # shears are in 2**-6 step until they are added up
_HALF = const(32)


@micropython.viper
def shear(way: int, skew: ptr32, at: int) -> int:
    """So many steps times a factor, in 2**-6 step: up to 2**24 steps."""
    factor = skew[at] - FAR
    bits = skew[at + 1] - _PART_BITS
    above = way >> _BITS
    below = way - (above << _BITS)
    high = factor >> _BITS
    low = factor - (high << _BITS)
    middle = above * low + below * high + ((below * low) >> _BITS)
    return ((above * high) << (2 * _BITS - bits)) + (middle >> (bits - _BITS))


@micropython.viper
def back_x(y: int, z: int, skew: ptr32) -> int:
    """How far, in steps, X is from its motor where those of Y and Z are that far from home."""
    return (int(shear(y, skew, XY)) + int(shear(z, skew, XZ)) + _HALF) >> _PART_BITS


@micropython.viper
def back_y(z: int, skew: ptr32) -> int:
    """How far Y is from its motor."""
    return (int(shear(z, skew, YZ)) + _HALF) >> _PART_BITS


@micropython.viper
def to_motors(table: ptr32, skew: ptr32) -> int:
    """TARGET of the planner's table was of axes, and now is of their motors."""
    at = LIMITS + TARGET * table[AXES]
    z = table[at + _Z] - skew[HOMED + _Z]
    table[at + _Y] = table[at + _Y] - int(back_y(z, skew))
    table[at] = table[at] - int(back_x(table[at + _Y] - skew[HOMED + _Y], z, skew))
    return 0


@micropython.viper
def follow_arc(
    course: ptr32,
    table: ptr32,
    ring: ptr32,
    flow: ptr32,
    speeds: ptr32,
    flags: int,
    line: int,
    power: int,
    rate: int,
    skew: ptr32,
) -> int:
    """As arcs.follow(), where something is to move."""
    found = 0
    while found == 0:
        if course[KNOWN] == 0:
            course[KNOWN] = 1
            if int(advance(course, table)):
                return OUTSIDE
            to_motors(table, skew)
        if int(full(flow)):
            return FULL
        at = flow[HEAD]
        if int(plan(course, table, ring, flow, flags, line, power, rate)):
            speeds[at] = speeds[flow[ROWS] + 1]
        else:
            found = NOWHERE
        course[KNOWN] = 0
        at = course[LEFT] - 1
        course[LEFT] = at
        if at & SOME == 0:
            break
    return found
