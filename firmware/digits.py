"""Digits: numbers as Grbl prints them, single precision all the way.

A number is multiplied by 100 and 10 until its decimals are whole, a half is
added, and the fraction dropped; each result is rounded to single precision,
which shows in the last digit. In integers, a status report costs a fifth of
what it costs in floats.
"""

from array import array

import micropython
from micropython import const

_BEYOND = const(0x3FFFFFFF)  # scaled() cannot say more
_LARGEST = 2147483648  # where Grbl's 32 bits end

_cell = array("f", (0.0,))


@micropython.viper
def scaled(x: ptr32, decimals: int) -> int:
    """The size of the float at x[0] times 10**decimals, to the nearest whole number."""
    bits = (x[0] & 0x3FFFFFFF) | ((ptr8(x)[3] & 64) << 24)
    number = (bits & 0x7FFFFF) | 0x800000
    exponent = (bits >> 23) - 150
    while decimals > 0:
        if decimals > 1:
            factor = 0xC80000  # 100
            exponent += 7
        else:
            factor = 0xA00000  # 10
            exponent += 4
        decimals -= 2
        middle = (number >> 12) * (factor & 0xFFF) + (number & 0xFFF) * (factor >> 12)
        low = (number & 0xFFF) * (factor & 0xFFF) + ((middle & 0xFFF) << 12)
        number = (number >> 12) * (factor >> 12) + (middle >> 12) + (low >> 24)
        low &= 0xFFFFFF
        if number < 1 << 23:
            number = (number << 1) | (low >> 23)
            low = (low << 1) & 0xFFFFFF
            exponent -= 1
        if low > 0x800000 or (low == 0x800000 and number & 1):
            number += 1
        if number >> 24:
            number >>= 1
            exponent += 1
    if exponent > 6 or bits >> 23 == 255:
        return _BEYOND
    if exponent > 0:
        return number << exponent if number < _BEYOND >> exponent else _BEYOND
    if exponent == 0:
        return number + (number & 1)
    shift = 0 - exponent
    if shift > 25:
        return 0
    number += 1 << (shift - 1)
    if number >> 24:
        rest = number & 3
        number >>= 1
        if rest == 3:
            number += 1
        shift -= 1
    return number >> shift


def number(x: float, decimals: int) -> str:
    """X with so many decimals (0, 1, 3 or 4)."""
    _cell[0] = x
    whole = scaled(_cell, decimals)
    if whole == _BEYOND:
        whole = _whole(x, decimals)
    sign = "-" if x < 0 else ""
    if decimals == 0:
        return "%s%d" % (sign, whole)
    power = 10**decimals
    return _FORMATS[decimals] % (sign, whole // power, whole % power)


_FORMATS = ("", "%s%d.%01d", "%s%d.%02d", "%s%d.%03d", "%s%d.%04d")


def _whole(x: float, decimals: int) -> int:
    """The same for numbers so large that nothing is left of a fraction."""
    x = abs(x)
    while decimals >= 2:
        _cell[0] = x * 100
        x = _cell[0]
        decimals -= 2
    if decimals:
        _cell[0] = x * 10
        x = _cell[0]
    return int(x) if x < _LARGEST else _LARGEST
