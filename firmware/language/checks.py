"""Checks: step three of the interpreter. Everything that can refuse a block does so here.

Along the way the block's values become what execution wants: mm, absolute,
machine coordinates. The order of checks is the standard's order of execution,
which decides the number that a block with two faults gets.
"""

from base import errors
from base.errors import GrblError
from base.f32 import f32, whole
from base.singles import add, to_mm
from control.coords import G28, G30, SYSTEMS
from control.modes import (
    FEED,
    INCHES,
    INVERSE_TIME,
    MOTION,
    OVERRIDE_CONTROL,
    RELATIVE,
    RPM,
    SYSTEM,
    TOOL_LENGTH,
)
from micropython import const

from language import block_layout as b
from language.arc_words import find_arc, is_there
from language.usual import in_mm, stay

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array

    from control.coords import Coords
    from control.modes import Modes

    from language.block import Block

_HIGHEST_LINE = const(10000000)


def check(modes: "Modes", coords: "Coords", block: "Block", jog: bool) -> None:
    """Refuse the block with GrblError, or leave it ready to be executed."""
    ints, singles = block.ints, block.singles
    words = ints[b.WORDS]
    axis_words = words & b.AXIS_WORDS
    if axis_words and not ints[b.CLAIM]:
        ints[b.CLAIM] = b.AXES_MOTION
    if singles[b.N] > _HIGHEST_LINE:
        raise GrblError(errors.GCODE_INVALID_LINE_NUMBER)
    _feed(modes, block, jog)
    if not words & b.WORD_S:
        singles[b.S] = modes.rates[RPM]
    unused = words & ~b.WORD_N
    if ints[b.COMMANDS] & b.GROUP_M9:
        _override_control(block)
        unused &= ~b.WORD_P
    if ints[b.NON_MODAL] == b.DWELL:
        if not words & b.WORD_P:
            raise GrblError(errors.GCODE_VALUE_WORD_MISSING)
        unused &= ~b.WORD_P
    if ints[INCHES]:
        in_mm(block.xyz, len(block.xyz), block.lengths, singles)
    claim = ints[b.CLAIM]
    if claim == b.AXES_TOOL_LENGTH and ints[TOOL_LENGTH]:
        if axis_words != 1 << coords.length_axis:
            raise GrblError(errors.GCODE_G43_DYNAMIC_AXIS_ERROR)
    command = ints[b.NON_MODAL]
    if command == b.SET_COORDS:
        unused &= ~_set_coords(modes, coords, block)
    elif command == b.SET_G92:
        _set_g92(modes, coords, block)
    else:
        if axis_words and claim != b.AXES_TOOL_LENGTH:
            _target(modes, coords, block)
        if command:
            _place(modes, coords, block)
    unused &= ~_motion(modes, block)
    unused &= ~(b.WORD_F if jog else b.WORD_F | b.WORD_S | b.WORD_T)
    if ints[b.CLAIM]:
        unused &= ~b.AXIS_WORDS
    if unused:
        raise GrblError(errors.GCODE_UNUSED_WORDS)
    if jog:
        _jog(block)


def _feed(modes: "Modes", block: "Block", jog: bool) -> None:
    ints, singles = block.ints, block.singles
    has_f = ints[b.WORDS] & b.WORD_F
    if jog:
        if not has_f:
            raise GrblError(errors.GCODE_UNDEFINED_FEED_RATE)
        if ints[INCHES]:
            to_mm(singles, b.F)
    elif ints[INVERSE_TIME]:
        cuts = ints[b.CLAIM] == b.AXES_MOTION and ints[MOTION] not in (b.NO_MOTION, b.SEEK)
        if cuts and not has_f:
            raise GrblError(errors.GCODE_UNDEFINED_FEED_RATE)
    elif not modes.modal[INVERSE_TIME]:
        if not has_f:
            singles[b.F] = modes.rates[FEED]
        elif ints[INCHES]:
            to_mm(singles, b.F)


def _override_control(block: "Block") -> None:
    """M56 P0 takes parking out of action, M56 or M56 P1 puts it back."""
    ints = block.ints
    off = ints[b.WORDS] & b.WORD_P and block.singles[b.P] == 0
    ints[OVERRIDE_CONTROL] = 0 if off else 1


def _set_g92(modes: "Modes", coords: "Coords", block: "Block") -> None:
    """G92: the new offsets go to block.xyz."""
    ints = block.ints
    if not ints[b.WORDS] & b.AXIS_WORDS:
        raise GrblError(errors.GCODE_NO_AXIS_WORDS)
    _offset_at(modes, coords, block, coords.systems[ints[SYSTEM]], coords.g92, block.xyz)


def _place(modes: "Modes", coords: "Coords", block: "Block") -> None:
    """Where G28 or G30 is to go, and whether G53 can go where it says."""
    command = block.ints[b.NON_MODAL]
    if command in (b.GO_G28, b.GO_G30):
        _stored(modes, coords, block)
    elif command == b.ABSOLUTE_OVERRIDE and block.ints[MOTION] not in (b.SEEK, b.LINEAR):
        raise GrblError(errors.GCODE_G53_INVALID_MOTION_MODE)


def _stored(modes: "Modes", coords: "Coords", block: "Block") -> None:
    """Where G28 or G30 is to go."""
    ints = block.ints
    stored = coords.systems[G28 if ints[b.NON_MODAL] == b.GO_G28 else G30]
    axis_words = ints[b.WORDS] & b.AXIS_WORDS
    if not axis_words:
        ints[b.CLAIM] = b.AXES_UNCLAIMED
    for i in range(len(modes.position)):
        here = axis_words and not axis_words >> i & 1
        block.stored[i] = modes.position[i] if here else stored[i]


def _set_coords(modes: "Modes", coords: "Coords", block: "Block") -> int:
    """G10 L2 and L20: the new offsets go to block.stored, the system's index to block.index."""
    ints = block.ints
    words = ints[b.WORDS]
    if not words & b.AXIS_WORDS:
        raise GrblError(errors.GCODE_NO_AXIS_WORDS)
    if not words & (b.WORD_P | b.WORD_L):
        raise GrblError(errors.GCODE_VALUE_WORD_MISSING)
    system = whole(block.singles[b.P]) & 255
    if system > SYSTEMS:
        raise GrblError(errors.GCODE_UNSUPPORTED_COORD_SYS)
    kind = whole(block.singles[b.L]) & 255
    if kind != 20 and (kind != 2 or words & b.WORD_R):
        raise GrblError(errors.GCODE_UNSUPPORTED_COMMAND)
    block.index = system - 1 if system else ints[SYSTEM]
    stored = coords.systems[block.index]
    if kind == 20:
        _offset_at(modes, coords, block, coords.g92, stored, block.stored)
    else:
        for i in range(len(modes.position)):
            block.stored[i] = block.xyz[i] if words >> i & 1 else stored[i]
    return b.WORD_P | b.WORD_L


def _offset_at(
    modes: "Modes",
    coords: "Coords",
    block: "Block",
    other: "array[float]",
    old: "array[float]",
    new: "array[float]",
) -> None:
    """The offset which, beside the other one, makes the present place read as programmed."""
    for i in range(len(modes.position)):
        if block.ints[b.WORDS] >> i & 1:
            offset = f32(f32(modes.position[i] - other[i]) - block.xyz[i])
            if i == coords.length_axis:
                offset -= coords.tool_length
            new[i] = offset
        else:
            new[i] = old[i]


def _target(modes: "Modes", coords: "Coords", block: "Block") -> None:
    """Axis words become a target in machine coordinates; axes without a word stay."""
    ints, xyz, position = block.ints, block.xyz, modes.position
    if ints[b.NON_MODAL] != b.ABSOLUTE_OVERRIDE:
        if ints[RELATIVE]:
            add(position, 0, xyz, len(position))
        else:
            add(coords.zero(ints[SYSTEM]), 0, xyz, len(position))
            if coords.tool_length:
                xyz[coords.length_axis] += coords.tool_length
    stay(position, xyz, ints[b.WORDS], len(position))


def _motion(modes: "Modes", block: "Block") -> int:
    """Check group 1; returns the value words it used."""
    ints = block.ints
    motion = ints[MOTION]
    axis_words = ints[b.WORDS] & b.AXIS_WORDS
    if motion == b.NO_MOTION:
        if axis_words:
            raise GrblError(errors.GCODE_AXIS_WORDS_EXIST)
        return 0
    if ints[b.CLAIM] != b.AXES_MOTION:
        return 0
    if motion == b.SEEK:
        if not axis_words:
            ints[b.CLAIM] = b.AXES_UNCLAIMED
        return 0
    if block.singles[b.F] == 0:
        raise GrblError(errors.GCODE_UNDEFINED_FEED_RATE)
    if motion == b.LINEAR:
        if not axis_words:
            ints[b.CLAIM] = b.AXES_UNCLAIMED
        return 0
    if not axis_words:
        raise GrblError(errors.GCODE_NO_AXIS_WORDS)
    if motion in (b.CW_ARC, b.CCW_ARC):
        return _arc(modes, block)
    if is_there(modes.position, block.xyz, len(modes.position)):
        raise GrblError(errors.GCODE_INVALID_TARGET)
    return 0


def _arc(modes: "Modes", block: "Block") -> int:
    """Find centre and radius of an arc; returns the value words it used."""
    ints, position, arc = block.ints, modes.position, block.arc
    axes, plane, numbers = block.axes, arc.plane, arc.numbers
    wrong = find_arc(ints, block.singles, block.xyz, position, axes, plane, numbers)
    if wrong:
        raise GrblError(wrong)
    return b.WORD_R if ints[b.WORDS] & b.WORD_R else b.WORD_IJK


def _jog(block: "Block") -> None:
    allowed = b.GROUP_0 | b.GROUP_3 | b.GROUP_6
    ints = block.ints
    is_move = ints[b.NON_MODAL] in (b.NO_ACTION, b.ABSOLUTE_OVERRIDE)
    if ints[b.COMMANDS] & ~allowed or not is_move:
        raise GrblError(errors.INVALID_JOG_COMMAND)
