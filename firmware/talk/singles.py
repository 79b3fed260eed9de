# mypy: disable-error-code=arg-type
"""Singles: positions as Grbl computes them, in single precision, by integers only.

A float of MicroPython is a piece of memory, and takes longer to make than all that is done here.
"""

import micropython
from language.words import add_single
from micropython import const

MINUS = const(128)  # in the last byte of a float


@micropython.viper
def divide(numbers: ptr32, divisors: ptr32, at: int, quotients: ptr32, count: int) -> int:
    """Divide whole numbers, made floats first, by the floats above 0 at divisors[at].

    Floats are seen as bits, and rounded to the nearest, halves to even. Numbers have 30 bits.
    """
    for i in range(count):
        number = numbers[i]
        minus = ptr8(numbers)[4 * i + 3] & MINUS
        if minus:
            number = 0 - number
        number &= 0x3FFFFFFF
        quotients[i] = 0
        if number:
            exponent = 0
            while number >> exponent >= 1 << 24:
                exponent += 1
            if exponent:
                number += (1 << (exponent - 1)) - 1 + ((number >> exponent) & 1)
                number >>= exponent
            divisor = divisors[at + i]
            exponent += 277 - (divisor >> 23)
            divisor = (divisor & 0x7FFFFF) | 0x800000
            while number < divisor:
                number <<= 1
                exponent -= 1
            rest = number - divisor
            number = 1
            for _ in range(4):
                rest <<= 7
                digit = rest // divisor
                number = (number << 7) + digit
                rest -= digit * divisor
            # Five bits more than there is room for; what is left matters only behind a half.
            if rest:
                number |= 1
            number = (number + 15 + ((number >> 5) & 1)) >> 5
            if number >> 24:
                number >>= 1
                exponent += 1
            if exponent > 254:
                exponent = 255  # infinite
                number = 0
            quotients[i] = (exponent << 23) | (number & 0x7FFFFF)
            ptr8(quotients)[4 * i + 3] |= minus
    return 0


@micropython.viper
def add(numbers: ptr32, flip: int, sums: ptr32, count: int) -> int:
    """Add floats, or take them away: flip is 0 or MINUS. numbers are negative afterwards, then.

    What is infinite stays so.
    """
    for i in range(count):
        ptr8(numbers)[4 * i + 3] ^= flip
        if (sums[i] >> 23) & 255 != 255:
            add_single(numbers, i, sums, i)
    return 0
