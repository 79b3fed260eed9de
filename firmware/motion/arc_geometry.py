# mypy: disable-error-code=arg-type
"""The geometry of an arc: from its ends and its centre to a course (arcs.py).

In single precision, as Grbl's, but on the bits of floats (base/float32_math.py), so that nothing
is left on the heap. An arc's numbers are an array of floats, r: the arc's own, scratch places,
constants, at the indexes below. A function names the indexes of its results; A, B and C may be
lost. On a float's bits, + _TWICE doubles it and - _TWICE halves it, & 0x7FFFFFFF removes its
sign, ^ MINUS (last byte) negates it; of two positive ones the larger has the larger bits.
multiply(r, i, s, j) is r[i] *= s[j]; likewise quotient() and subtract(); but
add_single(s, j, r, i) is r[i] += s[j]; root(r, i): r[i] = sqrt(r[i]); whole_part(r, i, n):
int(r[i] * 2**n). start, target: mm, a float per axis.
"""

from array import array

import micropython
from base.float32_math import MINUS, add_single, multiply, quotient, root, store, whole_part
from micropython import const

from motion import arcs

# Indexes of an arc's numbers.
RADIUS = const(0)  # mm, as the parser has it
CENTRE_0 = const(1)  # the arc's centre on the plane's first axis, relative to the start, mm
CENTRE_1 = const(2)  # the same on its second axis
TOLERANCE = const(3)  # how far chords may be off the arc, mm
ANGLE = const(4)  # the angle travelled, radians
A = const(5)  # scratch: lost in any function
B = const(6)  # scratch
C = const(7)  # scratch
_SINE = const(8)  # of a chord's angle: see _chord_rotation(). In sweep() scratch, too
_TANGENT = const(9)  # of half that angle. In sweep() scratch, too
_UNITS_PER_MM = const(10)  # of the course's positions, on all axes about: see _scale()
_UNIT_RATIO = const(11)  # units per mm of one axis over those of the other: see _place_axes()
_ONE = const(12)  # from here on, constants
_QUARTER_PI = const(13)
_HALF_PI = const(14)
_PI = const(15)
_TWO_PI = const(16)
_ATAN_FACTORS = const(17)  # of a series, fitted to the arc tangent up to _FLAT
_ATAN_TERMS = const(5)  # how many factors
_SINE_FACTORS = const(22)  # of another, fitted to the sine up to 0.8
_SINE_TERMS = const(3)  # how many factors

# An arc's plane, an array.
ONE_AXIS = const(0)  # index of the plane's first axis, in the order of the offsets
OTHER_AXIS = const(1)  # index of its second axis
CLOCKWISE = const(2)  # 1: it turns clockwise

_FACTORS = (
    (1.0, 0.7853981634, 1.5707963268, 3.1415926536, 6.2831853072),
    (-0.33333331, 0.19999610, -0.14265575, 0.10757241, -0.06488714),
    (-0.16666664, 0.0083327042, -0.00019578569),
)

# Bits of floats.
_NO_SWEEP = const(0x350637BD)  # 5e-7 radians: counts as none, so as a full circle of equal ends
_SAME_MM = const(0x3851B717)  # 0.00005 mm: equal ends are no farther apart
_FLAT = const(0x3ED413CD)  # tan(pi / 8), the bits of a float
_TWICE = const(0x800000)  # added to the bits of a float, doubles it
_WIDEST = const(98304)  # 1.5 radians, in 2**-16: if chords are wider, there are twice as many
_FEW_CHORDS = const(5)  # 5 chords, even of a full circle, are not as wide
_MOST_STEP_BITS = const(27)  # a step is at most 2**27 units


@micropython.viper
def subtract(r: ptr32, at: int, other: ptr32, i: int) -> int:
    """Subtract the float other[i] from r[at]: negate, add, negate. A 0 is never -0."""
    ptr8(r)[4 * at + 3] ^= MINUS
    add_single(other, i, r, at)
    if r[at] & int(0x7FFFFFFF):
        ptr8(r)[4 * at + 3] ^= MINUS  # negate
    return 0


@micropython.viper
def length(r: ptr32, at: int, of: int) -> int:
    """Set r[at] to sqrt(r[at]**2 + r[of]**2). r[of] is lost."""
    multiply(r, at, r, at)
    multiply(r, of, r, of)
    add_single(r, of, r, at)
    return int(root(r, at))


@micropython.viper
def _series(r: ptr32, at: int, first: int, terms: int) -> int:
    """Set x = r[at] to x + x * (f0 x**2 + f1 x**4 + …) by Horner's rule; r[first] is f0."""
    r[A] = r[at]
    multiply(r, A, r, A)  # x**2
    factor = first + terms - 1  # its index: the last one first
    r[B] = r[factor]
    while factor > first:
        factor -= 1
        multiply(r, B, r, A)
        add_single(r, factor, r, B)
    multiply(r, B, r, A)
    multiply(r, B, r, at)
    return int(add_single(r, B, r, at))


@micropython.viper
def _direction(r: ptr32, y: int, x: int) -> int:
    """Set r[ANGLE] to atan2(r[y], r[x]), radians, -pi to pi (0 if both are 0); these are lost.

    The smaller of the two by the larger is a tangent t from 0 to 1. Above tan(pi / 8) it is
    replaced by (t - 1) / (t + 1), whose angle is pi / 4 less, so that the series is short.
    """
    x_negative = ptr8(r)[4 * x + 3] & MINUS
    y_negative = ptr8(r)[4 * y + 3] & MINUS
    r[x] = r[x] & int(0x7FFFFFFF)
    r[y] = r[y] & int(0x7FFFFFFF)
    r[ANGLE] = 0
    if r[x] | r[y] == 0:
        return 0
    steep = 1 if r[y] > r[x] else 0
    if steep:
        r[ANGLE] = r[x]
        quotient(r, ANGLE, r, y)
    else:
        r[ANGLE] = r[y]
        quotient(r, ANGLE, r, x)
    wide = 1 if r[ANGLE] > _FLAT else 0  # bits of floats compare as they do
    if wide:  # (t - 1) / (t + 1)
        r[A] = r[ANGLE]
        add_single(r, _ONE, r, A)
        subtract(r, ANGLE, r, _ONE)
        quotient(r, ANGLE, r, A)
    _series(r, ANGLE, _ATAN_FACTORS, _ATAN_TERMS)
    if wide:
        add_single(r, _QUARTER_PI, r, ANGLE)
    if steep:  # pi / 2 - ANGLE
        ptr8(r)[4 * ANGLE + 3] ^= MINUS  # negate
        add_single(r, _HALF_PI, r, ANGLE)
    if x_negative:  # pi - ANGLE
        ptr8(r)[4 * ANGLE + 3] ^= MINUS  # negate
        add_single(r, _PI, r, ANGLE)
    ptr8(r)[4 * ANGLE + 3] ^= y_negative
    return 0


@micropython.viper
def _is_short(r: ptr32, plane: ptr32, start: ptr32, target: ptr32) -> int:
    """Return 1 if an arc whose ANGLE is about 0 is short: its ends differ by more than 0.00005 mm
    and than rounding. ANGLE is distance / radius then. Else 0: it is a full circle."""
    if r[RADIUS] == 0:
        return 0
    r[C] = _SAME_MM  # becomes the largest difference that may be rounding, mm
    for i in range(2):
        axis = plane[i]  # ONE_AXIS, OTHER_AXIS
        r[A + i] = target[axis]  # A, B: the differences of the ends
        subtract(r, A + i, start, axis)
        rounding = target[axis] & int(0x7FFFFFFF)
        if rounding < start[axis] & int(0x7FFFFFFF):
            rounding = start[axis] & int(0x7FFFFFFF)
        rounding -= 23 * _TWICE  # halved 23 times: one or two units in the last place
        if r[C] < rounding:
            r[C] = rounding
    if r[A] & int(0x7FFFFFFF) <= r[C] and r[B] & int(0x7FFFFFFF) <= r[C]:
        return 0  # the ends are the same
    # C: twice that, as an angle. A larger ANGLE is no rounding error, but nearly a full circle.
    r[C] = r[C] + _TWICE
    quotient(r, C, r, RADIUS)
    size = r[ANGLE] & int(0x7FFFFFFF)
    if size > _NO_SWEEP and size > r[C]:
        return 0
    length(r, A, B)
    r[ANGLE] = r[A]
    quotient(r, ANGLE, r, RADIUS)
    return 1


@micropython.viper
def sweep(r: ptr32, plane: ptr32, start: ptr32, target: ptr32) -> int:
    """Set r[ANGLE] to the angle travelled, radians, 0 to 2 pi. Equal ends make a full circle.

    atan2(r0 x r1, r0 . r1) of the radii to start and end. Both products are computed from the
    difference of the ends, because that of two nearly equal radii would lose all digits. Grbl
    loses them, and takes such a short arc for a full circle: docs/conformance.md.
    """
    one = plane[ONE_AXIS]
    other = plane[OTHER_AXIS]
    r[_SINE] = target[one]  # x and y of the difference, in scratch places
    subtract(r, _SINE, start, one)
    r[_TANGENT] = target[other]
    subtract(r, _TANGENT, start, other)
    # C, the cross product: CENTRE_1 * x - CENTRE_0 * y.
    r[C] = r[_SINE]
    multiply(r, C, r, CENTRE_1)
    r[A] = r[_TANGENT]
    multiply(r, A, r, CENTRE_0)
    subtract(r, C, r, A)
    # _SINE, the scalar product: CENTRE_0 * (CENTRE_0 - x) + CENTRE_1 * (CENTRE_1 - y).
    subtract(r, _SINE, r, CENTRE_0)
    subtract(r, _TANGENT, r, CENTRE_1)
    multiply(r, _SINE, r, CENTRE_0)
    multiply(r, _TANGENT, r, CENTRE_1)
    add_single(r, _TANGENT, r, _SINE)
    ptr8(r)[4 * _SINE + 3] ^= MINUS  # negate
    _direction(r, C, _SINE)
    if plane[CLOCKWISE]:
        ptr8(r)[4 * ANGLE + 3] ^= MINUS  # negate
    if ptr8(r)[4 * ANGLE + 3] & MINUS or r[ANGLE] <= _NO_SWEEP:
        if int(_is_short(r, plane, start, target)) == 0:
            add_single(r, _TWO_PI, r, ANGLE)
    return 0


@micropython.viper
def _chord_count(r: ptr32) -> int:
    """Return the number of chords, Grbl's: angle / 2 * radius / sqrt(tolerance * (2 radius -
    tolerance)), rounded down, at most 65535; 0: a straight line will do. The root is half the
    length of a chord that is `tolerance` off the arc in its middle."""
    if r[RADIUS] == 0:
        return 0
    r[A] = r[RADIUS] + _TWICE
    subtract(r, A, r, TOLERANCE)
    multiply(r, A, r, TOLERANCE)
    if r[A] == 0 or ptr8(r)[4 * A + 3] & MINUS:
        return 0
    root(r, A)
    r[B] = r[ANGLE] - _TWICE  # half of it
    multiply(r, B, r, RADIUS)
    quotient(r, B, r, A)
    return int(whole_part(r, B, 0)) & 0xFFFF  # as in Grbl, whose count has 16 bits


@micropython.viper
def _chord_rotation(r: ptr32, chords: int) -> int:
    """Set r[_SINE] to sin(phi), r[_TANGENT] to tan(phi / 2); phi: the angle of a chord. Returns
    SHIFT for arcs.rotate(): by how many bits the sine is below 1, at most as many as chords has.

    With h = sin(phi / 2) by the series, c = sqrt(1 - h**2): sin(phi) = 2 h c, tangent = h / c.
    """
    bits = 0
    while chords >> bits:
        bits += 1
    store(r, C, chords << (24 - bits), 126 + bits, 0)  # chords as mantissa, exponent, sign
    r[_TANGENT] = r[ANGLE]
    quotient(r, _TANGENT, r, C)
    r[_TANGENT] = r[_TANGENT] - _TWICE
    _series(r, _TANGENT, _SINE_FACTORS, _SINE_TERMS)
    r[C] = r[_TANGENT]  # h; C becomes c
    multiply(r, C, r, C)
    ptr8(r)[4 * C + 3] ^= MINUS  # negate
    add_single(r, _ONE, r, C)
    root(r, C)
    r[_SINE] = r[_TANGENT] + _TWICE
    multiply(r, _SINE, r, C)
    quotient(r, _TANGENT, r, C)
    shift = 126 - (r[_SINE] >> 23)  # 126: the exponent of 0.5 and of all up to 1
    return shift if shift < bits else bits


@micropython.viper
def _scale(r: ptr32, start: ptr32, target: ptr32, steps_per_mm: ptr32, axes: int) -> int:
    """Set r[_UNITS_PER_MM] for the course's positions: so many units that the farthest position
    fits (FARTHEST), but at most 2**27 per step of the coarsest axis. Returns 0 if positions are
    too far for whole steps, or are no numbers, else 1."""
    farthest = int(0x4D800000)  # the float FARTHEST
    if r[RADIUS] >= farthest:
        return 0
    # A: more than any position's distance from 0, mm. On its way a position is up to three radii
    # from the start, because shears overshoot.
    r[A] = r[RADIUS] + 2 * _TWICE if r[RADIUS] else 0  # four radii; then five, 1 mm, all ends
    add_single(r, RADIUS, r, A)
    add_single(r, _ONE, r, A)
    finest = 0
    coarsest = 0
    for i in range(axes):
        r[B] = start[i] & int(0x7FFFFFFF)
        add_single(r, B, r, A)
        r[B] = target[i] & int(0x7FFFFFFF)
        add_single(r, B, r, A)
        if steps_per_mm[i] > steps_per_mm[finest]:
            finest = i
        if steps_per_mm[i] < steps_per_mm[coarsest]:
            coarsest = i
    r[_UNITS_PER_MM] = farthest
    quotient(r, _UNITS_PER_MM, r, A)
    multiply(r, A, steps_per_mm, finest)  # the distance in steps
    if r[A] >= farthest:
        return 0
    greatest = steps_per_mm[coarsest] + _MOST_STEP_BITS * _TWICE  # times 2**27
    if r[_UNITS_PER_MM] > greatest:
        r[_UNITS_PER_MM] = greatest
    return 1


@micropython.viper
def _divide(distance: int, shift: int, chords: int) -> int:
    """Return distance / chords in 2**-shift, rounded towards 0: a long division, bit by bit."""
    result = (0 - distance if distance < 0 else distance) // chords
    rest = (0 - distance if distance < 0 else distance) - result * chords
    for _ in range(shift):
        rest <<= 1
        result <<= 1
        if rest >= chords:
            rest -= chords
            result += 1
    return 0 - result if distance < 0 else result


@micropython.viper
def _place_axes(
    r: ptr32,
    plane: ptr32,
    start: ptr32,
    target: ptr32,
    steps_per_mm: ptr32,
    course: ptr32,
    axes: int,
) -> int:
    """Fill the course's axes: position, bits of a step, centre in the plane, advance per chord.

    An axis's unit is its step / 2**bits. Sets r[_UNIT_RATIO] to units per mm of the rotation's
    first axis over those of its second, for shears between axes of different resolution.
    """
    chords = course[arcs.CHORDS_LEFT] + 1
    at = arcs.FIRST_AXIS  # index in the course
    for i in range(axes):
        r[B] = r[_UNITS_PER_MM]
        quotient(r, B, steps_per_mm, i)
        bits = (r[B] >> 23) - 126  # 2**bits is more than B, the units per step, at most twice
        r[A] = steps_per_mm[i] + bits * _TWICE  # units per mm
        r[B] = start[i]
        multiply(r, B, r, A)
        position = int(whole_part(r, B, 0))
        course[at] = arcs.PLACE_BIAS + position + (1 << bits >> 1)  # + half a step, to round
        course[at + arcs.POSITION_REST] = 0
        course[at + arcs.STEP_BITS] = bits
        course[at + arcs.CHORD_ADVANCE] = int(0x40000000)  # 1 << ADVANCE_BIAS_LOG2
        is_one_axis = 1 if i == plane[ONE_AXIS] else 0
        if is_one_axis or i == plane[OTHER_AXIS]:
            r[B] = r[CENTRE_0] if is_one_axis else r[CENTRE_1]
            multiply(r, B, r, A)
            course[at + arcs.CENTRE] = course[at] + int(whole_part(r, B, 0))
            second = 1 if is_one_axis == plane[CLOCKWISE] else 0  # their order is the direction
            course[arcs.PLANE_AXES + second] = at
            r[C if second else _UNIT_RATIO] = r[A]  # divided by each other at the end
        else:
            r[B] = target[i]
            multiply(r, B, r, A)
            distance = int(whole_part(r, B, 0)) - position
            course[at + arcs.CHORD_ADVANCE] += int(_divide(distance, course[arcs.SHIFT], chords))
        at += arcs.AXIS_STRIDE
    return int(quotient(r, _UNIT_RATIO, r, C))


@micropython.viper
def lay(
    r: ptr32,
    plane: ptr32,
    start: ptr32,
    target: ptr32,
    steps_per_mm: ptr32,
    course: ptr32,
    axes: int,
) -> int:
    """Fill a course from start to target, mm as bits of floats; r: an arc's numbers. Returns the
    number of chords; 0 and 1 mean a straight line, and the course is not filled."""
    course[arcs.CHORDS_LEFT] = 0
    course[arcs.END_KNOWN] = 0
    r[TOLERANCE] = course[arcs.CHORD_TOLERANCE]
    if int(_scale(r, start, target, steps_per_mm, axes)) == 0:
        return 0
    sweep(r, plane, start, target)
    chords = int(_chord_count(r))
    if chords > 1:
        if chords < _FEW_CHORDS and int(whole_part(r, ANGLE, 16)) > _WIDEST * chords:
            chords *= 2  # each was too wide
        course[arcs.CHORDS_LEFT] = chords - 1
        shift = int(_chord_rotation(r, chords))
        course[arcs.SHIFT] = shift
        _place_axes(r, plane, start, target, steps_per_mm, course, axes)
        multiply(r, _TANGENT, r, _UNIT_RATIO)
        quotient(r, _SINE, r, _UNIT_RATIO)
        course[arcs.SHEARS] = arcs.PLACE_BIAS - int(whole_part(r, _TANGENT, 28 + shift))  # -t
        course[arcs.SHEARS + 1] = arcs.PLACE_BIAS + int(whole_part(r, _SINE, 28 + shift))  # s
    return chords


class Arc:
    """One arc: its numbers and its plane."""

    def __init__(self) -> None:
        self.plane = array("i", (0, 1, 0))
        self.numbers = array("f", (0.0 for _ in range(_ONE)))
        for factors in _FACTORS:
            self.numbers.extend(array("f", factors))

    def lay(
        self,
        start: "array[float]",
        target: "array[float]",
        steps_per_mm: "array[float]",
        course: "array[int]",
    ) -> int:
        """Fill a course (arcs.py) from start to target, mm, for this arc's numbers and plane.
        Returns how many chords it has; 0 and 1 mean a straight line."""
        return lay(self.numbers, self.plane, start, target, steps_per_mm, course, len(start))

    def sweep(self, start: "array[float]", target: "array[float]") -> float:
        """Return the angle travelled, in radians."""
        sweep(self.numbers, self.plane, start, target)
        return self.numbers[ANGLE]
