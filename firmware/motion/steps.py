# mypy: disable-error-code=arg-type
"""Steps: from a target in mm to the steps of each motor, and the length of their way.

Viper, for plan_kernel.py. In the machine's table (layout.py), TARGET and POSITION are the end and
the start of a block, in steps + 2**29 per axis, and RESOLUTION is steps/mm. Reals are the numbers
of minifloat.py: a mantissa of 15 bits (MANTISSA is its mask, LIMIT is above it), and above it an
exponent. From LIMITS on the table has three reals per axis, the first of them mm per step. After
those, at these multiples of the number of axes: 5: distances; RESOLUTION; TARGET; POSITION; MOVES,
per motor which axes it moves: 1 << i if it moves only axis i.
"""

import micropython
from base.float32_math import SMALL, mantissa_product
from micropython import const

from motion.layout import (
    AXES,
    DIRS,
    EVENTS,
    LENGTH,
    LIMITS,
    MOTOR_COUNT,
    MOVES,
    RESOLUTION,
    REVERSE,
    STEPS,
    TARGET,
)
from motion.minifloat import LIMIT, MANTISSA, pack, square_root

_BIAS = const(0x20000000)  # 2**29, added to positions in the table
_FARTHEST = const(0x1FFFFFFF)  # 2**29 - 1 steps
_FRACTION = const(0x7FFFFF)  # the stored bits of a float's mantissa
_LEADING = const(0x800000)  # the leading 1 of a float's mantissa


@micropython.viper
def to_steps(target: ptr32, table: ptr32) -> int:
    """Round mm * steps/mm to whole steps, halves away from zero, into TARGET of the table.

    target, steps/mm: bits of single-precision floats. The product is rounded to single precision
    before it is rounded to steps, as Grbl's is, because a target half way between two steps must
    end on the same one. Returns 0 where an axis leaves +-2**29 steps, else 1.
    """
    inside = 1
    axes = table[AXES]
    resolution = LIMITS + RESOLUTION * axes  # index in the table
    signs = ptr8(target)
    for i in range(axes):
        # mm * steps/mm = product * 2**(exponent - 23). 253: two biases, less 1, because a
        # product is from 2 to 4. a, b: bits of mm, without the sign, and of steps/mm.
        a = target[i] & 0x3FFFFFFF
        high = (signs[4 * i + 3] & 0x40) << 24  # bit 30; a mask with it would be an object
        b = table[resolution + i]
        exponent = ((a + high) >> 23) + (b >> 23) - 253
        product = int(mantissa_product((a & _FRACTION) | _LEADING, (b & _FRACTION) | _LEADING))
        if product & SMALL:  # a flag: the product is from 1 to 2
            product ^= SMALL
            exponent -= 1
        if exponent > 28:
            inside = 0
            product = _FARTHEST  # the sign is set below
        elif exponent >= 23:
            product <<= exponent - 23
        elif exponent >= -1:  # half a step or more: one bit of the fraction decides
            product = ((product >> (22 - exponent)) + 1) >> 1
        else:
            product = 0
        if signs[4 * i + 3] & 0x80:
            product = 0 - product
        table[resolution + axes + i] = _BIAS + product  # TARGET follows RESOLUTION
    return inside


@micropython.viper
def motor_steps(places: ptr32, at: int, axes: int, moves: int) -> int:
    """Return a motor's steps from the position at places[at + axes] to the one at places[at].

    places: steps of axes, one position after the other; axes: how many axes each has. moves: which
    axes turn this motor: forwards with bit i set for axis i, backwards with bit i + REVERSE.
    """
    steps = 0
    for i in range(axes):
        direction = ((moves >> i) & 1) - ((moves >> (i + REVERSE)) & 1)
        steps += direction * (places[at + i] - places[at + axes + i])
    return steps


@micropython.viper
def measure(table: ptr32, ring: ptr32, at: int) -> int:
    """Begin a block from POSITION to TARGET, in the row at ring[at]: STEPS, EVENTS, DIRS, LENGTH
    (a real, mm). Returns EVENTS: steps of the motor that makes the most; 0: nothing is to move.

    length = sqrt(sum of distance_i**2), of the motors' distances, one per axis, as in Grbl: on a
    CoreXY machine $110 and $120 limit motors. The distances (reals, mm) are left in the table for
    plan_kernel.limit().
    """
    axes = table[AXES]
    # Indexes in the table.
    distance = LIMITS + 5 * axes
    target = LIMITS + TARGET * axes
    moves = LIMITS + MOVES * axes
    largest_exponent = 0
    dirs = 0
    events = 0
    for i in range(table[MOTOR_COUNT]):
        moved_axes = table[moves + i]  # mask of those that this motor moves
        if moved_axes == 1 << i:  # the common case: it turns the axis of its number
            steps = table[target + i] - table[target + axes + i]
        else:
            steps = int(motor_steps(table, target, axes, moved_axes))
        if steps < 0:
            dirs |= 1 << i
            steps = 0 - steps
        ring[at + STEPS + i] = steps
        if i >= axes:
            continue  # a second motor of an axis goes the distance of the first
        # The real steps * mm per step.
        mantissa = 0
        exponent = 0
        if steps:
            mantissa = steps
            while mantissa >= LIMIT:
                mantissa >>= 1
                exponent += 1
            mm_per_step = table[LIMITS + 3 * i]
            mantissa *= mm_per_step & MANTISSA
            exponent += mm_per_step >> 15
            while mantissa >= LIMIT:
                mantissa >>= 1
                exponent += 1
            if exponent > largest_exponent:
                largest_exponent = exponent
            if steps > events:
                events = steps
        table[distance + i] = (exponent << 15) + mantissa
    # At the exponent of the largest, so 14 bits each: six squares of 28 bits stay below 2**31.
    squares = 0
    for i in range(axes):
        moved_mm = table[distance + i]  # a real
        if moved_mm:
            shift = largest_exponent - (moved_mm >> 15) + 1
            mantissa = (moved_mm & MANTISSA) >> shift if shift < 15 else 0
            squares += mantissa * mantissa
    ring[at + EVENTS] = events
    ring[at + DIRS] = dirs
    if events:
        ring[at + LENGTH] = int(pack(int(square_root(squares)), largest_exponent + 1))
    return events
