# mypy: disable-error-code="arg-type, call-overload, has-type, misc"
"""The fast path's kernel: from a line's text to a block of the planner, in integers.

Everything here is viper: it allocates nothing. What a line depends on besides its text stands in
one table of integers, which fast_path.py keeps. Called by the main loop only.
"""

import micropython
from base.f32 import copy
from base.singles import add_single, multiply, whole_part
from control import modes as md
from control.canon import judge
from control.spindle import ASKED, weigh
from micropython import const
from motion.layout import HEAD
from motion.plan_kernel import FULL, OUTSIDE
from motion.plan_kernel import plan as plan_block
from motion.planner import SPINDLE_CW
from motion.reals import per_second

from language.words import number

# What read() found: bits of its mask. Behind these are X, Y, Z, A, B and C.
HAS_F = const(0x01)  # another feed rate than before
HAS_S = const(0x02)
HAS_N = const(0x04)
HAS_G0 = const(0x08)  # G0, which was not in force
HAS_G1 = const(0x10)
MODES = const(0x18)
NEWS = const(0x1B)
CHANGED = const(0x1000)  # how numbers are meant: G17 to G21, G90 or G91, which was not in force
SAME = const(0x20000000)  # no move, and nothing besides that but words that are in force
ODD = const(-1)  # what is none of those
F = const(0)  # the same as bit numbers
_S = const(1)
_N = const(2)
_G0 = const(3)
X = const(5)
_NO_LETTER = const(11)

# What is known: how many axes there are (0: nothing is known), the motion in force (HAS_G0 or
# HAS_G1, MODES for an arc), whether S goes with cutting motion, feed rate and spindle speed (bits
# of floats),
AXES = const(0)
MODE = const(1)
LASER = const(2)
FEED = const(3)
RPM = const(4)
# whether places are relative, F is of its line alone, one over a time (G93; without it there is
# none), nothing is to move,
IS_RELATIVE = const(5)
IS_TIMED = const(6)
DRY = const(7)
# what the planner is told: flags, spindle power (UNTOLD: none of it is known yet), rate: a real;
FLAGS = const(8)
POWER = const(9)
RATE = const(10)
UNTOLD = const(0x3FFFFFFF)
# the line's numbers, by their bit; whether they are inches; what is added to places, per axis.
VALUES = const(11)
_PLACES = const(VALUES + X)
IN_INCHES = const(22)
CHANGES = const(23)  # as they were counted when this was known
LACKS = const(24)  # whether the move lacks what is new
INCH_MM = const(25)
WAITS = const(26)  # whether room is all that the last line has lacked
LEFT = const(27)  # lines that may be done before the loop has its turn
# How the line itself means its numbers: in inches, relative, in which plane (its word's number).
LINE_INCHES = const(28)
LINE_RELATIVE = const(29)
LINE_PLANE = const(30)
XY = const(17)  # the first plane's word
DEGREES = const(31)  # axes (a mask) whose numbers are no lengths: in inches they go the long way
# The words in force, one of each group: their numbers, M words behind G words. 0: none that a line
# may repeat here; with 0 for the plane, as for jogs, it may have no word of a plane at all.
_IN_FORCE = const(32)
_PLANE = const(0)
_UNITS = const(1)
_DISTANCE = const(2)
_GROUPS = const(9)
_M_WORDS = const(100)
OFFSETS = const(_IN_FORCE + _GROUPS)

JOG_START = const(3)  # behind "$J="
UNKNOWN = const(-1)  # what a jog depends on is not known, or not any more


@micropython.viper
def set_in_force(known: ptr32, modal: ptr32) -> int:
    """Note which words a line may have that change nothing, and how numbers are meant."""
    known[IN_INCHES] = modal[md.INCHES]
    known[IS_RELATIVE] = modal[md.RELATIVE]
    known[IS_TIMED] = modal[md.INVERSE_TIME]
    known[_IN_FORCE + _PLANE] = XY + modal[md.PLANE]
    known[_IN_FORCE + _UNITS] = 20 if modal[md.INCHES] else 21
    known[_IN_FORCE + _DISTANCE] = 91 if modal[md.RELATIVE] else 90
    known[_IN_FORCE + 3] = 94 - modal[md.INVERSE_TIME]
    known[_IN_FORCE + 4] = 54 + modal[md.SYSTEM]
    known[_IN_FORCE + 5] = 40
    known[_IN_FORCE + 6] = 61
    word = _M_WORDS + 5
    if modal[md.SPINDLE]:
        word = _M_WORDS + (3 if modal[md.SPINDLE] == SPINDLE_CW else 4)
    known[_IN_FORCE + 7] = word
    word = 9 - modal[md.COOLANT]  # M8 for flood, M7 for mist; for both no word says all of it
    known[_IN_FORCE + 8] = 0 if word < 7 else _M_WORDS + word
    return 0


@micropython.viper
def _group(known: ptr32, value: int, first: int) -> int:
    """The group, a bit each, of a word that is in force, or with CHANGED of one that says how the
    line's numbers are meant; 0: of any other. value: the bits of its number, a float."""
    shift = 150 - (value >> 23)
    if shift < 17 or shift > 23:  # not from 1 to 127
        return 0
    digits = (value & 0x7FFFFF) | 0x800000
    word = digits >> shift
    if word << shift != digits:
        return 0
    for group in range(_GROUPS):
        if known[_IN_FORCE + group] == word + first:
            return 1 << group
    if first == 0 and word >> 1 == 10:  # 20 and 21
        known[LINE_INCHES] = 21 - word
        return CHANGED | 1 << _UNITS
    if first == 0 and word >> 1 == 45:  # 90 and 91
        known[LINE_RELATIVE] = word - 90
        return CHANGED | 1 << _DISTANCE
    if first == 0 and word >= XY and word <= XY + 2 and known[_IN_FORCE + _PLANE]:
        known[LINE_PLANE] = word
        return CHANGED | 1 << _PLANE
    return 0


@micropython.viper
def read(text: ptr8, pos: int, length: int, known: ptr32) -> int:
    """What a line, from pos on, holds if it does no more than move; ODD or 0 if it does, or if a
    word is wrong. Such have G0 and G1, X to Z and A to C, F, N and S, each once at the most, the
    last three not negative, words that are in force, G17 to G19, G20, G21, G90 and G91. Returns a
    mask of axes and of what is new, the public names above.
    """
    signs = ptr8(known)
    known[LINE_INCHES] = known[IN_INCHES]
    known[LINE_RELATIVE] = known[IS_RELATIVE]
    known[LINE_PLANE] = known[_IN_FORCE + _PLANE]
    seen = 0
    repeated = 0
    while pos < length:
        letter = text[pos]
        bit = _NO_LETTER
        first = 0
        if letter == 71:  # G
            bit = _G0
        elif letter == 77:  # M
            bit = _G0
            first = _M_WORDS
        elif letter >= 88 and letter <= 90:  # X, Y, Z
            bit = letter - 83
        elif letter >= 65 and letter <= 67:  # A, B, C
            bit = letter - 57
        elif letter == 70:  # F
            bit = F
        elif letter == 83:  # S
            bit = _S
        elif letter == 78:  # N
            bit = _N
        if bit == _NO_LETTER:
            return ODD
        pos = int(number(text, pos + 1, known, VALUES + bit))
        if pos == 0:
            return 0
        value = known[VALUES + bit]
        if bit == _G0:
            if first or (value and value != 0x3F800000):  # the float 1
                group = int(_group(known, value, first))
                if group == 0 or repeated & group & ~CHANGED:
                    return ODD
                repeated |= group
                continue
            if seen & MODES:
                return 0
            if value:
                bit += 1
        elif bit < X and signs[4 * (VALUES + bit) + 3] & 128:
            return 0
        elif bit == _N and value >> 7 >= 0x96312D:  # ten million
            return 0
        if (seen >> bit) & 1:
            return 0
        seen |= 1 << bit
    if seen:
        seen = int(_news(known, seen))
    elif repeated and known[IS_TIMED] == 0:
        seen = SAME
    return seen | repeated & CHANGED if seen else 0


@micropython.viper
def _news(known: ptr32, seen: int) -> int:
    """What is new of all that a line has; 0 where that does more than move."""
    if seen < 1 << X or seen >> (X + known[AXES]):
        return 0
    if known[LINE_INCHES] and seen >> X & known[DEGREES]:
        return 0
    mode = seen & MODES
    if mode == known[MODE]:
        seen ^= mode
    mode = mode or known[MODE]
    if mode == MODES:
        return 0
    rate = known[FEED]
    if seen & HAS_F:
        if known[VALUES + F] == rate and known[LINE_INCHES] == 0:
            seen ^= HAS_F
        rate = known[VALUES + F]
    elif known[IS_TIMED]:
        return 0
    if mode == HAS_G1:
        return seen if rate and (known[LASER] or not seen & HAS_S) else 0
    return 0 if seen & HAS_S else seen


@micropython.viper
def place(known: ptr32, seen: int, position: ptr32, target: ptr32) -> int:
    """Put the places of a line that has been read, offsets added, into target."""
    for i in range(known[AXES]):
        if (seen >> (X + i)) & 1:
            target[i] = known[_PLACES + i]
            if known[LINE_INCHES]:
                multiply(target, i, known, INCH_MM)
            if known[LINE_RELATIVE]:
                add_single(position, i, target, i)
            elif known[OFFSETS + i]:
                add_single(known, OFFSETS + i, target, i)
        else:
            target[i] = position[i]
    return 0


@micropython.viper
def line_number(known: ptr32, seen: int) -> int:
    """N of a line that has been read; 0 if it has none."""
    return int(whole_part(known, VALUES + _N, 0)) if seen & HAS_N else 0


@micropython.viper
def take_rates(known: ptr32, seen: int, rates: ptr32) -> int:
    """Put the feed rate and the spindle speed that a line has into what is in force."""
    if seen & HAS_F:
        rates[md.FEED] = known[VALUES + F]
    if seen & HAS_S:
        rates[md.RPM] = known[VALUES + _S]
    return 0


@micropython.viper
def _take_numbers(known: ptr32, seen: int, rates: ptr32, scale: ptr32) -> int:
    """Another feed rate in mm/min, or power, is in force."""
    known[LACKS] = 1
    take_rates(known, seen, rates)
    if seen & HAS_F:
        known[FEED] = known[VALUES + F]
        known[RATE] = int(per_second(known, FEED))
    if seen & HAS_S:
        known[RPM] = known[VALUES + _S]
        scale[ASKED] = known[RPM]
        if known[DRY] == 0:
            known[POWER] = int(weigh(scale, known[FLAGS]))
    return 0


@micropython.viper
def follow(
    text: ptr8,
    length: int,
    known: ptr32,
    position: ptr32,
    target: ptr32,
    travel: ptr32,
    table: ptr32,
    ring: ptr32,
    flow: ptr32,
    speeds: ptr32,
    changes: ptr32,
    rates: ptr32,
    scale: ptr32,
    news: object,
) -> int:
    """Plan a line that does no more than move and has nothing in its way. Returns 1; or 0, and
    nothing has changed but what is new, to which whoever goes on with the line sees as well.
    news: sees to what is new but rare, and says what the spindle makes of it."""
    if length == 0:
        return 1
    if known[AXES] == 0 or known[POWER] == UNTOLD or known[CHANGES] != changes[0]:
        return 0
    seen = int(read(text, 0, length, known))
    if seen <= 0:
        return 0
    if seen & SAME:
        if seen & CHANGED:
            news(seen)  # type: ignore[operator]
        return 1
    place(known, seen, position, target)
    found = int(judge(target, travel, flow))
    if found & OUTSIDE:
        return 0
    if known[DRY] == 0 and found & FULL:
        known[WAITS] = 1
        return 0
    if seen & (NEWS | CHANGED):
        if seen & (MODES | CHANGED) or (seen & HAS_F and known[LINE_INCHES]):
            known[POWER] = int(news(seen))  # type: ignore[operator]
        else:
            _take_numbers(known, seen, rates, scale)
    if known[DRY] == 0:
        at = flow[HEAD]
        line = int(line_number(known, seen))
        power = known[POWER]
        rate = known[RATE]
        if int(plan_block(target, table, ring, flow, known[FLAGS], line, power, rate)) == 0:
            return 0
        speeds[at] = known[RPM]
    copy(target, position, known[AXES])
    return 1


@micropython.viper
def follow_line(text: ptr8, length: int, memory: object) -> int:
    """follow() with all that it needs: what FastPath.memory() has."""
    known, position, target, travel, table, ring, flow, speeds, changes, rates, scale, news = (
        memory
    )
    return int(
        follow(
            text,
            length,
            ptr32(known),
            ptr32(position),
            ptr32(target),
            ptr32(travel),
            ptr32(table),
            ptr32(ring),
            ptr32(flow),
            ptr32(speeds),
            ptr32(changes),
            ptr32(rates),
            ptr32(scale),
            news,
        )
    )


@micropython.viper
def jog(text: ptr8, length: int, known: ptr32, memory: object) -> int:
    """Plan a "$J=" line that is allowed and finds room. Returns 1; 0, and nothing has changed; or
    UNKNOWN. known: a table of its own, without a motion mode, feed rate or power; memory: as that
    of follow_line()."""
    _, position, places, travel, table, ring, queue, speeds, changes, rates, _, _ = memory
    target = ptr32(places)
    flow = ptr32(queue)
    if known[AXES] == 0 or known[CHANGES] != ptr32(changes)[0]:
        return UNKNOWN
    seen = int(read(text, JOG_START, length, known))
    if seen <= 0 or seen & (SAME | MODES | HAS_F) != HAS_F or known[VALUES + F] == 0:
        return 0
    place(known, seen, ptr32(position), target)
    found = int(judge(target, ptr32(travel), flow))
    if found:
        return 0
    if known[LINE_INCHES]:
        multiply(known, VALUES + F, known, INCH_MM)
    rate = int(per_second(known, VALUES + F))
    at = flow[HEAD]
    line = int(line_number(known, seen))
    flags = known[FLAGS]
    if int(plan_block(target, ptr32(table), ptr32(ring), flow, flags, line, 0, rate)) == 0:
        return 0
    ptr32(speeds)[at] = ptr32(rates)[md.RPM]
    copy(target, ptr32(position), known[AXES])
    return 1
