# mypy: disable-error-code=arg-type
"""Reals: positive floating-point numbers in one integer, for the kernels.

A float is an object on MicroPython, and an interrupt must not create any. A real is an integer:

    bits  30 … 15  exponent e      value = mantissa * 2**(e - 64)
          14 …  0  mantissa        16384 … 32767, so bit 14 is always set; 0 is 0

The exponent is above the mantissa, so reals compare as plain integers do. Their relative error is
2**-14: enough for speeds and accelerations, which decide when a step comes. Positions, which
decide how many, are whole steps. Two mantissas of 15 bits have a product of 30, which fits.
"""

import math

import micropython
from micropython import const

_INFINITE = 1e18  # replaces higher numbers; no limit of a machine is as high
SMALLEST = const(16384)  # a mantissa has 15 bits
LIMIT = const(32768)  # a mantissa is below this
MANTISSA = const(32767)  # the mask of a mantissa; its exponent is >> 15
BIAS = const(64)  # a real with this exponent has the value of its mantissa
HIGHEST = const(0x3FFFFFFF)  # the largest number of 30 bits
ONE = const(0x194000)  # the real 1


def real(x: float) -> int:
    """Return the greatest real that is not above x; 0 if x is not positive."""
    if x <= 0:
        return 0
    mantissa, exponent = math.frexp(min(x, _INFINITE))  # mantissa: a float from 0.5 to 1
    return (exponent - 15 + BIAS) * LIMIT + int(mantissa * LIMIT)


def value(r: int) -> float:
    """Return the number that the real r stands for, as a float."""
    return float(r % LIMIT) * 2.0 ** (r // LIMIT - BIAS)


@micropython.viper
def per_minute(r: int) -> int:
    """Return 60 times the real r as an integer, rounded, a half up.

    It converts mm/s to mm/min, for reports. The result has at most 30 bits: from r = 2**24 on,
    far above any machine's speed, the exponent counts as 9, and the result is too small.
    """
    # Twice the result is computed first: adding 1 to that, then halving, rounds a half up.
    twice = r % LIMIT * 120  # 22 bits, to be multiplied by 2**exponent
    exponent = r // LIMIT - BIAS
    if exponent >= 0:
        left = exponent if exponent < 9 else 9
        return twice << left >> 1
    right = 0 - exponent if exponent > -31 else 31  # from 31 on nothing is left
    return ((twice >> right) + 1) >> 1


@micropython.viper
def per_second(rate: ptr32, at: int) -> int:
    """Return rate[at] / 60 as a real, rounded down: mm/min to mm/s. rate: floats, not negative,
    read as their bits."""
    bits = rate[at]
    if bits == 0:
        return 0
    # A float is (2**23 + fraction) * 2**(e - 150), e its bits 23 to 30; a sixtieth of the 24 bits
    # of its mantissa has 18 or 19.
    mantissa = (((bits & 0x7FFFFF) | 0x800000) // 60) >> 3  # from 17476 to 34952
    exponent = (bits >> 23) - 147 + BIAS  # 150, less the three bits that were dropped
    if mantissa >= LIMIT:
        mantissa >>= 1
        exponent += 1
    return (exponent << 15) + mantissa


@micropython.viper
def pack(mantissa: int, exponent: int) -> int:
    """Return the real mantissa * 2**(exponent - 64) of any mantissa from 0 to 2**30 - 1."""
    if mantissa == 0:
        return 0
    while mantissa >= LIMIT:
        mantissa >>= 1
        exponent += 1
    while mantissa < SMALLEST:
        mantissa <<= 1
        exponent -= 1
    return (exponent << 15) + mantissa


@micropython.viper
def mul(a: int, b: int) -> int:
    """Return the product of two reals, a real; 0 if one of them is 0."""
    # 2**14 <= m < 2**15 each: the product has 29 or 30 bits, and 15 or 16 once 14 are dropped.
    mantissa = ((a & MANTISSA) * (b & MANTISSA)) >> 14
    if mantissa == 0:
        return 0
    exponent = (a >> 15) + (b >> 15) - BIAS + 14
    if mantissa >= LIMIT:
        mantissa >>= 1
        exponent += 1
    return (exponent << 15) + mantissa


@micropython.viper
def ratio(n: int, b: int) -> int:
    """Return the real n / b; n: an integer from 0 to 2**30 - 1; b: a real that is not 0."""
    if n == 0:
        return 0
    # n becomes a mantissa; shifted by 15 it fits 30 bits, and the quotient has 15 or 16.
    exponent = 2 * BIAS - 15
    while n >= LIMIT:
        n >>= 1
        exponent += 1
    while n < SMALLEST:
        n <<= 1
        exponent -= 1
    n = (n << 15) // (b & MANTISSA)
    if n >= LIMIT:
        n >>= 1
        exponent += 1
    return ((exponent - (b >> 15)) << 15) + n


@micropython.viper
def square_root(n: int) -> int:
    """Return the integer square root of n, from 0 to 2**31 - 1.

    Digit by digit in base 4, as on paper: each turn decides one bit of the root, without a
    division.
    """
    root = 0
    bit = int(0x40000000)  # 1 << 30 is an object on a board
    while bit > n:
        bit >>= 2
    while bit:
        if n >= root + bit:
            n -= root + bit
            root = (root >> 1) + bit
        else:
            root >>= 1
        bit >>= 2
    return root


@micropython.viper
def product(a: int, b: int, c: int) -> int:
    """Return the whole part of a * b * c, three reals, as an integer; HIGHEST if it is more."""
    # Two mantissas, back at 15 or 16 bits, times the third: at most 2147287044, just below 2**31.
    mantissa = (((a & MANTISSA) * (b & MANTISSA)) >> 14) * (c & MANTISSA)
    # Three exponents, each with a bias; 14 bits of the product were dropped.
    shift = (a >> 15) + (b >> 15) + (c >> 15) - 3 * BIAS + 14
    if mantissa == 0 or shift < -30:
        return 0
    if shift < 0:
        return mantissa >> (0 - shift)
    return mantissa << shift if shift < 30 and mantissa <= HIGHEST >> shift else HIGHEST
