# mypy: disable-error-code=arg-type
"""Digits: numbers as Grbl prints them, single precision all the way, and texts made of them.

A number is multiplied by 100 and 10 until its decimals are whole, a half is added, and the
fraction dropped; each result is rounded to single precision, which shows in the last digit. In
integers, and into a buffer that is there already, a status report costs a quarter of what it costs
in floats and strings, and no memory.
"""

from array import array

import micropython
from base.text import text_of
from micropython import const

# What write() is told, and tells.
END = const(0)  # where the text ends so far
VALUES = const(1)  # whole numbers and masks, in the order in which a form asks for them


@micropython.viper
def scaled(x: ptr32, at: int, decimals: int) -> int:
    """The size of the float at x[at] times 10**decimals, to the nearest whole number.

    -1 where that leaves 31 bits.
    """
    exponent = ((x[at] >> 23) & 255) - 150
    if exponent == 105:
        return -1
    number = (x[at] & 0x7FFFFF) | 0x800000
    while decimals > 0:
        number *= 100 if decimals > 1 else 10
        decimals -= 2
        shift = 3
        while number >> shift >= 1 << 24:
            shift += 1
        number += (1 << (shift - 1)) - 1 + ((number >> shift) & 1)  # to nearest, halves to even
        number >>= shift
        exponent += shift
    if number >> 24:
        number >>= 1
        exponent += 1
    if exponent >= 0:
        if exponent == 0:
            number += number & 1
        return number << exponent if exponent < 8 else 0 - 1
    exponent = 0 - exponent
    if exponent > 25:
        return 0
    number += 1 << (exponent - 1)
    if number >> 24 and number & 3 == 3:
        number += 1
    return number >> exponent


@micropython.viper
def write(form: ptr8, out: ptr8, ints: ptr32, singles: ptr32) -> int:
    """Put a form, which a 0 ends, behind what is in `out` already, with values in some places.

    %: the next of the VALUES. #3: the next single, with three decimals. ?P: a P, if the lowest
    bit of the next of the VALUES is set; that is shifted, for the letter behind. Returns END.
    """
    end = ints[END]
    value = VALUES
    single = 0
    i = 0
    c = form[0]
    while c:
        if c > 63 or (c < 63 and c != 35 and c != 37):  # noqa: PLR1714 (a viper cannot ask `in`)
            out[end] = c
            end += 1
        elif c < 63:
            decimals = 0
            if c == 37:
                number = ints[value]
                value += 1
            else:
                i += 1
                decimals = form[i] - 48
                number = int(scaled(singles, single, decimals))
                if ptr8(singles)[4 * single + 3] > 128:  # minus, but not minus nothing
                    out[end] = 45
                    end += 1
                single += 1
            # From the last digit on, with room for eleven more in front of it; then moved there.
            # To divide takes the chip ten times as long as to multiply and shift.
            at = end + 12
            c = at
            while number or decimals >= 0:
                rest = number // 10 if number < 0 or number > 43689 else (number * 26215) >> 18
                digit = number - 10 * rest
                if number < 0:
                    rest = 214748364  # Grbl's 32 bits end with 2147483648
                    digit = 8
                number = rest
                at -= 1
                out[at] = 48 + digit
                decimals -= 1
                if decimals == 0:
                    at -= 1
                    out[at] = 46
            while at < c:
                out[end] = out[at]
                end += 1
                at += 1
        else:
            i += 1
            if ints[value] & 1:
                out[end] = form[i]
                end += 1
            ints[value] >>= 1
        i += 1
        c = form[i]
    ints[END] = end
    return end


_out = bytearray(32)
_end = array("i", (0,))
_single = array("f", (0.0,))


def number(x: float, decimals: int) -> str:
    """X with so many decimals (0, 1, 3 or 4)."""
    _end[END] = 0
    _single[0] = x
    end = write(b"#%d\0" % decimals, _out, _end, _single)
    return text_of(_out[:end])
