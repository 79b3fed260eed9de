# mypy: disable-error-code=arg-type
"""Arcs: chord by chord along a course.

A course is an array of integers that arc_geometry.lay() fills once for each arc. Positions in it
are fixed-point numbers of steps. The two axes of the plane rotate about the centre; the others of
a helix advance evenly. Integers, because an interrupt may come at any time and a float is an
object; main loop only.
"""

from array import array

import micropython
from base.float32 import copy
from micropython import const

from motion.layout import AXES, HEAD, LIMITS, ROWS, TARGET
from motion.plan_kernel import FULL, OUTSIDE, full, plan

# Units of places: so many reach as far as an arc does.
FARTHEST = 268435456.0

NOWHERE = const(4)  # a third result, with OUTSIDE and FULL
SOME = const(7)  # so many chords, and one, are planned without a look at the link: a mask

# A course: chords still to be made, all but the last; whether the place of the next is known;
LEFT = const(0)
KNOWN = const(1)
# where the plane's axes begin, in the order in which the arc turns; what its turn is made of,
# in 2**-(28 + shift);
TURNING = const(2)
SHIFT = const(4)
SHEARS = const(5)
# how far chords may stray from the arc, a float, mm;
STRAY = const(7)
# and per axis: its place, and 2**-shift of its unit; how many of its bits are a part of a step;
# where its centre is; how far it goes per chord, in 2**-shift; between which TARGETs it has to be.
FIRST = const(8)
REST = const(1)
BITS = const(2)
CENTRE = const(3)
WAY = const(4)
_LEAST = const(5)
_GREATEST = const(6)
STRIDE = const(7)
FAR = const(0x20000000)  # added to places and shears, as to TARGET
WAY_BIAS = const(30)  # added to ways, as a power of two


def course_length(axes: int) -> int:
    """Return the number of integers in a course."""
    return FIRST + STRIDE * axes


def limit(course: "array[int]", axis: int, least: float, greatest: float) -> None:
    """Set the steps from 0 between which an axis must stay. They are cut to what a course can
    hold."""
    at = FIRST + STRIDE * axis
    course[at + _LEAST] = FAR + int(max(least, -FARTHEST))
    course[at + _GREATEST] = FAR + int(min(greatest, FARTHEST))


def stray(course: "array[int]", mm: float) -> None:
    """Set how far chords may stray from an arc, mm. The float is stored as its bits."""
    copy(array("f", (mm,)), memoryview(course)[STRAY:], 1)


@micropython.viper
def rotate(course: ptr32, shift: int) -> int:
    """Rotate the position in the plane by the angle of one chord, phi.

    Three shears, with x and y seen from the centre, t = tan(phi / 2) and s = sin(phi):

        x -= t * y        y += s * x        x -= t * y

    Their product is the matrix of the rotation. A rounded shear can be undone exactly, so the
    radius does not drift, however many chords there are. The changes are small where chords are
    many; they are computed with `shift` more bits than positions have, and the remainder is kept
    in REST for the next chord: errors grow with the angle, not with the number of chords.
    Positions and centres: up to 2**28 units; shears: 2**-(28 + shift), + FAR.
    """
    # Each shear changes one axis of the plane by the other's distance from the centre.
    changed = course[TURNING]
    source = course[TURNING + 1]
    for i in range(3):
        away = course[source] - course[source + CENTRE]
        shear = course[SHEARS + (i & 1)] - FAR  # -t, s, -t
        # away * shear / 2**28, in halves of 14 bits so that each product fits 31.
        above = away >> 14
        high = shear >> 14
        change = ((away - (above << 14)) * high) >> 14
        change += above * high + ((above * (shear - (high << 14))) >> 14) + course[changed + REST]
        above = change >> shift
        course[changed + REST] = change - (above << shift)
        course[changed] = course[changed] + above
        # The axes change places.
        above = changed
        changed = source
        source = above
    return 0


@micropython.viper
def advance(course: ptr32, table: ptr32) -> int:
    """Advance by one chord: its end, in whole steps, goes into TARGET of the planner's table.

    Returns OUTSIDE where that is outside the machine's travel, else 0.
    """
    shift = course[SHIFT]
    rotate(course, shift)
    first = LIMITS + TARGET * table[AXES]
    at = FIRST
    beyond = 0
    for place in range(first, first + table[AXES]):
        # Units first, then whole steps. WAY has a bias of 1 << WAY_BIAS, a position one of FAR.
        rest = course[at + REST] + course[at + WAY]
        steps = rest >> shift
        course[at + REST] = rest - (steps << shift)
        steps += course[at] - (1 << (WAY_BIAS - shift))
        course[at] = steps
        steps = ((steps - FAR) >> course[at + BITS]) + FAR
        table[place] = steps
        # Negative where steps is less than _LEAST, or more than _GREATEST.
        beyond |= (steps - course[at + _LEAST]) | (course[at + _GREATEST] - steps)
        at += STRIDE
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

    flags, line, power, rate: as of plan_kernel.plan(); flags 0: check mode, nothing is to move.
    Returns why the next chord cannot be planned, OUTSIDE or FULL; NOWHERE where the last one had
    no steps; else 0. speeds[ROWS + 1] is the arc's programmed speed, for reports.
    """
    reason = 0
    while reason == 0:
        if course[KNOWN] == 0:
            course[KNOWN] = 1
            if int(advance(course, table)):
                return OUTSIDE
        if flags:
            if int(full(flow)):
                return FULL
            at = flow[HEAD]  # the row that plan() fills
            if int(plan(course, table, ring, flow, flags, line, power, rate)):
                speeds[at] = speeds[flow[ROWS] + 1]
            else:
                reason = NOWHERE
        course[KNOWN] = 0
        at = course[LEFT] - 1  # chords still to be made
        course[LEFT] = at
        if at & SOME == 0:  # each eighth one
            break
    return reason
