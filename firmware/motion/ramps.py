# mypy: disable-error-code=arg-type
"""Ramps: how far and how fast at constant acceleration, in integers, for segment_kernel.py.

Viper; runs in the engine's interrupt.
"""

import micropython

from motion.reals import BIAS, HIGHEST, LIMIT, SMALLEST, mul, pack, square_root


@micropython.viper
def share(part: int, all: int) -> int:
    """part / all in 2**-17, for part <= all; 2**17 where it is more."""
    if part >= all:
        return 131072
    while all >= 1 << 22:
        all >>= 1
        part >>= 1
    part <<= 9
    high = part // all
    return (high << 8) + (((part - high * all) << 8) // all)


@micropython.viper
def times(x: int, part: int) -> int:
    """x * part for a part in 2**-17, as in share()."""
    return (x >> 15) * (part >> 2) + (((x & 32767) * (part >> 2)) >> 15)


@micropython.viper
def braking(fast: int, slow: int, ramp: int, unit: int) -> int:
    """Distance, in 2**-unit steps, over which ramp changes one speed into the other.

    (fast2 - slow2) / 2 ramp, of the leading 15 bits of sum, difference and ramp: right to 2**-13
    of itself. Speeds and ramp: 0 to 2**30 - 1, in 2**-18 step; unit: 18, or 0 for whole steps.
    HIGHEST where it is more.
    """
    if fast == slow:
        return 0
    total = fast + slow
    change = fast - slow
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
    change = total * change // ramp
    if exponent < 0:
        return change >> (0 - exponent) if exponent > -31 else 0
    if exponent > 30 or change > HIGHEST >> exponent:
        return HIGHEST
    return change << exponent


@micropython.viper
def after(speed: int, ramp: int, distance: int, down: int) -> int:
    """Speed after speeding up, or slowing down, by ramp over a distance: v2 +- 2 ramp distance."""
    square = int(pack(speed, BIAS))
    square = int(mul(square, square))
    change = int(mul(int(pack(ramp, BIAS + 1)), int(pack(distance, BIAS))))
    exponent = square >> 15
    if change >> 15 > exponent:
        exponent = change >> 15
    shift = exponent - (square >> 15)
    mantissa = ((square & 32767) << 14) >> shift if shift < 30 else 0
    shift = exponent - (change >> 15)
    other = ((change & 32767) << 14) >> shift if shift < 30 else 0
    mantissa = mantissa - other if down else mantissa + other
    if mantissa <= 0:
        return 0
    exponent -= BIAS + 14
    if exponent & 1:
        mantissa >>= 1
        exponent += 1
    root = int(square_root(mantissa))
    exponent >>= 1
    if exponent < 0:
        return root >> (0 - exponent)
    return root << exponent if exponent < 30 and root <= HIGHEST >> exponent else HIGHEST
