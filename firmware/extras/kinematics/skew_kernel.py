# mypy: disable-error-code="arg-type, call-overload, has-type, misc"
"""The skew kernel: from positions of axes to those of their motors, in whole steps.

Viper, for skew.py. motion/layout.py defines the indices. The motor of Y moves back by what Z
brings along, the motor of X by what Y and Z bring. Each correction is computed from whole steps
and rounded once, so the inverse is exact.
"""

import micropython
from micropython import const
from motion.arcs import CHORDS_LEFT, EIGHT_MASK, END_KNOWN, NOWHERE, PLACE_BIAS, next_chord
from motion.layout import AXES, HEAD, LIMITS, ROWS, TARGET
from motion.plan_kernel import FULL, OUTSIDE, full, plan_block

# The skew table: three shears, each with its factor + PLACE_BIAS and its number of fraction bits;
# then the motors' positions where they were homed, in steps + PLACE_BIAS.
XY = const(0)
XZ = const(2)
YZ = const(4)
HOMED = const(6)
LENGTH = const(9)

_Y = const(1)
_Z = const(2)
_LOW_BITS = const(15)  # of the lower half: factors and distances are multiplied in two halves
MOST_BITS = const(36)
FEWEST_BITS = const(21)
_PART_BITS = const(6)  # shears are in 2**-6 step until they are added
_HALF = const(32)  # half a step in that unit, for rounding


@micropython.viper
def shear(distance: int, skew: ptr32, index: int) -> int:
    """Return distance * factor, in 2**-6 step. distance: steps, up to 2**24 in size.

    factor = (skew[index] - PLACE_BIAS) / 2**skew[index + 1]; index: XY, XZ, YZ. Both are split at
    15 bits, so that each of the four products fits 32 bits:

        distance = above * 2**15 + below        factor = high * 2**15 + low
    """
    factor = skew[index] - PLACE_BIAS
    bits = skew[index + 1] - _PART_BITS
    above = distance >> _LOW_BITS
    below = distance - (above << _LOW_BITS)
    high = factor >> _LOW_BITS
    low = factor - (high << _LOW_BITS)
    # The product is above * high * 2**30 + middle * 2**15; it has `bits` more than the result.
    middle = above * low + below * high + ((below * low) >> _LOW_BITS)
    return ((above * high) << (2 * _LOW_BITS - bits)) + (middle >> (bits - _LOW_BITS))


@micropython.viper
def back_x(y: int, z: int, skew: ptr32) -> int:
    """Return X minus its motor, in steps: by what Y and Z bring X along. y, z: steps of the motors
    of Y and Z from home; skew: the skew table."""
    return (int(shear(y, skew, XY)) + int(shear(z, skew, XZ)) + _HALF) >> _PART_BITS


@micropython.viper
def back_y(z: int, skew: ptr32) -> int:
    """Return Y minus its motor, in steps: by what Z brings Y along. z: steps of the motor of Z
    from home; skew: the skew table."""
    return (int(shear(z, skew, YZ)) + _HALF) >> _PART_BITS


@micropython.viper
def to_motors(table: ptr32, skew: ptr32) -> int:
    """Replace TARGET in the planner's table, steps of axes, by steps of their motors. skew: the
    skew table. Z's motor is at Z; Y's depends on it, and X's on both. Returns 0."""
    at = LIMITS + TARGET * table[AXES]  # index of X's target; Y and Z follow
    z = table[at + _Z] - skew[HOMED + _Z]  # steps of Z's motor from home
    table[at + _Y] = table[at + _Y] - int(back_y(z, skew))  # now of Y's motor
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
    """Plan an arc's chords, as arcs.follow() with the same arguments, to positions of motors.
    skew: the skew table. Return the reason to pause:

    0 after some chords (the caller then services the machine) or all of them, OUTSIDE if the next
    is outside the travel, FULL if no row is free, NOWHERE if the last chord had no steps.
    """
    result = 0
    while result == 0:
        if course[END_KNOWN] == 0:  # else TARGET is the end of the next chord already
            course[END_KNOWN] = 1
            if int(next_chord(course, table)):
                return OUTSIDE
            to_motors(table, skew)
        if int(full(flow)):
            return FULL
        row = flow[HEAD]  # number of the row that plan_block() fills
        if int(plan_block(course, table, ring, flow, flags, line, power, rate)):
            speeds[row] = speeds[flow[ROWS] + 1]  # the arc's programmed spindle speed
        else:
            result = NOWHERE
        course[END_KNOWN] = 0
        chords_left = course[CHORDS_LEFT] - 1
        course[CHORDS_LEFT] = chords_left
        if chords_left & EIGHT_MASK == 0:  # each eighth one
            break
    return result
