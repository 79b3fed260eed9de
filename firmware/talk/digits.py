# mypy: disable-error-code=arg-type
"""Digits: print numbers as Grbl does, in single precision, and build texts from forms.

A form is bytes ended by a 0. Its placeholders are filled in from `ints` and `singles`: % by the
next of the VALUES; #3 by the next single, with three decimals; ?P by a P if the lowest bit of the
next of the VALUES is set: the value is then shifted right, for the next letter.

A number is multiplied by 100 and 10 until its decimals are whole; then 0.5 is added and the
fraction dropped. Each result is rounded to single precision, as Grbl's is, which shows in the last
digit. With integers and an existing buffer a status report costs a quarter of the time that floats
and strings take, and allocates nothing.
"""

from array import array

import micropython
from base.text import text_of
from micropython import const

# Places in `ints`, the integers of write().
END = const(0)  # length of the text written so far
VALUES = const(1)  # integers and masks, in the order in which the form uses them

# Characters: the placeholders of a form, and those of a number.
_SINGLE = const(35)  # the character #
_INTEGER = const(37)  # the character %
_LETTER = const(63)  # the character ?
_MINUS = const(45)  # the character -
_POINT = const(46)  # the character .
_ZERO = const(48)  # the character 0

_EXPONENT_BIAS = const(150)  # of a single whose mantissa is read as an integer of 24 bits
_MINUS_ZERO_HIGH = const(128)  # the highest byte of -0.0; of other negative floats it is above
_SCRATCH = const(12)  # bytes after the text in which a number is written, its last digit first
_QUICK_TENTH = const(43689)  # up to here n * 26215 >> 18 is n // 10, in a tenth of the time
_TENTH_OF_2_31 = const(214748364)  # 2147483648 // 10


@micropython.viper
def scaled(x: ptr32, index: int, decimals: int) -> int:
    """Return |x[index]| * 10**decimals, rounded to the nearest whole number; -1 if that needs more
    than 31 bits. x: floats as bits; index: in x.

    `number` is the mantissa, below 2**24, so `number * 100` fits 31 bits. Each product, and the
    sum with 0.5, is rounded to 24 bits as Grbl's single precision is.
    """
    exponent = ((x[index] >> 23) & 255) - _EXPONENT_BIAS  # |x[index]| = number * 2**exponent
    if exponent == 255 - _EXPONENT_BIAS:  # infinite, or not a number
        return -1
    number = (x[index] & 0x7FFFFF) | 0x800000  # with the mantissa's first bit, which is implied
    while decimals > 0:
        number *= 100 if decimals > 1 else 10
        decimals -= 2
        # Round to 24 bits again: ten times the mantissa has at least 3 bits more.
        shift = 3
        while number >> shift >= 1 << 24:
            shift += 1
        number += (1 << (shift - 1)) - 1 + ((number >> shift) & 1)  # to nearest, halves to even
        number >>= shift
        exponent += shift
    if number >> 24:  # rounded up to 2**24
        number >>= 1
        exponent += 1
    # The whole number is number * 2**exponent + 0.5, without its fraction.
    if exponent >= 0:
        if exponent == 0:  # adding 0.5 is a tie: to even
            number += number & 1
        return number << exponent if exponent < 8 else 0 - 1
    exponent = 0 - exponent
    if exponent > 25:  # below 0.5
        return 0
    number += 1 << (exponent - 1)  # add 0.5
    if number >> 24 and number & 3 == 3:  # 25 bits: round to 24, halves to even
        number += 1
    return number >> exponent


@micropython.viper
def write(form: ptr8, out: ptr8, ints: ptr32, singles: ptr32) -> int:
    """Append a form to the text in `out`, and fill in its placeholders. Returns the length of the
    whole text, which is in ints[END], too. out: with 12 bytes of space after the text; ints: END,
    then from VALUES on the values; singles: floats as bits.

    Each call begins with the first value and the first single."""
    end = ints[END]
    value_at = VALUES
    single_at = 0
    i = 0
    c = form[0]
    while c:
        if c > _LETTER or (c < _LETTER and c != _SINGLE and c != _INTEGER):  # noqa: PLR1714
            out[end] = c  # no placeholder
            end += 1
        elif c < _LETTER:
            decimals = 0
            if c == _INTEGER:
                number = ints[value_at]
                value_at += 1
            else:
                i += 1
                decimals = form[i] - _ZERO
                number = int(scaled(singles, single_at, decimals))
                if ptr8(singles)[4 * single_at + 3] > _MINUS_ZERO_HIGH:  # negative
                    out[end] = _MINUS
                    end += 1
                single_at += 1
            # Written backwards from the last digit, then moved to `end`.
            after_digits = end + _SCRATCH
            at = after_digits
            while number or decimals >= 0:  # a 0 has a digit, too, and its decimals
                is_quick = 0 if number < 0 or number > _QUICK_TENTH else 1
                tenth = (number * 26215) >> 18 if is_quick else number // 10
                digit = number - 10 * tenth
                if number < 0:  # -1: too large. Grbl's 32 bits end with 2147483648
                    tenth = _TENTH_OF_2_31
                    digit = 8
                number = tenth
                at -= 1
                out[at] = _ZERO + digit
                decimals -= 1
                if decimals == 0:
                    at -= 1
                    out[at] = _POINT
            while at < after_digits:
                out[end] = out[at]
                end += 1
                at += 1
        else:  # a letter, if the value's lowest bit is set
            i += 1
            if ints[value_at] & 1:
                out[end] = form[i]
                end += 1
            ints[value_at] >>= 1
        i += 1
        c = form[i]
    ints[END] = end
    return end


_out = bytearray(32)
_end = array("i", (0,))
_single = array("f", (0.0,))


def number(x: float, decimals: int) -> str:
    """Return x as text, rounded to so many decimals (0, 1, 3 or 4), as Grbl prints it."""
    _end[END] = 0
    _single[0] = x
    end = write(b"#%d\0" % decimals, _out, _end, _single)
    return text_of(_out[:end])
