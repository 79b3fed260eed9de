# mypy: disable-error-code="arg-type, attr-defined, call-overload, has-type, misc"
"""Checks: step three of the interpreter, in kernels: what can refuse a block as a whole.

block.py has refused single words before; arc_words.py checks arcs for this module.

The checks also convert the block's values for execution: mm, absolute, machine coordinates. Their
order is the standard's order of execution (NIST RS274NGC v3, table 8), which decides the error
number of a block with two errors. They do not change the modal state. The sections named here are
the standard's.

Arguments: ints, singles, xyz, the block's integers, numbers and axis words; stored, what G10
stores or where G28 and G30 go; machine, Interpreter.machine (all: block_layout.py); modal, rates,
position, the modes in force (modes.py); plane, arc, the plane and the numbers of an arc, which are
set here (arc_geometry.py). offsets has all work offsets (coords.py), a float per axis each: those
of system 0 (G54) first, system n at n * axes; then G28, G30, G92, and the tool length.

A float is its bits; & 0x7FFFFFFF removes its sign, so that -0 is 0, too. multiply(a, i, b, j) is
a[i] *= b[j], subtract(a, i, b, j) is a[i] -= b[j]; but add_single(b, j, a, i) is a[i] += b[j].
"""

import micropython
from base import errors
from base.float32_math import add_single, multiply, whole_part
from control import modes as mode
from control.coords import G28, G30, G92, SYSTEMS
from motion.arc_geometry import subtract
from motion.planner import SPINDLE_CW

from language import block_layout as b
from language.arc_words import find_arc, same_position


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
    """Check a block that was read in that modal state. Returns its requests, bits of
    block_layout.py, or minus Grbl's error number. laser: laser mode; jog: 1 for a $J= line."""
    words = ints[b.WORDS]
    if ints[b.AXIS_USE] == b.AXES_UNUSED and words & b.AXIS_WORDS:
        ints[b.AXIS_USE] = b.AXES_FOR_MOTION
    if singles[b.N] & int(0x7FFFFFFF) > int(0x4B189680):  # the float 10,000,000
        return 0 - errors.GCODE_INVALID_LINE_NUMBER
    # 3.5.19, section of the standard: feed rate and feed rate mode.
    error = int(_rate(ints, singles, modal, rates, jog))
    if error:
        return 0 - error
    if words & b.WORD_S == 0:  # the last S stays in force
        singles[b.S] = rates[mode.RPM]
    used_words = b.WORD_N | b.WORD_F if jog else b.WORD_N | b.WORD_F | b.WORD_S | b.WORD_T
    if ints[b.COMMANDS] & b.GROUP_M9:
        # Grbl's own: M56 P0 disables parking, M56 or M56 P1 enables it.
        ints[mode.OVERRIDE_CONTROL] = 1
        if words & b.WORD_P and singles[b.P] & int(0x7FFFFFFF) == 0:
            ints[mode.OVERRIDE_CONTROL] = 0
        used_words |= b.WORD_P
    if ints[b.NON_MODAL] == b.DWELL:  # 3.5.4
        used_words |= b.WORD_P
        if words & b.WORD_P == 0:
            return 0 - errors.GCODE_VALUE_WORD_MISSING
    if ints[mode.INCHES]:
        _in_mm(xyz, machine, singles)
    if ints[b.AXIS_USE] == b.AXES_FOR_LENGTH and ints[mode.TOOL_LENGTH]:  # G43.1
        if words & b.AXIS_WORDS != 1 << machine[b.LENGTH_AXIS]:
            return 0 - errors.GCODE_G43_DYNAMIC_AXIS_ERROR
    result = int(_targets(ints, singles, xyz, position, offsets, machine, stored))
    if result < 0:
        return result
    used_words |= result
    result = int(_motion(ints, singles, xyz, position, machine[b.AXES], plane, arc))
    if result < 0:
        return result
    used_words |= result | (b.AXIS_WORDS if ints[b.AXIS_USE] else 0)
    if words & ~used_words:  # a value word that no command of the line uses
        return 0 - errors.GCODE_UNUSED_WORDS
    if jog:
        # G53, distance mode and units are allowed.
        allowed = ints[b.NON_MODAL] == 0 or ints[b.NON_MODAL] == b.ABSOLUTE_OVERRIDE
        if ints[b.COMMANDS] & ~(b.GROUP_0 | b.GROUP_3 | b.GROUP_6) or not allowed:
            return 0 - errors.INVALID_JOG_COMMAND
    return int(_asked(ints, singles, modal, rates, laser))


@micropython.viper
def _rate(ints: ptr32, singles: ptr32, modal: ptr32, rates: ptr32, jog: int) -> int:
    """Compute the block's feed rate, mm/min, or 1/min in inverse time mode, into singles[F].
    Returns Grbl's error number, or 0. jog: 1 for a $J= line.

    Without an F word the last rate stays in force, except in inverse time and in a jog: both need
    their own. On the line that ends G93 it does not, because it was no rate in mm/min: F is 0 if
    that line has none, and if it has one, it is not converted from inches, as in Grbl.
    """
    has_f = ints[b.WORDS] & b.WORD_F
    motion = ints[mode.MOTION]
    if jog:
        if has_f == 0:
            return errors.GCODE_UNDEFINED_FEED_RATE
        if ints[mode.INCHES]:
            multiply(singles, b.F, singles, b.INCH_MM)
    elif ints[mode.INVERSE_TIME]:
        feeds = motion != b.SEEK and motion != b.NO_MOTION  # noqa: PLR1714 (a viper cannot ask `in`)
        if ints[b.AXIS_USE] == b.AXES_FOR_MOTION and feeds and has_f == 0:
            return errors.GCODE_UNDEFINED_FEED_RATE
    elif modal[mode.INVERSE_TIME] == 0:  # else this line ends G93: see above
        if has_f == 0:
            singles[b.F] = rates[mode.FEED]
        elif ints[mode.INCHES]:
            multiply(singles, b.F, singles, b.INCH_MM)
    return 0


@micropython.viper
def _in_mm(xyz: ptr32, machine: ptr32, singles: ptr32) -> int:
    """Convert xyz from inches to mm, for axes that are lengths. (Others are angles.)"""
    for i in range(machine[b.AXES]):
        if (machine[b.LENGTHS] >> i) & 1:
            multiply(xyz, i, singles, b.INCH_MM)
    return 0


@micropython.viper
def _targets(
    ints: ptr32,
    singles: ptr32,
    xyz: ptr32,
    position: ptr32,
    offsets: ptr32,
    machine: ptr32,
    stored: ptr32,
) -> int:
    """Convert axis words into a target (in xyz), or into what a non-modal command does: offsets of
    G10 (stored) or G92 (xyz), the position of G28 or G30 (stored). Returns a mask of the other
    value words used, or minus Grbl's error number."""
    command = ints[b.NON_MODAL]
    axis_words = ints[b.WORDS] & b.AXIS_WORDS
    if command != b.SET_COORDS and command != b.SET_G92:  # noqa: PLR1714 (a viper cannot ask `in`)
        if axis_words and ints[b.AXIS_USE] != b.AXES_FOR_LENGTH:
            _target(ints, singles, xyz, position, offsets, machine)
        if command == 0:
            return 0
        # 3.5.12: with G0 and G1 only.
        if command == b.ABSOLUTE_OVERRIDE and ints[mode.MOTION] > b.LINEAR:
            return 0 - errors.GCODE_G53_INVALID_MOTION_MODE
    axes = machine[b.AXES]
    if command == b.SET_COORDS:
        return int(_set_coords(ints, singles, xyz, stored, position, offsets, machine))
    if command == b.SET_G92:
        if axis_words == 0:
            return 0 - errors.GCODE_NO_AXIS_WORDS
        # Into xyz: the new G92 offset, which replaces the old one. The active system's offset
        # stays in force.
        in_force = ints[mode.SYSTEM] * axes
        replaced = G92 * axes
        _offset(ints, singles, xyz, position, offsets, machine, in_force, replaced, xyz)
    elif command == b.GO_G28:
        _where_stored(ints, stored, position, offsets, G28, axes)
    elif command == b.GO_G30:
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
    """3.5.5, G10 L2 and L20: compute a coordinate system's new offsets into stored, and its
    number, from 0, into INDEX. Returns a mask of the value words used, or minus Grbl's error
    number.

    L2: the axis words are the offsets. L20: they are what the present position is to read. An axis
    without a word keeps its offset.
    """
    words = ints[b.WORDS]
    if words & b.AXIS_WORDS == 0:
        return 0 - errors.GCODE_NO_AXIS_WORDS
    if words & (b.WORD_P | b.WORD_L) == 0:  # as in Grbl, one of them is enough
        return 0 - errors.GCODE_VALUE_WORD_MISSING
    # & 255: Grbl stores the numbers of P and L in a byte. P: 1 to 6; 0: the active system.
    system = int(whole_part(singles, b.P, 0)) & 255
    if system > SYSTEMS:
        return 0 - errors.GCODE_UNSUPPORTED_COORD_SYS
    kind = int(whole_part(singles, b.L, 0)) & 255
    if kind != 20 and (kind != 2 or words & b.WORD_R):
        return 0 - errors.GCODE_UNSUPPORTED_COMMAND
    ints[b.INDEX] = system - 1 if system else ints[mode.SYSTEM]
    axes = machine[b.AXES]
    replaced = ints[b.INDEX] * axes  # index in offsets of the system's first one
    if kind == 20:
        in_force = G92 * axes  # stays as it is
        _offset(ints, singles, xyz, position, offsets, machine, in_force, replaced, stored)
    else:
        for i in range(axes):
            stored[i] = xyz[i] if (words >> i) & 1 else offsets[replaced + i]
    return b.WORD_P | b.WORD_L


@micropython.viper
def _offset(
    ints: ptr32,
    singles: ptr32,
    xyz: ptr32,
    position: ptr32,
    offsets: ptr32,
    machine: ptr32,
    in_force: int,
    replaced: int,
    new: ptr32,
) -> int:
    """3.5.18, G92 and G10 L20: compute the offset that, together with another one that stays in
    force, makes the current position read as programmed (xyz). Returns 0.

    new: the result, a float per axis; it may be xyz. in_force: index in offsets of the other one;
    replaced: of the one to be replaced, which an axis without a word keeps. For each axis with a
    word: new = position - other - programmed, and for the tool's axis, - tool length.
    """
    axes = machine[b.AXES]
    for i in range(axes):
        singles[b.SCRATCH] = offsets[replaced + i]
        if (ints[b.WORDS] >> i) & 1:
            singles[b.SCRATCH] = position[i]
            subtract(singles, b.SCRATCH, offsets, in_force + i)
            subtract(singles, b.SCRATCH, xyz, i)
            if i == machine[b.LENGTH_AXIS]:
                subtract(singles, b.SCRATCH, offsets, (G92 + 1) * axes)  # tool length
        new[i] = singles[b.SCRATCH]
    return 0


@micropython.viper
def _target(
    ints: ptr32, singles: ptr32, xyz: ptr32, position: ptr32, offsets: ptr32, machine: ptr32
) -> int:
    """Convert the axis words in xyz into a target in machine coordinates, mm, in place. An axis
    without a word stays at position. Returns 0."""
    axes = machine[b.AXES]
    system = ints[mode.SYSTEM] * axes  # index of the active system in offsets
    adds = ints[b.NON_MODAL] != b.ABSOLUTE_OVERRIDE  # with G53 nothing is added
    for i in range(axes):
        if (ints[b.WORDS] >> i) & 1 == 0:
            xyz[i] = position[i]
        elif adds and (xyz[i] >> 23) & 255 != 255:  # an infinite word stays infinite
            if ints[mode.RELATIVE]:
                add_single(position, i, xyz, i)
            else:
                singles[b.SCRATCH] = offsets[system + i]
                add_single(offsets, G92 * axes + i, singles, b.SCRATCH)
                add_single(singles, b.SCRATCH, xyz, i)
                if i == machine[b.LENGTH_AXIS]:
                    add_single(offsets, (G92 + 1) * axes, xyz, i)  # tool length
    return 0


@micropython.viper
def _where_stored(
    ints: ptr32, stored: ptr32, position: ptr32, offsets: ptr32, system: int, axes: int
) -> int:
    """3.5.8: compute where G28 or G30 goes, in machine coordinates, into stored; with axis words,
    on those axes only. Returns 0.

    system: G28 or G30, the number of the stored position in offsets.
    """
    axis_words = ints[b.WORDS] & b.AXIS_WORDS
    if axis_words == 0:
        ints[b.AXIS_USE] = b.AXES_UNUSED  # so that no move to xyz comes first
    for i in range(axes):
        stored[i] = offsets[system * axes + i]
        if axis_words and (axis_words >> i) & 1 == 0:
            stored[i] = position[i]
    return 0


@micropython.viper
def _motion(
    ints: ptr32, singles: ptr32, xyz: ptr32, position: ptr32, axes: int, plane: ptr32, arc: ptr32
) -> int:
    """Check group 1, the motion, from position to xyz. Returns a mask of the value words that it
    uses, or minus Grbl's error number. plane, arc: get the plane and the numbers of an arc."""
    motion = ints[mode.MOTION]
    words = ints[b.WORDS]
    axis_words = words & b.AXIS_WORDS
    if motion == b.NO_MOTION:  # 3.5.15
        return 0 - errors.GCODE_AXIS_WORDS_EXIST if axis_words else 0
    if ints[b.AXIS_USE] != b.AXES_FOR_MOTION:  # the axis words are those of another command
        return 0
    if motion != b.SEEK and singles[b.F] & int(0x7FFFFFFF) == 0:
        return 0 - errors.GCODE_UNDEFINED_FEED_RATE
    if axis_words == 0:
        if motion > b.LINEAR:
            return 0 - errors.GCODE_NO_AXIS_WORDS
        ints[b.AXIS_USE] = b.AXES_UNUSED  # a line without axis words only sets the mode
    elif motion == b.CW_ARC or motion == b.CCW_ARC:  # noqa: PLR1714 (a viper cannot ask `in`); 3.5.3
        error = int(find_arc(ints, singles, xyz, position, axes, plane, arc))
        if error:
            return 0 - error
        return b.WORD_R if words & b.WORD_R else b.WORD_IJK
    elif motion > b.NO_MOTION and motion < b.PROBE_TOWARD:  # an extra's: see interfaces.Motion
        return b.MOTION_WORDS
    elif motion > b.CCW_ARC and int(same_position(position, xyz, axes)):  # a probe that stands
        return 0 - errors.GCODE_INVALID_TARGET  # 3.5.9
    return 0


@micropython.viper
def _asked(ints: ptr32, singles: ptr32, modal: ptr32, rates: ptr32, laser: int) -> int:
    """Return the requests of a valid block: bits of block_layout.py. What differs from the modes
    in force (modal, rates) is requested. laser: not 0 in laser mode."""
    asked = b.CHECKED  # always set, so that the result is not 0
    # Another speed, unless both are 0.
    if rates[mode.RPM] != singles[b.S] and (rates[mode.RPM] | singles[b.S]) & int(0x7FFFFFFF):
        asked |= b.SPEED
    if ints[b.WORDS] & b.WORD_T:
        asked |= b.SET_TOOL
    if (
        modal[mode.SPINDLE] != ints[mode.SPINDLE]
        or modal[mode.COOLANT] != ints[mode.COOLANT]
        or modal[mode.OVERRIDE_CONTROL] != ints[mode.OVERRIDE_CONTROL]
    ):
        asked |= b.ACCESSORIES
    if modal[mode.SYSTEM] != ints[mode.SYSTEM] or ints[b.AXIS_USE] == b.AXES_FOR_LENGTH:
        asked |= b.OFFSETS
    if ints[b.NON_MODAL]:
        asked |= b.COMMAND
    if ints[b.AXIS_USE] == b.AXES_FOR_MOTION and ints[mode.MOTION] != b.NO_MOTION:
        asked |= b.MOVE if ints[mode.MOTION] <= b.LINEAR else b.MOVE | b.NOT_STRAIGHT
    if ints[mode.PROGRAM_FLOW]:
        asked |= b.FLOW
    if laser:
        # Whether this line's motion mode cuts, and whether the last one's did.
        motion = ints[mode.MOTION]
        cuts = 1 if motion <= b.CCW_ARC and (mode.CUTTING >> motion) & 1 else 0
        last = modal[mode.MOTION]
        did_cut = 1 if last <= b.CCW_ARC and (mode.CUTTING >> last) & 1 else 0
        if cuts == 0:
            asked |= b.BEAM_OFF  # the beam is off in this line
        if ints[b.WORDS] & b.AXIS_WORDS and ints[b.AXIS_USE] == b.AXES_FOR_MOTION:
            asked |= b.S_IN_MOTION  # S is set as the motion begins
        elif modal[mode.SPINDLE] == SPINDLE_CW and did_cut != cuts:
            asked |= b.BEAM_SWITCHES  # the beam of M3 goes on or off without a motion
    return asked
