# mypy: disable-error-code=arg-type
"""Trains: from segment rows to the durations that esp32.RMT plays, in integers and us.

Rows wait in a ring. A train is a stretch of them, the same for all axes, in which no axis reverses
and none has more steps than a channel can hold. choose_end() sets its length; durations() makes
the train of one axis. It begins with the time to the first step; then pulses and pauses alternate,
and a pulse is last.

Arguments: rows, the ring of ROWS rows, `size` integers each; timing, the integers shared by all
axes. A row (motion/layout.py) has at ROW_TICKS, which is 0, its time in us, at ROW_DIRS a mask of
the axes that turn backwards, and per axis, from ROW_AXES on, its steps and the times of the first
and of the last one, in us from the row's start.

Called in the engine's turns; nothing here allocates.
"""

import micropython
from micropython import const
from motion.layout import ROW_AXES, ROW_DIRS, ROW_STRIDE
from motion.slice_kernel import leading

ROWS = const(16)  # in the ring
_ROWS_MASK = const(15)  # of a row's number in the ring

LONGEST_US = const(18000)  # the longest train: a hold waits for its end
_ANY_END_US = const(9000)  # up to this length a train may end with any row
_LEAST_PAUSE_US = const(2)  # us between two pulses

# Indexes of `timing`, integers shared by all axes.
AXES = const(0)  # number of axes
PULSE_US = const(1)  # length of a pulse, us
FIRST_ROW = const(2)  # number in the ring of the first row of the next train
DONE_US = const(3)  # how much of that first row was in the last train; mostly 0
ROWS_HELD = const(4)  # how many rows are in the ring
ROWS_TAKEN = const(5)  # how many rows the next train takes to their end
PART_US = const(6)  # where it ends in its first row, us from that row's start; 0: not within it
LENGTH_US = const(7)  # of the next train, in us
DIRS = const(8)  # directions in the next train, for axes that step
LOCKED = const(9)  # mask of locked axes, which do not step
MOST_STEPS = const(10)  # most steps of an axis in a train
TIMING_LENGTH = const(11)


@micropython.viper
def held_us(rows: ptr32, timing: ptr32, size: int) -> int:
    """Return how long the rows in the ring last, us; a result above LONGEST_US may be too low."""
    total = 0 - timing[DONE_US]
    for k in range(timing[ROWS_HELD]):
        total += rows[((timing[FIRST_ROW] + k) & _ROWS_MASK) * size]
        if total > LONGEST_US:
            break
    return total


@micropython.viper
def choose_end(rows: ptr32, timing: ptr32, size: int) -> int:
    """Choose the end of the next train: ROWS_TAKEN, PART_US, LENGTH_US, DIRS. Returns LENGTH_US.

    It ends at the end of a row, where steps are slow; within a row only if the first one alone is
    too long, or has more steps than a channel can hold (MOST_STEPS). Up to _ANY_END_US it takes
    every row; later only rows whose steps are at most a quarter faster than at the best end.
    """
    axes_in_train = 0  # mask of axes that step in the train so far,
    dirs = 0  # and their directions
    total_us = 0 - timing[DONE_US]  # its length
    space = timing[MOST_STEPS]  # steps that still fit into a channel
    best_interval = 0  # us per step in the row that ends the train best so far
    timing[ROWS_TAKEN] = 0
    timing[PART_US] = 0
    timing[LENGTH_US] = 0
    for k in range(timing[ROWS_HELD]):
        at = ((timing[FIRST_ROW] + k) & _ROWS_MASK) * size  # index of the row; its time is first
        axes_in_row = 0  # mask of axes that step in this row
        most_steps = 0  # steps of the one that makes the most
        least_gap = rows[at]  # shortest gap from step to step, us
        for i in range(timing[AXES]):
            base = at + ROW_AXES + ROW_STRIDE * i
            steps = rows[base]
            if steps and (timing[LOCKED] >> i) & 1 == 0:
                axes_in_row |= 1 << i
                if steps > most_steps:
                    most_steps = steps
                if steps > 1:
                    gap = (rows[base + 2] - rows[base + 1]) // (steps - 1)
                    if gap < least_gap:
                        least_gap = gap
        if axes_in_train & axes_in_row & (dirs ^ rows[at + ROW_DIRS]):
            break  # an axis reverses here
        rest = rows[at]  # time of the row in this train
        if k == 0:  # the last train has begun this row: total_us is minus the time done
            rest += total_us
        row_steps = most_steps  # that a channel has to hold: at most those in `rest`
        if least_gap > 0 and rest // least_gap + 1 < most_steps:
            row_steps = rest // least_gap + 1
        total_us += rows[at]
        if k and (total_us > LONGEST_US or row_steps > space):
            break
        axes_in_train |= axes_in_row
        dirs |= rows[at + ROW_DIRS] & axes_in_row
        timing[DIRS] = dirs
        if total_us > LONGEST_US or row_steps > space:  # the first row: cut it
            end = LONGEST_US
            if row_steps > space and least_gap * space < end:
                end = least_gap * space
            timing[PART_US] = int(part(rows, timing, at, timing[DONE_US] + end))
            timing[LENGTH_US] = timing[PART_US] - timing[DONE_US]
            break
        space -= row_steps
        interval = rows[at] // most_steps if most_steps else LONGEST_US
        if total_us < _ANY_END_US or interval + (interval >> 2) >= best_interval:
            timing[ROWS_TAKEN] = k + 1
            timing[LENGTH_US] = total_us
            best_interval = interval
    return timing[LENGTH_US]


@micropython.viper
def part(rows: ptr32, timing: ptr32, at: int, end: int) -> int:
    """Return where to cut a long row, in us from its start: after the last step before `end`, or
    at `end` if that step is in the first half of what is left. at: the row's index in rows; end:
    the latest possible cut, us from the row's start."""
    latest = timing[DONE_US]  # just after the last step before `end`
    for i in range(timing[AXES]):
        base = at + ROW_AXES + ROW_STRIDE * i
        steps = rows[base]
        if steps and (timing[LOCKED] >> i) & 1 == 0:
            tick = rows[base + 1]
            gap = (rows[base + 2] - tick) // (steps - 1) if steps > 1 else 1
            if tick < end:
                # As if all gaps were longer: a cut that is too early by a step does no harm.
                gaps = (end - 1 - tick) // (gap + 1)
                if gaps >= steps:
                    gaps = steps - 1
                tick += gaps * gap + 1
                if tick > latest:
                    latest = tick
    return latest if latest > (timing[DONE_US] + end) >> 1 else end


@micropython.viper
def durations(rows: ptr32, timing: ptr32, size: int, axis: int, out: ptr32) -> int:
    """Make one axis' train in `out`: durations in us, a pause, a pulse, and so on. Returns their
    number: 0 if the axis does not step, -1 if they do not fit into a channel's memory.

    size: integers in a row. The first duration is the time to the first step.
    """
    if (timing[LOCKED] >> axis) & 1:
        return 0
    pulse = timing[PULSE_US]
    count = 0
    origin = 0 - timing[DONE_US]  # start of the row, from the start of the train
    last_end = 0 - pulse - _LEAST_PAUSE_US  # end of the last pulse
    done = timing[DONE_US]  # steps before this time of the first row were in the last train
    for k in range(timing[ROWS_TAKEN] + (1 if timing[PART_US] else 0)):
        at = ((timing[FIRST_ROW] + k) & _ROWS_MASK) * size
        base = at + ROW_AXES + ROW_STRIDE * axis
        steps = rows[base]
        end = rows[at] + 1  # steps before this time of the row are in the train: all,
        if timing[PART_US]:  # or, if it is cut, those before the cut
            end = timing[PART_US]
        tick = rows[base + 1]
        gap = 0
        longer = 0  # gaps that are one tick longer,
        longer_first = 0  # and how many of them come first; the others come last
        if steps > 1:
            gap = (rows[base + 2] - tick) // (steps - 1)
            longer = (rows[base + 2] - tick) % (steps - 1)
            longer_first = int(leading(steps - 1, gap, longer))
        for n in range(steps):
            if tick >= end:
                break
            if tick >= done:
                if count >> 1 >= timing[MOST_STEPS]:  # two durations per step
                    return -1
                edge = origin + tick  # start of the pulse
                if count and edge < last_end + _LEAST_PAUSE_US:
                    edge = last_end + _LEAST_PAUSE_US
                out[count] = edge - last_end if count else edge
                out[count + 1] = pulse
                count += 2
                last_end = edge + pulse
            tick += gap
            if n < longer_first or n >= steps - 1 - longer + longer_first:
                tick += 1
        origin += rows[at]
        done = 0
    return count


@micropython.viper
def remove_rows(timing: ptr32) -> int:
    """Remove the rows that the next train takes to their end from the ring: the train after it
    begins at its end, which may be within a row (PART_US)."""
    timing[FIRST_ROW] = (timing[FIRST_ROW] + timing[ROWS_TAKEN]) & _ROWS_MASK
    timing[ROWS_HELD] = timing[ROWS_HELD] - timing[ROWS_TAKEN]
    if timing[ROWS_TAKEN]:
        timing[DONE_US] = 0
    if timing[PART_US]:
        timing[DONE_US] = timing[PART_US]
    return 0


@micropython.viper
def made(durations: ptr32, count: int, passed: int) -> int:
    """Return how many steps of a train are made `passed` us after its start. durations: count
    times in us, a pause first, then pulses and pauses."""
    steps = 0
    for k in range(count):
        passed -= durations[k]
        if passed < 0:
            break
        if k & 1 == 0:  # a pause has ended: the pulse after it has begun
            steps += 1
    return steps


@micropython.viper
def lasts(durations: ptr32, count: int) -> int:
    """Return the length of a train, the sum of its durations (count of them), in us."""
    total = 0
    for k in range(count):
        total += durations[k]
    return total
