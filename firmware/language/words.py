# mypy: disable-error-code=arg-type
"""Words: a letter and a number, the atoms of a G-code line.

Numbers are converted to single precision, rounded in the same steps as by Grbl's reader: eight
digits count, further ones only move the point. The interpreter and commands use this module; it
does not know the meaning of any letter.
"""

from array import array

import micropython
from base import errors
from base.float32_math import SMALL, mantissa_product
from micropython import const

LINE_LENGTH = const(79)  # characters, as in Grbl
_DIGITS = const(8)  # so many count; further ones are read as 0
_PLUS = const(43)  # characters
_MINUS = const(45)
_POINT = const(46)
_ZERO = const(48)
_A = const(65)  # the first and last letter
_Z = const(90)
_FRACTION = const(0x7FFFFF)  # the stored bits of a float's mantissa
# Mantissas, of 24 bits.
_HUNDREDTH = const(0xA3D70A)  # 0.01 * 2**30
_TENTH = const(0xCCCCCD)  # 0.1 * 2**27
_TEN = const(0xA00000)  # 10 * 2**20


@micropython.viper
def store_single(number: int, power: int, values: ptr32, at: int) -> int:
    """Store number * 10**power in single precision as values[at]; number: 0 to 2**27 - 1.

    Multiplies by 0.01, 0.1 or 10, and rounds each product to even, as Grbl does. The result is
    stored as the bits of a float. Returns 0.
    """
    # The exponent of a float whose mantissa is a whole number of 24 bits, with the bias.
    exponent = 150
    # Round to 24 bits, halves to even. rest: the bits dropped; unit: 2**(how many).
    rest = 0
    unit = 1
    while number >= 1 << 24:
        rest |= (number & 1) * unit
        unit <<= 1
        number >>= 1
        exponent += 1
    if rest << 1 > unit or (rest << 1 == unit and number & 1):
        number += 1
    # The leading bit becomes bit 23, as in a mantissa.
    if number:
        while number < 1 << 16:
            number <<= 8
            exponent -= 8
        while number < 1 << 23:
            number <<= 1
            exponent -= 1
    while number and power:
        if power < -1:
            factor = _HUNDREDTH
            exponent -= 6  # 24 - 30: the factor is 0.01 * 2**30, and the product loses 24 bits
            power += 2
        elif power < 0:
            factor = _TENTH
            exponent -= 3  # 24 - 27: 0.1 * 2**27
            power = 0
        else:
            factor = _TEN
            exponent += 4  # 24 - 20: 10 * 2**20
            power -= 1
        number = int(mantissa_product(number, factor))
        if number & SMALL:  # the product has 47 bits, and not 48
            number ^= SMALL
            exponent -= 1
    if number == 1 << 24:
        number >>= 1
        exponent += 1
    if exponent > 254:
        exponent = 255  # infinite
        number = 0
    elif number == 0:
        exponent = 0
    values[at] = (exponent << 23) | (number & _FRACTION)
    return 0


@micropython.viper
def number(text: ptr8, pos: int, values: ptr32, at: int) -> int:
    """Read a number at text[pos] into values[at], a float as its bits. Returns the index in text
    after it, or 0 if there is no digit. The text must end with a character that no number has.

    The number is mantissa * 10**power; point is 1 after the decimal point.
    """
    sign = text[pos]
    if sign == _MINUS or sign == _PLUS:  # noqa: PLR1714 (a viper cannot ask `in`)
        pos += 1
    mantissa = 0
    digits = 0
    power = 0
    point = 0
    while True:
        digit = text[pos] - _ZERO
        if digit >= 0 and digit <= 9:
            digits += 1
            if digits <= _DIGITS:
                mantissa = mantissa * 10 + digit
                power -= point
            else:  # dropped
                power += 1 - point
        elif digit == _POINT - _ZERO and point == 0:
            point = 1
        else:
            break
        pos += 1
    if digits == 0:
        return 0
    store_single(mantissa, power, values, at)
    if sign == _MINUS:
        signs = ptr8(values)
        signs[4 * at + 3] = signs[4 * at + 3] | 128  # the sign bit
    return pos


@micropython.viper
def scan(text: ptr8, span: int, letters: ptr8, values: ptr32) -> int:
    """Read words from text[start:end]; text[end] is 0. span: count of earlier words << 16 |
    end << 8 | start.

    Letters (character codes) and values (bits of single-precision floats) are stored in their
    arrays, from the index count on. Returns count | error << 8 | index << 16: the count of words,
    earlier ones included; Grbl's error number of what follows them, or 0; and its index in text,
    if a letter was expected there, else 0.
    """
    pos = span & 255
    end = span >> 8 & 255
    count = span >> 16
    while pos < end:
        letter = text[pos]
        if letter < _A or letter > _Z:
            return count | errors.EXPECTED_COMMAND_LETTER << 8 | pos << 16
        letters[count] = letter
        pos = int(number(text, pos + 1, values, count))
        if pos == 0:
            return count | errors.BAD_NUMBER_FORMAT << 8
        count += 1
    return count


class Words:
    """The words of one line. letters[i] is a character code, values[i] its number. count: how many
    were read; fault: Grbl's error number, or 0. longest: most characters in a line."""

    def __init__(self, longest: int = LINE_LENGTH) -> None:
        most = longest // 2 + 1  # a word has at least two characters
        self.letters = bytearray(most)
        self.values = array("f", (0.0 for _ in range(most)))
        self.count = 0
        self.fault = 0

    def read(self, text: bytearray, start: int, end: int) -> None:
        """Read text[start:end]; text[end] is 0. Sets fault to Grbl's error number, or 0."""
        scanned = scan(text, end << 8 | start, self.letters, self.values)
        self.count = scanned & 255
        self.fault = scanned >> 8 & 255


_bare = array("f", (0.0,))


def bare(text: bytearray, start: int) -> "tuple[int, float]":
    """Read a number without a letter; return the index after it, or -1, and its value."""
    end = number(text, start, _bare, 0)
    return (end, _bare[0]) if end else (-1, 0.0)
