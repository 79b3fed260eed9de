# mypy: disable-error-code=arg-type
"""The jerk limit's planner: entry speeds and accelerations of blocks whose speed is averaged.

The executed speed is the planned one, averaged over a time T (jerk_kernel.py). Where the plan
brakes to a corner and accelerates after it, the average is faster there than the plan, by

    acceleration * T / 4        ACCEL * table[JUNCTION_DERATE], a root of a scaled speed squared

So corners, and places where the rate changes, are planned slower by that: lower_at_corner(). The
average also mixes the accelerations of several blocks, so one acceleration holds from stop to
stop.

Short lines would stop at each corner for that. Two rules avoid it: a short line goes no faster
than its corners allow, so the average is no faster either (limit_rate); a corner that only the
grid of steps makes does not count (mark_grid_corner).

Viper, as plan_kernel.py is, with its units and ranges: speeds squared are scaled, 0 to 2**30 - 1,
so their roots are below 2**15. Main loop only, called after a block is planned; the plan (the
motion before averaging) reads a block only once it is released. table, ring and flow are the
planner's, line is the delay line (jerk_layout.py). A row is the number of a block in the ring; at,
before and after are indexes in the ring where a block's numbers begin. JUNCTION_SQR is the speed
squared allowed in the corner at a block's begin, HIGHEST if it goes straight on.
"""

import micropython
from micropython import const
from motion.layout import (
    ACCEL,
    AXES,
    CRUISE,
    EVENTS,
    FACTOR,
    FLAGS,
    HEAD,
    JUNCTION,
    JUNCTION_DERATE,
    JUNCTION_SQR,
    LENGTH,
    LIMITS,
    LOADED,
    MAX_ENTRY_SQR,
    NOMINAL,
    NOMINAL_SQR,
    ROOT_SCALE,
    ROW_SIZE,
    ROWS,
    TAIL,
    UNPLANNED,
)
from motion.minifloat import BIAS, HIGHEST, LIMIT, ONE, mul, pack, product, square_root
from motion.plan_kernel import AT_ONCE, NEAR, compute_profile, reverse_pass

from extras.motors.jerk_layout import (
    CHAIN_SQR,
    FILTER_TAPS,
    RELEASED,
)

_UNITS_PER_MM = const(0x214000)  # the real 2**16,
_FOUR_UNITS_PER_MM = const(0x224000)  # and 4 * 2**16
_TOO_LONG_MM = const(0x204000)  # the real 16384: such a length does not fit jerk_kernel.py
_RATE_LIMITED = const(0x1000)  # flags of a block: it is no faster than the corners at its ends;
_IN_GRID_CHAIN = const(0x2000)  # it is short, and its first corner is one of the grid, or none
_MOST_GRID_STEPS = const(100)  # a block of more steps has no corners of the grid
_ROUNDING = const(64)  # of a mantissa, up to 1/256: an acceleration so little higher is the same
_MANTISSA = const(32767)  # of a real, below its exponent,
_EXPONENT_AT = const(15)  # which starts at this bit
_LIMITS_OF_AN_AXIS = const(3)  # in the table, from LIMITS on,
_ACCELERATION = const(2)  # and this one of them


@micropython.viper
def release_blocks(table: ptr32, ring: ptr32, flow: ptr32, line: ptr32, everything: int) -> int:
    """Release new blocks to the plan, with their accelerations and entry speeds.

    If NEAR or more blocks are waiting, new ones are collected until there are AT_ONCE, as in
    plan_kernel.append_block(), unless everything is not 0. Returns how many were released.
    """
    if line[FILTER_TAPS] == 0:
        return 0
    released = 0
    row = line[RELEASED]
    unreleased = flow[HEAD] - row  # numbers of blocks, once the ring's wrap is added
    waiting = flow[HEAD] - line[TAIL]
    if unreleased < 0:
        unreleased += flow[ROWS]
    if waiting < 0:
        waiting += flow[ROWS]
    if unreleased < AT_ONCE and waiting >= NEAR and everything == 0:
        return 0
    while row != flow[HEAD]:
        at = row * flow[ROW_SIZE]
        if int(set_acceleration(table, ring, flow, row, line[TAIL])):
            compute_profile(table, ring, at)
        before = (row or flow[ROWS]) * flow[ROW_SIZE] - flow[ROW_SIZE]  # index of the row before
        mark_grid_corner(table, ring, line, at, before)
        present = line[TAIL] if line[LOADED] else -1  # -1: the plan has begun no block
        limit_entries(table, ring, flow, row, present)
        row += 1
        if row == flow[ROWS]:
            row = 0
        released += 1
    if released:
        flow[UNPLANNED] = released + 1  # limit_entries() changes the block before, too
        reverse_pass(ring, flow, 0)
        line[RELEASED] = row
    return released


@micropython.viper
def reschedule(table: ptr32, ring: ptr32, flow: ptr32, present: int) -> int:
    """Compute all blocks again after an override changed. present: row of the plan's block, or -1.

    Returns how many blocks reverse_pass() has visited.
    """
    row = flow[TAIL]
    while row != flow[HEAD]:
        at = row * flow[ROW_SIZE]
        compute_profile(table, ring, at)
        # compute_profile() has set the whole rate again.
        ring[at + FLAGS] = ring[at + FLAGS] & (-1 - _RATE_LIMITED)
        if row != flow[TAIL]:
            limit_entries(table, ring, flow, row, present)
        row += 1
        if row == flow[ROWS]:
            row = 0
    return int(reverse_pass(ring, flow, 1))


@micropython.viper
def limit_entries(table: ptr32, ring: ptr32, flow: ptr32, row: int, present: int) -> int:
    """Set a block's MAX_ENTRY_SQR, as plan_kernel.limit_entry() does without a limit of jerk; and
    that of the block before, because both its corners are known now.

    row: the newest block so far; JUNCTION_SQR is its corner with the block before. present: row of
    the block that the plan has begun, or -1. The block before cannot change any more once the
    plan has begun it, or has ended it: this block is then the one begun, or the ring's first.
    """
    rows = flow[ROWS]
    size = flow[ROW_SIZE]
    before = row - 1 if row else rows - 1
    before_is_over = row == flow[TAIL] or row == present
    if not before_is_over and before != present:
        before_previous = before - 1 if before else rows - 1
        limit_rate(table, ring, before * size, row * size, before_previous * size)
        set_max_entry(table, ring, before * size, before_previous * size)
    set_max_entry(table, ring, row * size, before * size)
    return 0


@micropython.viper
def set_max_entry(table: ptr32, ring: ptr32, at: int, before: int) -> int:
    """Set a block's MAX_ENTRY_SQR from its corner, its rate and the rate of the block before.
    Returns 0.

    Corner and rate are lowered by the excess of the average over the plan. Exceptions: equal
    rates, and as such two blocks with _RATE_LIMITED whose squared rates differ by 1/8 at most; a
    corner of the grid, or none.
    """
    corner_sqr = ring[at + JUNCTION_SQR]
    slow_sqr = ring[at + NOMINAL_SQR]  # the lower one of the two rates, squared,
    fast_sqr = ring[before + NOMINAL_SQR]  # and the higher one
    if fast_sqr < slow_sqr:
        slow_sqr = fast_sqr
        fast_sqr = ring[at + NOMINAL_SQR]
    accel = ring[at + ACCEL]
    both_limited = ring[at + FLAGS] & ring[before + FLAGS] & _RATE_LIMITED
    if both_limited and fast_sqr - (fast_sqr >> 3) <= slow_sqr:
        fast_sqr = slow_sqr  # as equal rates: nothing is lowered
    elif corner_sqr < HIGHEST and ring[at + FLAGS] & _IN_GRID_CHAIN == 0:
        corner_sqr = int(lower_at_corner(table, accel, corner_sqr))
    rate_sqr = slow_sqr  # what the rates allow
    if fast_sqr != slow_sqr:
        rate_sqr = int(lower_at_corner(table, accel, slow_sqr))
    ring[at + MAX_ENTRY_SQR] = rate_sqr if rate_sqr < corner_sqr else corner_sqr
    return 0


@micropython.viper
def mark_grid_corner(table: ptr32, ring: ptr32, line: ptr32, at: int, before: int) -> int:
    """Mark a new block as _IN_GRID_CHAIN if its corner is one that only the grid of steps makes,
    or if it goes straight on from such a block. Returns 0.

    Within a chain of such blocks, the average is no faster than the plan is somewhere in it. At
    the end it may be, where a long block goes straight on, so that block gets the chain's last
    corner (CHAIN_SQR) as its own.
    """
    junction = ring[at + JUNCTION_SQR]
    after_chain = ring[before + FLAGS] & _IN_GRID_CHAIN
    in_chain = 0  # 1: this block belongs to a chain, too
    if junction == HIGHEST:  # it goes straight on
        if after_chain:
            in_chain = int(is_short(table, ring, at, line[CHAIN_SQR]))
            if in_chain == 0:  # the chain ends here
                ring[at + JUNCTION_SQR] = line[CHAIN_SQR]
    elif junction and (after_chain or ring[before + JUNCTION_SQR] < HIGHEST):
        # A corner directly after another one, or in a chain.
        in_chain = int(is_grid_corner(table, ring, at, before))
        line[CHAIN_SQR] = junction
    if in_chain:
        ring[at + FLAGS] = ring[at + FLAGS] | _IN_GRID_CHAIN
    return 0


@micropython.viper
def is_grid_corner(table: ptr32, ring: ptr32, at: int, before: int) -> int:
    """Return 1 if the corner between two short blocks is within a step of a straight line, else 0.

    A corner by the angle t, n steps from the next one (the shorter block's, at most
    _MOST_GRID_STEPS), is n t / 2 steps off the line: less than one step where t < 2 / n. Junction
    deviation d allows, with the acceleration a, v**2 = 8 a d / t**2 for a small t, and 2.4 a d for
    a right angle, which n = 1 may be. So the condition is v**2 >= 2 a d n**2.
    """
    steps = ring[at + EVENTS]
    if steps > ring[before + EVENTS]:
        steps = ring[before + EVENTS]
    junction = ring[at + JUNCTION_SQR]
    if steps > _MOST_GRID_STEPS:
        return 0
    # table[JUNCTION] is d * 2**16, scaled as v**2 is.
    two_n_sqr = int(pack(2 * steps * steps, BIAS - 16))
    if junction < int(product(ring[at + ACCEL], table[JUNCTION], two_n_sqr)):
        return 0
    return int(is_short(table, ring, at, junction)) & int(is_short(table, ring, before, junction))


@micropython.viper
def is_short(table: ptr32, ring: ptr32, at: int, sqr: int) -> int:
    """Return 1 if a block is shorter than the distance v T, v**2 being sqr (scaled), else 0.

    T, the averaging time in s, is 4 * JUNCTION_DERATE * ROOT_SCALE; v in mm/s is the root of sqr
    times ROOT_SCALE. Lengths are compared in 2**-16 mm, HIGHEST for 16384 mm and more.
    """
    root = int(pack(int(square_root(sqr)), BIAS))
    scale = table[ROOT_SCALE]
    quarter_time = int(mul(table[JUNCTION_DERATE], scale))  # T / 4, in s; all these are reals
    way = int(product(int(mul(root, quarter_time)), scale, _FOUR_UNITS_PER_MM))  # v T
    return 1 if way > int(product(ring[at + LENGTH], _UNITS_PER_MM, ONE)) else 0


@micropython.viper
def limit_rate(table: ptr32, ring: ptr32, at: int, after: int, before: int) -> int:
    """Limit the rate of a short block whose corners would be stops to what its corners allow.

    Nor is it faster than such a block before it. Then the average is no faster than the corners
    allow, and the plan need not stop. at, after, before: indexes in the ring of the block, the
    next and the previous one. Returns 0; the block has the flag _RATE_LIMITED if it was limited.
    """
    sqr = ring[after + JUNCTION_SQR]  # becomes the speed squared that the corners allow
    first = ring[at + JUNCTION_SQR]  # its first corner; 0: a standstill, which limits nothing
    if first and first < sqr:
        sqr = first
    if first and ring[before + FLAGS] & _RATE_LIMITED and ring[before + NOMINAL_SQR] < sqr:
        sqr = ring[before + NOMINAL_SQR]
    # Nothing to do: a stop, or straight lines, or corners that are no stops when lowered.
    lowered_sqr = int(lower_at_corner(table, ring[at + ACCEL], sqr))
    if sqr == 0 or sqr == HIGHEST or lowered_sqr:  # noqa: PLR1714 (a viper cannot ask `in`)
        return 0
    if ring[after + FLAGS] & _IN_GRID_CHAIN or int(is_short(table, ring, at, sqr)) == 0:
        return 0
    if sqr < ring[at + NOMINAL_SQR]:
        ring[at + NOMINAL_SQR] = sqr
        root = int(pack(int(square_root(sqr)), BIAS))
        ring[at + NOMINAL] = int(mul(root, table[ROOT_SCALE]))
        # As block speed units, at least 1.
        ring[at + CRUISE] = int(product(ring[at + NOMINAL], ring[at + FACTOR], ONE)) or 1
    ring[at + FLAGS] = ring[at + FLAGS] | _RATE_LIMITED
    return 0


@micropython.viper
def set_acceleration(table: ptr32, ring: ptr32, flow: ptr32, row: int, present: int) -> int:
    """Set a new block's acceleration: that of the block before, unless the machine stops between.

    It stops, so JUNCTION_SQR becomes 0, if the plan is already at this block (present: row of the
    plan's block); if this block allows less; if it allows more and the corner would be a stop
    anyway; and before and after a block of 16384 mm or more. row: the new block's. Returns 1 if
    ACCEL has changed, else 0.
    """
    size = flow[ROW_SIZE]
    at = row * size
    before = (row if row else flow[ROWS]) * size - size
    own = int(shared_acceleration(table, ring[at + ACCEL]))  # what this block alone allows
    accel = ring[before + ACCEL]
    junction = ring[at + JUNCTION_SQR]
    is_long = ring[at + LENGTH] >= _TOO_LONG_MM or ring[before + LENGTH] >= _TOO_LONG_MM
    if row == present or own < accel or is_long:
        junction = 0
    elif own > accel and junction < HIGHEST and int(lower_at_corner(table, accel, junction)) == 0:
        junction = 0
    if junction == 0:
        accel = own
    ring[at + JUNCTION_SQR] = junction
    changed = 1 if ring[at + ACCEL] != accel else 0
    ring[at + ACCEL] = accel
    return changed


@micropython.viper
def lower_at_corner(table: ptr32, accel: int, sqr: int) -> int:
    """Return a speed squared, lowered by what the average is faster than the plan at a corner.

    sqr: scaled, 0 to 2**30 - 1. accel: real, mm/s2. The root loses 1 more, because product()
    rounds down.
    """
    root = int(square_root(sqr)) - int(product(accel, table[JUNCTION_DERATE], ONE)) - 1
    return root * root if root > 0 else 0


@micropython.viper
def shared_acceleration(table: ptr32, accel: int) -> int:
    """Return the highest acceleration, at most accel, that is an axis's, or 1/2, 1/4, ... of one.

    So similar directions have the same acceleration, and blocks need not stop between them. Reals,
    mm/s2; one less in the exponent (LIMIT) is a half.
    """
    highest = 0
    if accel <= LIMIT:  # a real so small cannot be halved
        return accel
    most = int(pack((accel & _MANTISSA) + _ROUNDING, accel >> _EXPONENT_AT))
    for i in range(table[AXES]):
        limit = table[LIMITS + _LIMITS_OF_AN_AXIS * i + _ACCELERATION]
        while limit > most:
            limit -= LIMIT  # halve it
        if limit > highest:
            highest = limit
    return highest
