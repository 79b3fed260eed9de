# mypy: disable-error-code="arg-type, attr-defined"
"""The words of an arc: from its target and offsets, or radius, to an Arc, checked as Grbl does.

Arguments: ints, singles, xyz, the block's integers, numbers and axis words (block_layout.py);
position, the parser's, as xyz in mm; plane and r, the arc's plane and numbers (arc_geometry.py),
in which A, B and C are scratch, and CENTRE_0, CENTRE_1 the centre relative to the start.

Floats are handled as their bits; & 0x7FFFFFFF removes the sign, ^ MINUS in the last byte changes
it. multiply(r, i, s, j) is r[i] *= s[j]; likewise quotient() and subtract(); but add_single(s, j,
r, i) is r[i] += s[j]. length(r, i, j) sets r[i] to sqrt(r[i]**2 + r[j]**2), root(r, i) to its
square root.
"""

import micropython
from base import errors
from base.float32_math import MINUS, add_single, multiply, quotient, root
from control import modes as mode
from micropython import const
from motion import arc_geometry as arc
from motion.arc_geometry import length, subtract

from language import block_layout as b

# Floats as bits. How far a target may be off the arc's circle: _CLOSE_MM, or _RADIUS_PART of the
# radius, if that is more, but at most _FAR_MM.
_CLOSE_MM = const(0x3BA3D70A)  # 0.005 mm: always allowed
_RADIUS_PART = const(0x3A83126F)  # 0.001 of the radius
_FAR_MM = const(0x3F000000)  # 0.5 mm: more is never allowed
_HALF = const(0x3F000000)  # 0.5


@micropython.viper
def find_arc(
    ints: ptr32, singles: ptr32, xyz: ptr32, position: ptr32, axes: int, plane: ptr32, r: ptr32
) -> int:
    """Find plane, centre and radius of a block's arc from position to xyz, mm, into plane and r.
    Returns Grbl's error number, or 0. With R the centre is computed; with I, J, K it is given, and
    the target must be on the circle through the start."""
    words = ints[b.WORDS]
    if words & b.AXIS_WORDS == 0:
        return errors.GCODE_NO_AXIS_WORDS
    # The axes of G17, G18, G19 are 0 and 1, 2 and 0, 1 and 2.
    first = (3 - ints[mode.PLANE]) % 3
    second = (first + 1) % 3
    plane[arc.ONE_AXIS] = first
    plane[arc.OTHER_AXIS] = second
    plane[arc.CLOCKWISE] = 1 if ints[mode.MOTION] == b.CW_ARC else 0
    if words & (1 << first | 1 << second) == 0:
        return errors.GCODE_NO_AXIS_WORDS_IN_PLANE
    if words & b.WORD_R:
        return int(_by_radius(ints, singles, xyz, position, axes, plane, r))
    if words & (b.WORD_I << first | b.WORD_I << second) == 0:
        return errors.GCODE_NO_OFFSETS_IN_PLANE
    if ints[mode.INCHES]:
        multiply(singles, b.I + first, singles, b.INCH_MM)
        multiply(singles, b.I + second, singles, b.INCH_MM)
    r[arc.CENTRE_0] = singles[b.I + first]
    r[arc.CENTRE_1] = singles[b.I + second]
    # The radius is the length of the offsets.
    r[arc.RADIUS] = r[arc.CENTRE_0]
    r[arc.A] = r[arc.CENTRE_1]
    length(r, arc.RADIUS, arc.A)
    # A and B: the target, as seen from the centre.
    r[arc.A] = xyz[first]
    subtract(r, arc.A, position, first)
    subtract(r, arc.A, r, arc.CENTRE_0)
    r[arc.B] = xyz[second]
    subtract(r, arc.B, position, second)
    subtract(r, arc.B, r, arc.CENTRE_1)
    # How far the target is off the circle: its distance from the centre, less the radius.
    length(r, arc.A, arc.B)
    subtract(r, arc.A, r, arc.RADIUS)
    off_mm = r[arc.A] & int(0x7FFFFFFF)
    r[arc.B] = _RADIUS_PART
    multiply(r, arc.B, r, arc.RADIUS)
    # Floats that are not negative compare as their bits do.
    if off_mm > _CLOSE_MM and (off_mm > _FAR_MM or off_mm > r[arc.B]):
        return errors.GCODE_INVALID_TARGET
    return 0


@micropython.viper
def same_position(position: ptr32, xyz: ptr32, axes: int) -> int:
    """Return 1 if the two positions are equal, else 0. 0 and -0 are equal."""
    for i in range(axes):
        if position[i] != xyz[i] and (position[i] | xyz[i]) & int(0x7FFFFFFF):
            return 0
    return 1


@micropython.viper
def _by_radius(
    ints: ptr32, singles: ptr32, xyz: ptr32, position: ptr32, axes: int, plane: ptr32, r: ptr32
) -> int:
    """Find the centre of the arc with radius R over the chord from position to xyz: CENTRE_0,
    CENTRE_1 and RADIUS of r.

    The centre is on the chord's perpendicular bisector: left of the direction of motion for a
    counterclockwise arc of less than half a circle. R < 0 requests the longer arc. Returns Grbl's
    error number, or 0.
    """
    if int(same_position(position, xyz, axes)):
        return errors.GCODE_INVALID_TARGET
    if ints[mode.INCHES]:
        multiply(singles, b.R, singles, b.INCH_MM)
    # The chord. It is halved at the end.
    r[arc.CENTRE_0] = xyz[plane[arc.ONE_AXIS]]
    subtract(r, arc.CENTRE_0, position, plane[arc.ONE_AXIS])
    r[arc.CENTRE_1] = xyz[plane[arc.OTHER_AXIS]]
    subtract(r, arc.CENTRE_1, position, plane[arc.OTHER_AXIS])
    # Four times the radius squared, less the chord squared.
    r[arc.RADIUS] = singles[b.R] & int(0x7FFFFFFF)
    r[arc.A] = r[arc.RADIUS]
    multiply(r, arc.A, r, arc.A)
    r[arc.B] = int(0x40800000)  # the float 4
    multiply(r, arc.A, r, arc.B)
    r[arc.B] = r[arc.CENTRE_0]
    multiply(r, arc.B, r, arc.B)
    r[arc.C] = r[arc.CENTRE_1]
    multiply(r, arc.C, r, arc.C)
    subtract(r, arc.A, r, arc.B)
    subtract(r, arc.A, r, arc.C)
    if ptr8(r)[4 * arc.A + 3] & MINUS:
        return errors.GCODE_ARC_RADIUS_ERROR
    # The centre's distance from the middle of the chord, as a fraction of half the chord: the root
    # of A, over that of the chord squared.
    add_single(r, arc.C, r, arc.B)
    root(r, arc.A)
    root(r, arc.B)
    if r[arc.B]:
        quotient(r, arc.A, r, arc.B)
    else:  # ends so close that the square of their distance is 0
        r[arc.A] = 0
    # To the right if R is negative or the arc is clockwise, to the left if both or neither.
    if (ptr8(singles)[4 * b.R + 3] >> 7) != plane[arc.CLOCKWISE]:
        ptr8(r)[4 * arc.A + 3] ^= MINUS
    # With the fraction f in A and the chord (x, y): centre = (x - f * y, y + f * x) / 2.
    r[arc.B] = r[arc.CENTRE_1]
    multiply(r, arc.B, r, arc.A)
    multiply(r, arc.A, r, arc.CENTRE_0)
    subtract(r, arc.CENTRE_0, r, arc.B)
    add_single(r, arc.A, r, arc.CENTRE_1)
    r[arc.A] = _HALF
    multiply(r, arc.CENTRE_0, r, arc.A)
    multiply(r, arc.CENTRE_1, r, arc.A)
    return 0
