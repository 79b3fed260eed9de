# mypy: disable-error-code=arg-type
"""Arcs: chord by chord along a course.

A course is an array of integers that arc_geometry.lay() fills once for each arc. Positions in it
are fixed-point numbers of steps: an axis has a unit, which is its step / 2**STEP_BITS. The two
axes of the plane rotate about the centre; the others of a helix advance evenly. Integers, because
an interrupt may come at any time and a float is an object; main loop only. The planner's arrays
table, ring and flow are described in layout.py: TARGET, from LIMITS on, is the end of the next
block, per axis; HEAD is the row that plan_block() fills, ROWS the number of rows.
"""

from array import array

import micropython
from base.float32 import copy
from micropython import const

from motion.layout import AXES, HEAD, LIMITS, ROWS, TARGET
from motion.plan_kernel import FULL, OUTSIDE, full, plan_block

FARTHEST = 268435456.0  # 2**28, in units or steps: no position in a course is farther from 0

NOWHERE = const(4)  # a third result of follow(), with OUTSIDE and FULL
EIGHT_MASK = const(7)  # follow() returns if no bit is left of the chords left: at each eighth one

# A course: indexes.
CHORDS_LEFT = const(0)  # chords still to be made, without the last one
END_KNOWN = const(1)  # 1: the end of the next chord is in TARGET already
PLANE_AXES = const(2)  # two: the plane's axes, as indexes in the course, in the order of the turn
SHIFT = const(4)  # how many more bits shears, POSITION_REST and CHORD_ADVANCE have than units
SHEARS = const(5)  # two: the rotation by one chord, in 2**-(28 + SHIFT): see rotate()
CHORD_TOLERANCE = const(7)  # how far chords may stray from the arc, a float, mm
# Then, per axis, from FIRST_AXIS + AXIS_STRIDE * axis on: its position, in units; and further:
FIRST_AXIS = const(8)  # index of the first axis's integers
POSITION_REST = const(1)  # the position's fraction, in 2**-SHIFT unit
STEP_BITS = const(2)  # a step is 2**STEP_BITS units
CENTRE = const(3)  # position of the arc's centre, in units; in the plane only
CHORD_ADVANCE = const(4)  # how far a helix advances per chord, in 2**-SHIFT unit
_LEAST = const(5)  # the least TARGET allowed, in steps + PLACE_BIAS
_GREATEST = const(6)  # the greatest TARGET allowed, in steps + PLACE_BIAS
AXIS_STRIDE = const(7)  # integers per axis
PLACE_BIAS = const(0x20000000)  # 2**29, added to positions and shears, as to TARGET
ADVANCE_BIAS_LOG2 = const(30)  # 2**30 is added to CHORD_ADVANCE


def course_length(axes: int) -> int:
    """Return the number of integers in a course."""
    return FIRST_AXIS + AXIS_STRIDE * axes


def limit(course: "array[int]", axis: int, least: float, greatest: float) -> None:
    """Set the positions, in steps, between which an axis (its number) must stay. They are cut to
    the range that a course can hold, FARTHEST."""
    at = FIRST_AXIS + AXIS_STRIDE * axis
    course[at + _LEAST] = PLACE_BIAS + int(max(least, -FARTHEST))
    course[at + _GREATEST] = PLACE_BIAS + int(min(greatest, FARTHEST))


def stray(course: "array[int]", mm: float) -> None:
    """Set how far chords may stray from an arc, mm. The float is stored as its bits."""
    copy(array("f", (mm,)), memoryview(course)[CHORD_TOLERANCE:], 1)


@micropython.viper
def rotate(course: ptr32, shift: int) -> int:
    """Rotate the position in the plane by the angle of one chord, phi.

    Three shears, with x and y seen from the centre, t = tan(phi / 2) and s = sin(phi):

        x -= t * y        y += s * x        x -= t * y

    Their product is the matrix of the rotation. A rounded shear can be undone exactly, so the
    radius does not drift, however many chords there are. The changes are small where chords are
    many; they are computed with `shift` more bits than positions have, and the remainder is kept
    in POSITION_REST for the next chord: errors grow with the angle, not with the number of chords.
    Positions and centres: up to 2**28 units; shears: 2**-(28 + shift), + PLACE_BIAS.
    """
    # Each shear changes one axis of the plane by the other's distance from the centre.
    changed = course[PLANE_AXES]
    source = course[PLANE_AXES + 1]
    for i in range(3):
        away = course[source] - course[source + CENTRE]
        shear = course[SHEARS + (i & 1)] - PLACE_BIAS  # -t, s, -t
        # away * shear / 2**28, in halves of 14 bits so that each product fits 31.
        above = away >> 14
        high = shear >> 14
        change = ((away - (above << 14)) * high) >> 14
        change += above * high + ((above * (shear - (high << 14))) >> 14)
        change += course[changed + POSITION_REST]  # in 2**-shift unit
        units = change >> shift
        course[changed + POSITION_REST] = change - (units << shift)
        course[changed] = course[changed] + units
        # The axes change roles.
        other = changed
        changed = source
        source = other
    return 0


@micropython.viper
def next_chord(course: ptr32, table: ptr32) -> int:
    """Advance by one chord: its end, in whole steps, goes into TARGET of the planner's table.

    Returns OUTSIDE if that is outside the limits of any axis (limit()), else 0.
    """
    shift = course[SHIFT]
    rotate(course, shift)
    first = LIMITS + TARGET * table[AXES]
    at = FIRST_AXIS  # index in the course of an axis
    beyond = 0  # negative once an axis is outside
    for place in range(first, first + table[AXES]):
        # Units first, then whole steps. CHORD_ADVANCE has a bias of 1 << ADVANCE_BIAS_LOG2, a
        # position one of PLACE_BIAS.
        rest = course[at + POSITION_REST] + course[at + CHORD_ADVANCE]
        units = rest >> shift
        course[at + POSITION_REST] = rest - (units << shift)
        units += course[at] - (1 << (ADVANCE_BIAS_LOG2 - shift))
        course[at] = units
        steps = ((units - PLACE_BIAS) >> course[at + STEP_BITS]) + PLACE_BIAS
        table[place] = steps
        # Negative where steps is less than _LEAST, or more than _GREATEST.
        beyond |= (steps - course[at + _LEAST]) | (course[at + _GREATEST] - steps)
        at += AXIS_STRIDE
    return OUTSIDE if beyond < 0 else 0


@micropython.viper
def follow(
    course: ptr32,
    table: ptr32,
    ring: ptr32,
    flow: ptr32,
    speeds: ptr32,
    flags: int,
    line: int,
    power: int,
    rate: int,
) -> int:
    """Plan chords, up to eight, until the link must be read again.

    flags, line, power, rate: see plan_kernel.plan_block(); flags 0: check mode, nothing moves.
    Returns the reason to pause: OUTSIDE or FULL if the next chord cannot be planned, NOWHERE if
    the last one had no steps, else 0: eight are made, or all. speeds: each block's programmed
    spindle speed, for overrides and reports; speeds[flow[ROWS] + 1] is the arc's.
    """
    reason = 0
    while reason == 0:
        if course[END_KNOWN] == 0:  # after FULL the end is known already
            course[END_KNOWN] = 1
            if int(next_chord(course, table)):
                return OUTSIDE
        if flags:
            if int(full(flow)):
                return FULL
            row = flow[HEAD]  # the one that plan_block() fills
            if int(plan_block(course, table, ring, flow, flags, line, power, rate)):
                speeds[row] = speeds[flow[ROWS] + 1]
            else:
                reason = NOWHERE
        course[END_KNOWN] = 0
        chords_left = course[CHORDS_LEFT] - 1
        course[CHORDS_LEFT] = chords_left
        if chords_left & EIGHT_MASK == 0:  # each eighth one
            break
    return reason
