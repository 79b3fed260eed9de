# mypy: disable-error-code=arg-type
"""Arcs: from centre and target to chords that stray no further than the tolerance.

An Arc is what the parser has found. It lays a course, once and in floats: an array of integers,
along which advance() goes chord by chord and allocates nothing. Places in it are fixed-point
numbers of steps. Those of the plane turn about their centres, those of other axes go evenly.
"""

import math

import micropython
from base.f32 import f32, whole
from micropython import const

from motion.layout import AXES, HEAD, LIMITS, ROWS, TARGET
from motion.plan_kernel import FULL, OUTSIDE, full, plan

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array

# Below this a sweep counts as none, which means a full circle.
_NO_SWEEP = 5e-7
_WIDEST = 1.5  # radians: what has wider chords, smaller than the tolerance, gets more of them
# Units of places: so many reach as far as an arc does, and so many at the most are a step.
FARTHEST = 268435456.0
_FINEST = 134217728.0

NOWHERE = const(4)  # beside OUTSIDE and FULL
SOME = const(7)  # so many chords, and one, are planned without a look at the link: a mask

# A course: chords still to be made, all but the last; whether the place of the next is known;
LEFT = const(0)
KNOWN = const(1)
# where the plane's axes begin, in the order in which the arc turns; what its turn is made of,
# in 2**-(28 + shift);
_PLANE = const(2)
_SHIFT = const(4)
_SHEARS = const(5)
# and per axis: its place, and 2**-shift of its unit; how many of its bits are a part of a step;
# where its centre is; how far it goes per chord, in 2**-shift; between which TARGETs it has to be.
_FIRST = const(7)
_REST = const(1)
_BITS = const(2)
_CENTRE = const(3)
_WAY = const(4)
_LEAST = const(5)
_GREATEST = const(6)
_STRIDE = const(7)
FAR = const(0x20000000)  # added to places and shears, as to TARGET
_WAY_BIAS = const(30)  # added to ways, as a power of two


def course_length(axes: int) -> int:
    """Integers in a course."""
    return _FIRST + _STRIDE * axes


def limit(course: "array[int]", axis: int, least: float, greatest: float) -> None:
    """Say between which steps the places of an axis have to be."""
    at = _FIRST + _STRIDE * axis
    course[at + _LEAST] = FAR + int(max(least, -FARTHEST))
    course[at + _GREATEST] = FAR + int(min(greatest, FARTHEST))


@micropython.viper
def rotate(course: ptr32, shift: int) -> int:
    """Turn the places of the plane on by a chord's angle.

    With the places x and y seen from their centre, x -= t * y, y += s * x, x -= t * y, where s is
    the angle's sine and t the tangent of its half: the radius cannot change. Such products are
    small where chords are many, so they are made with `shift` bits more than places have, which
    wait for the next chord: errors grow with the angle and not with the number of chords.
    """
    one = course[_PLANE]
    other = course[_PLANE + 1]
    for i in range(3):
        away = course[other] - course[other + _CENTRE]
        shear = course[_SHEARS + (i & 1)] - FAR
        # Their product / 2**28.
        above = away >> 14
        high = shear >> 14
        change = ((away - (above << 14)) * high) >> 14
        change += above * high + ((above * (shear - (high << 14))) >> 14) + course[one + _REST]
        above = change >> shift
        course[one + _REST] = change - (above << shift)
        course[one] = course[one] + above
        above = one
        one = other
        other = above
    return 0


@micropython.viper
def advance(course: ptr32, table: ptr32) -> int:
    """Go on by a chord: its place, in whole steps, comes into TARGET of the planner's table.

    Returns OUTSIDE where that is outside the machine's travel; 0.
    """
    shift = course[_SHIFT]
    rotate(course, shift)
    target = LIMITS + TARGET * table[AXES]
    at = _FIRST
    beyond = 0
    for i in range(target, target + table[AXES]):
        rest = course[at + _REST] + course[at + _WAY]
        steps = rest >> shift
        course[at + _REST] = rest - (steps << shift)
        steps += course[at] - (1 << (_WAY_BIAS - shift))
        course[at] = steps
        steps = ((steps - FAR) >> course[at + _BITS]) + FAR
        table[i] = steps
        beyond |= (steps - course[at + _LEAST]) | (course[at + _GREATEST] - steps)
        at += _STRIDE
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
    """Plan chords until the link is to be looked at. flags: 0 where nothing is to move.

    Returns what stands against the next, OUTSIDE or FULL; NOWHERE, where the last had no steps; or
    0. Behind the speeds of the ring's blocks stands that of the arc.
    """
    found = 0
    while found == 0:
        if course[KNOWN] == 0:
            course[KNOWN] = 1
            if int(advance(course, table)):
                return OUTSIDE
        if flags:
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


class Arc:
    """Geometry of one arc. plane: its two axes.

    centre: offset of the centre from the start, in the plane; the radius is the
    parser's, so that a helix's end does not bend it.
    """

    def __init__(self) -> None:
        self.plane = (0, 1)
        self.clockwise = False
        self.radius = 0.0
        self.centre_0 = 0.0
        self.centre_1 = 0.0

    def lay(
        self,
        start: "array[float]",
        target: "array[float]",
        tolerance: float,
        steps_per_mm: "array[float]",
        course: "array[int]",
    ) -> int:
        """Lay its course. Returns how many chords it takes; 0 and 1 mean a straight line."""
        angle = self.sweep(start, target)
        chords = self._count(angle, tolerance)
        scale = self._scale(start, target, steps_per_mm)
        course[LEFT] = course[KNOWN] = 0
        if chords > 1 and scale:
            if angle > _WIDEST * chords:
                chords *= 2
            course[LEFT] = chords - 1
            angle = f32(angle / chords)
            sine = f32(math.sin(angle))
            course[_SHIFT] = shift = min(-math.frexp(sine)[1], math.frexp(chords)[1])
            ratio = self._place(start, target, scale, steps_per_mm, course)
            course[_SHEARS] = FAR - int(f32(math.tan(angle / 2) * ratio) * 2.0 ** (28 + shift))
            course[_SHEARS + 1] = FAR + int(f32(sine / ratio) * 2.0 ** (28 + shift))
        return chords if scale else 0

    def sweep(self, start: "array[float]", target: "array[float]") -> float:
        """The angle travelled, in radians."""
        a, b = self.plane
        from_0, from_1 = -self.centre_0, -self.centre_1
        to_0 = target[a] - start[a] - self.centre_0
        to_1 = target[b] - start[b] - self.centre_1
        angle = math.atan2(from_0 * to_1 - from_1 * to_0, from_0 * to_0 + from_1 * to_1)
        if self.clockwise:
            angle = -angle
        if angle <= _NO_SWEEP:
            angle += 2 * math.pi
        return f32(angle)

    def _count(self, angle: float, tolerance: float) -> int:
        squared = tolerance * (2 * self.radius - tolerance)
        if squared <= 0:
            return 0
        return whole(0.5 * angle * self.radius / math.sqrt(squared)) & 0xFFFF

    def _scale(
        self, start: "array[float]", target: "array[float]", steps_per_mm: "array[float]"
    ) -> float:
        """Units per mm, half of those that there is room for. 0 where places are too far for whole
        steps, or are no numbers."""
        reach = 1 + 5 * self.radius  # a place, on its way, is up to three radii from its start
        finest = coarsest = steps_per_mm[0]
        for i in range(len(start)):
            reach += abs(start[i]) + abs(target[i])
            resolution = steps_per_mm[i]
            if resolution > finest:
                finest = resolution
            elif resolution < coarsest:
                coarsest = resolution
        if not reach * finest < FARTHEST:
            return 0.0
        return min(FARTHEST / reach, coarsest * _FINEST)

    def _place(
        self,
        start: "array[float]",
        target: "array[float]",
        scale: float,
        steps_per_mm: "array[float]",
        course: "array[int]",
    ) -> float:
        """Put places where the arc begins, and where they go. Returns how many times as many units
        of the one axis of the plane are a mm as of the other."""
        a, b = self.plane
        ratio = 1.0
        for i in range(len(start)):
            resolution = steps_per_mm[i]
            bits = math.frexp(scale / resolution)[1]
            per_mm = resolution * (1 << bits)
            at = _FIRST + _STRIDE * i
            place = int(start[i] * per_mm)
            course[at] = FAR + place + (1 << bits >> 1)
            course[at + _REST] = 0
            course[at + _BITS] = bits
            course[at + _WAY] = 1 << _WAY_BIAS
            if i != a and i != b:  # noqa: PLR1714 (it would make a tuple)
                if target[i] != start[i]:  # else no integer of more than 30 bits is made
                    way = int(target[i] * per_mm) - place
                    course[at + _WAY] += (way << course[_SHIFT]) // (course[LEFT] + 1)
                continue
            centre = self.centre_0 if i == a else self.centre_1
            course[at + _CENTRE] = course[at] + int(centre * per_mm)
            if (i == a) is self.clockwise:
                course[_PLANE + 1] = at
                ratio /= per_mm
            else:
                course[_PLANE] = at
                ratio *= per_mm
        return ratio
