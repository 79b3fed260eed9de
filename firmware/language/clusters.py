# mypy: disable-error-code=arg-type
"""Clusters: many powers in one line, S0:0:875:0, each for an equal part of the line's way.

LightBurn's way to send rasters. Viper; knows text, single precision as bits, and no hardware.
"""

import micropython
from base.errors import BAD_NUMBER_FORMAT, GCODE_MAX_VALUE_EXCEEDED, NEGATIVE_VALUE
from control.spindle import ASKED, weigh
from motion.beam import MOST, ROOM

from language.words import number


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
def store(
    values: ptr32,
    count: int,
    scale: ptr32,
    flags: int,
    clusters: ptr32,
    speeds: ptr32,
    block: int,
) -> int:
    """Powers, and what they are made of, go where a block's are looked for. scale and flags: as
    weigh() wants them."""
    at = ROOM * block
    last = -1
    power = 0
    for i in range(count):
        if values[i] != last:
            last = values[i]
            scale[ASKED] = last
            power = int(weigh(scale, flags))
        clusters[at + 1 + i] = power
        speeds[MOST * block + i] = last
    clusters[at] = count
    return 0
