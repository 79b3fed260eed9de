# mypy: disable-error-code=arg-type
"""Words: a letter and a number, the atoms of a G-code line.

Numbers come out in single precision, rounded digit by digit as Grbl's reader
does: eight digits count, the rest only move the point. Called by gcode and
commands; it knows no meaning of any letter.
"""

from array import array

import micropython
from micropython import const

_MAX_WORDS = const(128)

# What plain() found: bits of its mask. Bits 0 to 3 are X, Y, Z and A.
HAS_F = const(0x10)  # another feed rate than before
HAS_S = const(0x20)
HAS_G0 = const(0x40)  # G0, which was not in force
HAS_G1 = const(0x80)
HAS_N = const(0x100)
# Where in `at` the place of a word is; and, behind those, what plain() is told:
F_AT = const(4)
S_AT = const(5)
N_AT = const(8)
AXES = const(9)  # how many there are
MODE = const(10)  # the motion in force: HAS_G0 or HAS_G1
LASER = const(11)  # S goes with cutting motion

# What scan() found wrong, above the count of words.
LETTER_EXPECTED = const(1)
NUMBER_EXPECTED = const(2)


@micropython.viper
def store_single(number: int, power: int, values: ptr32, at: int) -> int:
    """Put number * 10**power, in single precision, into values[at]; number < 2**27.

    Powers are taken in steps of 0.01, 0.1 or 10, and each product is rounded.
    """
    exponent = 150
    rest = 0
    half = 1
    while number >= 1 << 24:
        rest |= (number & 1) * half
        half <<= 1
        number >>= 1
        exponent += 1
    if rest << 1 > half or (rest << 1 == half and number & 1):
        number += 1
    if number:
        while number < 1 << 16:
            number <<= 8
            exponent -= 8
        while number < 1 << 23:
            number <<= 1
            exponent -= 1
    while number and power:
        if power < -1:
            factor = 0xA3D70A
            exponent -= 6
            power += 2
        elif power < 0:
            factor = 0xCCCCCD
            exponent -= 3
            power = 0
        else:
            factor = 0xA00000
            exponent += 4
            power -= 1
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
    if number == 1 << 24:
        number >>= 1
        exponent += 1
    if exponent > 254:
        exponent = 255  # infinite
        number = 0
    elif number == 0:
        exponent = 0
    values[at] = (exponent << 23) | (number & 0x7FFFFF)
    return 0


@micropython.viper
def scan(text: ptr8, span: int, letters: ptr8, values: ptr32) -> int:
    """Read words from text[start:end], span = end << 8 | start; text[end] is 0.

    Letters and values, as bits of single-precision floats, go into their
    arrays. Returns the count of words, and above it (<< 8) what was wrong
    after the last of them. A letter of 0 there asks for one bare number, and
    for the position after it: see Words.number().
    """
    pos = span & 255
    end = span >> 8
    signs = ptr8(values)
    count = 0
    bare = letters[0] == 0
    while pos < end or bare:
        if not bare:
            letter = text[pos]
            if letter < 65 or letter > 90:
                return count | 256
            letters[count] = letter
            pos += 1
        sign = text[pos]
        if sign == 45 or sign == 43:  # noqa: PLR1714 (a viper cannot ask `in`)
            pos += 1
        number = 0
        digits = 0
        power = 0
        point = 0
        while True:
            c = text[pos] - 48
            if c >= 0 and c <= 9:
                digits += 1
                if digits <= 8:
                    number = number * 10 + c
                    power -= point
                else:
                    power += 1 - point
            elif c == -2 and point == 0:
                point = 1
            else:
                break
            pos += 1
        if digits == 0:
            return count | 512
        store_single(number, power, values, count)
        if sign == 45:
            signs[4 * count + 3] = signs[4 * count + 3] | 128
        count += 1
        if bare:
            return pos
    return count


@micropython.viper
def plain(letters: ptr8, values: ptr32, count: int, at: ptr8, feed: ptr32) -> int:
    """What a line holds if it does no more than move; 0 if it does, or if a word is wrong.

    Plain are G0 and G1, X to Z and A, F, N and S, each once at the most, the
    last three not negative. Returns a mask of axes and of what is new to the
    interpreter, the public names above; at[bit] tells which word it is. feed:
    the rate in force.
    """
    if count > 255:
        return 0  # scan() has found a fault
    signs = ptr8(values)
    seen = 0
    for i in range(count):
        letter = letters[i]
        value = values[i]
        bit = 8
        if letter == 71:  # G
            if value >> 23 == 127 and value & 0x7FFFFF == 0:
                bit = 7
            elif value:
                return 0
            else:
                bit = 6
            if seen & 0xC0:
                return 0
        elif letter >= 88:  # X, Y, Z
            bit = letter - 88
        elif letter == 65:  # A
            bit = 3
        elif signs[4 * i + 3] & 128:
            return 0
        elif letter == 70:  # F
            bit = 4
        elif letter == 83:  # S
            bit = 5
        elif letter != 78 or value >> 7 >= 0x96312D:  # N below ten million
            return 0
        if seen >> bit & 1:
            return 0
        seen |= 1 << bit
        at[bit] = i
    if seen & 15 == 0 or (seen & 15) >> at[AXES]:
        return 0
    mode = seen & (HAS_G0 | HAS_G1)
    if mode == at[MODE]:
        seen ^= mode
    mode = mode or at[MODE]
    rate = feed[0]
    if seen & HAS_F:
        if values[at[F_AT]] == rate:
            seen ^= HAS_F
        rate = values[at[F_AT]]
    if mode == HAS_G1:
        return seen if rate and (at[LASER] or not seen & HAS_S) else 0
    return 0 if seen & HAS_S else seen


@micropython.viper
def target(values: ptr32, at: ptr8, seen: int, offsets: ptr32, position: ptr32, xyz: ptr32) -> int:
    """Put the axis words of a plain line, offsets added, into xyz; other axes stay in position."""
    for i in range(at[AXES]):
        if seen >> i & 1:
            xyz[i] = values[at[i]]
            if offsets[i]:
                add_single(offsets, i, xyz, i)
        else:
            xyz[i] = position[i]
    return 0


@micropython.viper
def add_single(a: ptr32, i: int, b: ptr32, j: int) -> int:
    """Make b[j] the sum of a[i] and b[j], all bits of single-precision floats, rounded to even."""
    sign_a = ptr8(a)[4 * i + 3] >> 7
    sign_b = ptr8(b)[4 * j + 3] >> 7
    x = (a[i] & 0x3FFFFFFF) | ((ptr8(a)[4 * i + 3] & 64) << 24)
    y = (b[j] & 0x3FFFFFFF) | ((ptr8(b)[4 * j + 3] & 64) << 24)
    if x < y:
        shift = x
        x = y
        y = shift
        shift = sign_a
        sign_a = sign_b
        sign_b = shift
    exponent = x >> 23
    shift = exponent - (y >> 23)
    if y >> 23 and shift < 27:
        # Three more bits, the last one sticky, are enough to round as if all were there.
        y = ((y & 0x7FFFFF) | 0x800000) << 3
        rest = y & ((1 << shift) - 1)
        y = (y >> shift) | (1 if rest else 0)
        x = ((x & 0x7FFFFF) | 0x800000) << 3
        x = x + y if sign_a == sign_b else x - y
        if x == 0:
            exponent = 0
            sign_a = 0
        while x and x < 1 << 26:
            x <<= 1
            exponent -= 1
        if x >= 1 << 27:
            x = (x >> 1) | (x & 1)
            exponent += 1
        rest = x & 7
        x >>= 3
        if rest > 4 or (rest == 4 and x & 1):
            x += 1
        if x >> 24:
            x >>= 1
            exponent += 1
        x = (exponent << 23) | (x & 0x7FFFFF)
    b[j] = x
    if sign_a:
        ptr8(b)[4 * j + 3] = ptr8(b)[4 * j + 3] | 128
    return 0


class Words:
    """The words of one line. letters[i] is a character code, values[i] its number.

    axes: how many plain() knows.
    """

    def __init__(self, axes: int = 0) -> None:
        self.letters = bytearray(b"\1" * _MAX_WORDS)  # never 0: see scan()
        self.values = array("f", (0.0 for _ in range(_MAX_WORDS)))
        self.count = 0
        self.fault = 0
        self.at = bytearray(16)
        self.at[AXES] = axes
        self._number = array("f", (0.0,))
        self._no_letter = bytearray(1)

    def read(self, text: bytearray, start: int, end: int) -> None:
        """Read text[start:end], which a 0 follows. fault tells what is wrong behind the words."""
        self.found(scan(text, end << 8 | start, self.letters, self.values))

    def found(self, found: int) -> None:
        """Take over what scan() has found."""
        self.count = found & 255
        self.fault = found >> 8

    def number(self, text: bytearray, start: int) -> "tuple[int, float]":
        """Read a bare number; returns the position after it, or -1, and its value."""
        end = scan(text, start, self._no_letter, self._number)
        if end >= 512:
            return -1, 0.0
        return end, self._number[0]
