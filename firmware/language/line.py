# mypy: disable-error-code="arg-type, attr-defined, call-overload, has-type, misc, operator"
"""A line: read, check, and if it is a move-only line, execute it; all in kernels.

An arc is executed here, too, if one chord is enough, and in check mode if there are no soft limits
that a chord could violate.

The loop (talk/stream_loop.py) calls this for every line. The interpreter executes other lines.
`memory`, a tuple, is Interpreter.memory()'s: words for block.read(); the block and the modes; the
planner. Kernels unpack it, because they have no attributes. `modal` is the modal state, a value
per modal group (control/modes.py). `machine` is Interpreter.machine, and `ints`, `singles` and
`xyz` are the block's integers, numbers and axis words (block_layout.py). Floats are handled as
their bits. Requests: a mask of what a line asks for, bits of block_layout.py.
"""

import micropython
from base import errors
from base.float32 import copy
from base.float32_math import whole_part
from base.state import CHECK
from control import modes as mode
from control.canon import SHUT, check_travel
from control.spindle import ASKED as ASKED_SPEED
from control.spindle import LASER, power_from_rpm
from micropython import const
from motion import layout
from motion.arc_geometry import lay
from motion.arcs import CHORDS_LEFT
from motion.minifloat import per_second
from motion.plan_kernel import FULL, OUTSIDE, plan_block
from motion.planner import COOLANT_SHIFT, SPINDLE_CCW, SPINDLE_CW, SPINDLE_MASK

from language import block_layout as b
from language.block import read
from language.checks import check

# The requests that can be executed here.
PLAIN = const(
    b.CHECKED | b.MOVE | b.NOT_STRAIGHT | b.SPEED | b.SET_TOOL | b.BEAM_OFF | b.S_IN_MOTION
)


@micropython.viper
def execute(text: object, length: int, modal: ptr32, machine: ptr32, memory: object) -> int:
    """Execute a move-only line, text[:length], if nothing makes it wait. Returns 1; or 0, and then
    nothing has moved, and the interpreter must execute the line. The block is ready for that, with
    check_line()'s result in machine[ASKED], unless that is 0.
    """
    machine[b.ASKED] = 0
    if machine[b.IS_OPEN] == 0:  # kernels may not execute lines now
        return 0
    if length == 0:
        return 1
    asked = int(check_line(text, length << 8, modal, 0, memory))  # its span begins at 0
    machine[b.ASKED] = asked
    # WATCHED: the requests that an extra wants the interpreter to execute. A negative result is an
    # error, which the interpreter raises.
    return 0 if asked < 0 or asked & machine[b.WATCHED] else int(run_move(asked, modal, memory))


@micropython.viper
def check_line(text: object, span: int, modal: ptr32, jog: int, memory: object) -> int:
    """Read and check text[start:end], where text[end] is 0; span: end << 8 | start. Returns its
    requests, bits of block_layout.py, or minus Grbl's error number. jog: 1 for a $J= line, else 0.
    The block then has the line's numbers and its target."""
    words, block, _ = memory
    # scale: State.spindle; rare: arrays that few lines need.
    _ints, _singles, _xyz, rates, position, offsets, _machine, scale, rare = block
    stored, plane, arc = rare
    ints = ptr32(_ints)
    singles = ptr32(_singles)
    xyz = ptr32(_xyz)
    machine = ptr32(_machine)
    machine[b.ASKED] = 0  # the block of the line that it belonged to is overwritten
    error = int(read(text, span, modal, ints, singles, xyz, machine[b.AXES], words))
    if error:
        return 0 - error
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
    only = ints[b.ONLY]  # an extra has read text that is valid with these requests only, and S
    if asked > 0 and only and (asked & ~b.SPEED != only or ints[mode.INVERSE_TIME]):
        return 0 - errors.GCODE_UNSUPPORTED_COMMAND
    return asked


@micropython.viper
def run_move(asked: int, modal: ptr32, memory: object) -> int:
    """Execute the checked block, whose requests are `asked`, if its motion is one straight line
    and the ring has a free row. Returns 1; or 0, and the interpreter must do the rest.

    After 1 the modes, rates and the parser's position are those after the line. After 0 the modes
    and rates may be, too, but the position is not.
    """
    # Another S of a turning spindle has to wait for the end of motion, except a laser's.
    if asked & ~PLAIN or (asked & b.SPEED and modal[mode.SPINDLE] and asked & b.S_IN_MOTION == 0):
        return 0
    _, block, plans = memory
    _ints, _singles, target, _rates, _position, _, _machine, _scale, rare = block
    _travel, table, ring, _flow, speeds, running, hook, _, _ = plans
    ints = ptr32(_ints)
    singles = ptr32(_singles)
    xyz = ptr32(target)
    rates = ptr32(_rates)
    position = ptr32(_position)
    axes = ptr32(_machine)[b.AXES]
    scale = ptr32(_scale)
    travel = ptr32(_travel)
    flow = ptr32(_flow)
    moves = 0  # 1: there is a move to plan; in check mode there is none
    if asked & b.MOVE:
        obstacles = int(check_travel(xyz, travel, flow))  # a mask of OUTSIDE and FULL
        moves = 0 if ptr32(running)[0] & CHECK else 1
        if obstacles & OUTSIDE or (moves and obstacles & FULL):
            return 0
    if asked & b.NOT_STRAIGHT:
        if ints[mode.MOTION] > b.CCW_ARC or ints[mode.INVERSE_TIME]:  # not an arc, or with G93
            return 0
        if moves == 0 and travel[SHUT]:  # check mode with soft limits: a chord may violate them
            return 0
        if moves and (hook or int(_more_chords(xyz, position, axes, rare, plans))):
            return 0  # several chords; or a hook, which plans all arcs
    commit_modal(ints, singles, modal, rates)
    rates[mode.RPM] = singles[b.S]
    rates[mode.TOOL] = singles[b.T]
    if moves:
        flags = int(_flags(ints, modal, scale[LASER]))
        power = 0
        scale[ASKED_SPEED] = 0 if asked & b.BEAM_OFF else rates[mode.RPM]
        speed = scale[ASKED_SPEED]  # here, because power_from_rpm() overwrites it
        if flags & SPINDLE_MASK:
            power = int(power_from_rpm(scale, flags))
        line = int(whole_part(singles, b.N, 0))
        rate = int(per_second(singles, b.F))  # a minifloat (motion/minifloat.py)
        row = flow[layout.HEAD]  # the free row of the ring, which the block will use
        if hook:  # an extra's function, which plans instead of plan_block()
            made = int(hook(target, flags, line, power, rate))
        else:
            made = int(plan_block(xyz, ptr32(table), ptr32(ring), flow, flags, line, power, rate))
        if made:
            ptr32(speeds)[row] = speed  # rpm, from which overrides compute the power again
        elif scale[LASER] and flags & SPINDLE_CW:  # no steps: Canon.apply_zero_length()
            return 0
    if asked & b.MOVE:
        copy(xyz, position, axes)
    return 1


@micropython.viper
def _flags(ints: ptr32, modal: ptr32, laser: int) -> int:
    """Return the flags of a block's move, for the planner (motion/layout.py). laser: 0 unless in
    laser mode."""
    flags = modal[mode.SPINDLE] | modal[mode.COOLANT] << COOLANT_SHIFT  # their values are flags
    if laser and flags & SPINDLE_CCW:  # M4: power follows the speed
        flags |= layout.DYNAMIC
    if ints[mode.MOTION] == b.SEEK:
        flags |= layout.RAPID_MOTION
    if ints[mode.INVERSE_TIME]:
        flags |= layout.INVERSE_TIME
    return flags


@micropython.viper
def _more_chords(xyz: ptr32, position: ptr32, axes: int, rare: object, plans: object) -> int:
    """Return how many chords the block's arc, from position to xyz, takes beyond one: 0 if one is
    enough. rare, plans: parts of `memory`. Uses the planner's course as scratch."""
    _, plane, arc = rare
    _, _, _, _, _, _, _, steps_per_mm, course = plans
    chords = ptr32(course)
    lay(ptr32(arc), ptr32(plane), position, xyz, ptr32(steps_per_mm), chords, axes)
    more_chords = chords[CHORDS_LEFT]
    chords[CHORDS_LEFT] = 0  # else Canon would plan them
    return more_chords


@micropython.viper
def commit_modal(ints: ptr32, singles: ptr32, modal: ptr32, rates: ptr32) -> int:
    """Apply the modes of a checked block (ints) that need no action, and its feed rate: units,
    plane, distance, feed rate and motion mode. They go to modal and rates. Returns 0."""
    modal[mode.INVERSE_TIME] = ints[mode.INVERSE_TIME]
    modal[mode.PLANE] = ints[mode.PLANE]
    modal[mode.INCHES] = ints[mode.INCHES]
    modal[mode.RELATIVE] = ints[mode.RELATIVE]
    modal[mode.MOTION] = ints[mode.MOTION]
    rates[mode.FEED] = singles[b.F]
    return 0
