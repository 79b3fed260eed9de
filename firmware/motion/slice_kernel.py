# mypy: disable-error-code=arg-type
"""The slices' kernel: a segment planned becomes rows for the engine, one or several.

Viper, as segment_kernel.py is, which plans it; all of it runs in the engine's interrupt. What
stands where is told in layout.py.
"""

import micropython
from micropython import const

from motion.layout import (
    ADVANCE,
    AT,
    FRACTION,
    MOTOR_COUNT,
    MOTORS,
    NOW,
    PARTIAL,
    PIECE,
    PIECES,
    POWER_FLOOR,
    POWER_MAX,
    PROGRAMMED,
    REACHED,
    ROW_AXES,
    ROW_STRIDE,
    ROW_TICKS,
    SEGMENT_LOG2,
    SLICE,
    SLICES,
    SPARE,
    STEPS,
    TIME,
    WHOLE,
)
from motion.ramps import share, times

# Ahead of the truth, so that rounding does not cost the last step of a hold.
STEP_BIAS = const(0x800)


@micropython.viper
def leading(gaps: int, gap: int, longer: int) -> int:
    """Return how many of a row's longer gaps come first; its other longer gaps come last.

    gaps: between the row's steps, `longer` of which take gap + 1 ticks and the others gap. All
    long ones first would put a motor off its line by up to gaps / (4 * gap) steps, half of them
    first by half of that: so it is where that is an eighth of a step or more.
    """
    return longer >> 1 if gaps > gap >> 1 else longer


@micropython.viper
def slices(flow: ptr32, table: ptr32, dynamic: int) -> int:
    """How many rows the segment planned is to be, for the steps of a row are even: as many as it
    takes that none changes the speed by more than a thirty-second, if they are long enough, and
    that motors, where several move, are off the line by no more than a quarter of a step besides
    the half that rounding makes. A row of n steps in t ticks is off by n2 / 8t (leading()): with
    n, up to 4095, in a full segment of 2**log2 ticks, n2 / 2**(log2 + 1) rows keep to it. Their
    power is one, too: where that follows speed they are short whenever the speed changes, and no
    longer than a millisecond.
    """
    slow = flow[REACHED]
    fast = slow
    at = PIECES
    while at < flow[PIECE]:
        at += 2
        speed = flow[at - 1]
        if speed < slow:
            slow = speed
        if speed > fast:
            fast = speed
    if flow[TIME] > 131072:
        return 1  # it is so long for the sake of one step
    slice = table[SLICE]
    if dynamic:
        slice -= slice >> 2
    count = (flow[TIME] + (slice >> 1)) // slice or 1
    slight = fast >> (8 if dynamic else 5)
    steps = fast >> 18
    log2 = table[SEGMENT_LOG2]
    least = (steps * steps + (1 << log2)) >> (log2 + 1)
    if least > 1 and int(is_alone(flow, table[MOTOR_COUNT])):
        least = 1
    if least > count:
        least = count
    while count > 1 and fast - slow <= slight * (count >> 1):
        count >>= 1
    return count if count > least else least


@micropython.viper
def is_alone(flow: ptr32, motors: int) -> int:
    """Whether the block's steps left are those of one motor, which has no line to leave."""
    moving = 0
    for i in range(motors):
        if flow[MOTORS + 2 * i]:
            moving += 1
    return 1 if moving < 2 else 0


@micropython.viper
def travel(flow: ptr32, part: int) -> int:
    """Go on along the pieces of the segment planned, for so long. Returns how far."""
    speed = flow[REACHED]
    distance = 0
    while part:
        at = flow[PIECE]
        time = flow[at]
        end = flow[at + 1]
        if time > part:
            end = speed + (end - speed) // (time >> 6 | 1) * (part >> 6)
            flow[at] = time - part
            time = part
        else:
            flow[PIECE] = at + 2
        distance += int(times((speed + end) >> 1, time))
        speed = end
        part -= time
    flow[REACHED] = speed
    return distance


@micropython.viper
def next_row(flow: ptr32, row: ptr32, log2: int) -> int:
    """Take the next slice of the segment, of one step at least, or what is left. Returns steps."""
    distance = 0
    time = 0
    steps = 0
    while flow[SLICES] > 1 and steps == 0:
        part = flow[TIME] // flow[SLICES] >> 6 << 6  # times() and travel() are exact for these
        flow[SLICES] = flow[SLICES] - 1
        flow[TIME] = flow[TIME] - part
        time += part
        distance += int(travel(flow, part))
        steps = (flow[PARTIAL] + distance) >> 18
    if steps == 0 or steps >= (flow[PARTIAL] + flow[ADVANCE]) >> 18:
        distance = flow[ADVANCE]
        time += flow[TIME]
        flow[SLICES] = 0
        flow[REACHED] = flow[NOW]
    flow[ADVANCE] = flow[ADVANCE] - distance
    return int(end_on_step(flow, row, distance, time >> (17 - log2)))


@micropython.viper
def end_on_step(flow: ptr32, row: ptr32, distance: int, ticks: int) -> int:
    """End the row with a step of the longest axis: whole steps, and the time they take.

    What is left over, distance and time, goes into the next one. So every
    interval of a row is the same, and at a constant speed every interval
    of a block. Returns the steps.
    """
    distance += flow[PARTIAL]
    ticks += flow[SPARE]
    steps = distance >> 18
    rest = distance & 0x3FFFF
    flow[PARTIAL] = rest
    flow[SPARE] = 0
    if rest > STEP_BIAS and steps:
        part = int(share(steps << 18, distance))
        whole_ticks = (((ticks >> 15) * part) >> 2) + (((ticks & 32767) * (part >> 2)) >> 15)
        flow[SPARE] = ticks - whole_ticks
        ticks = whole_ticks
    row[ROW_TICKS] = ticks if ticks else 1
    return steps


@micropython.viper
def place_steps(flow: ptr32, ring: ptr32, row: ptr32, motors: int, events: int) -> int:
    """Lay the row's steps out in time: per motor how many, when the first and the last.

    events: those of the longest axis. A motor's phase runs on from row to row, so that at a
    constant speed its steps are evenly spaced. The block's last row makes what is left to make.
    """
    events <<= 3
    ticks = row[ROW_TICKS]
    ratios = flow[AT] + STEPS + motors
    last = flow[WHOLE] == 0 and flow[FRACTION] == 0 and flow[SLICES] == 0
    long = 0
    while ticks >> long >= 1 << 18:
        long += 1
    for i in range(motors):
        ratio = ring[ratios + i]
        phase = flow[MOTORS + 2 * i + 1]
        gain = ((events * (ratio >> 15)) << 1) + ((events * (ratio & 32767)) >> 14)
        steps = (phase + gain) >> 18
        left = flow[MOTORS + 2 * i]
        if last or steps > left:
            steps = left
        at = ROW_AXES + ROW_STRIDE * i
        row[at] = steps
        flow[MOTORS + 2 * i] = left - steps
        flow[MOTORS + 2 * i + 1] = (phase + gain) & 0x3FFFF
        scale = 0
        while gain >= 1 << 21:
            gain >>= 1
            scale += 1
        for k in range(2 if steps else 0):
            part = (((steps if k else 1) << 18) - phase) >> scale
            if part < gain:
                coarse = (ticks >> long >> 9) * part
                quotient = coarse // gain
                rest = ((coarse - quotient * gain) << 9) + ((ticks >> long) & 511) * part
                part = ((quotient << 9) + (rest + (gain >> 1)) // gain) << long
            else:
                part = ticks
            row[at + 1 + k] = part
    return 0


@micropython.viper
def speed_share(flow: ptr32, ring: ptr32) -> int:
    """The part of the programmed rate, in 2**-17, that the row just made has come to."""
    return int(share(flow[REACHED], ring[flow[AT] + PROGRAMMED]))


@micropython.viper
def scaled_power(table: ptr32, full: int, part: int) -> int:
    """Spindle power at a part of the programmed rate, where power follows speed; full: at all of
    it, in 1/64."""
    if part < 131072:
        full = int(times(full, part))
    if full == 0:
        return 0
    if full <= table[POWER_FLOOR]:
        return 1
    full = ((full - table[POWER_FLOOR]) >> 6) + 1
    return full if full < table[POWER_MAX] else table[POWER_MAX]
