# mypy: disable-error-code=arg-type
r"""The jerk limit's kernel: it averages the planned speed over a time, integers only.

    planned   ____/    \____     The average is over FILTER_TAPS slots; a slot lasts as long as a
                                 full segment. The plan reaches its acceleration at once, the
    executed  ___.-    -.___     average within that time. The path is the same. No average is
                                 above its highest value: speed and acceleration keep their limits.

The plan is made by segment_kernel.py on a flow of its own, the line, and runs ahead. Its distance
in a slot becomes a tap of the line. The average of the taps is laid out along the same blocks once
more, for slice_kernel.py. Units in the line:

    distance  2**-16 mm along the path; 0 to 2**30 - 1, which is 16384 mm, the longest block
    speed     the sum of the taps, so FILTER_TAPS times the distance per slot; 0 to 2**29, because
              Jerk.limit() chooses FILTER_TAPS so: two of them still fit 31 bits
    time      2**-17 slot, 0 to 2**17

Distances are whole numbers and remainders are carried on, so no distance is lost or added. In the
flow, units are those of segment_kernel.py: 2**-18 step, and 2**-18 step per slot.

Viper, as segment_kernel.py is; all of it runs in the engine's interrupt. jerk_layout.py and
motion/layout.py have the places. In the line, they hold:

    FILTER_TAPS, PER_TAP        slots over which speed is averaged; 1 / FILTER_TAPS, a real
    RELEASED                    row of the first block that the plan must not read yet
    SLOT_BEGUN, SLOT_DISTANCE   1: the plan has begun the next slot; its distance in it so far
    STAND_SLOTS                 slots for which the plan still stands
    TIME_TO_FILL                of the plan: time left of its slot
    PIECE_DISTANCE              of the plan: distance of its last piece
    OLDEST_TAP                  index of the oldest tap, from TAP_DISTANCES on
    TAP_SUM                     speed of the average at the end of the slot being laid out
    SUM_LAID_OUT                the same at the end of its part that is laid out already
    DISTANCE_TO_LAY             distance of that slot that is not laid out yet;
    TIME_TO_LAY                 its time
    PLAN_LEFT, EXECUTED_LEFT    distance left of the block: of the plan's, of the executed one

`plan` in the texts below is the motion before averaging.
"""

import micropython
from micropython import const
from motion.layout import (
    ACCEL,
    BLOCK_AT,
    DYNAMIC,
    END_SPEED,
    ENTRY_SQR,
    FACTOR,
    FLAGS,
    FRACTION_LEFT,
    HEAD,
    HOLD,
    JOIN_SPEED,
    JUNCTION_DERATE,
    JUNCTION_SQR,
    LENGTH,
    LOADED,
    MOTOR_COUNT,
    NOMINAL_SQR,
    PARTIAL_STEP,
    PIECE_AT,
    PIECE_DISTANCE,
    PIECES,
    PLANNED_DISTANCE,
    PLANNED_TIME,
    ROOT_SCALE,
    ROW_SIZE,
    ROW_SPEED,
    ROWS,
    SLICES,
    STEPS_LEFT,
    TAIL,
    TIME_TO_FILL,
)
from motion.minifloat import BIAS, HIGHEST, LIMIT, ONE, pack, product, ratio, square_root
from motion.ramps import share, times
from motion.segment_kernel import add_piece, is_due, load, next_piece
from motion.slice_kernel import slices

from extras.motors.jerk_layout import (
    DISTANCE_TO_LAY,
    EXECUTED_LEFT,
    FILTER_TAPS,
    OLDEST_TAP,
    PER_TAP,
    PLAN_FRACTION,
    PLAN_LEFT,
    RELEASED,
    REMAINDER,
    SLOT_BEGUN,
    SLOT_DISTANCE,
    STAND_SLOTS,
    SUM_LAID_OUT,
    TAP_DISTANCES,
    TAP_SUM,
    TIME_TO_LAY,
)

_LEAST_DISTANCE = const(0x50000)  # of a segment, 2**-18 step: 1.25 steps, if the block has them,
_MOST_SLOTS = const(32)  # or it lasts so many slots
_SLOT_TIME = const(131072)  # time of a slot
_TIME_BITS = const(17)  # a time of 1 << _TIME_BITS is a slot
_STEP_BITS = const(18)  # distances of a flow are in 2**-18 step
_COUNTED_STEPS = const(4095)  # so many and more do not fit 30 bits in that unit
_FRACTION_BITS = const(4)  # of PLAN_FRACTION
_SHORTEST_PIECE = const(64)  # time: less is not worth a piece of the plan, the slot ends there
_PER_MM = const(0x214000)  # the real 2**16
_SIXTEEN = const(0x1B4000)  # the real 16


@micropython.viper
def smooth(flow: ptr32, line: ptr32, ring: ptr32, table: ptr32) -> int:
    """Plan the next segment of the executed motion, and its number of rows (SLICES), as
    segment_kernel.plan_segment() does. Returns 1, or 0 if nothing is to move.

    The rest of a slot and further slots are added until the segment covers _LEAST_DISTANCE or
    lasts _MOST_SLOTS slots, so its time is below 2**23. It ends where the block does.
    """
    span = 0  # time of the segment so far
    has_begun = 0
    in_block = 1  # 0: the segment has reached the end of its block
    while in_block:
        if line[TIME_TO_LAY] == 0:  # the slot is laid out: end the segment, or begin another slot
            # PARTIAL_STEP: distance since the last step, which the segment's first step includes.
            if has_begun and (
                flow[PLANNED_DISTANCE] + flow[PARTIAL_STEP] >= _LEAST_DISTANCE
                or span >= _MOST_SLOTS << _TIME_BITS
            ):
                break
            if int(shift_filter(flow, line, ring, table)) == 0:
                break
        if has_begun == 0:
            if int(begin_segment(flow, line, ring, table[MOTOR_COUNT])) == 0:
                return 0
            has_begun = 1
        piece_time = int(place_slot(flow, line))
        span += piece_time
        in_block = int(add_piece(flow, piece_time))
    if has_begun == 0:
        return 0
    # slices() makes a single row of a time above a slot, because in segment_kernel.py that is a
    # slow segment of one step. Up to two slots may have more steps: they are cut as one slot.
    flow[PLANNED_TIME] = _SLOT_TIME if span > _SLOT_TIME and span < 2 * _SLOT_TIME else span
    flow[SLICES] = int(slices(flow, table, ring[flow[BLOCK_AT] + FLAGS] & DYNAMIC))
    flow[PLANNED_TIME] = span
    flow[PIECE_AT] = PIECES  # from now on the first piece that is not in a row yet
    return 1


@micropython.viper
def begin_segment(flow: ptr32, line: ptr32, ring: ptr32, motors: int) -> int:
    """Begin a segment; load the next block if none is loaded. Returns 1, or 0 if there is none.

    motors: number of motors. In a new block END_SPEED becomes the average speed in its units.
    """
    if flow[LOADED] == 0:
        if int(load(flow, ring, motors)) == 0:
            return 0
        line[EXECUTED_LEFT] = int(block_distance(ring, flow[BLOCK_AT]))
        # The block's length in two units, as reals: of the line and of the flow.
        in_line = int(pack(line[EXECUTED_LEFT], BIAS))
        in_steps = int(distance_left(flow))
        flow[END_SPEED] = int(part_of(line[SUM_LAID_OUT], in_line, in_steps, line[PER_TAP]))
    flow[ROW_SPEED] = flow[END_SPEED]
    flow[PIECE_AT] = PIECES  # no piece is planned yet
    flow[PLANNED_DISTANCE] = 0
    return 1


@micropython.viper
def block_distance(ring: ptr32, at: int) -> int:
    """Return a block's length in 2**-16 mm: 1 to 2**30 - 1 (16384 mm and more)."""
    return int(product(ring[at + LENGTH], _PER_MM, ONE)) or 1


@micropython.viper
def distance_left(flow: ptr32) -> int:
    """Return the distance left of the loaded block: a real, in 2**-18 step."""
    if flow[STEPS_LEFT] < _COUNTED_STEPS:
        return int(pack((flow[STEPS_LEFT] << _STEP_BITS) + flow[FRACTION_LEFT], BIAS))
    return int(pack(flow[STEPS_LEFT], BIAS + _STEP_BITS))


@micropython.viper
def part_of(part: int, whole: int, other: int, scale: int) -> int:
    """Return part / whole * other * scale, an integer from 0 to 2**30 - 1: it converts from mm to
    steps, or back.

    part: 0 to 2**30 - 1, of the distance whole, which is other in the other unit. whole, other,
    scale: reals; whole is not 0.
    """
    return int(product(int(ratio(part, whole)), other, scale))


@micropython.viper
def place_slot(flow: ptr32, line: ptr32) -> int:
    """Lay out the distance of the slot that is left, or the part up to the end of the block.

    Leaves the speed at its end in END_SPEED, its distance in PIECE_DISTANCE. Returns its time.
    With the speeds v at the beginning, w at the end of the block and u at the end of the slot, a
    part f of the distance (EXECUTED_LEFT / DISTANCE_TO_LAY) takes this part of the slot's time:

        f (v + u) / (v + w)     because distance = mean speed * time
    """
    block_left = line[EXECUTED_LEFT]
    way = line[DISTANCE_TO_LAY]  # to lay out now, in 2**-16 mm
    time = line[TIME_TO_LAY]
    # What is left of the block in two units, as reals: of the line and of the flow.
    in_line = int(pack(block_left or 1, BIAS))  # part_of() divides by it
    in_steps = int(distance_left(flow))
    block_steps = HIGHEST  # what is left of the block in 2**-18 step
    if flow[STEPS_LEFT] < _COUNTED_STEPS:
        block_steps = (flow[STEPS_LEFT] << _STEP_BITS) + flow[FRACTION_LEFT]
    steps = block_steps  # `way` in 2**-18 step
    end_speed = line[TAP_SUM]  # at the end of `way`: u, or w below
    if way > block_left:  # the block ends within the slot
        part = int(share(block_left, way))  # f, in 2**-17
        time_part = part  # f (v + u) / (v + w), or f if v + w is 0
        start_speed = line[SUM_LAID_OUT]  # v
        speeds = start_speed + end_speed  # v + u
        end_speed = int(speed_between(start_speed, end_speed, part))  # w
        if start_speed + end_speed:
            time_part = int(share(int(times(speeds, part)), start_speed + end_speed))
        time = int(times(time, time_part))
        way = block_left
    elif way < block_left:
        steps = int(part_of(way, in_line, in_steps, ONE))
        if steps >= block_steps:  # rounding must not end the block here
            steps = block_steps - 1
    flow[END_SPEED] = int(part_of(end_speed, in_line, in_steps, line[PER_TAP]))
    flow[PIECE_DISTANCE] = steps
    flow[TIME_TO_FILL] = time
    line[SUM_LAID_OUT] = end_speed
    line[EXECUTED_LEFT] = block_left - way
    line[DISTANCE_TO_LAY] = line[DISTANCE_TO_LAY] - way
    line[TIME_TO_LAY] = line[TIME_TO_LAY] - time
    return time


@micropython.viper
def speed_between(start: int, end: int, part: int) -> int:
    """Return the speed after a part (2**-17) of the distance in which start becomes end.

    v**2 = start**2 + (end**2 - start**2) * part, at constant acceleration. Speeds: 0 to 2**29;
    both lose bits until they have 15, so that their squares fit 30.
    """
    if start == end:
        return start
    shift = 0
    while start >= LIMIT or end >= LIMIT:
        start >>= 1
        end >>= 1
        shift += 1
    if end < start:
        sqr = start * start - int(times(start * start - end * end, part))
    else:
        sqr = start * start + int(times(end * end - start * start, part))
    return int(square_root(sqr)) << shift


@micropython.viper
def shift_filter(flow: ptr32, line: ptr32, ring: ptr32, table: ptr32) -> int:
    """Plan a slot to its end, put its distance into the line as a tap, and compute the next slot
    of the average: DISTANCE_TO_LAY, TIME_TO_LAY, SUM_LAID_OUT. Returns 1, or 0 if nothing is
    planned and the line is empty.

    TAP_SUM += the new tap - the oldest one. The distance of the slot is that at the mean speed,

        (TAP_SUM before + TAP_SUM after + REMAINDER) / (2 * FILTER_TAPS)

    where both sums are at most 2**29 and REMAINDER is below 128. While STAND_SLOTS lasts, the plan
    stands and the new tap is 0.
    """
    sum_before = line[TAP_SUM]
    tap = 0  # the new one: distance of the plan in this slot
    if sum_before == 0 and line[SLOT_BEGUN] == 0:
        line[STAND_SLOTS] = 0  # the average has stopped already
    if line[STAND_SLOTS] and line[SLOT_BEGUN] == 0:
        line[STAND_SLOTS] = line[STAND_SLOTS] - 1
    else:
        plan_slot(flow, line, ring, table, HIGHEST)
        if line[SLOT_BEGUN]:
            tap = line[SLOT_DISTANCE]
        elif sum_before == 0:
            return 0  # nothing is planned, and the average stands
        line[SLOT_BEGUN] = 0
    slots = line[FILTER_TAPS]
    oldest = line[OLDEST_TAP]
    sum_after = sum_before + tap - line[TAP_DISTANCES + oldest]
    line[TAP_DISTANCES + oldest] = tap
    oldest += 1
    line[OLDEST_TAP] = oldest if oldest < slots else 0
    dividend = sum_before + sum_after + line[REMAINDER]
    distance = dividend // (2 * slots)
    line[REMAINDER] = dividend - 2 * slots * distance
    line[SUM_LAID_OUT] = sum_before
    line[TAP_SUM] = sum_after
    line[DISTANCE_TO_LAY] = distance
    line[TIME_TO_LAY] = _SLOT_TIME
    return 1


@micropython.viper
def plan_slot(flow: ptr32, line: ptr32, ring: ptr32, table: ptr32, most: int) -> int:
    """Continue the plan of the next slot by pieces, at most `most` of them (HIGHEST: to the slot's
    end). Returns 0.

    So a slot of many short blocks is planned bit by bit, while the one before it is executed.
    SLOT_DISTANCE becomes its distance. The slot ends early if no block is due.
    """
    # The plan sees released blocks only, and holds as the machine does.
    line[HEAD] = line[RELEASED]
    line[HOLD] = flow[HOLD]
    while (
        most
        and line[STAND_SLOTS] == 0
        and (line[SLOT_BEGUN] == 0 or line[TIME_TO_FILL] > _SHORTEST_PIECE)
    ):
        is_new = line[LOADED] == 0
        if int(is_due(line, ring, 0)) == 0:  # 0: the plan has no motors
            return 0
        if line[SLOT_BEGUN] == 0:
            line[SLOT_BEGUN] = 1
            line[SLOT_DISTANCE] = 0
            # The rest of the last slot is dropped, because times are at most 2**17.
            line[TIME_TO_FILL] = _SLOT_TIME
        if is_new:
            line[PLAN_LEFT] = int(block_distance(ring, line[BLOCK_AT]))
            line[PLAN_FRACTION] = 0
        rest = int(distance_left(line))
        line[PIECE_AT] = PIECES  # replaces the last piece: the plan makes no rows
        line[PLANNED_DISTANCE] = 0
        in_block = int(next_piece(line, ring, table[ROOT_SCALE]))  # 0: it ends the block
        if in_block:
            line[SLOT_DISTANCE] += int(count_piece(line, rest))
        else:
            line[SLOT_DISTANCE] += line[PLAN_LEFT]
            end_plan_block(line, ring, table[JUNCTION_DERATE])
        most -= 1
    return 0


@micropython.viper
def count_piece(line: ptr32, rest: int) -> int:
    """Return the distance of the plan's last piece in 2**-16 mm; PLAN_FRACTION is carried on.

    rest: distance_left() before it. A piece must have less than 1024 mm, 2**30 of 2**-20 mm.
    """
    block_left = line[PLAN_LEFT]
    in_line = int(pack(block_left, BIAS))  # the distance that `rest` is in 2**-18 step
    # Converted by what is left of the block in both units, times 16: in 2**-20 mm.
    fine_way = int(part_of(line[PIECE_DISTANCE], rest, in_line, _SIXTEEN)) + line[PLAN_FRACTION]
    line[PLAN_FRACTION] = fine_way & ((1 << _FRACTION_BITS) - 1)
    way = fine_way >> _FRACTION_BITS
    if way > block_left:
        way = block_left
    line[PLAN_LEFT] = block_left - way
    return way


@micropython.viper
def end_plan_block(line: ptr32, ring: ptr32, gentle: int) -> int:
    """End the plan's block. If the next one is entered from standstill, let the plan stand for
    STAND_SLOTS slots. Returns 0.

    The average over T also stops if the plan stands for T. With the acceleration a before and
    after, and a stop of the time r, it slows down to a (T - r)**2 / 4T. The corner and both rates
    allow v (0 after the last block), so STAND_SLOTS is, in whole slots, rounded up,

        r = T (1 - sqrt(v / (a T / 4)))

    gentle: T / 4, as table[JUNCTION_DERATE], so a T / 4 and v are roots of scaled speeds squared.
    """
    before = line[BLOCK_AT]  # index of the block that ends; at: of the next one
    line[JOIN_SPEED] = int(ratio(line[END_SPEED], ring[before + FACTOR]))  # a real, mm/s
    line[LOADED] = 0
    tail = line[TAIL] + 1
    if tail == line[ROWS]:
        tail = 0
    line[TAIL] = tail
    at = tail * line[ROW_SIZE]
    sqr = 0  # v squared, scaled
    if tail != line[HEAD]:
        if ring[at + ENTRY_SQR]:
            return 0  # entered at a speed: the plan need not stand
        sqr = ring[at + JUNCTION_SQR]
        if sqr > ring[at + NOMINAL_SQR]:
            sqr = ring[at + NOMINAL_SQR]
        if sqr > ring[before + NOMINAL_SQR]:
            sqr = ring[before + NOMINAL_SQR]
    line[JOIN_SPEED] = 0
    line[TIME_TO_FILL] = 0
    slowdown = int(product(ring[before + ACCEL], gentle, ONE))  # a T / 4
    # sqrt(v / (a T / 4)) in 2**-14.5, up to 23170. 181 is 2**7.5, so * 181 >> 22 makes it a whole
    # number. FILTER_TAPS, which is T in slots, is up to 64.
    part = int(square_root(int(share(int(square_root(sqr)), slowdown)) << 12)) if sqr else 0
    line[STAND_SLOTS] = line[FILTER_TAPS] - (line[FILTER_TAPS] * part * 181 >> 22)
    return 0
