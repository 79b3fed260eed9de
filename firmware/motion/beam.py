# mypy: disable-error-code=arg-type
"""The beam: where in a segment the power of a laser changes, and to what.

To an engine that can do it, a beam is one more motor: its steps are changes of power. They stand
in a segment's row behind those of the motors, first, last, the others evenly between, as steps do,
and hardware counts them out at the same tick as the steps that they belong to. What power changes
to goes into a ring, a level per change. Viper; runs in the engine's interrupt.
"""

import micropython
from micropython import const

from motion.layout import (
    AT,
    DYNAMIC,
    EVENTS,
    FLAGS,
    KEEP_POWER,
    LOADED,
    MOTOR_COUNT,
    MOTORS,
    ROW_AXES,
    ROW_POWER,
    ROW_SIZE,
    ROW_STRIDE,
    ROW_TICKS,
    STEPS,
)
from motion.slice_kernel import dimmed, speed_share

# The beam, an array: levels made since power-up; the last one's power, or UNKNOWN;
COUNT = const(0)
LEVEL = const(1)
# ticks from the last change to the end of what has been made, and the least from one to the next;
SINCE = const(2)
GAP = const(3)
# what makes a level of a power, in 2**-FULL_LOG2, see full(), and what all are multiplied with;
FULL = const(4)
BOTH = const(5)
# integers that a block has in the clusters: 0, or ROOM.
ROW = const(6)
LENGTH = const(7)

UNKNOWN = const(-1)

# The ring of levels: as many as all rows that wait may have.
LEVELS_LOG2 = const(8)
LEVELS_MASK = const(255)

# Clusters, a row per block: how many dots it has, 0 if it is none; their powers, as POWER is.
MOST = const(16)
ROOM = const(17)

# Levels have 16 bits, and there are as many powers as 14 bits can tell, or fewer.
_FULL_LOG2 = const(14)

_SOONEST = const(8)  # ticks in which an engine is ready for the first change of a segment
_LONG = const(0x100000)  # ticks: no gap is longer


def full(level: int, power: int) -> int:
    """FULL, where the highest power has that level: no product of it needs more than 31 bits."""
    return ((level << _FULL_LOG2) + power - 1) // power


@micropython.viper
def reach(row: ptr32, base: int, whole: int, over: int, parts: int) -> int:
    """The tick at which the axis at row[base] comes to a place: whole steps, and `over` of `parts`
    of one, into its segment. A step is made half way to the next place of a motor."""
    gaps = row[base] - 1
    tick = row[base + 1]
    gap = row[ROW_TICKS]
    if gaps > 0:
        span = row[base + 2] - tick
        gap = span // gaps
        longer = span - gap * gaps
        tick += gap * whole + (whole if whole < longer else longer)
    return tick + gap // (2 * parts) * (2 * over - parts)


@micropython.viper
def emit(beam: ptr32, levels: ptr32, power: int) -> int:
    """A change of power: its level goes into the ring."""
    levels[beam[COUNT] & LEVELS_MASK] = ((power * beam[FULL]) >> _FULL_LOG2) * beam[BOTH]
    beam[COUNT] += 1
    beam[LEVEL] = power
    return 0


@micropython.viper
def lay(table: ptr32, row: ptr32, beam: ptr32, number: int, first: int, last: int) -> int:
    """Put so many changes into a row, not sooner than the hardware is ready for them."""
    base = ROW_AXES + ROW_STRIDE * table[MOTOR_COUNT]
    row[base] = number
    since = beam[SINCE] + row[ROW_TICKS]
    if number:
        soonest = beam[GAP] - beam[SINCE]
        if soonest < _SOONEST:
            soonest = _SOONEST
        if first < soonest:
            first = soonest
        soonest = first + (number - 1) * beam[GAP]
        if last < soonest:
            last = soonest
        row[base + 1] = first
        row[base + 2] = last
        since = row[ROW_TICKS] - last
    beam[SINCE] = since if since < _LONG else _LONG
    return 0


@micropython.viper
def leader(ring: ptr32, at: int) -> int:
    """The motor with the most steps in the block at ring[at]: each of its steps is an event."""
    motor = 0
    while ring[at + STEPS + motor] != ring[at + EVENTS]:
        motor += 1
    return motor


@micropython.viper
def begun(done: int, events: int, parts: int) -> int:
    """How many of the dots that share the events have begun, when so many are done."""
    return (done * parts + events - 1) // events


@micropython.viper
def dots(
    flow: ptr32,
    ring: ptr32,
    table: ptr32,
    row: ptr32,
    beam: ptr32,
    levels: ptr32,
    clusters: ptr32,
    own: int,
) -> int:
    """The changes of power in a segment of a cluster, whose row begins at clusters[own].

    Dots are as long as each other, and the first begins with the block. Where power follows speed,
    a segment in which no dot begins has the power of the old one at its own speed.
    """
    at = flow[AT]
    events = ring[at + EVENTS]
    count = clusters[own]
    parts = count if count < events else events
    motor = int(leader(ring, at))
    base = ROW_AXES + ROW_STRIDE * motor
    done = events - flow[MOTORS + 2 * motor]
    before = done - row[base]
    dot = int(begun(before, events, parts))
    number = int(begun(done, events, parts)) - dot
    first = 0
    last = 0
    if number:
        whole = events * dot // parts
        over = events * dot - whole * parts
        if before:
            first = int(reach(row, base, whole - before, over, parts))
        whole = events * (dot + number - 1) // parts
        over = events * (dot + number - 1) - whole * parts
        last = int(reach(row, base, whole - before, over, parts)) if number > 1 else first
    elif ring[at + FLAGS] & DYNAMIC:
        number = 1
        dot -= 1
    begins = dot * events >= before * parts
    dynamic = ring[at + FLAGS] & DYNAMIC
    part = int(speed_share(flow, ring))
    for i in range(number):
        power = clusters[own + 1 + (dot + i if parts == count else (dot + i) * count // parts)]
        if dynamic:
            power = int(dimmed(table, power, part))
        if begins or power != beam[LEVEL]:
            emit(beam, levels, power)
        else:
            number = 0
    lay(table, row, beam, number, first, last)
    return 0


@micropython.viper
def mark(
    flow: ptr32,
    ring: ptr32,
    table: ptr32,
    row: ptr32,
    beam: ptr32,
    levels: ptr32,
    clusters: ptr32,
) -> int:
    """Put the changes of power into a segment just made: see segment_kernel.fill()."""
    at = flow[AT] // flow[ROW_SIZE] * beam[ROW]
    if clusters[at]:
        dots(flow, ring, table, row, beam, levels, clusters, at)
        if flow[LOADED] == 0:
            clusters[at] = 0
    else:
        number = 0
        if row[ROW_POWER] != beam[LEVEL]:
            emit(beam, levels, row[ROW_POWER])
            number = 1
        lay(table, row, beam, number, 0, 0)
    row[ROW_POWER] = KEEP_POWER
    return 0
