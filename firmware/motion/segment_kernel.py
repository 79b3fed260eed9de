# mypy: disable-error-code=arg-type
"""The segments' kernel: integers only, from blocks to a few milliseconds of steps.

Viper, as plan_kernel.py is; all of it runs in the engine's interrupt. layout.py has the places in
flow, ring and table; docs/motion.md derives the formulas.

A full segment lasts 2**SEGMENT_LOG2 ticks, about 10 ms. Units within a block, of its longest axis:

    speed     2**-18 step per full segment; 0 to 2**30 - 2**18, because a full segment has at most
              4095 steps (planner.configure)
    ramp      acceleration: the change of such a speed in a full segment
    time      2**-17 of a full segment, so a speed times a time is a distance >> 17
    distance  2**-18 step; one of 4095 steps or more does not fit: it is HIGHEST, and whole steps
              are counted instead (unit 0 for 18)

A segment is planned as up to four pieces, each with a constant acceleration. The flow holds:

    AT                index in the ring of the loaded block's row; LOADED is 1 if there is one
    NOW               speed at the end of what is planned; LEAVE: at which to leave the block
    WHOLE, FRACTION   distance left of the block: whole steps, and 2**-18 of one
    LEFT              time that the segment lacks to a full one
    PIECE             index in the flow of the next piece: its time, then its final speed
    WAY, ADVANCE      distance of the piece just planned; of all that are not in a row yet
    SLICES, REACHED   rows of the segment still to be made; speed at the end of the last row
    CARRY             a real: speed in mm/s from one block to the next
    TAIL, HEAD        numbers of the row of the block executed, and of that after the newest block
    HOLD, SYSTEM      stop; execute the system's own block (1), which is done (2)

In a block RAMP, CRUISE and FACTOR are its acceleration, its nominal speed, and its units of speed
per mm/s, a real.
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
    PIECE,
    PIECES,
    POWER,
    RAMP,
    REACHED,
    ROOT_SCALE,
    ROW_DIRS,
    ROW_POWER,
    ROW_SIZE,
    ROWS,
    SEGMENT_LOG2,
    SLICES,
    SPARE,
    STEPS,
    SYSTEM,
    TAIL,
    TIME,
    WAY,
    WHOLE,
)
from motion.minifloat import BIAS, HIGHEST, ONE, product, ratio, square_root
from motion.ramps import FULL_TIME, after, braking, share, times
from motion.slice_kernel import STEP_BIAS, next_row, place_steps, scaled_power, slices, speed_share

_COUNTED = const(4095)  # from so many steps on, distances are counted in whole steps
_LEAST = const(0x50000)  # a segment covers at least 1.25 steps, if the block has them,
_LONGEST = const(0x8000000)  # or lasts 1024 full ones: at low speed it is prolonged
_HALF_STEP = const(0x20000)
_STEP_FRACTION = const(0x3FFFF)  # a step is 1 << 18
_SPLINTER = const(64)  # time: less is not worth a piece, the segment ends there


@micropython.viper
def load(flow: ptr32, ring: ptr32, motors: int) -> int:
    """Begin the block at TAIL, or the system's own: copy its numbers to the flow. Returns 0 if
    there is none, else 1. motors: their number."""
    at = flow[ROWS] if flow[SYSTEM] else flow[TAIL]  # the system's block follows the others
    if flow[SYSTEM] == 2 or at == flow[HEAD]:  # 2: it has been executed
        return 0
    at *= flow[ROW_SIZE]
    flow[AT] = at
    speed = int(product(flow[CARRY], ring[at + FACTOR], ONE))  # from mm/s
    cruise = ring[at + CRUISE]
    if speed < cruise and speed + (cruise >> 9) >= cruise:
        speed = cruise  # within 1/512: only rounding between the units of two blocks
    flow[NOW] = speed
    flow[LEAVE] = 0
    flow[LEAVE_SQR] = 0
    flow[WHOLE] = ring[at + EVENTS]
    flow[FRACTION] = 0
    flow[PARTIAL] = STEP_BIAS  # so that rounding never loses the last step of a hold
    flow[BRAKE_FROM] = 0
    flow[SPARE] = 0
    for i in range(motors):
        flow[MOTORS + 2 * i] = ring[at + STEPS + i]
        flow[MOTORS + 2 * i + 1] = _HALF_STEP  # a motor steps nearest to the line
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
        root = int(square_root(sqr))
        root = (exponent << 15) + root if root else 0
        flow[LEAVE] = int(product(root, scale, ring[flow[AT] + FACTOR]))
    return flow[LEAVE]


@micropython.viper
def change_speed(flow: ptr32, ramp: int, goal: int, room: int) -> int:
    """Plan a piece that changes the speed by ramp towards goal, over a distance of at most room.

    ramp: acceleration; goal: a speed; room: a distance. The piece ends with the goal, the segment
    (LEFT) or the room, whichever comes first:

        time to the goal = |goal - speed| / ramp        distance = (speed + end) / 2 * time

    Leaves the speed at its end in NOW, its distance in WAY. Returns its time.
    """
    speed = flow[NOW]
    down = 1 if goal < speed else 0  # 1: it slows down
    time = int(share(speed - goal if down else goal - speed, ramp))
    end = goal
    if time >= flow[LEFT]:
        time = flow[LEFT]
        end = speed - int(times(ramp, time)) if down else speed + int(times(ramp, time))
    distance = int(times((speed + end) >> 1, time))
    if distance >= room:
        distance = room
        end = int(after(speed, ramp, room, down))
        time = -1  # its time is computed below
    if end < goal if down else end > goal:
        end = goal  # rounding has passed it
    if time < 0:
        time = int(share(room, (speed + end) >> 1))
    flow[NOW] = end
    flow[WAY] = distance
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
    speed at its end in NOW, its distance in WAY. Returns its time.
    """
    speed = flow[NOW]
    time = flow[LEFT]
    end = leave
    mean = (speed + leave) >> 1
    if rest > int(times(mean, time)):
        most_change = int(times(ramp, time))
        if rest < HIGHEST:
            change = int(times(speed - leave, int(share(int(times(mean, time)), rest))))
        else:
            # share() is at most 1: where more is needed, the excess is added.
            change = int(times(most_change, int(share(flow[BRAKE_WAY], flow[WHOLE]))))
            if flow[BRAKE_WAY] > flow[WHOLE]:
                late = flow[BRAKE_WAY] - flow[WHOLE]
                change += int(times(most_change, int(share(late, flow[WHOLE]))))
        most_change += most_change >> 4  # a sixteenth more
        if change > most_change:
            change = most_change
        end = speed - change
        mean = speed - (change >> 1)
        distance = int(times(mean, time))
        if distance > rest:
            distance = rest
            time = int(share(rest, mean))
    else:
        distance = rest
        time = int(share(rest, mean)) if mean else 1
        # More than a sixteenth above ramp, rounding apart: brake as ramp allows, and leave faster.
        if speed - leave > int(times(ramp + (ramp >> 4), time)) + 4:
            end = int(after(speed, ramp, rest, 1))
            if end < leave:
                end = leave
            time = int(share(rest, (speed + end) >> 1))
    flow[NOW] = end
    flow[WAY] = distance
    return time


@micropython.viper
def add_piece(flow: ptr32, part: int) -> int:
    """Add a piece to the segment: part is its time, flow[NOW] the speed at its end, flow[WAY] its
    distance.

    The distance is subtracted from that left of the block. Returns 0 if nothing is left, else
    another number.
    """
    if part > flow[LEFT]:
        part = flow[LEFT]
    flow[LEFT] = flow[LEFT] - part
    at = flow[PIECE]  # index in the flow: a piece's time, and then its final speed
    if at == MOTORS:
        at -= 2  # the pieces' places end there: it is merged with the last piece
    else:
        flow[at] = 0
        flow[PIECE] = at + 2
    flow[at] = flow[at] + part
    flow[at + 1] = flow[NOW]
    flow[ADVANCE] = flow[ADVANCE] + flow[WAY]
    distance = flow[FRACTION] - flow[WAY]
    if distance < 0:
        steps = (0 - distance + _STEP_FRACTION) >> 18  # whole steps, rounded up
        distance += steps << 18
        flow[WHOLE] = flow[WHOLE] - steps
    flow[FRACTION] = distance
    return flow[WHOLE] or distance


@micropython.viper
def next_piece(flow: ptr32, ring: ptr32, scale: int) -> int:
    """Choose and plan the segment's next piece. Returns 0 at the block's end. scale: ROOT_SCALE.

    speed        ________            A piece is one of: speed up, cruise, brake,
                /        `.          slow down to a lowered nominal speed or to a hold.
               /           `. leave  It brakes as soon as the distance left is no longer
      entry __/              `.__    than the braking distance.

    slack = distance left - braking distance. Cruising uses up as much of it as the piece is long,
    speeding up twice that, because the braking distance grows as fast. So room, how long the piece
    may be, is the slack or half of it. With unit 0 braking is 2**-12 early, for braking()'s error.
    """
    at = flow[AT]
    ramp = ring[at + RAMP]
    top = ring[at + CRUISE]
    speed = flow[NOW]
    unit = 18 if flow[WHOLE] < _COUNTED else 0  # slack is in 2**-unit step
    rest = (flow[WHOLE] << 18) + flow[FRACTION] if unit else HIGHEST  # distance left of the block
    room = rest
    due = 0  # 1: braking has to begin
    leave = int(look_ahead(flow, ring, scale))
    if leave > top:
        leave = top
    if flow[HOLD]:
        top = 0
    if top or leave == 0:  # a hold, too, ends at the block's end, if the block stops there
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
            if speed < leave:  # it need not brake: way is the distance to speed up to leave
                slack += way if way < slack else slack
            else:
                slack -= way
                if slack <= (speed >> 8 if unit else (way >> 12) + 1):  # 1/256 segment
                    due = 1
        if due == 0 and speed <= top:
            if unit == 0:
                slack = slack << 18 if slack < 4096 else HIGHEST
            if speed < top:
                slack = (slack + 1) >> 1
            if slack < rest:
                room = slack
    time = flow[LEFT]
    if due:
        time = int(brake(flow, ramp, leave, rest))
    elif speed != top:
        time = int(change_speed(flow, ramp, top, room))
    else:
        flow[WAY] = speed if time == FULL_TIME else int(times(speed, time))
        if room <= flow[WAY]:
            flow[WAY] = room
            time = int(share(room, speed))
    return int(add_piece(flow, time))


@micropython.viper
def is_due(flow: ptr32, ring: ptr32, motors: int) -> int:
    """Return 1 if a segment can be planned, else 0. It needs a block, which is loaded here if none
    is, and that no hold has stopped motion. motors: their number."""
    if flow[LOADED]:
        return 0 if flow[HOLD] and flow[NOW] == 0 else 1
    if flow[HOLD] and flow[CARRY] == 0:
        return 0
    return int(load(flow, ring, motors))


@micropython.viper
def plan(flow: ptr32, ring: ptr32, table: ptr32) -> int:
    """Plan the next segment as pieces, and its number of rows (SLICES). Returns 1, or 0 if nothing
    is to move.

    Pieces are added until the segment is full. If it is shorter than _LEAST then, its time is
    prolonged by further full segments, because a row needs a step. A hold ends it when the speed
    is 0.
    """
    if int(is_due(flow, ring, table[MOTOR_COUNT])) == 0:
        return 0
    flow[REACHED] = flow[NOW]  # the segment's first speed
    flow[PIECE] = PIECES
    flow[LEFT] = FULL_TIME
    flow[ADVANCE] = 0
    span = FULL_TIME  # longest time of the segment
    more = 1  # the block has distance left
    while more and not (flow[HOLD] and flow[NOW] == 0):
        if flow[LEFT] <= _SPLINTER:
            if flow[ADVANCE] + flow[PARTIAL] >= _LEAST or span == _LONGEST:
                break
            flow[LEFT] = flow[LEFT] + FULL_TIME
            span += FULL_TIME
        more = int(next_piece(flow, ring, table[ROOT_SCALE]))
    flow[TIME] = span - flow[LEFT]
    flow[SLICES] = int(slices(flow, table, ring[flow[AT] + FLAGS] & DYNAMIC))
    flow[PIECE] = PIECES  # from now on the first piece that is not in a row yet
    return 1


@micropython.viper
def fill(flow: ptr32, ring: ptr32, table: ptr32, row: ptr32) -> int:
    """Make the next row for the pulse engine, and plan a segment first if all rows of the last one
    are made. Returns 1, or 0 if nothing is to move. At the end of a block TAIL is advanced."""
    if flow[SLICES] == 0:
        if int(plan(flow, ring, table)) == 0:
            return 0
    steps = int(next_row(flow, row, table[SEGMENT_LOG2]))
    more = flow[SLICES] or flow[WHOLE] or flow[FRACTION]  # 0: the block ends with this row
    if steps == 0 and more and flow[HOLD] and flow[NOW] == 0:
        return 0  # held: stopped between two steps
    at = flow[AT]
    row[ROW_DIRS] = ring[at + DIRS]
    row[ROW_POWER] = ring[at + POWER]
    if ring[at + FLAGS] & DYNAMIC:
        row[ROW_POWER] = int(scaled_power(table, row[ROW_POWER], int(speed_share(flow, ring))))
    place_steps(flow, ring, row, table[MOTOR_COUNT], steps)
    if more == 0:
        flow[CARRY] = int(ratio(flow[NOW], ring[at + FACTOR]))  # a real, mm/s
        flow[LOADED] = 0
        if flow[SYSTEM]:
            flow[SYSTEM] = 2
        else:
            tail = flow[TAIL] + 1
            flow[TAIL] = tail if tail < flow[ROWS] else 0
    return 1
