# mypy: disable-error-code="arg-type, call-overload, has-type, misc"
"""Fields: what nearly every status report is made of, in two kernels.

To ask each object for its part and to write it by itself takes a Pico a millisecond.
"""

import micropython
from base.float32_math import divide
from base.state import DOOR, HOLD, HOMING, JOG, RPM, RUN
from micropython import const
from motion.layout import AT, CARRY, FACTOR, HEAD, LOADED, REACHED, ROWS, TAIL
from motion.minifloat import per_minute, ratio

from talk.digits import END, VALUES, write
from talk.lines import free_space

# States in which there is a feed rate.
MOVING = const(HOMING | RUN | HOLD | JOG | DOOR)


@micropython.viper
def begin(name: ptr8, memory: object) -> int:
    """A report begins, with the name of a state; and machine position in mm, not written yet.
    memory: text, integers, singles, axes, steps, planner's table, where in it steps per mm are."""
    out, ints, mm, axes, steps, table, at = memory
    ptr32(ints)[END] = 0
    write(name, ptr8(out), ptr32(ints), ptr32(mm))
    divide(ptr32(steps), ptr32(table), int(at), ptr32(mm), int(axes))
    return 0


@micropython.viper
def write_common(name: ptr8, memory: object, spindle: ptr32, state: int) -> int:
    """A whole report: state, machine position, room in buffers, and speeds, as the form has them.
    Returns its length. memory: the form, begin()'s, text, integers, singles with room for the
    spindle's speed behind the axes, axes, the planner's flow and ring, LineReader's own, and
    whether the form asks for room."""
    form, begun, out, ints, mm, axes, flow, ring, reader, buffers = memory
    begin(name, begun)
    return int(
        _speeds(
            ptr8(form),
            ptr8(out),
            ptr32(ints),
            ptr32(mm),
            int(axes),
            ptr32(flow),
            ptr32(ring),
            ptr32(reader),
            int(buffers),
            ptr32(spindle),
            state,
        )
    )


@micropython.viper
def _speeds(
    form: ptr8,
    out: ptr8,
    ints: ptr32,
    mm: ptr32,
    axes: int,
    flow: ptr32,
    ring: ptr32,
    reader: ptr32,
    buffers: int,
    spindle: ptr32,
    state: int,
) -> int:
    value = VALUES
    if buffers:
        free = flow[TAIL] - flow[HEAD] - 1
        ints[value] = free + flow[ROWS] if free < 0 else free
        ints[value + 1] = int(free_space(reader))
        value += 2
    rate = 0
    if state & MOVING:
        rate = flow[CARRY]
        if flow[LOADED]:
            rate = int(ratio(flow[REACHED], ring[flow[AT] + FACTOR]))
        rate = int(per_minute(rate))
    ints[value] = rate
    mm[axes] = spindle[RPM]
    return int(write(form, out, ints, mm))
