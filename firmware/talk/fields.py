# mypy: disable-error-code="arg-type, call-overload, has-type, misc"
"""Fields: the parts that nearly every status report has, written by two kernels.

Asking each object for its value and writing each field by itself takes a Pico 1 ms.
"""

import micropython
from base.float32_math import divide
from base.state import DOOR, HOLD, HOMING, JOG, RPM, RUN
from micropython import const
from motion.layout import BLOCK_AT, FACTOR, HEAD, JOIN_SPEED, LOADED, ROW_SPEED, ROWS, TAIL
from motion.minifloat import per_minute, ratio

from talk.digits import END, VALUES, write
from talk.lines import free_space

MOVING = const(HOMING | RUN | HOLD | JOG | DOOR)  # run states that have a feed rate


@micropython.viper
def begin(name: ptr8, memory: object) -> int:
    """Begin a report: write the name of the state, and compute machine position in mm, without
    writing it. name: a form that a 0 ends. Returns 0.

    memory: out, the report's text; ints, digits.write()'s integers; mm, floats, for the position;
    the number of axes; steps, the position to convert; the planner's table, and the index in it of
    the X axis's steps per mm, which those of the other axes follow.
    """
    out, ints, mm, axes, steps, table, x_resolution_at = memory
    ptr32(ints)[END] = 0  # the text is empty
    write(name, ptr8(out), ptr32(ints), ptr32(mm))
    # mm = steps / steps per mm, for each axis
    divide(ptr32(steps), ptr32(table), int(x_resolution_at), ptr32(mm), int(axes))
    return 0


@micropython.viper
def write_common(name: ptr8, memory: object, spindle: ptr32, state: int) -> int:
    """Write a whole report: the state by begin(), all that follows by _write_rest(). Returns its
    length in bytes.

    name: the state's form; spindle: State.spindle; state: the run state. memory: the form of the
    rest (machine position, free space in buffers if requested, speeds), begin()'s memory, the
    report's text, digits.write()'s integers and floats (after the axes comes the spindle speed),
    the number of axes, the planner's flow and ring, LineReader's state, and whether the form has
    free space (0: no).
    """
    rest_form, begin_args, out, ints, mm, axes, flow, ring, reader, buffers = memory
    begin(name, begin_args)
    return int(
        _write_rest(
            ptr8(rest_form),
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
def _write_rest(
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
    """Fill in all of a report that follows the state, and write it. Returns the report's length in
    bytes.

    form: the report after the state's name, with placeholders (digits.write()); out: the report's
    text; ints: END, then from VALUES on free blocks and free bytes, if the form has them (buffers
    is not 0), and the feed rate in mm/min; mm: the position, which is there already, and the
    spindle speed after it. flow, ring: the planner's state and blocks; reader: LineReader's state;
    spindle: State.spindle, with the speed at RPM; state: the run state; the feed rate is 0 unless
    it is one of MOVING.
    """
    value_at = VALUES
    if buffers:
        free = flow[TAIL] - flow[HEAD] - 1  # of a ring; one block always stays free
        ints[value_at] = free + flow[ROWS] if free < 0 else free
        ints[value_at + 1] = int(free_space(reader))
        value_at += 2
    rate = 0  # in mm/s a minifloat, from per_minute() on whole mm/min
    if state & MOVING:
        rate = flow[JOIN_SPEED]  # between two blocks: the speed carried over, in mm/s
        if flow[LOADED]:  # in a block: the speed reached, in units of which FACTOR are 1 mm/s
            rate = int(ratio(flow[ROW_SPEED], ring[flow[BLOCK_AT] + FACTOR]))
        rate = int(per_minute(rate))
    ints[value_at] = rate
    mm[axes] = spindle[RPM]  # the float's bits
    return int(write(form, out, ints, mm))
