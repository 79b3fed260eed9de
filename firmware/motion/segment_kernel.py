# mypy: disable-error-code=arg-type
"""The segments' kernel: integers only, from blocks to a few milliseconds of steps.

Viper, in the engine's interrupt. layout.py has all places; docs/motion.md derives the formulas.

A full segment lasts 2**SEGMENT_LOG2 ticks, about 10 ms. Units within a block, of its longest axis:

    speed     2**-18 step per full segment; 0 to 2**30 - 2**18, because a full segment has at most
              4095 steps (planner.configure)
    ramp      acceleration: the change of such a speed in a full segment
    time      2**-17 of a full segment, so a speed times a time is a distance >> 17
    distance  2**-18 step; one of 4095 steps or more does not fit: it is HIGHEST, and whole steps
              are counted instead (unit 0 for 18)

A segment is planned as up to four pieces, each with a constant acceleration. The flow holds:

    LOADED, BLOCK_AT   1: a block is loaded; index of its row in the ring
    END_SPEED          speed at the end of what is planned
    LEAVE_SPEED        at which to leave the block; LEAVE_SQR: as the planner has it, squared
    STEPS_LEFT         distance of the block not planned yet: steps; FRACTION_LEFT: 2**-18 of one
    TIME_TO_FILL       time that the segment lacks to a full one
    PIECE_AT           index in the flow of the next piece: its time, then its final speed;
                       the first one is at PIECES, the last one before MOTORS
    PIECE_DISTANCE     of the piece just planned
    PLANNED_DISTANCE   of all pieces that are not in a row yet; PLANNED_TIME: their time
    SLICES, ROW_SPEED  rows of the segment still to be made; speed at the end of the last row
    PARTIAL_STEP       distance since the last step of the longest axis; SPARE_TICKS: its time
    BRAKE_DISTANCE     from speed BRAKE_FROM to BRAKE_TO, in 2**-BRAKE_UNIT step: computed last
    JOIN_SPEED         a real: speed in mm/s from one block to the next
    MOTORS + 2 * i     of motor i: steps still to go in the block; then its phase, 2**-18 step
    TAIL, HEAD         numbers of the row of the block executed, and of that after the newest block
    HOLD, SYSTEM       1: stop; 1: execute the system's own block, 2: it has been executed

In a block RAMP, CRUISE and FACTOR are its acceleration, its nominal speed, and its units of speed
per mm/s, a real (minifloat.py); EVENTS is the steps of its longest axis.

    speed        ________            A piece is one of: speed up, cruise, brake,
                /        `.          slow down to a lowered nominal speed or to a hold.
               /           `. leave  It brakes as soon as the distance left is no longer
      entry __/              `.__    than the braking distance.
"""

import micropython
from micropython import const

from motion.layout import (
    BLOCK_AT,
    BRAKE_DISTANCE,
    BRAKE_FROM,
    BRAKE_TO,
    BRAKE_UNIT,
    CRUISE,
    DIRS,
    DYNAMIC,
    END_SPEED,
    ENTRY_SQR,
    EVENTS,
    FACTOR,
    FLAGS,
    FRACTION_LEFT,
    HEAD,
    HOLD,
    JOIN_SPEED,
    LEAVE_SPEED,
    LEAVE_SQR,
    LOADED,
    MOTOR_COUNT,
    MOTORS,
    PARTIAL_STEP,
    PIECE_AT,
    PIECE_DISTANCE,
    PIECES,
    PLANNED_DISTANCE,
    PLANNED_TIME,
    POWER,
    RAMP,
    ROOT_SCALE,
    ROW_DIRS,
    ROW_POWER,
    ROW_SIZE,
    ROW_SPEED,
    ROWS,
    SEGMENT_LOG2,
    SLICES,
    SPARE_TICKS,
    STEPS,
    STEPS_LEFT,
    SYSTEM,
    TAIL,
    TIME_TO_FILL,
)
from motion.minifloat import BIAS, HIGHEST, ONE, product, ratio, square_root
from motion.ramps import FULL_TIME, after, braking, share, times
from motion.slice_kernel import STEP_BIAS, next_row, place_steps, scaled_power, slices, speed_share

_MOST_FINE_STEPS = const(4095)  # from so many on, distances are counted in whole steps: unit 0
_LEAST_DISTANCE = const(0x50000)  # a segment has at least 1.25 steps, if its block has them
_LONGEST = const(0x8000000)  # 1024 full segments: a slow segment is prolonged up to that
_HALF_STEP = const(0x20000)  # in 2**-18 step
_STEP_FRACTION = const(0x3FFFF)  # a step is 1 << 18
_LEAST_TIME = const(64)  # a piece is not shorter: the segment ends there


@micropython.viper
def load(flow: ptr32, ring: ptr32, motors: int) -> int:
    """Begin the block at TAIL, or the system's own: copy its numbers to the flow. Returns 0 if
    there is none, else 1. motors: their number."""
    at = flow[ROWS] if flow[SYSTEM] else flow[TAIL]  # the system's block follows the others
    if flow[SYSTEM] == 2 or at == flow[HEAD]:  # it has been executed; or there is no other
        return 0
    at *= flow[ROW_SIZE]
    flow[BLOCK_AT] = at
    speed = int(product(flow[JOIN_SPEED], ring[at + FACTOR], ONE))  # from mm/s
    cruise = ring[at + CRUISE]
    if speed < cruise and speed + (cruise >> 9) >= cruise:
        speed = cruise  # within 1/512: only rounding between the units of two blocks
    flow[END_SPEED] = speed
    flow[LEAVE_SPEED] = 0  # of LEAVE_SQR 0: see look_ahead()
    flow[LEAVE_SQR] = 0
    flow[STEPS_LEFT] = ring[at + EVENTS]
    flow[FRACTION_LEFT] = 0
    flow[PARTIAL_STEP] = STEP_BIAS  # so that rounding never loses the last step of a hold
    flow[BRAKE_FROM] = 0  # no BRAKE_DISTANCE is known
    flow[SPARE_TICKS] = 0
    for i in range(motors):
        flow[MOTORS + 2 * i] = ring[at + STEPS + i]
        flow[MOTORS + 2 * i + 1] = _HALF_STEP  # so that a motor steps nearest to the line
    flow[LOADED] = 1
    return 1


@micropython.viper
def look_ahead(flow: ptr32, ring: ptr32, scale: int) -> int:
    """Return the speed at which to leave the loaded block: the next one's entry speed, or 0.

    scale: ROOT_SCALE, a real. The planner may raise ENTRY_SQR at any time, so it is read anew for
    each piece; the root is only computed when it has changed.
    """
    sqr = 0
    following = flow[TAIL] + 1
    if following == flow[ROWS]:
        following = 0
    if flow[SYSTEM] == 0 and following != flow[HEAD]:
        sqr = ring[following * flow[ROW_SIZE] + ENTRY_SQR]
    if sqr != flow[LEAVE_SQR]:
        flow[LEAVE_SQR] = sqr
        # The root as a real: sqr becomes large enough for a root of 15 bits, a mantissa.
        exponent = BIAS
        while sqr and sqr < 1 << 28:
            sqr <<= 2
            exponent -= 1
        mantissa = int(square_root(sqr))
        root = (exponent << 15) + mantissa if mantissa else 0
        flow[LEAVE_SPEED] = int(product(root, scale, ring[flow[BLOCK_AT] + FACTOR]))
    return flow[LEAVE_SPEED]


@micropython.viper
def change_speed(flow: ptr32, ramp: int, goal: int, room: int) -> int:
    """Plan a piece that changes the speed by ramp towards goal, over a distance of at most room.

    ramp: acceleration; goal: a speed; room: a distance. The piece ends with the goal, the segment
    (TIME_TO_FILL) or the room, whichever comes first:

        time to the goal = |goal - speed| / ramp        distance = (speed + end) / 2 * time

    Leaves the speed at its end in END_SPEED, its distance in PIECE_DISTANCE. Returns its time.
    """
    speed = flow[END_SPEED]
    down = 1 if goal < speed else 0  # 1: it slows down
    time = int(share(speed - goal if down else goal - speed, ramp))
    end = goal
    if time >= flow[TIME_TO_FILL]:
        time = flow[TIME_TO_FILL]
        end = speed - int(times(ramp, time)) if down else speed + int(times(ramp, time))
    distance = int(times((speed + end) >> 1, time))
    if distance >= room:  # the room ends first
        distance = room
        end = int(after(speed, ramp, room, down))
        time = -1  # its time is computed below
    if end < goal if down else end > goal:
        end = goal  # rounding has passed it
    if time < 0:
        time = int(share(room, (speed + end) >> 1))
    flow[END_SPEED] = end
    flow[PIECE_DISTANCE] = distance
    return time


@micropython.viper
def brake(flow: ptr32, ramp: int, leave: int, rest: int) -> int:
    """Plan a piece that brakes, to leave the block at the speed `leave` after the distance rest.

    The deceleration is computed anew from the distance that is left, so rounding never adds up; it
    exceeds ramp by a sixteenth at most. From v to u over s it is (v**2 - u**2) / 2s. With
    (v + u) / 2 * time = the distance at mean speed, the change of speed in this piece is

        (v - u) * distance at mean speed / s      where s fits 2**-18 step
        ramp * time * braking distance / s        both in whole steps, where s is HIGHEST

    rest: s, the distance left of the block, or HIGHEST. ramp: the block's acceleration. Leaves the
    speed at its end in END_SPEED, its distance in PIECE_DISTANCE. Returns its time.
    """
    speed = flow[END_SPEED]
    time = flow[TIME_TO_FILL]
    end = leave
    mean = (speed + leave) >> 1
    at_mean = int(times(mean, time))  # distance at mean speed
    if rest > at_mean:  # the segment ends before the block
        most_change = int(times(ramp, time))
        if rest < HIGHEST:  # it fits 2**-18 step
            change = int(times(speed - leave, int(share(at_mean, rest))))
        else:  # share() is at most 1: where more is needed, the excess is added
            change = int(times(most_change, int(share(flow[BRAKE_DISTANCE], flow[STEPS_LEFT]))))
            if flow[BRAKE_DISTANCE] > flow[STEPS_LEFT]:
                excess = flow[BRAKE_DISTANCE] - flow[STEPS_LEFT]
                change += int(times(most_change, int(share(excess, flow[STEPS_LEFT]))))
        most_change += most_change >> 4  # a sixteenth more
        if change > most_change:
            change = most_change
        end = speed - change
        mean = speed - (change >> 1)
        distance = int(times(mean, time))
        if distance > rest:
            distance = rest
            time = int(share(rest, mean))
    else:  # the block ends first, and with it the piece
        distance = rest
        time = int(share(rest, mean)) if mean else 1
        most_change = int(times(ramp + (ramp >> 4), time)) + 4  # a sixteenth more; 4: rounding
        if speed - leave > most_change:  # brake as ramp allows, leave faster
            end = int(after(speed, ramp, rest, 1))
            if end < leave:
                end = leave
            time = int(share(rest, (speed + end) >> 1))
    flow[END_SPEED] = end
    flow[PIECE_DISTANCE] = distance
    return time


@micropython.viper
def add_piece(flow: ptr32, time: int) -> int:
    """Add a piece of this time to the segment: flow[END_SPEED] is the speed at its end, and
    flow[PIECE_DISTANCE] its distance.

    The distance is subtracted from that left of the block. Returns 0 if nothing is left, else
    another number.
    """
    if time > flow[TIME_TO_FILL]:
        time = flow[TIME_TO_FILL]
    flow[TIME_TO_FILL] = flow[TIME_TO_FILL] - time
    at = flow[PIECE_AT]  # index in the flow: a piece's time, and then its final speed
    if at == MOTORS:
        at -= 2  # there is no place for another one: it is merged with the last piece
    else:
        flow[at] = 0  # its time
        flow[PIECE_AT] = at + 2
    flow[at] = flow[at] + time
    flow[at + 1] = flow[END_SPEED]
    flow[PLANNED_DISTANCE] = flow[PLANNED_DISTANCE] + flow[PIECE_DISTANCE]
    distance = flow[FRACTION_LEFT] - flow[PIECE_DISTANCE]
    if distance < 0:
        steps = (0 - distance + _STEP_FRACTION) >> 18  # whole steps, rounded up
        distance += steps << 18
        flow[STEPS_LEFT] = flow[STEPS_LEFT] - steps
    flow[FRACTION_LEFT] = distance
    return flow[STEPS_LEFT] or distance  # 0: the block has no distance left


@micropython.viper
def next_piece(flow: ptr32, ring: ptr32, scale: int) -> int:
    """Choose and plan the segment's next piece. Returns 0 at the block's end. scale: ROOT_SCALE.

    slack = distance left - braking distance. Cruising uses up as much of it as the piece is long,
    speeding up twice that, because the braking distance grows as fast. So room, how long the piece
    may be, is the slack or half of it. With unit 0 braking is 2**-12 early, for braking()'s error.
    """
    at = flow[BLOCK_AT]
    ramp = ring[at + RAMP]
    top = ring[at + CRUISE]  # the speed to reach: the nominal one, 0 in a hold
    speed = flow[END_SPEED]
    # slack and braking distances are in 2**-unit step: 18, or 0 for whole steps if many are left.
    unit = 18 if flow[STEPS_LEFT] < _MOST_FINE_STEPS else 0
    rest = (flow[STEPS_LEFT] << 18) + flow[FRACTION_LEFT] if unit else HIGHEST  # of the block
    room = rest  # the longest distance of the piece
    must_brake = 0
    leave = int(look_ahead(flow, ring, scale))
    if leave > top:
        leave = top
    if flow[HOLD]:
        top = 0
    if top or leave == 0:  # a hold, too, ends at the block's end, if the block stops there
        slack = rest if unit else flow[STEPS_LEFT]
        if speed != leave:
            fast = speed if speed > leave else leave
            slow = leave if speed > leave else speed
            if fast != flow[BRAKE_FROM] or slow != flow[BRAKE_TO] or unit != flow[BRAKE_UNIT]:
                flow[BRAKE_FROM] = fast
                flow[BRAKE_TO] = slow
                flow[BRAKE_UNIT] = unit
                flow[BRAKE_DISTANCE] = int(braking(fast, slow, ramp, unit))
            ramp_distance = flow[BRAKE_DISTANCE]  # between both speeds; computed if they are new
            if speed < leave:  # it speeds up: more slack; twice is enough, because it is halved
                slack += ramp_distance if ramp_distance < slack else slack
            else:
                slack -= ramp_distance
                # Too little to be worth a piece: 1/256 segment, or braking()'s error.
                least = speed >> 8 if unit else (ramp_distance >> 12) + 1
                if slack <= least:
                    must_brake = 1
        if must_brake == 0 and speed <= top:
            if unit == 0:  # whole steps to a distance
                slack = slack << 18 if slack < 4096 else HIGHEST
            if speed < top:  # it speeds up, which uses up twice its distance
                slack = (slack + 1) >> 1
            if slack < rest:
                room = slack
    time = flow[TIME_TO_FILL]
    if must_brake:
        time = int(brake(flow, ramp, leave, rest))
    elif speed != top:
        time = int(change_speed(flow, ramp, top, room))
    else:  # cruise
        flow[PIECE_DISTANCE] = speed if time == FULL_TIME else int(times(speed, time))
        if room <= flow[PIECE_DISTANCE]:
            flow[PIECE_DISTANCE] = room
            time = int(share(room, speed))
    return int(add_piece(flow, time))


@micropython.viper
def is_due(flow: ptr32, ring: ptr32, motors: int) -> int:
    """Return 1 if a segment can be planned, else 0: no hold has stopped motion, and a block is
    loaded, or can be loaded here. motors: their number."""
    if flow[LOADED]:
        return 0 if flow[HOLD] and flow[END_SPEED] == 0 else 1
    if flow[HOLD] and flow[JOIN_SPEED] == 0:
        return 0
    return int(load(flow, ring, motors))


@micropython.viper
def plan_segment(flow: ptr32, ring: ptr32, table: ptr32) -> int:
    """Plan the next segment as pieces, and its number of rows (SLICES). Returns 1, or 0 if nothing
    is to move.

    Pieces are added until the segment is full. If it is shorter than _LEAST_DISTANCE then, its
    time is prolonged by further full segments, because a row needs a step. A hold ends it when the
    speed is 0.
    """
    if int(is_due(flow, ring, table[MOTOR_COUNT])) == 0:
        return 0
    flow[ROW_SPEED] = flow[END_SPEED]  # the segment's first speed
    flow[PIECE_AT] = PIECES
    flow[TIME_TO_FILL] = FULL_TIME
    flow[PLANNED_DISTANCE] = 0
    span = FULL_TIME  # longest time of the segment
    more = 1  # the block has distance left
    while more and not (flow[HOLD] and flow[END_SPEED] == 0):
        if flow[TIME_TO_FILL] <= _LEAST_TIME:
            if flow[PLANNED_DISTANCE] + flow[PARTIAL_STEP] >= _LEAST_DISTANCE or span == _LONGEST:
                break
            flow[TIME_TO_FILL] = flow[TIME_TO_FILL] + FULL_TIME
            span += FULL_TIME
        more = int(next_piece(flow, ring, table[ROOT_SCALE]))
    flow[PLANNED_TIME] = span - flow[TIME_TO_FILL]
    flow[SLICES] = int(slices(flow, table, ring[flow[BLOCK_AT] + FLAGS] & DYNAMIC))
    flow[PIECE_AT] = PIECES  # from now on the first piece that is not in a row yet
    return 1


@micropython.viper
def fill(flow: ptr32, ring: ptr32, table: ptr32, row: ptr32) -> int:
    """Make the next row for the pulse engine, and plan a segment first if all rows of the last one
    are made. Returns 1, or 0 if nothing is to move. At the end of a block TAIL is advanced."""
    if flow[SLICES] == 0:
        if int(plan_segment(flow, ring, table)) == 0:
            return 0
    steps = int(next_row(flow, row, table[SEGMENT_LOG2]))
    # 0: the block ends with this row.
    more = flow[SLICES] or flow[STEPS_LEFT] or flow[FRACTION_LEFT]
    if steps == 0 and more and flow[HOLD] and flow[END_SPEED] == 0:
        return 0  # held: stopped between two steps
    at = flow[BLOCK_AT]
    row[ROW_DIRS] = ring[at + DIRS]
    row[ROW_POWER] = ring[at + POWER]
    if ring[at + FLAGS] & DYNAMIC:  # power follows speed
        row[ROW_POWER] = int(scaled_power(table, row[ROW_POWER], int(speed_share(flow, ring))))
    place_steps(flow, ring, row, table[MOTOR_COUNT], steps)
    if more == 0:
        flow[JOIN_SPEED] = int(ratio(flow[END_SPEED], ring[at + FACTOR]))  # a real, mm/s
        flow[LOADED] = 0
        if flow[SYSTEM]:
            flow[SYSTEM] = 2  # executed
        else:
            tail = flow[TAIL] + 1
            flow[TAIL] = tail if tail < flow[ROWS] else 0
    return 1
