# mypy: disable-error-code=arg-type
"""Fields: what nearly every status report is made of, in two kernels.

To ask each object for its part and to write it by itself takes a Pico a millisecond.
"""

import micropython
from base.singles import divide
from base.state import RPM
from motion.layout import AT, CARRY, FACTOR, HEAD, LOADED, REACHED, ROWS, TAIL
from motion.reals import per_minute, ratio

from talk.digits import END, VALUES, write
from talk.lines import room


@micropython.viper
def begin(
    name: ptr8,
    out: ptr8,
    ints: ptr32,
    steps: ptr32,
    table: ptr32,
    at: int,
    mm: ptr32,
    axes: int,
) -> int:
    """A report begins, with the name of a state; and machine position in mm, not written yet. at:
    where in the table steps per mm are."""
    ints[END] = 0
    write(name, out, ints, mm)
    divide(steps, table, at, mm, axes)
    return 0


@micropython.viper
def usual(
    name: ptr8,
    form: ptr8,
    out: ptr8,
    ints: ptr32,
    steps: ptr32,
    table: ptr32,
    at: int,
    mm: ptr32,
    axes: int,
    flow: ptr32,
    ring: ptr32,
    reader: ptr32,
    spindle: ptr32,
    buffers: int,
    moves: int,
) -> int:
    """A whole report: state, machine position, room in buffers, and speeds, as the form has them.
    Returns its length. reader: LineReader's own; mm has room for the spindle's speed behind the
    axes; buffers: whether the form asks for room."""
    begin(name, out, ints, steps, table, at, mm, axes)
    value = VALUES
    if buffers:
        free = flow[TAIL] - flow[HEAD] - 1
        ints[value] = free + flow[ROWS] if free < 0 else free
        ints[value + 1] = int(room(reader))
        value += 2
    rate = 0
    if moves:
        rate = flow[CARRY]
        if flow[LOADED]:
            rate = int(ratio(flow[REACHED], ring[flow[AT] + FACTOR]))
        rate = int(per_minute(rate))
    ints[value] = rate
    mm[axes] = spindle[RPM]
    return int(write(form, out, ints, mm))
