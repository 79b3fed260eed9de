# mypy: disable-error-code="arg-type, attr-defined"
"""The words of an arc: from its target and offsets, or radius, to an Arc, checked as Grbl does."""

import micropython
from base.errors import (
    GCODE_ARC_RADIUS_ERROR,
    GCODE_INVALID_TARGET,
    GCODE_NO_AXIS_WORDS,
    GCODE_NO_AXIS_WORDS_IN_PLANE,
    GCODE_NO_OFFSETS_IN_PLANE,
)
from base.singles import MINUS, add_single, multiply, quotient, root
from control.modes import INCHES, MOTION, PLANE
from micropython import const
from motion.arc_geometry import (
    CENTRE_0,
    CENTRE_1,
    CLOCKWISE,
    ONE_AXIS,
    OTHER_AXIS,
    RADIUS,
    A,
    B,
    C,
    length,
    subtract,
)

from language.block_layout import AXIS_WORDS, CW_ARC, INCH_MM, WORD_I, WORD_R, WORDS, I, R

# A target may be so far off an arc's circle, floats by their bits: 0.005 mm, or that part of the
# radius, 0.001, up to 0.5 mm.
_CLOSE = const(0x3BA3D70A)
_PART = const(0x3A83126F)
_WORST = const(0x3F000000)
_HALF = const(0x3F000000)


@micropython.viper
def find_arc(
    ints: ptr32, singles: ptr32, xyz: ptr32, position: ptr32, axes: int, plane: ptr32, r: ptr32
) -> int:
    """Find plane, centre and radius of a block's arc from position to xyz. Returns what is wrong
    with it, or 0. r: the arc's numbers."""
    words = ints[WORDS]
    if words & AXIS_WORDS == 0:
        return GCODE_NO_AXIS_WORDS
    # The axes of G17, G18, G19 are 0 and 1, 2 and 0, 1 and 2.
    one = (3 - ints[PLANE]) % 3
    other = (one + 1) % 3
    plane[ONE_AXIS] = one
    plane[OTHER_AXIS] = other
    plane[CLOCKWISE] = 1 if ints[MOTION] == CW_ARC else 0
    if words & (1 << one | 1 << other) == 0:
        return GCODE_NO_AXIS_WORDS_IN_PLANE
    if words & WORD_R:
        return int(_by_radius(ints, singles, xyz, position, axes, plane, r))
    if words & (WORD_I << one | WORD_I << other) == 0:
        return GCODE_NO_OFFSETS_IN_PLANE
    if ints[INCHES]:
        multiply(singles, I + one, singles, INCH_MM)
        multiply(singles, I + other, singles, INCH_MM)
    r[CENTRE_0] = singles[I + one]
    r[CENTRE_1] = singles[I + other]
    r[RADIUS] = r[CENTRE_0]
    r[A] = r[CENTRE_1]
    length(r, RADIUS, A)
    r[A] = xyz[one]
    subtract(r, A, position, one)
    subtract(r, A, r, CENTRE_0)
    r[B] = xyz[other]
    subtract(r, B, position, other)
    subtract(r, B, r, CENTRE_1)
    length(r, A, B)
    subtract(r, A, r, RADIUS)
    off = r[A] & int(0x7FFFFFFF)
    r[B] = _PART
    multiply(r, B, r, RADIUS)
    return GCODE_INVALID_TARGET if off > _CLOSE and (off > _WORST or off > r[B]) else 0


@micropython.viper
def is_there(position: ptr32, xyz: ptr32, axes: int) -> int:
    """Whether the two places are the same."""
    for i in range(axes):
        if position[i] != xyz[i] and (position[i] | xyz[i]) & int(0x7FFFFFFF):
            return 0
    return 1


@micropython.viper
def _by_radius(
    ints: ptr32, singles: ptr32, xyz: ptr32, position: ptr32, axes: int, plane: ptr32, r: ptr32
) -> int:
    """Find the centre of the arc with radius R over the chord to the target.

    It lies on the chord's perpendicular bisector, left of the way for a
    counterclockwise arc of less than half a circle. R < 0 asks for the longer arc.
    """
    if int(is_there(position, xyz, axes)):
        return GCODE_INVALID_TARGET
    if ints[INCHES]:
        multiply(singles, R, singles, INCH_MM)
    # The chord, and its halves.
    r[CENTRE_0] = xyz[plane[ONE_AXIS]]
    subtract(r, CENTRE_0, position, plane[ONE_AXIS])
    r[CENTRE_1] = xyz[plane[OTHER_AXIS]]
    subtract(r, CENTRE_1, position, plane[OTHER_AXIS])
    # Four times the radius squared, less the chord squared.
    r[RADIUS] = singles[R] & int(0x7FFFFFFF)
    r[A] = r[RADIUS]
    multiply(r, A, r, A)
    r[B] = int(0x40800000)  # the float 4
    multiply(r, A, r, B)
    r[B] = r[CENTRE_0]
    multiply(r, B, r, B)
    r[C] = r[CENTRE_1]
    multiply(r, C, r, C)
    subtract(r, A, r, B)
    subtract(r, A, r, C)
    if ptr8(r)[4 * A + 3] & MINUS:
        return GCODE_ARC_RADIUS_ERROR
    # How far the centre lies from the chord's middle, as a part of half the chord.
    add_single(r, C, r, B)
    root(r, A)
    root(r, B)
    if r[B]:
        quotient(r, A, r, B)
    else:
        r[A] = 0
    if (ptr8(singles)[4 * R + 3] >> 7) != plane[CLOCKWISE]:
        ptr8(r)[4 * A + 3] ^= MINUS
    r[B] = r[CENTRE_1]
    multiply(r, B, r, A)
    multiply(r, A, r, CENTRE_0)
    subtract(r, CENTRE_0, r, B)
    add_single(r, A, r, CENTRE_1)
    r[A] = _HALF
    multiply(r, CENTRE_0, r, A)
    multiply(r, CENTRE_1, r, A)
    return 0
