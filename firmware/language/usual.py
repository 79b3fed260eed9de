# mypy: disable-error-code="arg-type, attr-defined, call-overload, has-type, misc"
"""The usual block: checked and put in force by kernels, where it asks for nothing seldom.

Modes, coordinate systems, motion in a line or an arc, feed, spindle, coolant, program flow: that
is nearly every line which does more than move. What usual() does not know checks.py sees to;
either way a block is the same behind it.
"""

import micropython
from base.errors import (
    GCODE_AXIS_WORDS_EXIST,
    GCODE_INVALID_LINE_NUMBER,
    GCODE_UNDEFINED_FEED_RATE,
    GCODE_UNUSED_WORDS,
    GCODE_VALUE_WORD_MISSING,
)
from base.singles import add, multiply
from control.modes import (
    COOLANT,
    FEED,
    INCHES,
    INVERSE_TIME,
    MOTION,
    OVERRIDE_CONTROL,
    PLANE,
    PROGRAM_FLOW,
    RELATIVE,
    RPM,
    SPINDLE,
    SYSTEM,
    TOOL_LENGTH,
)
from micropython import const

from language.arc_words import find_arc
from language.block_layout import (
    AXES_MOTION,
    AXES_TOOL_LENGTH,
    AXES_UNCLAIMED,
    AXIS_WORDS,
    CCW_ARC,
    CLAIM,
    COMMANDS,
    DWELL,
    GROUP_3,
    GROUP_6,
    GROUP_M9,
    INCH_MM,
    LINEAR,
    NO_MOTION,
    NON_MODAL,
    SEEK,
    WORD_F,
    WORD_IJK,
    WORD_N,
    WORD_P,
    WORD_R,
    WORD_S,
    WORD_T,
    WORDS,
    F,
    N,
    S,
    T,
)

ODD = const(-1)  # it asks for what is seldom

# What is left to be done with a block, a bit each.
SPEED = const(1)
SET_TOOL = const(2)
ACCESSORIES = const(4)
OFFSETS = const(8)
COMMAND = const(16)  # one that is not modal
MOVE = const(32)
FLOW = const(64)


@micropython.viper
def _claim(ints: ptr32) -> int:
    """Who uses the axis words; ODD where that is somebody seldom."""
    claim = ints[CLAIM]
    motion = ints[MOTION]
    axis_words = ints[WORDS] & AXIS_WORDS
    if axis_words and claim == AXES_UNCLAIMED:
        claim = AXES_MOTION
    if claim == AXES_MOTION:
        return ODD if motion > CCW_ARC and motion != NO_MOTION else claim
    if claim == AXES_TOOL_LENGTH:
        return ODD if axis_words or ints[TOOL_LENGTH] else claim
    return ODD if claim else claim


@micropython.viper
def _rate(ints: ptr32, singles: ptr32, modal: ptr32, rates: ptr32, claim: int) -> int:
    """Find F of a block, as it is in force. Returns what is wrong with it, or 0."""
    has_f = ints[WORDS] & WORD_F
    motion = ints[MOTION]
    if ints[INVERSE_TIME]:
        cuts = motion != SEEK and motion != NO_MOTION  # noqa: PLR1714 (a viper cannot ask `in`)
        return GCODE_UNDEFINED_FEED_RATE if claim == AXES_MOTION and cuts and has_f == 0 else 0
    if modal[INVERSE_TIME] == 0:
        if has_f == 0:
            singles[F] = rates[FEED]
        elif ints[INCHES]:
            multiply(singles, F, singles, INCH_MM)
    return 0


@micropython.viper
def usual(zero: ptr32, modal: ptr32, lengths: int, memory: object) -> int:
    """Check a block as checks.check() does, and leave it ready. Returns what is wrong with it, 0,
    or ODD where that has to see to it, and nothing has been changed. zero: of the block's system,
    without tool length, which is none; lengths: a mask; memory: an interpreter's."""
    ints, singles, xyz, position, rates, axes, plane, arc = memory
    return int(
        _usual(
            ptr32(ints),
            ptr32(singles),
            ptr32(xyz),
            ptr32(position),
            zero,
            modal,
            ptr32(rates),
            int(axes),
            lengths,
            ptr32(plane),
            ptr32(arc),
        )
    )


@micropython.viper
def _usual(
    ints: ptr32,
    singles: ptr32,
    xyz: ptr32,
    position: ptr32,
    zero: ptr32,
    modal: ptr32,
    rates: ptr32,
    axes: int,
    lengths: int,
    plane: ptr32,
    arc: ptr32,
) -> int:
    """As usual(). plane, arc: those of an Arc."""
    words = ints[WORDS]
    axis_words = words & AXIS_WORDS
    command = ints[NON_MODAL]
    motion = ints[MOTION]
    claim = int(_claim(ints))
    if claim == ODD or ints[COMMANDS] & GROUP_M9 or (command and command != DWELL):
        return ODD
    if singles[N] & int(0x7FFFFFFF) > int(0x4B189680):  # the float 10,000,000; -0 is a number, too
        return GCODE_INVALID_LINE_NUMBER
    wrong = int(_rate(ints, singles, modal, rates, claim))
    if wrong:
        return wrong
    if words & WORD_S == 0:
        singles[S] = rates[RPM]
    unused = words & ~(WORD_N | WORD_F | WORD_S | WORD_T)
    if command == DWELL:
        if words & WORD_P == 0:
            return GCODE_VALUE_WORD_MISSING
        unused &= ~WORD_P
    if axis_words:
        if ints[INCHES]:
            in_mm(xyz, axes, lengths, singles)
        add(position if ints[RELATIVE] else zero, 0, xyz, axes)
        stay(position, xyz, words, axes)
    if motion == NO_MOTION and axis_words:
        return GCODE_AXIS_WORDS_EXIST
    if claim == AXES_MOTION and motion != NO_MOTION:
        if motion != SEEK and singles[F] & int(0x7FFFFFFF) == 0:
            return GCODE_UNDEFINED_FEED_RATE
        if motion > LINEAR:
            wrong = int(find_arc(ints, singles, xyz, position, axes, plane, arc))
            if wrong:
                return wrong
            unused &= ~(WORD_R if words & WORD_R else WORD_IJK)
        elif axis_words == 0:
            claim = AXES_UNCLAIMED
    if claim:
        unused &= ~AXIS_WORDS
    ints[CLAIM] = claim
    return GCODE_UNUSED_WORDS if unused else 0


@micropython.viper
def plain_jog(ints: ptr32) -> int:
    """Whether usual() may see to the block of a jog: a move with a feed rate, and modes of how to
    read its numbers."""
    words = ints[WORDS]
    if words & WORD_F == 0 or words & ~(AXIS_WORDS | WORD_F | WORD_N) or ints[NON_MODAL]:
        return 0
    return 0 if ints[COMMANDS] & ~(GROUP_3 | GROUP_6) else 1


@micropython.viper
def in_mm(xyz: ptr32, axes: int, lengths: int, singles: ptr32) -> int:
    """Inches to mm, of the axes that are lengths: a mask. singles: a block's, which has 25.4."""
    for i in range(axes):
        if (lengths >> i) & 1:
            multiply(xyz, i, singles, INCH_MM)
    return 0


@micropython.viper
def stay(position: ptr32, xyz: ptr32, words: int, axes: int) -> int:
    """Axes without a word, a bit of words each, stay at their position."""
    for i in range(axes):
        if (words >> i) & 1 == 0:
            xyz[i] = position[i]
    return 0


@micropython.viper
def settle(ints: ptr32, singles: ptr32, modal: ptr32, rates: ptr32) -> int:
    """Put in force what a checked block changes by itself: modes of how to read numbers and how to
    move, and the feed rate. Returns what is left to be done."""
    left = 0
    if rates[RPM] != singles[S] and (rates[RPM] | singles[S]) & int(0x7FFFFFFF):
        left = SPEED
    if singles[T]:
        left |= SET_TOOL
    if (
        modal[SPINDLE] != ints[SPINDLE]
        or modal[COOLANT] != ints[COOLANT]
        or modal[OVERRIDE_CONTROL] != ints[OVERRIDE_CONTROL]
    ):
        left |= ACCESSORIES
    if modal[SYSTEM] != ints[SYSTEM] or ints[CLAIM] == AXES_TOOL_LENGTH:
        left |= OFFSETS
    if ints[NON_MODAL]:
        left |= COMMAND
    if ints[CLAIM] == AXES_MOTION and ints[MOTION] != NO_MOTION:
        left |= MOVE
    if ints[PROGRAM_FLOW]:
        left |= FLOW
    modal[INVERSE_TIME] = ints[INVERSE_TIME]
    modal[PLANE] = ints[PLANE]
    modal[INCHES] = ints[INCHES]
    modal[RELATIVE] = ints[RELATIVE]
    modal[MOTION] = ints[MOTION]
    rates[FEED] = singles[F]
    return left
