# mypy: disable-error-code=arg-type
"""Clusters: many powers in one line, S0:0:875:0, each for an equal part of the line's way.

LightBurn's way to send rasters. Viper; knows text, single precision as bits, and no hardware.
"""

import micropython
from base.errors import BAD_NUMBER_FORMAT, GCODE_MAX_VALUE_EXCEEDED, NEGATIVE_VALUE
from micropython import const
from motion.beam import MOST, ROOM

from language.words import number

# The scale: what S means, as store() wants it; the first three are bits of floats above 0.
HIGHEST = const(0)  # S of full power,
LOWEST = const(1)  # of the least there is,
GRADIENT = const(2)  # and power per S above that
FULL = const(3)
DYNAMIC = const(4)  # power is to follow speed: it is told in 1/64, of all of S
SCALE_LENGTH = const(5)


@micropython.viper
def gather(line: ptr8, length: int, text: ptr8, values: ptr32) -> int:
    """Read a line's cluster: its numbers, as bits, go to values, and a line with the last of them
    alone to text. Returns how many << 8 with the length of that line, 0 where there is none, or
    what is wrong with it, below 0."""
    colon = 0
    while colon < length and line[colon] != 58:  # :
        colon += 1
    if colon == length:
        return 0
    pos = colon
    while pos and (line[pos - 1] < 65 or line[pos - 1] > 90):
        pos -= 1
    if pos == 0 or line[pos - 1] != 83:  # S
        return 0 - BAD_NUMBER_FORMAT
    for i in range(pos):
        text[i] = line[i]
    to = pos
    count = 0
    last = pos
    wrong = 0
    while wrong == 0:
        last = pos
        pos = int(number(line, pos, values, count))
        if pos == 0:
            wrong = BAD_NUMBER_FORMAT
        elif ptr8(values)[4 * count + 3] & 128:
            wrong = NEGATIVE_VALUE
        count += 1
        if wrong or pos >= length or line[pos] != 58:
            break
        if count == MOST:
            wrong = GCODE_MAX_VALUE_EXCEEDED
        pos += 1
    if wrong:
        return 0 - wrong
    while last < length:
        text[to] = line[last]
        to += 1
        last += 1
    text[to] = 0
    return count << 8 | to


@micropython.viper
def times(a: int, b: int, shift: int) -> int:
    """The whole part of the product, rounded to single precision, of two floats above 0, as bits;
    2**shift times as much."""
    exponent = ((a >> 23) & 255) + ((b >> 23) & 255) - 276 + shift
    a = (a & 0x7FFFFF) | 0x800000
    b = (b & 0x7FFFFF) | 0x800000
    middle = (a >> 12) * (b & 0xFFF) + (a & 0xFFF) * (b >> 12)
    low = (a & 0xFFF) * (b & 0xFFF) + ((middle & 0xFFF) << 12)
    high = (a >> 12) * (b >> 12) + (middle >> 12) + (low >> 24)
    low &= 0xFFFFFF
    if high < 1 << 23:
        high = (high << 1) | (low >> 23)
        low = (low << 1) & 0xFFFFFF
        exponent -= 1
    if low > 0x800000 or (low == 0x800000 and high & 1):
        high += 1
    if exponent > 5:
        exponent = 5
    if exponent > 0:
        high <<= exponent
    elif exponent > -25:
        high >>= 0 - exponent
    else:
        high = 0
    return high


@micropython.viper
def less(a: int, b: int) -> int:
    """The difference, as bits and rounded, of two floats, as bits, the first one being greater."""
    exponent = a >> 23
    shift = exponent - (b >> 23)
    a = ((a & 0x7FFFFF) | 0x800000) << 3
    if b == 0 or shift > 26:
        b = 1 if b else 0
    else:
        b = ((b & 0x7FFFFF) | 0x800000) << 3
        rest = b & ((1 << shift) - 1)
        b = (b >> shift) | (1 if rest else 0)
    a -= b
    while a < 1 << 26:
        a <<= 1
        exponent -= 1
    rest = a & 7
    a >>= 3
    if rest > 4 or (rest == 4 and a & 1):
        a += 1
    if a >> 24:
        a >>= 1
        exponent += 1
    return exponent << 23 | (a & 0x7FFFFF)


@micropython.viper
def weigh(value: int, scale: ptr32) -> int:
    """The power of S, a float as bits: what spindle.Spindle.block_power() says of it."""
    power = 0
    if scale[DYNAMIC] and value > scale[HIGHEST]:
        value = scale[HIGHEST]
    if scale[DYNAMIC] == 0 and (scale[LOWEST] >= scale[HIGHEST] or value >= scale[HIGHEST]):
        power = scale[FULL]
    elif value == 0:
        power = 0
    elif scale[DYNAMIC] == 0 and value <= scale[LOWEST]:
        power = 1
    else:
        shift = 6
        if scale[DYNAMIC] == 0:
            shift = 0
            power = 1
            value = int(less(value, scale[LOWEST]))
        power += int(times(value, scale[GRADIENT], shift))
    return power


@micropython.viper
def store(
    values: ptr32, count: int, scale: ptr32, clusters: ptr32, speeds: ptr32, block: int
) -> int:
    """Powers, and what they are made of, go where a block's are looked for."""
    at = ROOM * block
    last = -1
    power = 0
    for i in range(count):
        if values[i] != last:
            last = values[i]
            power = int(weigh(last, scale))
        clusters[at + 1 + i] = power
        speeds[MOST * block + i] = last
    clusters[at] = count
    return 0
