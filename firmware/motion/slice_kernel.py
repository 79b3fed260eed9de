# mypy: disable-error-code=arg-type
"""The slices' kernel: a planned segment becomes rows for the engine, one or several.

Viper, as segment_kernel.py is, which plans it. All of it runs in the engine's interrupt. A row
has, per motor, steps that are evenly spaced between a first and a last tick; hardware plays it.

Speeds and distances are in 2**-18 step of the block's longest axis, speeds per full segment. Times
are in 2**-17 of a full segment, or in ticks, of which it has 2**SEGMENT_LOG2. The flow holds:

    SLICES            rows of the segment still to be made, at most; PLANNED_TIME: their time
    PLANNED_DISTANCE  distance of the segment that is not in a row yet
    PARTIAL_STEP      distance between the last step and the end of the last row;
    SPARE_TICKS       and ticks, which are added to the next row
    PIECE_AT          index in the flow of a piece of the segment: its time, then its final speed;
                      the first one is at PIECES
    ROW_SPEED         speed at the end of the last row; END_SPEED: at the end of the segment
    STEPS_LEFT        distance of the block that is not planned yet: steps;
    FRACTION_LEFT     and 2**-18 of one
    BLOCK_AT          index in the ring of the block's row
    MOTORS + 2 * i    of motor i: steps still to go in the block; then its phase, 2**-18 step

The table of the machine: SEGMENT_LOG2; SLICE, the shortest time of a row; POWER_FLOOR and
POWER_MAX, spindle power. In a segment's row: ROW_TICKS, its time; and from ROW_AXES on, per motor,
ROW_STRIDE integers: steps, tick of the first one, tick of the last one.
"""

import micropython
from micropython import const

from motion.layout import (
    BLOCK_AT,
    END_SPEED,
    FRACTION_LEFT,
    MOTOR_COUNT,
    MOTORS,
    PARTIAL_STEP,
    PIECE_AT,
    PIECES,
    PLANNED_DISTANCE,
    PLANNED_TIME,
    POWER_FLOOR,
    POWER_MAX,
    PROGRAMMED,
    ROW_AXES,
    ROW_SPEED,
    ROW_STRIDE,
    ROW_TICKS,
    SEGMENT_LOG2,
    SLICE,
    SLICES,
    SPARE_TICKS,
    STEPS,
    STEPS_LEFT,
)
from motion.ramps import FULL_TIME, share, times

# Distances begin with so much too many, so that rounding never loses the last step of a hold.
STEP_BIAS = const(0x800)  # in 2**-18 step
_STEP_FRACTION = const(0x3FFFF)  # a step is 1 << 18


@micropython.viper
def leading(gaps: int, gap: int, longer: int) -> int:
    """Return how many of a row's longer gaps come first; its other longer gaps come last.

    gaps: how many there are between the row's steps; `longer` of them take gap + 1 ticks, and the
    others gap. With all longer ones first, a motor is off its line by up to gaps / (4 * gap)
    steps; with half of them first, by half of that. So they are halved if the error would be an
    eighth of a step or more.
    """
    return longer >> 1 if gaps > gap >> 1 else longer


@micropython.viper
def step_tick(row: ptr32, base: int, k: int) -> int:
    """Return the tick, from the start of the row, of step k (from 0) of the motor at row[base].

    row[base] is its number of steps; the ticks of the first and of the last follow. The gaps
    between steps differ by at most one tick: see leading(). k beyond the last step continues with
    gaps of the shorter kind.
    """
    tick = row[base + 1]
    gaps = row[base] - 1
    if gaps < 1:
        return tick
    span = row[base + 2] - tick
    gap = span // gaps
    longer = span - gap * gaps
    first_longer = int(leading(gaps, gap, longer))
    tick += gap * k + (k if k < first_longer else first_longer)
    # Now k becomes how many of the longer gaps at the end are before the step.
    k -= gaps - longer + first_longer
    if k > 0:
        tick += k if k < longer - first_longer else longer - first_longer
    return tick


@micropython.viper
def slices(flow: ptr32, table: ptr32, dynamic: int) -> int:
    """Return into how many rows the planned segment is cut. The steps of a row are evenly spaced,
    so each row has one speed. dynamic: not 0 if power follows speed.

    The rows are so many that none changes the speed by more than 1/32, or 1/256 if dynamic,
    because power is constant in a row; but none takes much less than SLICE. They are so many that
    motors, if several move, are off the line by at most a quarter of a step, in addition to the
    half of rounding: a row of n steps in t ticks is off by n**2 / 8t steps (leading()), so a full
    segment of 2**log2 ticks and n steps, up to 4095, takes n**2 / 2**(log2 + 1) rows.
    """
    # The segment's lowest and highest speed: its first, and that at the end of each piece.
    slow = flow[ROW_SPEED]
    fast = slow
    at = PIECES  # index in the flow
    while at < flow[PIECE_AT]:
        at += 2
        speed = flow[at - 1]
        if speed < slow:
            slow = speed
        if speed > fast:
            fast = speed
    if flow[PLANNED_TIME] > FULL_TIME:
        return 1  # it is so long for the sake of one step
    shortest = table[SLICE]  # time of a row
    if dynamic:
        shortest -= shortest >> 2  # a quarter shorter than SLICE
    count = (flow[PLANNED_TIME] + (shortest >> 1)) // shortest or 1  # as many as the time allows
    slight_change = fast >> (8 if dynamic else 5)
    steps = fast >> 18  # of a full segment at the highest speed
    log2 = table[SEGMENT_LOG2]
    # The fewest rows, so that motors stay on the line.
    least = (steps * steps + (1 << log2)) >> (log2 + 1)
    if least > 1 and int(is_alone(flow, table[MOTOR_COUNT])):
        least = 1
    if least > count:
        least = count
    while count > 1 and fast - slow <= slight_change * (count >> 1):
        count >>= 1  # half as many rows are still even enough
    return count if count > least else least


@micropython.viper
def is_alone(flow: ptr32, motors: int) -> int:
    """Return 1 if at most one motor has steps left in the block, else 0. Alone it cannot leave the
    line. motors: their number."""
    moving = 0
    for i in range(motors):
        if flow[MOTORS + 2 * i]:
            moving += 1
    return 1 if moving < 2 else 0


@micropython.viper
def travel(flow: ptr32, duration: int) -> int:
    """Remove the first `duration` from the segment's pieces, which is the time of a row. Returns
    the distance in that time, and leaves the speed at its end in ROW_SPEED.

    A piece that lasts longer is split: its speed there is speed + (end - speed) * duration / time,
    with both times in units of 64, so that the product fits.
    """
    speed = flow[ROW_SPEED]
    distance = 0
    while duration:
        at = flow[PIECE_AT]
        time = flow[at]
        end = flow[at + 1]  # speed
        if time > duration:  # split it; | 1: never a division by 0
            end = speed + (end - speed) // (time >> 6 | 1) * (duration >> 6)
            flow[at] = time - duration  # the rest is for the next row
            time = duration
        else:
            flow[PIECE_AT] = at + 2
        distance += int(times((speed + end) >> 1, time))
        speed = end
        duration -= time
    flow[ROW_SPEED] = speed
    return distance


@micropython.viper
def next_row(flow: ptr32, row: ptr32, log2: int) -> int:
    """Make the next row from the next slice of the segment. Returns its steps of the longest axis;
    ROW_TICKS of the row is its time. log2: a full segment has 2**log2 ticks.

    A row has at least one step, so slices are merged at low speed. It gets all that is left of the
    segment if the rest would make no step.
    """
    # A step is due when PARTIAL_STEP, the distance since the last one, and `distance` make a whole
    # one.
    distance = 0
    time = 0
    steps = 0
    while flow[SLICES] > 1 and steps == 0:
        # A multiple of 64: times() and travel() are exact for these.
        slice_time = flow[PLANNED_TIME] // flow[SLICES] >> 6 << 6  # an even part of what is left
        flow[SLICES] = flow[SLICES] - 1
        flow[PLANNED_TIME] = flow[PLANNED_TIME] - slice_time
        time += slice_time
        distance += int(travel(flow, slice_time))
        steps = (flow[PARTIAL_STEP] + distance) >> 18
    # The last slice, or all steps that the segment still has: this is its last row.
    if steps == 0 or steps >= (flow[PARTIAL_STEP] + flow[PLANNED_DISTANCE]) >> 18:
        distance = flow[PLANNED_DISTANCE]
        time += flow[PLANNED_TIME]
        flow[SLICES] = 0
        flow[ROW_SPEED] = flow[END_SPEED]
    flow[PLANNED_DISTANCE] = flow[PLANNED_DISTANCE] - distance
    # From 2**-17 of a full segment to ticks.
    return int(end_on_step(flow, row, distance, time >> (17 - log2)))


@micropython.viper
def end_on_step(flow: ptr32, row: ptr32, distance: int, ticks: int) -> int:
    """End a row that was to have this distance and these ticks at its last whole step of the
    longest axis. Returns its steps; its time goes to ROW_TICKS.

    ticks' = ticks * whole steps / distance. The rest of distance (PARTIAL_STEP) and time
    (SPARE_TICKS) goes into the next row. So all intervals of a row are equal, and at a constant
    speed all intervals of a block; otherwise each row would end with an interval of another
    length.
    """
    distance += flow[PARTIAL_STEP]
    ticks += flow[SPARE_TICKS]
    steps = distance >> 18  # whole ones
    rest = distance & _STEP_FRACTION
    flow[PARTIAL_STEP] = rest
    flow[SPARE_TICKS] = 0
    if rest > STEP_BIAS and steps:  # else it ends on a step (all rest is the bias), or has none
        part = int(share(steps << 18, distance))  # whole steps / distance, in 2**-17
        # ticks * part >> 17, in halves so that the products fit.
        whole_ticks = (((ticks >> 15) * part) >> 2) + (((ticks & 32767) * (part >> 2)) >> 15)
        flow[SPARE_TICKS] = ticks - whole_ticks
        ticks = whole_ticks
    row[ROW_TICKS] = ticks if ticks else 1
    return steps


@micropython.viper
def place_steps(flow: ptr32, ring: ptr32, row: ptr32, motors: int, events: int) -> int:
    """Place each motor's steps in the row: how many, the tick of the first and of the last.

    motors: their number; events: the row's steps of the longest axis. A motor with the share q of
    those (ratio, after STEPS in the block) advances its phase by gain = events * q, in 2**-18
    step, and steps where the phase passes a whole number:

        tick of step k = ticks * (k - phase) / gain        k = 1, and k = steps

    The phase runs on from row to row, so at a constant speed the steps of all rows are evenly
    spaced. The last row of a block makes exactly the steps that are left.
    """
    # gain = events * ratio >> 11, ratio from 0 to 2**29: events << 3 times its upper 15 bits and
    # its lower 15.
    events <<= 3  # no longer a count of steps
    ticks = row[ROW_TICKS]
    ratios = flow[BLOCK_AT] + STEPS + motors  # index in the ring: steps / EVENTS, in 2**-29
    # Whether this is the block's last row: nothing is left to plan, and no other row is to come.
    last = flow[STEPS_LEFT] == 0 and flow[FRACTION_LEFT] == 0 and flow[SLICES] == 0
    # ticks may have 27 bits: `dropped` low ones are ignored, so that 18 are left, for the products
    # below.
    dropped = 0
    while ticks >> dropped >= 1 << 18:
        dropped += 1
    for i in range(motors):
        ratio = ring[ratios + i]
        phase = flow[MOTORS + 2 * i + 1]
        gain = ((events * (ratio >> 15)) << 1) + ((events * (ratio & 32767)) >> 14)
        steps = (phase + gain) >> 18
        steps_left = flow[MOTORS + 2 * i]
        if last or steps > steps_left:
            steps = steps_left
        at = ROW_AXES + ROW_STRIDE * i  # index in the row: steps, first tick, last tick
        row[at] = steps
        flow[MOTORS + 2 * i] = steps_left - steps
        flow[MOTORS + 2 * i + 1] = (phase + gain) & _STEP_FRACTION
        scale = 0  # bits that gain loses, for the products below
        while gain >= 1 << 21:
            gain >>= 1
            scale += 1
        for k in range(2 if steps else 0):  # its first step, then its last
            step = steps if k else 1
            to_go = ((step << 18) - phase) >> scale  # phase from the row's start to that step
            tick = ticks  # the row's end
            if to_go < gain:
                # ticks * to_go / gain, ticks as two digits of 9 bits; gain has 21 bits at most.
                coarse = (ticks >> dropped >> 9) * to_go
                quotient = coarse // gain
                rest = ((coarse - quotient * gain) << 9) + ((ticks >> dropped) & 511) * to_go
                tick = ((quotient << 9) + (rest + (gain >> 1)) // gain) << dropped
            row[at + 1 + k] = tick
    return 0


@micropython.viper
def speed_share(flow: ptr32, ring: ptr32) -> int:
    """Return the speed at the end of the row as a part of the programmed rate, in 2**-17."""
    return int(share(flow[ROW_SPEED], ring[flow[BLOCK_AT] + PROGRAMMED]))


@micropython.viper
def scaled_power(table: ptr32, full: int, part: int) -> int:
    """Return the spindle power at a part of the programmed rate (2**-17), where power follows
    speed: from 0 to POWER_MAX, in whole units.

    full: the power at the whole rate, in 1/64 unit. As in Grbl's laser mode the power is linear in
    the speed, and never 0 while S is not: up to POWER_FLOOR, in 1/64, too, it is 1.
    """
    fine_power = full  # in 1/64 unit
    if part < FULL_TIME:
        fine_power = int(times(full, part))
    if fine_power == 0:
        return 0
    if fine_power <= table[POWER_FLOOR]:
        return 1
    power = ((fine_power - table[POWER_FLOOR]) >> 6) + 1
    return power if power < table[POWER_MAX] else table[POWER_MAX]
