# mypy: disable-error-code=arg-type
"""The segments' kernel: integers only, from blocks to a few milliseconds of steps.

Viper, as plan_kernel.py is; all of it runs in the engine's interrupt. What stands where is told in
layout.py.
"""

import micropython
from micropython import const

from motion.layout import (
    ADVANCE,
    AT,
    BRAKE_FROM,
    BRAKE_TO,
    BRAKE_UNIT,
    BRAKE_WAY,
    CARRY,
    CRUISE,
    DIRS,
    DYNAMIC,
    ENTRY_SQR,
    EVENTS,
    FACTOR,
    FLAGS,
    FRACTION,
    HEAD,
    HOLD,
    LEAVE,
    LEAVE_SQR,
    LEFT,
    LOADED,
    MOTOR_COUNT,
    MOTORS,
    NOW,
    PARTIAL,
    POWER,
    POWER_FLOOR,
    POWER_MAX,
    PROGRAMMED,
    RAMP,
    ROOT_SCALE,
    ROW_AXES,
    ROW_DIRS,
    ROW_POWER,
    ROW_SIZE,
    ROW_STRIDE,
    ROW_TICKS,
    ROWS,
    SEGMENT_LOG2,
    SPARE,
    STEPS,
    SYSTEM,
    TAIL,
    WHOLE,
)
from motion.ramps import after, braking, share, times
from motion.reals import BIAS, HIGHEST, ONE, product, ratio, square_root

_LEAST = const(0x50000)  # a segment covers 1.25 steps, where the block reaches that far,
_LONGEST = const(0x8000000)  # or lasts as long as 1024 full ones
_HAIR = const(0x800)  # ahead of the truth, so that rounding does not cost the last step of a hold
_SPLINTER = const(64)  # a segment is not filled up with pieces as short as that, in 2**-17


@micropython.viper
def load(flow: ptr32, ring: ptr32, motors: int) -> int:
    """Take up the next block. Returns 0 where there is none."""
    at = flow[ROWS] if flow[SYSTEM] else flow[TAIL]
    if flow[SYSTEM] == 2 or at == flow[HEAD]:
        return 0
    at *= flow[ROW_SIZE]
    flow[AT] = at
    speed = int(product(flow[CARRY], ring[at + FACTOR], ONE))
    cruise = ring[at + CRUISE]
    if speed < cruise and speed + (cruise >> 9) >= cruise:
        speed = cruise  # what rounding took off between blocks
    flow[NOW] = speed
    flow[LEAVE] = 0
    flow[LEAVE_SQR] = 0
    flow[WHOLE] = ring[at + EVENTS]
    flow[FRACTION] = 0
    flow[PARTIAL] = _HAIR
    flow[BRAKE_FROM] = 0
    flow[SPARE] = 0
    for i in range(motors):
        flow[MOTORS + 2 * i] = ring[at + STEPS + i]
        flow[MOTORS + 2 * i + 1] = 131072  # half a step: all step where they are nearest the line
    flow[LOADED] = 1
    return 1


@micropython.viper
def look_ahead(flow: ptr32, ring: ptr32, scale: int) -> int:
    """The speed at which to leave the loaded block: the planner's promise for the next one."""
    sqr = 0
    following = flow[TAIL] + 1
    if following == flow[ROWS]:
        following = 0
    if flow[SYSTEM] == 0 and following != flow[HEAD]:
        sqr = ring[following * flow[ROW_SIZE] + ENTRY_SQR]
    if sqr != flow[LEAVE_SQR]:
        flow[LEAVE_SQR] = sqr
        exponent = BIAS
        while sqr and sqr < 1 << 28:
            sqr <<= 2
            exponent -= 1
        root = int(square_root(sqr))  # 15 bits, unless 0
        root = (exponent << 15) + root if root else 0
        flow[LEAVE] = int(product(root, scale, ring[flow[AT] + FACTOR]))
    return flow[LEAVE]


@micropython.viper
def approach(flow: ptr32, ramp: int, goal: int, room: int) -> int:
    """The next piece speeds up, or slows down, by ramp to a goal, as far as there is room."""
    speed = flow[NOW]
    down = 1 if goal < speed else 0
    part = int(share(speed - goal if down else goal - speed, ramp))
    end = goal
    if part >= flow[LEFT]:
        part = flow[LEFT]
        end = speed - int(times(ramp, part)) if down else speed + int(times(ramp, part))
    distance = int(times((speed + end) >> 1, part))
    if distance >= room:
        distance = room
        end = int(after(speed, ramp, room, down))
        part = -1
    if end < goal if down else end > goal:
        end = goal
    if part < 0:
        part = int(share(room, (speed + end) >> 1))
    return int(piece(flow, end, distance, part))


@micropython.viper
def brake(flow: ptr32, ramp: int, leave: int, rest: int) -> int:
    """The next piece brakes so as to leave the block, rest ahead, at the speed planned.

    The rate of braking follows from what is left of the way, so that rounding
    never adds up; it stays within a sixteenth of the ramp.
    """
    speed = flow[NOW]
    left = flow[LEFT]
    end = leave
    mean = (speed + leave) >> 1
    if rest > int(times(mean, left)):
        most = int(times(ramp, left))
        change = most
        if rest < HIGHEST:
            change = int(times(speed - leave, int(share(int(times(mean, left)), rest))))
            most += most >> 4
            if change > most:
                change = most
        end = speed - change
        mean = speed - (change >> 1)
        distance = int(times(mean, left))
        if distance > rest:
            distance = rest
            left = int(share(rest, mean))
    else:
        distance = rest
        left = int(share(rest, mean)) if mean else 1
        if speed - leave > int(times(ramp + (ramp >> 4), left)) + 4:
            end = int(after(speed, ramp, rest, 1))
            if end < leave:
                end = leave
            left = int(share(rest, (speed + end) >> 1))
    return int(piece(flow, end, distance, left))


# inline: always, for it runs several times for each block and segment
@micropython.viper
def piece(flow: ptr32, end: int, distance: int, part: int) -> int:
    """Add a piece to the segment being made. part: its duration in 2**-17 of a full segment."""
    if part > flow[LEFT]:
        part = flow[LEFT]
    flow[LEFT] = flow[LEFT] - part
    flow[NOW] = end
    flow[ADVANCE] = flow[ADVANCE] + distance
    distance = flow[FRACTION] - distance
    if distance < 0:
        steps = (0 - distance + 0x3FFFF) >> 18
        distance += steps << 18
        flow[WHOLE] = flow[WHOLE] - steps
    flow[FRACTION] = distance
    return flow[WHOLE] or distance


@micropython.viper
def proceed(flow: ptr32, ring: ptr32, scale: int) -> int:
    """Choose the next piece of the segment. Returns 0 at the end of the block.

    speed        ________            A piece is one of: speed up, cruise, brake,
                /        `.          slow down to a lowered nominal speed or to a hold.
               /           `. leave  It brakes as soon as the way left is no longer
      entry __/              `.__    than what braking takes.
    """
    at = flow[AT]
    ramp = ring[at + RAMP]
    top = ring[at + CRUISE]
    speed = flow[NOW]
    unit = 18 if flow[WHOLE] < 4095 else 0
    rest = (flow[WHOLE] << 18) + flow[FRACTION] if unit else HIGHEST
    room = rest
    due = 0
    if flow[HOLD]:
        top = 0
    else:
        leave = int(look_ahead(flow, ring, scale))
        if leave > top:
            leave = top
        slack = rest if unit else flow[WHOLE]
        if speed != leave:
            fast = speed if speed > leave else leave
            slow = leave if speed > leave else speed
            if fast != flow[BRAKE_FROM] or slow != flow[BRAKE_TO] or unit != flow[BRAKE_UNIT]:
                flow[BRAKE_FROM] = fast
                flow[BRAKE_TO] = slow
                flow[BRAKE_UNIT] = unit
                flow[BRAKE_WAY] = int(braking(fast, slow, ramp, unit))
            way = flow[BRAKE_WAY]
            if speed < leave:
                slack += way if way < slack else slack
            else:
                slack -= way
                if slack <= (speed >> 8 if unit else 1):
                    due = 1
        if due == 0 and speed <= top:
            if unit == 0:
                slack = slack << 18 if slack < 2048 else HIGHEST
            if speed < top:
                slack = (slack + 1) >> 1
            if slack < rest:
                room = slack
    if due:
        return int(brake(flow, ramp, leave, rest))
    if speed != top:
        return int(approach(flow, ramp, top, room))
    part = flow[LEFT]
    distance = speed if part == 131072 else int(times(speed, part))
    if room <= distance:
        distance = room
        part = int(share(room, speed))
    return int(piece(flow, speed, distance, part))


@micropython.viper
def close(flow: ptr32, row: ptr32, ticks: int) -> int:
    """End the segment with a step of the longest axis: whole steps, and the time they take.

    What is left over, distance and time, goes into the next segment. So every
    interval of a segment is the same, and at a constant speed every interval
    of a block. Returns the steps.
    """
    distance = flow[PARTIAL] + flow[ADVANCE]
    ticks += flow[SPARE]
    steps = distance >> 18
    rest = distance & 0x3FFFF
    flow[PARTIAL] = rest
    flow[SPARE] = 0
    if rest > _HAIR and steps:
        part = int(share(steps << 18, distance))
        whole_ticks = (((ticks >> 15) * part) >> 2) + (((ticks & 32767) * (part >> 2)) >> 15)
        flow[SPARE] = ticks - whole_ticks
        ticks = whole_ticks
    row[ROW_TICKS] = ticks if ticks else 1
    return steps


@micropython.viper
def spread(flow: ptr32, ring: ptr32, row: ptr32, motors: int) -> int:
    """Lay the segment's steps out in time: per motor how many, when the first and the last.

    A motor's phase runs on from segment to segment, so that at a constant
    speed its steps are evenly spaced. The block's last segment makes what is
    left to make.
    """
    high = flow[ADVANCE] >> 15
    low = flow[ADVANCE] & 32767
    ticks = row[ROW_TICKS]
    ratios = flow[AT] + STEPS + motors
    last = flow[WHOLE] == 0 and flow[FRACTION] == 0
    long = 0
    while ticks >> long >= 1 << 18:
        long += 1
    for i in range(motors):
        ratio = ring[ratios + i]
        phase = flow[MOTORS + 2 * i + 1]
        middle = high * (ratio & 32767) + low * (ratio >> 15) + ((low * (ratio & 32767)) >> 15)
        gain = ((high * (ratio >> 15)) << 1) + (middle >> 14)
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
def power(flow: ptr32, ring: ptr32, table: ptr32) -> int:
    """Spindle power of the segment just made, of a block whose power follows speed."""
    at = flow[AT]
    full = ring[at + POWER]
    rate = ring[at + PROGRAMMED]
    if flow[NOW] < rate:
        full = int(times(full, int(share(flow[NOW], rate))))
    if full == 0:
        return 0
    if full <= table[POWER_FLOOR]:
        return 1
    full = ((full - table[POWER_FLOOR]) >> 6) + 1
    return full if full < table[POWER_MAX] else table[POWER_MAX]


@micropython.viper
def fill(flow: ptr32, ring: ptr32, table: ptr32, row: ptr32) -> int:
    """Make the next segment. Returns 0 where nothing is to move: no block, or held at rest."""
    motors = table[MOTOR_COUNT]
    if flow[LOADED] == 0:
        if flow[HOLD] and flow[CARRY] == 0:
            return 0
        if int(load(flow, ring, motors)) == 0:
            return 0
    elif flow[HOLD] and flow[NOW] == 0:
        return 0
    flow[LEFT] = 131072
    flow[ADVANCE] = 0
    span = 131072
    going = 1
    while going and not (flow[HOLD] and flow[NOW] == 0):
        if flow[LEFT] <= _SPLINTER:
            if flow[ADVANCE] + flow[PARTIAL] >= _LEAST or span == _LONGEST:
                break
            flow[LEFT] = flow[LEFT] + 131072
            span += 131072
        going = int(proceed(flow, ring, table[ROOT_SCALE]))
    steps = int(close(flow, row, (span - flow[LEFT]) >> (17 - table[SEGMENT_LOG2])))
    if steps == 0 and going and flow[HOLD] and flow[NOW] == 0:
        return 0  # at rest, less than a step further
    flow[ADVANCE] = steps << 18
    at = flow[AT]
    row[ROW_DIRS] = ring[at + DIRS]
    row[ROW_POWER] = ring[at + POWER]
    if ring[at + FLAGS] & DYNAMIC:
        row[ROW_POWER] = int(power(flow, ring, table))
    spread(flow, ring, row, motors)
    if going == 0:
        flow[CARRY] = int(ratio(flow[NOW], ring[at + FACTOR]))
        flow[LOADED] = 0
        if flow[SYSTEM]:
            flow[SYSTEM] = 2
        else:
            tail = flow[TAIL] + 1
            flow[TAIL] = tail if tail < flow[ROWS] else 0
    return 1
