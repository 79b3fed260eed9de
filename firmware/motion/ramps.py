# mypy: disable-error-code=arg-type
"""Ramps: how far and how fast at constant acceleration, in integers, for segment_kernel.py.

The equations of motion at constant acceleration, v**2 - u**2 = 2 a s and s = (v + u) / 2 * t, for
speeds in 2**-18 step per full segment and times in 2**-17 of a full segment (segment_kernel.py).
A speed has up to 30 bits, so products are made in parts that fit 32. Viper; runs in the engine's
interrupt.
"""

import micropython
from micropython import const

from motion.minifloat import BIAS, HIGHEST, LIMIT, MANTISSA, SMALLEST, mul, pack, square_root

FULL_TIME = const(131072)  # 2**17: 1, of a fraction or of a full segment


@micropython.viper
def share(part: int, whole: int) -> int:
    """Return part / whole in 2**-17; FULL_TIME, which is 1, where part >= whole.

    Both are integers from 0 to 2**30 - 1. A long division in two digits, of 9 and 8 bits: both are
    halved until whole is below 2**22, so that part << 9 fits 31 bits.
    """
    if part >= whole:
        return FULL_TIME
    while whole >= 1 << 22:
        whole >>= 1
        part >>= 1
    part <<= 9
    high = part // whole
    return (high << 8) + (((part - high * whole) << 8) // whole)


@micropython.viper
def times(x: int, part: int) -> int:
    """Return x * part / 2**17; x: 0 to 2**30 - 1; part: a fraction in 2**-17, as share() returns
    it, 0 to 2**17.

    part loses two bits, so that each half of x (15 bits) times part stays below 2**31.
    """
    return (x >> 15) * (part >> 2) + (((x & 32767) * (part >> 2)) >> 15)


@micropython.viper
def braking(fast: int, slow: int, ramp: int, unit: int) -> int:
    """Return the distance, in 2**-unit step, in which the acceleration ramp changes one speed into
    the other; slow <= fast.

    s = (fast**2 - slow**2) / (2 * ramp) = (fast + slow) * (fast - slow) / (2 * ramp), of the
    leading 15 bits of each factor: right to 2**-13 of itself. Speeds and ramp: 0 to 2**30 - 1, in
    2**-18 step per full segment; unit: 18, or 0 for whole steps. HIGHEST where it does not fit.
    """
    if fast == slow:
        return 0
    total = fast + slow
    change = fast - slow
    # s = total * change / ramp * 2**exponent: the speeds have 18 bits of fraction; 1 is the 2 of
    # the formula. Each is reduced to 15 bits.
    exponent = unit - 19
    while total >= LIMIT:
        total >>= 1
        exponent += 1
    while change >= LIMIT:
        change >>= 1
        exponent += 1
    while change < SMALLEST:
        change <<= 1
        exponent -= 1
    while ramp >= LIMIT:
        ramp >>= 1
        exponent -= 1
    distance = total * change // ramp  # to be multiplied by 2**exponent
    if exponent < 0:
        return distance >> (0 - exponent) if exponent > -31 else 0
    if exponent > 30 or distance > HIGHEST >> exponent:
        return HIGHEST
    return distance << exponent


@micropython.viper
def after(speed: int, ramp: int, distance: int, down: int) -> int:
    """Return the speed after a distance of speeding up (down = 0) or of braking (down = 1):
    sqrt(speed**2 +- 2 * ramp * distance), or 0 if braking ends before.

    speed: 2**-18 step per full segment, which ramp changes so much in a full segment; distance:
    2**-18 step. The sum is made of two reals at the larger exponent, with 14 more bits of each.
    """
    square = int(pack(speed, BIAS))
    square = int(mul(square, square))  # a real: speed**2
    # A real: 2 * ramp * distance. BIAS + 1: twice ramp.
    change = int(mul(int(pack(ramp, BIAS + 1)), int(pack(distance, BIAS))))
    # Both mantissas at the larger exponent; the smaller number loses bits.
    exponent = square >> 15
    if change >> 15 > exponent:
        exponent = change >> 15
    shift = exponent - (square >> 15)
    mantissa = ((square & MANTISSA) << 14) >> shift if shift < 30 else 0  # of speed**2
    shift = exponent - (change >> 15)
    term = ((change & MANTISSA) << 14) >> shift if shift < 30 else 0
    mantissa = mantissa - term if down else mantissa + term  # of the sum
    if mantissa <= 0:
        return 0
    exponent -= BIAS + 14  # from here on the sum is mantissa * 2**exponent
    if exponent & 1:  # the root of 2**exponent has half of it
        mantissa >>= 1
        exponent += 1
    root = int(square_root(mantissa))
    exponent >>= 1
    if exponent < 0:
        return root >> (0 - exponent)
    return root << exponent if exponent < 30 and root <= HIGHEST >> exponent else HIGHEST
