# mypy: disable-error-code=arg-type
"""Where jerk is limited: how fast blocks are entered, and how hard they are sped up.

What is made is the plan averaged over a time (jerk_kernel.py). Where the plan brakes to a corner
and speeds up behind it, the average is faster there than the plan: so corners are planned slower,
and so are places where the rate changes. And the average mixes accelerations of several blocks: so
one holds from stop to stop.

Viper, as plan_kernel.py is; called by the main loop only, behind whatever plans blocks. Until then
the plan does not see them.
"""

import micropython
from micropython import const
from motion.layout import (
    ACCEL,
    AXES,
    HEAD,
    JUNCTION_DERATE,
    JUNCTION_SQR,
    LENGTH,
    LIMITS,
    MAX_ENTRY_SQR,
    NOMINAL_SQR,
    ROW_SIZE,
    ROWS,
    TAIL,
    UNPLANNED,
)
from motion.minifloat import HIGHEST, LIMIT, ONE, pack, product, square_root
from motion.plan_kernel import AT_ONCE, NEAR, compute_profile, reverse_pass

from extras.motors.jerk_layout import (
    FILTER_TAPS,
    RELEASED,
)

_LONG = const(0x204000)  # the real 16384, mm: a block of that is longer than its way can be told
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
        if int(begin(table, ring, flow, row, line[TAIL])):
            compute_profile(table, ring, row * flow[ROW_SIZE])
        soften(table, ring, flow, row)
        row += 1
        if row == flow[ROWS]:
            row = 0
        new += 1
    if new:
        flow[UNPLANNED] = new
        reverse_pass(ring, flow, 0)
        line[RELEASED] = row
    return new


@micropython.viper
def reschedule(table: ptr32, ring: ptr32, flow: ptr32) -> int:
    """Work out every block anew, after an override has changed."""
    row = flow[TAIL]
    while row != flow[HEAD]:
        compute_profile(table, ring, row * flow[ROW_SIZE])
        if row != flow[TAIL]:
            soften(table, ring, flow, row)
        row += 1
        if row == flow[ROWS]:
            row = 0
    return int(reverse_pass(ring, flow, 1))


@micropython.viper
def soften(table: ptr32, ring: ptr32, flow: ptr32, row: int) -> int:
    """As plan_kernel.limit_entry(), where jerk is limited."""
    size = flow[ROW_SIZE]
    at = row * size
    before = (row if row else flow[ROWS]) * size - size
    entry = ring[at + NOMINAL_SQR]
    slow = ring[before + NOMINAL_SQR]
    if entry != slow:
        entry = int(lower(table, ring[at + ACCEL], slow if slow < entry else entry))
    if entry > ring[at + JUNCTION_SQR]:
        entry = ring[at + JUNCTION_SQR]
    ring[at + MAX_ENTRY_SQR] = entry
    return 0


@micropython.viper
def begin(table: ptr32, ring: ptr32, flow: ptr32, row: int, present: int) -> int:
    """A block is new: its corner as it is to be planned, and its acceleration: that of the block
    before, unless the machine stops between them, as it does where this one allows less.

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
    elif junction < HIGHEST:
        junction = int(lower(table, accel, junction))
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
