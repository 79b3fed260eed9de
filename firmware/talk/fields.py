# mypy: disable-error-code="arg-type, call-overload, has-type, misc"
"""Fields: the parts that nearly every status report has, written by two kernels.

Asking each object for its value and writing each field by itself takes a Pico 1 ms.
"""

import micropython
from base.float32_math import divide
from base.state import DOOR, HOLD, HOMING, JOG, RPM, RUN
from micropython import const
from motion.layout import AT, CARRY, FACTOR, HEAD, LOADED, REACHED, ROWS, TAIL
from motion.minifloat import per_minute, ratio

from talk.digits import END, VALUES, write
from talk.lines import free_space

# States that have a feed rate.
MOVING = const(HOMING | RUN | HOLD | JOG | DOOR)


@micropython.viper
def begin(name: ptr8, memory: object) -> int:
    """Begin a report: write the name of the state, and compute machine position in mm, without
    writing it. name: a form that a 0 ends.

    memory: text, integers, singles, axes, steps, the planner's table, and the index in it of steps
    per mm.
    """
    out, ints, mm, axes, steps, table, at = memory
    ptr32(ints)[END] = 0
    write(name, ptr8(out), ptr32(ints), ptr32(mm))
    divide(ptr32(steps), ptr32(table), int(at), ptr32(mm), int(axes))
    return 0


@micropython.viper
def write_common(name: ptr8, memory: object, spindle: ptr32, state: int) -> int:
    """Write a whole report: state, machine position, free space in buffers, and speeds, as the
    form has them. Returns its length.

    memory: the form, begin()'s memory, text, integers, singles (after the axes comes the spindle
    speed), axes, the planner's flow and ring, LineReader's state, and whether the form has free
    space.
    """
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
    """Fill in free blocks, free bytes, feed rate (mm/min) and spindle speed; then write the form.
    Returns the report's length. state: the run state; spindle: the array with the speed (RPM)."""
    value = VALUES
    if buffers:
        free = flow[TAIL] - flow[HEAD] - 1  # of a ring; one block always stays free
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
