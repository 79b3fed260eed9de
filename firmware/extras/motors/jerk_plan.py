# mypy: disable-error-code=arg-type
"""Where jerk is limited: how fast blocks are entered, and how hard they are sped up.

What is made is the plan averaged over a time (jerk_kernel.py). Where the plan brakes to a corner
and speeds up behind it, the average is faster there than the plan: so corners are planned slower,
and so are places where the rate changes. And the average mixes accelerations of several blocks: so
one holds from stop to stop.

Short lines would stop at each corner for that. Where they go no faster than their corners allow
(calm) the average is no faster either; and a corner of the grid of steps is none (link).

Viper, as plan_kernel.py is; called by the main loop only, behind whatever plans blocks. Until then
the plan does not see them.
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
    CHAIN,
    FILTER_TAPS,
    RELEASED,
)

_PER_MM = const(0x214000)  # the reals 2**16,
_FOUR_OF_16 = const(0x224000)  # and 2**18
_LONG = const(0x204000)  # the real 16384, mm: a block of that is longer than its way can be told
_CALM = const(0x1000)  # flags of a block: it is no faster than the corners at its ends;
_LINKED = const(0x2000)  # and it is short, and the corner at its beginning is one of the grid
_FINE = const(100)  # a block of so many steps has no corners of the grid
_ROUNDING = const(64)  # of a mantissa: an acceleration so little above a block's is taken for it


@micropython.viper
def release_blocks(table: ptr32, ring: ptr32, flow: ptr32, line: ptr32, everything: int) -> int:
    """Have the plan see the blocks that have been added, as they are to be made: several at once
    where it has many before it, as plan_kernel.append_block() does, unless everything is to be
    done. Returns their number."""
    if line[FILTER_TAPS] == 0:
        return 0
    new = 0
    row = line[RELEASED]
    unseen = flow[HEAD] - row
    waiting = flow[HEAD] - line[TAIL]
    if unseen < 0:
        unseen += flow[ROWS]
    if waiting < 0:
        waiting += flow[ROWS]
    if unseen < AT_ONCE and waiting >= NEAR and everything == 0:
        return 0
    while row != flow[HEAD]:
        at = row * flow[ROW_SIZE]
        if int(begin(table, ring, flow, row, line[TAIL])):
            compute_profile(table, ring, at)
        link(table, ring, line, at, (row or flow[ROWS]) * flow[ROW_SIZE] - flow[ROW_SIZE])
        soften(table, ring, flow, row, line[TAIL] if line[LOADED] else -1)
        row += 1
        if row == flow[ROWS]:
            row = 0
        new += 1
    if new:
        flow[UNPLANNED] = new + 1  # soften() raises the entry of the block before, too
        reverse_pass(ring, flow, 0)
        line[RELEASED] = row
    return new


@micropython.viper
def reschedule(table: ptr32, ring: ptr32, flow: ptr32, present: int) -> int:
    """Work out every block anew, after an override has changed. present: where the plan is."""
    row = flow[TAIL]
    while row != flow[HEAD]:
        at = row * flow[ROW_SIZE]
        compute_profile(table, ring, at)
        ring[at + FLAGS] = ring[at + FLAGS] & (-1 - _CALM)
        if row != flow[TAIL]:
            soften(table, ring, flow, row, present)
        row += 1
        if row == flow[ROWS]:
            row = 0
    return int(reverse_pass(ring, flow, 1))


@micropython.viper
def soften(table: ptr32, ring: ptr32, flow: ptr32, row: int, present: int) -> int:
    """As plan_kernel.limit_entry(), where jerk is limited; and of the block before, both of whose
    corners are known now. present: where the plan is, -1 where it has not begun."""
    rows = flow[ROWS]
    size = flow[ROW_SIZE]
    before = row - 1 if row else rows - 1
    known = row != flow[TAIL] and row != present
    if known and before != present:
        second = before - 1 if before else rows - 1
        calm(table, ring, before * size, row * size, second * size)
        enter(table, ring, before * size, second * size)
    enter(table, ring, row * size, before * size)
    return 0


@micropython.viper
def enter(table: ptr32, ring: ptr32, at: int, before: int) -> int:
    """How fast a block may be entered, by its corner, its rate and that of the block before.

    Slower than these are by what the average is faster than the plan, unless both blocks are
    calm, or their corner is one of the grid.
    """
    junction = ring[at + JUNCTION_SQR]
    entry = ring[at + NOMINAL_SQR]
    fast = ring[before + NOMINAL_SQR]
    if fast < entry:
        entry = fast
        fast = ring[at + NOMINAL_SQR]
    accel = ring[at + ACCEL]
    if ring[at + FLAGS] & ring[before + FLAGS] & _CALM and fast - (fast >> 3) <= entry:
        fast = entry
    elif junction < HIGHEST and ring[at + FLAGS] & _LINKED == 0:
        junction = int(lower(table, accel, junction))
    if fast != entry:
        entry = int(lower(table, accel, entry))
    ring[at + MAX_ENTRY_SQR] = entry if entry < junction else junction
    return 0


@micropython.viper
def link(table: ptr32, ring: ptr32, line: ptr32, at: int, before: int) -> int:
    """A block is new: see whether its corner is one of the grid. Within a chain of such blocks the
    average is no faster than the plan is somewhere there; at its ends it may be, where a long
    block goes straight on: the chain's last corner is there, too."""
    junction = ring[at + JUNCTION_SQR]
    chained = ring[before + FLAGS] & _LINKED
    linked = 0
    if junction == HIGHEST:
        if chained:
            linked = int(is_short(table, ring, at, line[CHAIN]))
            if linked == 0:
                ring[at + JUNCTION_SQR] = line[CHAIN]
    elif junction and (chained or ring[before + JUNCTION_SQR] < HIGHEST):
        linked = int(is_grid(table, ring, at, before))
        line[CHAIN] = junction
    if linked:
        ring[at + FLAGS] = ring[at + FLAGS] | _LINKED
    return 0


@micropython.viper
def is_grid(table: ptr32, ring: ptr32, at: int, before: int) -> int:
    """Whether a corner between two short blocks is less than a step away from a straight line.

    A turn by an angle t within n steps is so below n t / 2 = 1. Junction deviation d allows
    v2 = 8 a d / t2 there, and 2.4 a d where t is a right angle: so where v2 >= 2 a d n2.
    """
    steps = ring[at + EVENTS]
    if steps > ring[before + EVENTS]:
        steps = ring[before + EVENTS]
    junction = ring[at + JUNCTION_SQR]
    if steps > _FINE:
        return 0
    # table[JUNCTION] is 2**16 d
    twice = int(pack(2 * steps * steps, BIAS - 16))
    if junction < int(product(ring[at + ACCEL], table[JUNCTION], twice)):
        return 0
    return int(is_short(table, ring, at, junction)) & int(is_short(table, ring, before, junction))


@micropython.viper
def is_short(table: ptr32, ring: ptr32, at: int, sqr: int) -> int:
    """Whether a block takes less than the time of the average at that speed, squared.

    GENTLE is a quarter of that time, and speeds by the root of a scaled square have ROOT_SCALE.
    """
    root = int(pack(int(square_root(sqr)), BIAS))
    scale = table[ROOT_SCALE]
    way = int(product(int(mul(root, int(mul(table[JUNCTION_DERATE], scale)))), scale, _FOUR_OF_16))
    return 1 if way > int(product(ring[at + LENGTH], _PER_MM, ONE)) else 0


@micropython.viper
def calm(table: ptr32, ring: ptr32, at: int, after: int, before: int) -> int:
    """Have a short block, whose corners would be stops, go no faster than these, and than the
    calm block before it. So the average has nothing to be faster from, and nobody stops."""
    sqr = ring[after + JUNCTION_SQR]
    entry = ring[at + JUNCTION_SQR]
    if entry and entry < sqr:
        sqr = entry
    if entry and ring[before + FLAGS] & _CALM and ring[before + NOMINAL_SQR] < sqr:
        sqr = ring[before + NOMINAL_SQR]
    if sqr == 0 or int(lower(table, ring[at + ACCEL], sqr)) or sqr == HIGHEST:
        return 0
    if ring[after + FLAGS] & _LINKED or int(is_short(table, ring, at, sqr)) == 0:
        return 0
    if sqr < ring[at + NOMINAL_SQR]:
        ring[at + NOMINAL_SQR] = sqr
        root = int(pack(int(square_root(sqr)), BIAS))
        ring[at + NOMINAL] = int(mul(root, table[ROOT_SCALE]))
        ring[at + CRUISE] = int(product(ring[at + NOMINAL], ring[at + FACTOR], ONE)) or 1
    ring[at + FLAGS] = ring[at + FLAGS] | _CALM
    return 0


@micropython.viper
def begin(table: ptr32, ring: ptr32, flow: ptr32, row: int, present: int) -> int:
    """A block is new: its acceleration is that of the block before, unless the machine stops
    between them, as it does where this one allows less: its corner is 0 then.

    present: where the plan is. Returns 1 where the acceleration is another than the block's own.
    """
    size = flow[ROW_SIZE]
    at = row * size
    before = (row if row else flow[ROWS]) * size - size
    own = int(level(table, ring[at + ACCEL]))
    accel = ring[before + ACCEL]
    junction = ring[at + JUNCTION_SQR]
    is_long = ring[at + LENGTH] >= _LONG or ring[before + LENGTH] >= _LONG
    if row == present or own < accel or is_long:
        junction = 0
    elif own > accel and junction < HIGHEST and int(lower(table, accel, junction)) == 0:
        junction = 0
    if junction == 0:
        accel = own
    ring[at + JUNCTION_SQR] = junction
    changed = 1 if ring[at + ACCEL] != accel else 0
    ring[at + ACCEL] = accel
    return changed


@micropython.viper
def lower(table: ptr32, accel: int, sqr: int) -> int:
    """A speed squared, lower by what the average over a corner is higher than the plan."""
    root = int(square_root(sqr)) - int(product(accel, table[JUNCTION_DERATE], ONE)) - 1
    return root * root if root > 0 else 0


@micropython.viper
def level(table: ptr32, accel: int) -> int:
    """The highest acceleration within a block's that is an axis', or half of it, or a quarter...

    So directions that differ little have the same, and blocks need not stop between them.
    """
    found = 0
    if accel <= LIMIT:
        return accel
    most = int(pack((accel & 32767) + _ROUNDING, accel >> 15))
    for i in range(table[AXES]):
        one = table[LIMITS + 3 * i + 2]
        while one > most:
            one -= LIMIT
        if one > found:
            found = one
    return found
