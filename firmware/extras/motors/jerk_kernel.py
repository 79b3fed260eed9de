# mypy: disable-error-code=arg-type
r"""The kernel of limited jerk: integers only, from the plan's way in time to one without jolts.

    plan  ____/    \____     Speed along the path is averaged over SLOTS full segments, the slots.
                             So where the plan's acceleration is reached at once, what is made
    made  ___.-    -.___     comes to it in that time. The path is the same, and no average is
                             faster than what it is made of, or sped up harder.

The plan is that of segment_kernel.py, on a flow of its own, which runs ahead. What it comes to in
a slot is noted in the line, as a way along the path; what leaves the line is laid out along the
same blocks once more, for slice_kernel.py. Ways are whole numbers, and remainders are kept: what
goes in comes out.

Viper, as segment_kernel.py is; all of it runs in the engine's interrupt. What stands where is told
in jerk_layout.py and motion/layout.py.
"""

import micropython
from micropython import const
from motion.layout import (
    ACCEL,
    ADVANCE,
    AT,
    CARRY,
    DYNAMIC,
    ENTRY_SQR,
    FACTOR,
    FLAGS,
    FRACTION,
    HEAD,
    HOLD,
    JUNCTION_DERATE,
    JUNCTION_SQR,
    LEFT,
    LENGTH,
    LOADED,
    MOTOR_COUNT,
    NOMINAL_SQR,
    NOW,
    PARTIAL,
    PIECE,
    PIECES,
    REACHED,
    ROOT_SCALE,
    ROW_SIZE,
    ROWS,
    SLICES,
    TAIL,
    TIME,
    WAY,
    WHOLE,
)
from motion.minifloat import BIAS, HIGHEST, LIMIT, ONE, pack, product, ratio, square_root
from motion.ramps import share, times
from motion.segment_kernel import add_piece, is_due, load, next_piece
from motion.slice_kernel import slices

from extras.motors.jerk_layout import (
    BEFORE,
    FILTER_TAPS,
    MADE_LEFT,
    OLDEST,
    OPEN,
    PER_TAP,
    PLAN_FRACTION,
    PLAN_LEFT,
    RELEASED,
    REMAINDER,
    RESTS,
    SLOT_DISTANCE,
    SUM,
    TAP_DISTANCES,
    TIME_LEFT,
    TO_GO,
)

_LEAST = const(0x50000)  # a segment covers 1.25 steps, where the block reaches that far,
_LONGEST = const(32)  # or has taken so many slots
_SPLINTER = const(64)  # the plan is not asked for less than that of a slot, in 2**-17
_PER_MM = const(0x214000)  # the real 2**16
_SIXTEEN = const(0x1B4000)  # the real 16


@micropython.viper
def smooth(flow: ptr32, line: ptr32, ring: ptr32, table: ptr32) -> int:
    """Plan the next segment of what is made. Returns 0 where nothing is to move."""
    span = 0
    begun = 0
    going = 1
    while going:
        if line[TIME_LEFT] == 0:
            if begun and (flow[ADVANCE] + flow[PARTIAL] >= _LEAST or span >= _LONGEST << 17):
                break
            if int(shift_filter(flow, line, ring, table)) == 0:
                break
        if begun == 0:
            if int(begin_segment(flow, line, ring, table[MOTOR_COUNT])) == 0:
                return 0
            begun = 1
        part = int(place_slot(flow, line))
        span += part
        going = int(add_piece(flow, part))
    if begun == 0:
        return 0
    # A part of a slot and a whole one are cut as a segment of today is; what is longer is so for
    # the sake of one step.
    flow[TIME] = 131072 if span > 131072 and span < 262144 else span
    flow[SLICES] = int(slices(flow, table, ring[flow[AT] + FLAGS] & DYNAMIC))
    flow[TIME] = span
    flow[PIECE] = PIECES
    return 1


@micropython.viper
def begin_segment(flow: ptr32, line: ptr32, ring: ptr32, motors: int) -> int:
    """Begin a segment, with the next block where none is loaded. Returns 0 where there is none."""
    if flow[LOADED] == 0:
        if int(load(flow, ring, motors)) == 0:
            return 0
        line[MADE_LEFT] = int(block_distance(ring, flow[AT]))
        whole = int(pack(line[MADE_LEFT], BIAS))
        rest = int(distance_left(flow))
        flow[NOW] = int(part_of(line[BEFORE], whole, rest, line[PER_TAP]))
    flow[REACHED] = flow[NOW]
    flow[PIECE] = PIECES
    flow[ADVANCE] = 0
    return 1


@micropython.viper
def block_distance(ring: ptr32, at: int) -> int:
    """The length of a block in 2**-16 mm, 1 at least."""
    return int(product(ring[at + LENGTH], _PER_MM, ONE)) or 1


@micropython.viper
def distance_left(flow: ptr32) -> int:
    """What a block has still to go: a real, in 2**-18 step."""
    if flow[WHOLE] < 4095:
        return int(pack((flow[WHOLE] << 18) + flow[FRACTION], BIAS))
    return int(pack(flow[WHOLE], BIAS + 18))


@micropython.viper
def part_of(part: int, whole: int, other: int, scale: int) -> int:
    """As much of another whole as a part is of one; times a scale. Wholes and scale are reals."""
    return int(product(int(ratio(part, whole)), other, scale))


@micropython.viper
def place_slot(flow: ptr32, line: ptr32) -> int:
    """Lay out what the slot has to go: all of it, or up to the end of the block.

    Leaves the speed at its end in NOW, its way in WAY. Returns its time, in 2**-17 slot.
    """
    left = line[MADE_LEFT]
    way = line[TO_GO]
    part = line[TIME_LEFT]
    in_line = int(pack(left or 1, BIAS))
    rest = int(distance_left(flow))
    whole = (flow[WHOLE] << 18) + flow[FRACTION] if flow[WHOLE] < 4095 else HIGHEST
    steps = whole
    end = line[SUM]
    if way > left:
        share_of_way = int(share(left, way))
        start = line[BEFORE]
        both = start + end
        end = int(speed_between(start, end, share_of_way))
        if start + end:
            share_of_way = int(share(int(times(both, share_of_way)), start + end))
        part = int(times(part, share_of_way))
        way = left
    elif way < left:
        steps = int(part_of(way, in_line, rest, ONE))
        if steps >= whole:
            steps = whole - 1
    flow[NOW] = int(part_of(end, in_line, rest, line[PER_TAP]))
    flow[WAY] = steps
    flow[LEFT] = part
    line[BEFORE] = end
    line[MADE_LEFT] = left - way
    line[TO_GO] = line[TO_GO] - way
    line[TIME_LEFT] = line[TIME_LEFT] - part
    return part


@micropython.viper
def speed_between(start: int, end: int, part: int) -> int:
    """The speed where that part, in 2**-17, of the way from one speed to another is behind."""
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
    """Have the plan go on to the end of a slot, and take the next out of the line. Returns 0 at
    rest."""
    before = line[SUM]
    way = 0
    if before == 0 and line[OPEN] == 0:
        line[RESTS] = 0
    if line[RESTS] and line[OPEN] == 0:
        line[RESTS] = line[RESTS] - 1
    else:
        advance(flow, line, ring, table, HIGHEST)
        if line[OPEN]:
            way = line[SLOT_DISTANCE]
        elif before == 0:
            return 0
        line[OPEN] = 0
    slots = line[FILTER_TAPS]
    at = line[OLDEST]
    total = before + way - line[TAP_DISTANCES + at]
    line[TAP_DISTANCES + at] = way
    at += 1
    line[OLDEST] = at if at < slots else 0
    both = before + total + line[REMAINDER]
    way = both // (2 * slots)
    line[REMAINDER] = both - 2 * slots * way
    line[BEFORE] = before
    line[SUM] = total
    line[TO_GO] = way
    line[TIME_LEFT] = 131072
    return 1


@micropython.viper
def advance(flow: ptr32, line: ptr32, ring: ptr32, table: ptr32, most: int) -> int:
    """Have the plan go on in the slot that comes next, by so many pieces at the most.

    So a slot of many short blocks is planned bit by bit, while the one before it is made.
    """
    line[HEAD] = line[RELEASED]
    line[HOLD] = flow[HOLD]
    while most and line[RESTS] == 0 and (line[OPEN] == 0 or line[LEFT] > _SPLINTER):
        is_new = line[LOADED] == 0
        if int(is_due(line, ring, 0)) == 0:
            return 0
        if line[OPEN] == 0:
            line[OPEN] = 1
            line[SLOT_DISTANCE] = 0
            line[LEFT] = 131072  # no more: segment_kernel.change_speed() knows of no longer time
        if is_new:
            line[PLAN_LEFT] = int(block_distance(ring, line[AT]))
            line[PLAN_FRACTION] = 0
        rest = int(distance_left(line))
        line[PIECE] = PIECES
        line[ADVANCE] = 0
        going = int(next_piece(line, ring, table[ROOT_SCALE]))
        if going:
            line[SLOT_DISTANCE] += int(count(line, rest))
        else:
            line[SLOT_DISTANCE] += line[PLAN_LEFT]
            leave(line, ring, table[JUNCTION_DERATE])
        most -= 1
    return 0


@micropython.viper
def count(line: ptr32, rest: int) -> int:
    """The way that the plan's last piece has come, in 2**-16 mm: rest was to go before."""
    left = line[PLAN_LEFT]
    whole = int(pack(left, BIAS))
    way = int(part_of(line[WAY], rest, whole, _SIXTEEN)) + line[PLAN_FRACTION]
    line[PLAN_FRACTION] = way & 15
    way >>= 4
    if way > left:
        way = left
    line[PLAN_LEFT] = left - way
    return way


@micropython.viper
def leave(line: ptr32, ring: ptr32, gentle: int) -> int:
    """The plan has come to the end of a block. Where the next is entered from rest, it rests.

    The average comes to rest if the plan rests for as long as that is over, T. With acceleration
    a before and behind, and a rest r, it comes down to a (T - r)2 / 4T: where the corner and the
    rates allow v, r is T (1 - root of v / (a T / 4)). gentle: T / 4, as table[GENTLE].
    """
    before = line[AT]
    line[CARRY] = int(ratio(line[NOW], ring[before + FACTOR]))
    line[LOADED] = 0
    tail = line[TAIL] + 1
    if tail == line[ROWS]:
        tail = 0
    line[TAIL] = tail
    at = tail * line[ROW_SIZE]
    sqr = 0
    if tail != line[HEAD]:
        if ring[at + ENTRY_SQR]:
            return 0
        sqr = ring[at + JUNCTION_SQR]
        if sqr > ring[at + NOMINAL_SQR]:
            sqr = ring[at + NOMINAL_SQR]
        if sqr > ring[before + NOMINAL_SQR]:
            sqr = ring[before + NOMINAL_SQR]
    line[CARRY] = 0
    line[LEFT] = 0
    least = int(product(ring[before + ACCEL], gentle, ONE))
    part = int(square_root(int(share(int(square_root(sqr)), least)) << 12)) if sqr else 0
    line[RESTS] = line[FILTER_TAPS] - (line[FILTER_TAPS] * part * 181 >> 22)  # part: in 2**-14.5
    return 0
