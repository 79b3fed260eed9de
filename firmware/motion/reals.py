# mypy: disable-error-code=arg-type
"""Reals: positive numbers in one integer, for the kernels.

15 bits of mantissa, with the exponent above them: value = mantissa * 2**(exponent - 64). Reals
compare as plain integers do; 0 is 0. Their relative error is 2**-14.
"""

import math

import micropython
from micropython import const

_INFINITE = 1e18  # no limit of a machine is as high
SMALLEST = const(16384)  # a mantissa has 15 bits
LIMIT = const(32768)
BIAS = const(64)  # the exponent of whole numbers
HIGHEST = const(0x3FFFFFFF)
ONE = const(0x194000)  # the real 1


def real(x: float) -> int:
    """The real nearest below x >= 0."""
    if x <= 0:
        return 0
    mantissa, exponent = math.frexp(min(x, _INFINITE))
    return (exponent - 15 + BIAS) * LIMIT + int(mantissa * LIMIT)


def value(r: int) -> float:
    """The number that the real r stands for."""
    return float(r % LIMIT) * 2.0 ** (r // LIMIT - BIAS)


@micropython.viper
def per_minute(r: int) -> int:
    """60 times the real r, rounded, a half up; at most 30 bits."""
    twice = r % LIMIT * 120
    shift = BIAS - r // LIMIT
    if shift <= 0:
        return twice << (0 - shift if shift > -9 else 9) >> 1
    return ((twice >> (shift if shift < 31 else 31)) + 1) >> 1


@micropython.viper
def per_second(rate: ptr32, at: int) -> int:
    """The real nearest below a sixtieth of a float that is not negative: its bits are rate[at]."""
    bits = rate[at]
    if bits == 0:
        return 0
    mantissa = (((bits & 0x7FFFFF) | 0x800000) // 60) >> 3  # from 17476 to 34952
    exponent = (bits >> 23) - 147 + BIAS
    if mantissa >= LIMIT:
        mantissa >>= 1
        exponent += 1
    return (exponent << 15) + mantissa


@micropython.viper
def pack(mantissa: int, exponent: int) -> int:
    """The real mantissa * 2**(exponent - 64) of any mantissa."""
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
    """The product of two reals."""
    mantissa = ((a & 32767) * (b & 32767)) >> 14
    if mantissa == 0:
        return 0
    exponent = (a >> 15) + (b >> 15) - BIAS + 14
    if mantissa >= LIMIT:
        mantissa >>= 1
        exponent += 1
    return (exponent << 15) + mantissa


@micropython.viper
def ratio(n: int, b: int) -> int:
    """The quotient of an integer and a real that is not 0."""
    if n == 0:
        return 0
    exponent = 2 * BIAS - 15
    while n >= LIMIT:
        n >>= 1
        exponent += 1
    while n < SMALLEST:
        n <<= 1
        exponent -= 1
    n = (n << 15) // (b & 32767)
    if n >= LIMIT:
        n >>= 1
        exponent += 1
    return ((exponent - (b >> 15)) << 15) + n


@micropython.viper
def square_root(n: int) -> int:
    """The integer square root."""
    root = 0
    bit = 1 << 28
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
    """The whole part of the product of three reals, 2**30 - 1 at the most."""
    mantissa = (((a & 32767) * (b & 32767)) >> 14) * (c & 32767)
    shift = (a >> 15) + (b >> 15) + (c >> 15) - 3 * BIAS + 14
    if mantissa == 0 or shift < -30:
        return 0
    if shift < 0:
        return mantissa >> (0 - shift)
    return mantissa << shift if shift < 30 and mantissa <= HIGHEST >> shift else HIGHEST
