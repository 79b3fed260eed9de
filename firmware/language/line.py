# mypy: disable-error-code="arg-type, attr-defined, call-overload, has-type, misc, operator"
"""A line: read, checked, and where it does no more than move, executed; all in kernels.

An arc is a line, too, where one chord does for it; and in check mode, where there are no soft
limits that it might pass on its way.

Called for every line by the loop (talk/quick_lines.py), which has the interpreter do what is left.
"""

import micropython
from base.errors import GCODE_UNSUPPORTED_COMMAND
from base.f32 import copy
from base.singles import whole_part
from base.state import CHECK
from control.canon import SHUT, judge
from control.modes import (
    COOLANT,
    FEED,
    INCHES,
    INVERSE_TIME,
    MOTION,
    PLANE,
    RELATIVE,
    RPM,
    SPINDLE,
    TOOL,
)
from control.spindle import ASKED as ASKED_SPEED
from control.spindle import LASER, weigh
from micropython import const
from motion import layout
from motion.arc_geometry import lay
from motion.arcs import LEFT
from motion.plan_kernel import FULL, OUTSIDE
from motion.plan_kernel import plan as plan_block
from motion.planner import COOLANT_SHIFT, SPINDLE_CCW, SPINDLE_MASK
from motion.reals import per_second

from language.block import read
from language.block_layout import ASKED, AXES, CCW_ARC, IS_OPEN, POWERS, SEEK, WATCHED, F, N, S, T
from language.checks import (
    CHECKED,
    DARK,
    IN_MOTION,
    MOVE,
    SET_TOOL,
    SPECIAL,
    SPEED,
    check,
)

_CUT = const(CHECKED | MOVE | IN_MOTION)
# All that can be done here.
PLAIN = const(CHECKED | MOVE | SPECIAL | SPEED | SET_TOOL | DARK | IN_MOTION)


@micropython.viper
def execute(text: ptr8, length: int, modal: ptr32, memory: object) -> int:
    """Execute a line that does no more than move, and has nothing in its way. Returns 1; or 0, and
    nothing has changed, but the block is ready, with what look() says in ASKED. memory: an
    interpreter's."""
    # As look() and go() do, whose calls would take memory apart twice more: 6 % of a stream.
    words, block, plans = memory
    _ints, _singles, _xyz, _rates, _position, _offsets, _machine, _scale, rare = block
    stored, plane, arc = rare
    ints = ptr32(_ints)
    singles = ptr32(_singles)
    xyz = ptr32(_xyz)
    rates = ptr32(_rates)
    position = ptr32(_position)
    offsets = ptr32(_offsets)
    machine = ptr32(_machine)
    scale = ptr32(_scale)
    ints[ASKED] = 0
    if machine[IS_OPEN] == 0:
        return 0
    if length == 0:
        return 1
    asked = int(read(text, length << 8, modal, ints, singles, xyz, machine[AXES], words))
    if asked:
        asked = 0 - asked
    else:
        asked = int(
            check(
                modal,
                scale[LASER],
                0,
                ints,
                singles,
                xyz,
                rates,
                position,
                offsets,
                machine,
                ptr32(stored),
                ptr32(plane),
                ptr32(arc),
            )
        )
        asked = int(_with_powers(asked, ints))
    ints[ASKED] = asked
    if asked < 0 or asked & machine[WATCHED]:
        return 0
    return int(
        _go(asked, modal, ints, singles, xyz, rates, position, machine, scale, _xyz, rare, plans)
    )


@micropython.viper
def look(text: ptr8, span: int, modal: ptr32, jog: int, memory: object) -> int:
    """Read and check line[start:end], span = end << 8 | start, which a 0 follows. Returns what it
    asks for, or below 0 what is wrong with it: see check(). memory: an interpreter's."""
    words, block, _ = memory
    _ints, _singles, _xyz, rates, position, offsets, _machine, scale, rare = block
    stored, plane, arc = rare
    ints = ptr32(_ints)
    singles = ptr32(_singles)
    xyz = ptr32(_xyz)
    machine = ptr32(_machine)
    wrong = int(read(text, span, modal, ints, singles, xyz, machine[AXES], words))
    if wrong:
        return 0 - wrong
    asked = int(
        check(
            modal,
            ptr32(scale)[LASER],
            jog,
            ints,
            singles,
            xyz,
            ptr32(rates),
            ptr32(position),
            ptr32(offsets),
            machine,
            ptr32(stored),
            ptr32(plane),
            ptr32(arc),
        )
    )
    return int(_with_powers(asked, ints))


@micropython.viper
def _with_powers(asked: int, ints: ptr32) -> int:
    """Many powers are for a cut along a straight line, which asks for nothing else."""
    if asked > 0 and ints[POWERS] and (asked & ~SPEED != _CUT or ints[INVERSE_TIME]):
        return 0 - GCODE_UNSUPPORTED_COMMAND
    return asked


@micropython.viper
def go(asked: int, modal: ptr32, memory: object) -> int:
    """Execute a block that asks for that, if it is no more than a line, which has room. Returns 1;
    or 0, and what is left is for the interpreter. memory: its."""
    _, block, plans = memory
    ints, singles, xyz, rates, position, _, machine, scale, rare = block
    return int(
        _go(
            asked,
            modal,
            ptr32(ints),
            ptr32(singles),
            ptr32(xyz),
            ptr32(rates),
            ptr32(position),
            ptr32(machine),
            ptr32(scale),
            xyz,
            rare,
            plans,
        )
    )


@micropython.viper
def _go(
    asked: int,
    modal: ptr32,
    ints: ptr32,
    singles: ptr32,
    xyz: ptr32,
    rates: ptr32,
    position: ptr32,
    machine: ptr32,
    scale: ptr32,
    target: object,
    rare: object,
    plans: object,
) -> int:
    """As go(). target: what xyz is an address of."""
    if asked & ~PLAIN or (asked & SPEED and modal[SPINDLE] and asked & IN_MOTION == 0):
        return 0
    _travel, _table, _ring, _flow, _speeds, running, hook, _, _ = plans
    travel = ptr32(_travel)
    flow = ptr32(_flow)
    moves = 0
    if asked & MOVE:
        found = int(judge(xyz, travel, flow))
        moves = 0 if ptr32(running)[0] & CHECK else 1
        if found & OUTSIDE or (moves and found & FULL):
            return 0
    if asked & SPECIAL:
        if ints[MOTION] > CCW_ARC or ints[INVERSE_TIME]:
            return 0
        if moves == 0 and travel[SHUT]:  # one of its chords may lie outside
            return 0
        if moves and (hook or int(_is_bent(xyz, position, machine[AXES], rare, plans))):
            return 0
    put_in_force(ints, singles, modal, rates)
    rates[RPM] = singles[S]
    rates[TOOL] = singles[T]
    if moves:
        flags = int(_flags(ints, modal, scale[LASER]))
        power = 0
        scale[ASKED_SPEED] = 0 if asked & DARK else rates[RPM]
        speed = scale[ASKED_SPEED]
        if flags & SPINDLE_MASK:
            power = int(weigh(scale, flags))
        line = int(whole_part(singles, N, 0))
        rate = int(per_second(singles, F))
        at = flow[layout.HEAD]
        if hook:
            planned = int(hook(target, flags, line, power, rate))
        else:
            table = ptr32(_table)
            planned = int(plan_block(xyz, table, ptr32(_ring), flow, flags, line, power, rate))
        if planned == 0:
            return 0
        ptr32(_speeds)[at] = speed
    if asked & MOVE:
        copy(xyz, position, machine[AXES])
    return 1


@micropython.viper
def _flags(ints: ptr32, modal: ptr32, laser: int) -> int:
    """What a block in the planner is told of its move."""
    flags = modal[SPINDLE] | modal[COOLANT] << COOLANT_SHIFT
    if laser and flags & SPINDLE_CCW:
        flags |= layout.DYNAMIC
    if ints[MOTION] == SEEK:
        flags |= layout.RAPID_MOTION
    if ints[INVERSE_TIME]:
        flags |= layout.INVERSE_TIME
    return flags


@micropython.viper
def _is_bent(xyz: ptr32, position: ptr32, axes: int, rare: object, plans: object) -> int:
    """Whether an arc takes more than one chord."""
    _, plane, arc = rare
    _, _, _, _, _, _, _, steps_per_mm, course = plans
    way = ptr32(course)
    lay(ptr32(arc), ptr32(plane), position, xyz, ptr32(steps_per_mm), way, axes)
    left = way[LEFT]
    way[LEFT] = 0
    return left


@micropython.viper
def put_in_force(ints: ptr32, singles: ptr32, modal: ptr32, rates: ptr32) -> int:
    """Put in force what a checked block changes by itself: modes of how to read numbers and how to
    move, and the feed rate."""
    modal[INVERSE_TIME] = ints[INVERSE_TIME]
    modal[PLANE] = ints[PLANE]
    modal[INCHES] = ints[INCHES]
    modal[RELATIVE] = ints[RELATIVE]
    modal[MOTION] = ints[MOTION]
    rates[FEED] = singles[F]
    return 0
