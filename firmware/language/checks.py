# mypy: disable-error-code="arg-type, attr-defined, call-overload, has-type, misc"
"""Checks: step three of the interpreter, in kernels. All that can refuse a block does so here.

Along the way the block's values become what execution wants: mm, absolute, machine coordinates.
The order of checks is the standard's order of execution (NIST RS274NGC v3, table 8), which decides
the number that a block with two faults gets. Nothing that is in force changes. Sections named here
are the standard's.
"""

import micropython
from base.errors import (
    GCODE_AXIS_WORDS_EXIST,
    GCODE_G43_DYNAMIC_AXIS_ERROR,
    GCODE_G53_INVALID_MOTION_MODE,
    GCODE_INVALID_LINE_NUMBER,
    GCODE_INVALID_TARGET,
    GCODE_NO_AXIS_WORDS,
    GCODE_UNDEFINED_FEED_RATE,
    GCODE_UNSUPPORTED_COMMAND,
    GCODE_UNSUPPORTED_COORD_SYS,
    GCODE_UNUSED_WORDS,
    GCODE_VALUE_WORD_MISSING,
    INVALID_JOG_COMMAND,
)
from base.singles import add_single, multiply, whole_part
from control.coords import G28, G30, G92, SYSTEMS
from control.modes import (
    COOLANT,
    FEED,
    INCHES,
    INVERSE_TIME,
    MOTION,
    OVERRIDE_CONTROL,
    PROGRAM_FLOW,
    RELATIVE,
    RPM,
    SPINDLE,
    SYSTEM,
    TOOL_LENGTH,
)
from micropython import const
from motion.arc_geometry import subtract
from motion.planner import SPINDLE_CW

from language.arc_words import find_arc, is_there
from language.block_layout import (
    ABSOLUTE_OVERRIDE,
    AXES,
    AXES_MOTION,
    AXES_TOOL_LENGTH,
    AXES_UNCLAIMED,
    AXIS_WORDS,
    CCW_ARC,
    CLAIM,
    COMMANDS,
    CW_ARC,
    DWELL,
    GO_G28,
    GO_G30,
    GROUP_0,
    GROUP_3,
    GROUP_6,
    GROUP_M9,
    INCH_MM,
    INDEX,
    LENGTH_AXIS,
    LENGTHS,
    LINEAR,
    MOTION_WORDS,
    NO_MOTION,
    NON_MODAL,
    PROBE_TOWARD,
    SCRATCH,
    SEEK,
    SET_COORDS,
    SET_G92,
    WORD_F,
    WORD_IJK,
    WORD_L,
    WORD_N,
    WORD_P,
    WORD_R,
    WORD_S,
    WORD_T,
    WORDS,
    F,
    L,
    N,
    P,
    S,
)

# What a checked block asks for, a bit each.
SPEED = const(0x001)
SET_TOOL = const(0x002)
ACCESSORIES = const(0x004)
OFFSETS = const(0x008)
COMMAND = const(0x010)  # one that is not modal
MOVE = const(0x020)
FLOW = const(0x040)
SPECIAL = const(0x080)  # its motion is an arc, or a probe's
# Laser mode: what it means for the beam.
DARK = const(0x100)  # it is no cutting motion
IN_MOTION = const(0x200)  # S goes with the motion
SYNC = const(0x400)  # the beam changes though nothing moves
CHECKED = const(0x800)  # always there

_CUTS = const(1 << LINEAR | 1 << CW_ARC | 1 << CCW_ARC)


@micropython.viper
def check(
    modal: ptr32,
    laser: int,
    jog: int,
    ints: ptr32,
    singles: ptr32,
    xyz: ptr32,
    rates: ptr32,
    position: ptr32,
    offsets: ptr32,
    machine: ptr32,
    stored: ptr32,
    plane: ptr32,
    arc: ptr32,
) -> int:
    """Check a block that begins with that modal state. Returns what it asks for, the bits above,
    or below 0 what is wrong with it. laser: the machine is in laser mode; jog: it is a line of
    $J=; stored, plane, arc: a block's."""
    words = ints[WORDS]
    if ints[CLAIM] == AXES_UNCLAIMED and words & AXIS_WORDS:
        ints[CLAIM] = AXES_MOTION
    if singles[N] & int(0x7FFFFFFF) > int(0x4B189680):  # the float 10,000,000
        return 0 - GCODE_INVALID_LINE_NUMBER
    # 3.5.19: feed rate, and how it is meant.
    wrong = int(_rate(ints, singles, modal, rates, jog))
    if wrong:
        return 0 - wrong
    if words & WORD_S == 0:
        singles[S] = rates[RPM]
    used = WORD_N | WORD_F if jog else WORD_N | WORD_F | WORD_S | WORD_T
    if ints[COMMANDS] & GROUP_M9:
        # Grbl's own: M56 P0 takes parking out of action, M56 or M56 P1 puts it back.
        ints[OVERRIDE_CONTROL] = 1
        if words & WORD_P and singles[P] & int(0x7FFFFFFF) == 0:
            ints[OVERRIDE_CONTROL] = 0
        used |= WORD_P
    if ints[NON_MODAL] == DWELL:  # 3.5.4
        used |= WORD_P
        if words & WORD_P == 0:
            return 0 - GCODE_VALUE_WORD_MISSING
    if ints[INCHES]:
        _in_mm(xyz, machine, singles)
    if ints[CLAIM] == AXES_TOOL_LENGTH and ints[TOOL_LENGTH]:  # G43.1: Grbl's, for 3.5.11
        if words & AXIS_WORDS != 1 << machine[LENGTH_AXIS]:
            return 0 - GCODE_G43_DYNAMIC_AXIS_ERROR
    found = int(_places(ints, singles, xyz, position, offsets, machine, stored))
    if found < 0:
        return found
    used |= found
    found = int(_motion(ints, singles, xyz, position, machine[AXES], plane, arc))
    if found < 0:
        return found
    used |= found | (AXIS_WORDS if ints[CLAIM] else 0)
    if words & ~used:
        return 0 - GCODE_UNUSED_WORDS
    if jog:
        plain = ints[NON_MODAL] == 0 or ints[NON_MODAL] == ABSOLUTE_OVERRIDE
        if ints[COMMANDS] & ~(GROUP_0 | GROUP_3 | GROUP_6) or not plain:
            return 0 - INVALID_JOG_COMMAND
    return int(_asked(ints, singles, modal, rates, laser))


@micropython.viper
def _rate(ints: ptr32, singles: ptr32, modal: ptr32, rates: ptr32, jog: int) -> int:
    """Find F of a block, as it will be in force. Returns what is wrong with it, or 0."""
    has_f = ints[WORDS] & WORD_F
    motion = ints[MOTION]
    if jog:
        if has_f == 0:
            return GCODE_UNDEFINED_FEED_RATE
        if ints[INCHES]:
            multiply(singles, F, singles, INCH_MM)
    elif ints[INVERSE_TIME]:
        cuts = motion != SEEK and motion != NO_MOTION  # noqa: PLR1714 (a viper cannot ask `in`)
        if ints[CLAIM] == AXES_MOTION and cuts and has_f == 0:
            return GCODE_UNDEFINED_FEED_RATE
    elif modal[INVERSE_TIME] == 0:
        if has_f == 0:
            singles[F] = rates[FEED]
        elif ints[INCHES]:
            multiply(singles, F, singles, INCH_MM)
    return 0


@micropython.viper
def _in_mm(xyz: ptr32, machine: ptr32, singles: ptr32) -> int:
    """Inches to mm, of the axes that are lengths."""
    for i in range(machine[AXES]):
        if (machine[LENGTHS] >> i) & 1:
            multiply(xyz, i, singles, INCH_MM)
    return 0


@micropython.viper
def _places(
    ints: ptr32,
    singles: ptr32,
    xyz: ptr32,
    position: ptr32,
    offsets: ptr32,
    machine: ptr32,
    stored: ptr32,
) -> int:
    """What the axis words mean: a target, or offsets. Returns the value words used for it, or
    below 0 what is wrong."""
    command = ints[NON_MODAL]
    axis_words = ints[WORDS] & AXIS_WORDS
    if command != SET_COORDS and command != SET_G92:  # noqa: PLR1714 (a viper cannot ask `in`)
        if axis_words and ints[CLAIM] != AXES_TOOL_LENGTH:
            _target(ints, singles, xyz, position, offsets, machine)
        if command == 0:
            return 0
        if command == ABSOLUTE_OVERRIDE and ints[MOTION] > LINEAR:  # 3.5.12: with G0 and G1 only
            return 0 - GCODE_G53_INVALID_MOTION_MODE
    axes = machine[AXES]
    if command == SET_COORDS:
        return int(_set_coords(ints, singles, xyz, stored, position, offsets, machine))
    if command == SET_G92:
        if axis_words == 0:
            return 0 - GCODE_NO_AXIS_WORDS
        system = ints[SYSTEM] * axes
        _offset(ints, singles, xyz, position, offsets, machine, system, G92 * axes, xyz)
    elif command == GO_G28:
        _where_stored(ints, stored, position, offsets, G28, axes)
    elif command == GO_G30:
        _where_stored(ints, stored, position, offsets, G30, axes)
    return 0


@micropython.viper
def _set_coords(
    ints: ptr32,
    singles: ptr32,
    xyz: ptr32,
    stored: ptr32,
    position: ptr32,
    offsets: ptr32,
    machine: ptr32,
) -> int:
    """3.5.5, G10 L2 and L20: the new offsets go to stored, the system's number to INDEX."""
    words = ints[WORDS]
    if words & AXIS_WORDS == 0:
        return 0 - GCODE_NO_AXIS_WORDS
    if words & (WORD_P | WORD_L) == 0:
        return 0 - GCODE_VALUE_WORD_MISSING
    system = int(whole_part(singles, P, 0)) & 255
    if system > SYSTEMS:
        return 0 - GCODE_UNSUPPORTED_COORD_SYS
    kind = int(whole_part(singles, L, 0)) & 255
    if kind != 20 and (kind != 2 or words & WORD_R):
        return 0 - GCODE_UNSUPPORTED_COMMAND
    ints[INDEX] = system - 1 if system else ints[SYSTEM]
    axes = machine[AXES]
    at = ints[INDEX] * axes
    if kind == 20:
        _offset(ints, singles, xyz, position, offsets, machine, G92 * axes, at, stored)
    else:
        for i in range(axes):
            stored[i] = xyz[i] if (words >> i) & 1 else offsets[at + i]
    return WORD_P | WORD_L


@micropython.viper
def _offset(
    ints: ptr32,
    singles: ptr32,
    xyz: ptr32,
    position: ptr32,
    offsets: ptr32,
    machine: ptr32,
    other: int,
    old: int,
    new: ptr32,
) -> int:
    """3.5.18, G92 and G10 L20: the offset which, beside the other one, makes the present place
    read as programmed. other, old: where they begin in offsets; new may be xyz."""
    axes = machine[AXES]
    for i in range(axes):
        singles[SCRATCH] = offsets[old + i]
        if (ints[WORDS] >> i) & 1:
            singles[SCRATCH] = position[i]
            subtract(singles, SCRATCH, offsets, other + i)
            subtract(singles, SCRATCH, xyz, i)
            if i == machine[LENGTH_AXIS]:
                subtract(singles, SCRATCH, offsets, (G92 + 1) * axes)
        new[i] = singles[SCRATCH]
    return 0


@micropython.viper
def _target(
    ints: ptr32, singles: ptr32, xyz: ptr32, position: ptr32, offsets: ptr32, machine: ptr32
) -> int:
    """Axis words become a target in machine coordinates; axes without a word stay."""
    axes = machine[AXES]
    system = ints[SYSTEM] * axes
    adds = ints[NON_MODAL] != ABSOLUTE_OVERRIDE
    for i in range(axes):
        if (ints[WORDS] >> i) & 1 == 0:
            xyz[i] = position[i]
        elif adds and (xyz[i] >> 23) & 255 != 255:  # what is infinite stays so
            if ints[RELATIVE]:
                add_single(position, i, xyz, i)
            else:
                singles[SCRATCH] = offsets[system + i]
                add_single(offsets, G92 * axes + i, singles, SCRATCH)
                add_single(singles, SCRATCH, xyz, i)
                if i == machine[LENGTH_AXIS]:
                    add_single(offsets, (G92 + 1) * axes, xyz, i)
    return 0


@micropython.viper
def _where_stored(
    ints: ptr32, stored: ptr32, position: ptr32, offsets: ptr32, system: int, axes: int
) -> int:
    """3.5.8: where G28 or G30 is to go; with axis words, only those axes."""
    axis_words = ints[WORDS] & AXIS_WORDS
    if axis_words == 0:
        ints[CLAIM] = AXES_UNCLAIMED
    for i in range(axes):
        stored[i] = offsets[system * axes + i]
        if axis_words and (axis_words >> i) & 1 == 0:
            stored[i] = position[i]
    return 0


@micropython.viper
def _motion(
    ints: ptr32, singles: ptr32, xyz: ptr32, position: ptr32, axes: int, plane: ptr32, arc: ptr32
) -> int:
    """Check group 1. Returns the value words it uses, or below 0 what is wrong."""
    motion = ints[MOTION]
    words = ints[WORDS]
    axis_words = words & AXIS_WORDS
    if motion == NO_MOTION:  # 3.5.15
        return 0 - GCODE_AXIS_WORDS_EXIST if axis_words else 0
    if ints[CLAIM] != AXES_MOTION:
        return 0
    if motion != SEEK and singles[F] & int(0x7FFFFFFF) == 0:
        return 0 - GCODE_UNDEFINED_FEED_RATE
    if axis_words == 0:
        if motion > LINEAR:
            return 0 - GCODE_NO_AXIS_WORDS
        ints[CLAIM] = AXES_UNCLAIMED
    elif motion == CW_ARC or motion == CCW_ARC:  # noqa: PLR1714 (a viper cannot ask `in`); 3.5.3
        wrong = int(find_arc(ints, singles, xyz, position, axes, plane, arc))
        if wrong:
            return 0 - wrong
        return WORD_R if words & WORD_R else WORD_IJK
    elif motion > NO_MOTION and motion < PROBE_TOWARD:  # see Motion
        return MOTION_WORDS
    elif motion > CCW_ARC and int(is_there(position, xyz, axes)):  # 3.5.9: a probe has a way to go
        return 0 - GCODE_INVALID_TARGET
    return 0


@micropython.viper
def _asked(ints: ptr32, singles: ptr32, modal: ptr32, rates: ptr32, laser: int) -> int:
    """What a block asks for that is right."""
    asked = CHECKED
    if rates[RPM] != singles[S] and (rates[RPM] | singles[S]) & int(0x7FFFFFFF):
        asked |= SPEED
    if ints[WORDS] & WORD_T:
        asked |= SET_TOOL
    if (
        modal[SPINDLE] != ints[SPINDLE]
        or modal[COOLANT] != ints[COOLANT]
        or modal[OVERRIDE_CONTROL] != ints[OVERRIDE_CONTROL]
    ):
        asked |= ACCESSORIES
    if modal[SYSTEM] != ints[SYSTEM] or ints[CLAIM] == AXES_TOOL_LENGTH:
        asked |= OFFSETS
    if ints[NON_MODAL]:
        asked |= COMMAND
    if ints[CLAIM] == AXES_MOTION and ints[MOTION] != NO_MOTION:
        asked |= MOVE if ints[MOTION] <= LINEAR else MOVE | SPECIAL
    if ints[PROGRAM_FLOW]:
        asked |= FLOW
    if laser:
        cuts = 1 if ints[MOTION] <= CCW_ARC and (_CUTS >> ints[MOTION]) & 1 else 0
        cut = 1 if modal[MOTION] <= CCW_ARC and (_CUTS >> modal[MOTION]) & 1 else 0
        if cuts == 0:
            asked |= DARK
        if ints[WORDS] & AXIS_WORDS and ints[CLAIM] == AXES_MOTION:
            asked |= IN_MOTION
        elif modal[SPINDLE] == SPINDLE_CW and cut != cuts:
            asked |= SYNC
    return asked
