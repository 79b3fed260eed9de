# mypy: disable-error-code=arg-type
"""The planner's kernel: integers only, from a target to a block that joins the others.

Everything here is viper: it allocates nothing, knows no objects, and takes and returns values from
0 to 2**30 - 1, so that it means the same on a 32-bit board, on the 64-bit desktop MicroPython and
under CPython. What stands where is told in layout.py. Called by the main loop only.
"""

import micropython
from micropython import const

from motion.layout import (
    ACCEL,
    AXES,
    CRUISE,
    DELTA_SQR,
    DIRS,
    ENTRY_SQR,
    EVENTS,
    FACTOR,
    FEED_OVERRIDE,
    FLAGS,
    GENTLE,
    HEAD,
    INVERSE_TIME,
    JUNCTION,
    JUNCTION_SQR,
    LENGTH,
    LIMITS,
    LINE,
    MAX_ENTRY_SQR,
    MOTOR_COUNT,
    NO_FEED_OVERRIDE,
    NOMINAL,
    NOMINAL_SQR,
    PLACED,
    POWER,
    PROGRAMMED,
    RAMP,
    RAPID,
    RAPID_MOTION,
    RAPID_OVERRIDE,
    RATE,
    ROW_SIZE,
    ROWS,
    SEGMENT_ACCEL,
    SEGMENT_RATE,
    SLOWEST,
    SQR_SCALE,
    STEPS,
    SYSTEM,
    SYSTEM_MOTION,
    TAIL,
    TARGET,
    UNPLANNED,
)
from motion.reals import (
    BIAS,
    HIGHEST,
    LIMIT,
    ONE,
    SMALLEST,
    mul,
    pack,
    product,
    ratio,
    square_root,
)
from motion.steps import measure, to_steps

# Where more blocks than that wait, going back over all of them for each new one would take longer
# than the rest of its planning. So it is done for several at once: a new one's entry is 0 until
# then, which keeps every promise.
NEAR = const(16)
AT_ONCE = const(4)

# What may stand against a block (mask).
OUTSIDE = const(1)
FULL = const(2)


@micropython.viper
def full(flow: ptr32) -> int:
    """FULL, where the ring has no room."""
    following = flow[HEAD] + 1
    if following == flow[ROWS]:
        following = 0
    return FULL if following == flow[TAIL] else 0


@micropython.viper
def limit(table: ptr32, ring: ptr32, at: int) -> int:
    """What the axes of a measured block allow: its RAPID and ACCEL; and its direction.

    A limit is the smallest, over the axes, of axis limit * length / distance.
    Unit vectors are kept per axis as 16384 + component * 16384.
    """
    axes = table[AXES]
    length = ring[at + LENGTH]
    rapid = HIGHEST
    accel = HIGHEST
    direction = LIMITS + 4 * axes
    for i in range(axes):
        mm = table[direction + axes + i]
        component = 0
        if mm:
            shift = (length >> 15) - (mm >> 15)
            if shift < 15:
                component = (((mm & 32767) << 14) // (length & 32767)) >> shift
            if component > 16384:
                component = 16384
            scale = ((length & 32767) << 14) // (mm & 32767)
            for k in range(1, 3):
                limiting = table[LIMITS + 3 * i + k]
                mantissa = ((limiting & 32767) * scale) >> 14
                exponent = (limiting >> 15) + shift
                if mantissa >= LIMIT:
                    mantissa >>= 1
                    exponent += 1
                elif mantissa < SMALLEST:
                    mantissa <<= 1
                    exponent -= 1
                limiting = (exponent << 15) + mantissa
                if k == 1:
                    if limiting < rapid:
                        rapid = limiting
                elif limiting < accel:
                    accel = limiting
        table[direction + i] = component
    ring[at + RAPID] = rapid
    ring[at + ACCEL] = accel
    return 0


@micropython.viper
def turn(table: ptr32, dirs: int) -> int:
    """How fast, squared, the machine may go from the previous block into this one.

    Junction deviation: the speed at which an arc that keeps within $11 of the
    corner would need the axes' acceleration. With the change of direction D,
    its cosine of half the angle c, and the acceleration along it that no axis
    exceeds, v2 = accel * deviation * 4 c (1 + c) / D2.
    """
    axes = table[AXES]
    previous = LIMITS + 3 * axes
    squares = 0
    least = HIGHEST
    for i in range(axes):
        component = table[previous + axes + i]
        component = 16384 - component if (dirs >> i) & 1 else 16384 + component
        change = component - table[previous + i]
        table[previous + i] = component
        if change < 0:
            change = 0 - change
        squares += change * change
        if change or component != 16384:
            # One more than it seems: a weak axis that hardly turns is not overlooked.
            accel = table[LIMITS + 3 * i + 2]
            mantissa = ((accel & 32767) << 15) // (change + 1)
            exponent = (accel >> 15) - 15
            while mantissa >= LIMIT:
                mantissa >>= 1
                exponent += 1
            accel = (exponent << 15) + mantissa
            if accel < least:
                least = accel
    if squares < 16:
        return HIGHEST
    if squares >= 0x3FFFFC00:
        return 0
    cosine = 0
    for _ in range(2):
        change = cosine
        cosine = int(square_root(squares))
        squares = 0x3FFFFFFF - squares
    cosine >>= 1
    shape = (((cosine * (16384 + cosine)) >> 14) << 15) // change
    return int(product(int(pack(shape, BIAS - 15)), least, table[JUNCTION]))


@micropython.viper
def schedule(table: ptr32, ring: ptr32, at: int) -> int:
    """What the interrupt will want to know of a block; also after an override has changed."""
    flags = ring[at + FLAGS]
    rate = ring[at + RATE]
    nominal = rate
    override = table[RAPID_OVERRIDE] if flags & RAPID_MOTION else table[FEED_OVERRIDE]
    if override != ONE and not flags & NO_FEED_OVERRIDE:
        nominal = int(mul(nominal, override))
    if nominal > ring[at + RAPID]:
        nominal = ring[at + RAPID]
    if nominal < table[SLOWEST]:
        nominal = table[SLOWEST]
    ring[at + NOMINAL] = nominal
    accel = ring[at + ACCEL]
    per_mm = int(ratio(ring[at + EVENTS], ring[at + LENGTH]))
    factor = int(mul(per_mm, table[SEGMENT_RATE]))
    ring[at + FACTOR] = factor
    # Five products that stand one behind the other, and one place in the code for all of them.
    a = accel
    b = per_mm
    c = table[SEGMENT_ACCEL]
    for to in range(RAMP, RAMP + 5):
        number = int(product(a, b, c))
        if to <= CRUISE and number == 0:
            number = 1
        ring[at + to] = number
        if to < PROGRAMMED:
            a = nominal if to == RAMP else rate
            b = factor
            c = ONE
        elif to == PROGRAMMED:
            a = nominal
            b = nominal
            c = table[SQR_SCALE]
        else:
            a = accel + LIMIT  # twice
            b = ring[at + LENGTH]
    return 0


@micropython.viper
def ratios(ring: ptr32, at: int, motors: int) -> int:
    """A block's steps per motor as parts of its EVENTS, in 2**-29."""
    events = ring[at + EVENTS]
    width = 15 if events < LIMIT else (9 if events < 1 << 21 else 1)
    for i in range(motors):
        rest = ring[at + STEPS + i]
        ratio = 0
        if rest == events:
            ratio = 0x20000000
        elif rest:
            bits = 29
            while bits:
                take = width if width < bits else bits
                rest <<= take
                part = rest // events
                ratio = (ratio << take) + part
                rest -= part * events
                bits -= take
        ring[at + STEPS + motors + i] = ratio
    return 0


@micropython.viper
def join(table: ptr32, ring: ptr32, flow: ptr32) -> int:
    """Put the block that has been made at HEAD into the ring."""
    size = flow[ROW_SIZE]
    head = flow[HEAD]
    at = head * size
    junction = int(turn(table, ring[at + DIRS]))
    if head == flow[TAIL]:
        junction = 0  # from rest
    ring[at + JUNCTION_SQR] = junction
    ring[at + ENTRY_SQR] = 0
    limit_entry(ring, flow, head)
    if table[GENTLE]:
        ring[at + MAX_ENTRY_SQR] = 0  # until the extra that wants it so has seen to it
    axes = table[AXES]
    target = LIMITS + TARGET * axes
    for i in range(axes):
        table[target + axes + i] = table[target + i]
    head += 1
    flow[HEAD] = head if head < flow[ROWS] else 0
    flow[UNPLANNED] += 1
    waiting = head - flow[TAIL]
    if waiting < 0:
        waiting += flow[ROWS]
    if waiting < NEAR or flow[UNPLANNED] >= AT_ONCE:
        reverse_pass(ring, flow, 0)
    return 0


@micropython.viper
def limit_entry(ring: ptr32, flow: ptr32, row: int) -> int:
    """No block is entered faster than it, the one before, or the corner between them allow."""
    size = flow[ROW_SIZE]
    at = row * size
    before = (row if row else flow[ROWS]) * size - size
    entry = ring[at + JUNCTION_SQR]
    if entry > ring[at + NOMINAL_SQR]:
        entry = ring[at + NOMINAL_SQR]
    if entry > ring[before + NOMINAL_SQR]:
        entry = ring[before + NOMINAL_SQR]
    ring[at + MAX_ENTRY_SQR] = entry
    return 0


@micropython.viper
def plan(
    target: ptr32,
    table: ptr32,
    ring: ptr32,
    flow: ptr32,
    flags: int,
    line: int,
    power: int,
    rate: int,
) -> int:
    """Add a block from POSITION to target, in mm. Returns 0 where it has no steps.

    flags: with PLACED, TARGET is known already. rate: real, mm/s, or 1/s with INVERSE_TIME. There
    has to be room.
    """
    at = flow[ROWS] if flags & SYSTEM_MOTION else flow[HEAD]
    at *= flow[ROW_SIZE]
    if not flags & PLACED:
        to_steps(target, table)
    if int(measure(table, ring, at)) == 0:
        return 0
    limit(table, ring, at)
    ring[at + FLAGS] = flags
    ring[at + LINE] = line
    ring[at + POWER] = power
    if flags & RAPID_MOTION:
        rate = ring[at + RAPID]
    elif flags & INVERSE_TIME:
        rate = int(mul(rate, ring[at + LENGTH]))
    ring[at + RATE] = rate
    schedule(table, ring, at)
    ratios(ring, at, table[MOTOR_COUNT])
    if flags & SYSTEM_MOTION:
        flow[SYSTEM] = 1
    else:
        join(table, ring, flow)
    return 1


@micropython.viper
def reverse_pass(ring: ptr32, flow: ptr32, everything: int) -> int:
    """Raise the blocks' entry speeds to what they can brake from by the end of the last one.

    Works from the newest block back, past all that are new, and stops where
    nothing changes, unless everything is to be done. The block at the tail is
    being executed: its entry is history. Returns how many blocks were looked at.
    """
    size = flow[ROW_SIZE]
    head = flow[HEAD]
    tail = flow[TAIL]
    exit_sqr = 0
    seen = 0
    while head != tail:
        head = head - 1 if head else flow[ROWS] - 1
        if head == tail:
            break
        at = head * size
        entry = exit_sqr + ring[at + DELTA_SQR]
        if entry > ring[at + MAX_ENTRY_SQR]:
            entry = ring[at + MAX_ENTRY_SQR]
        seen += 1
        if entry == ring[at + ENTRY_SQR] and everything == 0 and seen > flow[UNPLANNED]:
            break
        ring[at + ENTRY_SQR] = entry
        exit_sqr = entry
    flow[UNPLANNED] = 0
    return seen
