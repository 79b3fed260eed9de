# mypy: disable-error-code=arg-type
"""The planner's kernel: from a target to a block in the ring, and the speeds between blocks.

docs/motion.md derives the formulas. All of it is viper on integers: no allocation, no objects.
Arguments and results are from 0 to 2**30 - 1 unless a function says otherwise, so they mean the
same on a 32-bit board, on 64-bit desktop MicroPython and under CPython. layout.py has all places.
The ring has ROWS rows of ROW_SIZE integers, a block each, then the system's own block; `at` is the
index of a row. In the flow are numbers of rows: HEAD, of the next block to add; TAIL, of the one
being executed; and UNPLANNED: new blocks without a backward pass. From LIMITS on the table has
mm/step, mm/s and mm/s2 per axis, then, each per axis, the last block's direction, this one's, its
distances. Reals: minifloat.py. Main loop only; the interrupt reads the ring, writes only TAIL.

Speeds squared are scaled so that the square of the machine's highest speed is 2**30 (SQR_SCALE):
a sum of two fits 31 bits. An entry speed is a promise: the machine can brake for all that follows.
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
    HEAD,
    INVERSE_TIME,
    JUNCTION,
    JUNCTION_DERATE,
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
from motion.minifloat import (
    BIAS,
    HIGHEST,
    LIMIT,
    MANTISSA,
    ONE,
    SMALLEST,
    mul,
    pack,
    product,
    ratio,
    square_root,
)
from motion.steps import measure, to_steps

# With many blocks waiting, a backward pass takes longer than the rest of a block's planning. Until
# it comes their entry speed is 0, which is always safe.
NEAR = const(16)  # with fewer blocks waiting, a backward pass is run for each new one
AT_ONCE = const(4)  # with more waiting, one pass is run for so many new ones

# Reasons not to add a block: bits of a mask.
OUTSIDE = const(1)  # it leaves the machine's travel
FULL = const(2)  # the ring has no free row
_UNIT = const(16384)  # 1, of a component of a direction, in 2**-14
_REVERSAL = const(0x3FFFFC00)  # nearly 2**30, the square of 2 in 2**-28: |D|**2 of a reversal
_STRAIGHT = const(16)  # |D|**2 in 2**-28: less is rounding


@micropython.viper
def full(flow: ptr32) -> int:
    """Return FULL where the ring has no free row, else 0. One row always stays free."""
    following = flow[HEAD] + 1
    if following == flow[ROWS]:
        following = 0
    return FULL if following == flow[TAIL] else 0


@micropython.viper
def limit(table: ptr32, ring: ptr32, at: int) -> int:
    """Compute a block's RAPID (mm/s), ACCEL (mm/s2), both reals, and its direction, after
    steps.measure() has left its LENGTH and its distances per axis. Returns 0.

    An axis moves by distance / length of the path's speed, so the path's limit is the smallest,
    over the axes, of axis limit * length / distance. The direction goes into the table, for the
    next corner, as |component| * 16384 per axis; the signs are in DIRS.
    """
    axes = table[AXES]
    length = ring[at + LENGTH]
    rapid = HIGHEST
    accel = HIGHEST
    direction = LIMITS + 4 * axes  # its index in the table; the distances follow
    for i in range(axes):
        mm = table[direction + axes + i]
        component = 0
        if mm:
            # Both are reals. mm <= length, so shift >= 0; beyond 14 the component is nothing.
            shift = (length >> 15) - (mm >> 15)
            if shift < 15:
                component = (((mm & MANTISSA) << 14) // (length & MANTISSA)) >> shift
            if component > _UNIT:
                component = _UNIT
            # length / mm = scale * 2**(shift - 14), with scale between 2**13 and 2**15; k: 1, the
            # axis's speed; 2, its acceleration.
            scale = ((length & MANTISSA) << 14) // (mm & MANTISSA)
            for k in range(1, 3):
                # The real axis limit * length / mm.
                axis_limit = table[LIMITS + 3 * i + k]
                mantissa = ((axis_limit & MANTISSA) * scale) >> 14
                exponent = (axis_limit >> 15) + shift
                if mantissa >= LIMIT:
                    mantissa >>= 1
                    exponent += 1
                elif mantissa < SMALLEST:
                    mantissa <<= 1
                    exponent -= 1
                path_limit = (exponent << 15) + mantissa
                if k == 1:
                    if path_limit < rapid:
                        rapid = path_limit
                elif path_limit < accel:
                    accel = path_limit
        table[direction + i] = component
    ring[at + RAPID] = rapid
    ring[at + ACCEL] = accel
    return 0


@micropython.viper
def junction_speed_sqr(table: ptr32, dirs: int) -> int:
    """Return the squared speed allowed in the corner between the previous block and this one.

    Junction deviation, Grbl's idea (Sungeun K. Jeon): the speed at which a circle that stays
    within $11 of the corner would use the axes' acceleration.

        D = e1 - e0     the change of direction, between unit vectors; |D| = 2 sin(turn / 2)
        c = cos(turn / 2) = sqrt(1 - |D|**2 / 4)
        v**2 = deviation * 4 c (1 + c) / |D| * min over axes of accel_i / |D_i|

    Components are in 2**-14 and carry a bias of 16384 here, so they run from 0 to 32768. HIGHEST
    for a straight line, 0 for a reversal. dirs: DIRS of this block. Its direction is stored as the
    previous one of the next corner.
    """
    axes = table[AXES]
    previous = LIMITS + 3 * axes  # index of the last direction, followed by this one
    squares = 0
    least = HIGHEST
    for i in range(axes):
        component = table[previous + axes + i]
        component = _UNIT - component if (dirs >> i) & 1 else _UNIT + component
        change = component - table[previous + i]
        table[previous + i] = component
        if change < 0:
            change = 0 - change
        squares += change * change
        if change or component != _UNIT:
            # accel / |D_i|, a real; + 1, because an axis whose change is rounded to 0 may still be
            # the weakest.
            axis_accel = table[LIMITS + 3 * i + 2]  # a real, mm/s2
            mantissa = ((axis_accel & MANTISSA) << 15) // (change + 1)
            exponent = (axis_accel >> 15) - 15
            while mantissa >= LIMIT:
                mantissa >>= 1
                exponent += 1
            path_accel = (exponent << 15) + mantissa
            if path_accel < least:
                least = path_accel
    # |D|**2 in 2**-28, so 2**30 is a reversal.
    if squares < _STRAIGHT:
        return HIGHEST
    if squares >= _REVERSAL:
        return 0
    root = 0
    for _ in range(2):  # in 2**-14: |D|, then the root of 4 - |D|**2, twice the cosine
        size = root  # |D|, in the second round
        root = int(square_root(squares))
        squares = 0x3FFFFFFF - squares  # 4 in 2**-28, less |D|**2
    cosine = root >> 1
    # c (1 + c) / |D| in 2**-15. JUNCTION's 2**16 makes up for the 2**-14 of D_i, and is the 4.
    shape = (((cosine * (_UNIT + cosine)) >> 14) << 15) // size
    return int(product(int(pack(shape, BIAS - 15)), least, table[JUNCTION]))


@micropython.viper
def compute_profile(table: ptr32, ring: ptr32, at: int) -> int:
    """Compute what the interrupt needs of a block, from its RATE, ACCEL and the overrides.

    Called again when an override changes. With per_mm = EVENTS / LENGTH (steps per mm of the
    path), FACTOR = per_mm * SEGMENT_RATE turns mm/s into block speed units (segment_kernel.py):

        RAMP = ACCEL * per_mm * SEGMENT_ACCEL     change of speed in a full segment
        CRUISE = NOMINAL * FACTOR                 PROGRAMMED = RATE * FACTOR
        NOMINAL_SQR = NOMINAL**2 * SQR_SCALE      DELTA_SQR = 2 * ACCEL * LENGTH * SQR_SCALE
    """
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
    # RAMP, CRUISE, PROGRAMMED, NOMINAL_SQR, DELTA_SQR: a * b * c each. One loop, because product()
    # is inlined, and code takes memory.
    a = accel
    b = per_mm
    c = table[SEGMENT_ACCEL]
    for place in range(RAMP, RAMP + 5):
        number = int(product(a, b, c))
        if place <= CRUISE and number == 0:
            number = 1  # so that every block proceeds
        ring[at + place] = number
        # The factors of the next one.
        if place < PROGRAMMED:  # CRUISE, then PROGRAMMED
            a = nominal if place == RAMP else rate
            b = factor
            c = ONE
        elif place == PROGRAMMED:  # NOMINAL_SQR
            a = nominal
            b = nominal
            c = table[SQR_SCALE]
        else:  # DELTA_SQR
            a = accel + LIMIT  # twice accel: its exponent and one; c is still SQR_SCALE
            b = ring[at + LENGTH]
    return 0


@micropython.viper
def step_ratios(ring: ptr32, at: int, motors: int) -> int:
    """Compute each motor's steps / EVENTS, from 0 to 1 in 2**-29, into the row after STEPS.

    Long division. A digit has as many bits as fit 31 together with a remainder below EVENTS.
    """
    events = ring[at + EVENTS]
    width = 15 if events < 1 << 15 else (9 if events < 1 << 21 else 1)  # bits per digit
    for i in range(motors):
        rest = ring[at + STEPS + i]
        ratio = 0
        if rest == events:
            ratio = 0x20000000  # 1: this motor makes the most steps
        elif rest:
            bits = 29  # bits of the ratio still to be computed
            while bits:
                digit_bits = width if width < bits else bits
                rest <<= digit_bits
                digit = rest // events
                ratio = (ratio << digit_bits) + digit
                rest -= digit * events
                bits -= digit_bits
        ring[at + STEPS + motors + i] = ratio
    return 0


@micropython.viper
def append_block(table: ptr32, ring: ptr32, flow: ptr32) -> int:
    """Append the block in row HEAD to the ring: compute its corner's speed, advance HEAD, run the
    backward pass; in a well filled ring once for several blocks (NEAR, AT_ONCE). Returns 0."""
    size = flow[ROW_SIZE]
    head = flow[HEAD]
    at = head * size
    junction = int(junction_speed_sqr(table, ring[at + DIRS]))
    if head == flow[TAIL]:
        junction = 0  # the ring is empty: it starts at speed 0
    ring[at + JUNCTION_SQR] = junction
    ring[at + ENTRY_SQR] = 0
    limit_entry(ring, flow, head)
    if table[JUNCTION_DERATE]:
        ring[at + MAX_ENTRY_SQR] = 0  # until the extra that has set JUNCTION_DERATE sets it
    axes = table[AXES]
    target = LIMITS + TARGET * axes
    for i in range(axes):
        table[target + axes + i] = table[target + i]  # POSITION, after TARGET
    head += 1
    flow[HEAD] = head if head < flow[ROWS] else 0
    flow[UNPLANNED] += 1
    blocks = head - flow[TAIL]  # waiting, with the one being executed
    if blocks < 0:
        blocks += flow[ROWS]
    if blocks < NEAR or flow[UNPLANNED] >= AT_ONCE:
        reverse_pass(ring, flow, 0)
    return 0


@micropython.viper
def limit_entry(ring: ptr32, flow: ptr32, row: int) -> int:
    """Set a block's MAX_ENTRY_SQR, the least of three: its corner's speed squared, and the nominal
    speeds squared of this block and the one before. row: number of its row. Returns 0."""
    size = flow[ROW_SIZE]
    at = row * size
    previous = (row if row else flow[ROWS]) * size - size  # index of the block before
    entry = ring[at + JUNCTION_SQR]
    if entry > ring[at + NOMINAL_SQR]:
        entry = ring[at + NOMINAL_SQR]
    if entry > ring[previous + NOMINAL_SQR]:
        entry = ring[previous + NOMINAL_SQR]
    ring[at + MAX_ENTRY_SQR] = entry
    return 0


@micropython.viper
def plan_block(
    target: ptr32,
    table: ptr32,
    ring: ptr32,
    flow: ptr32,
    flags: int,
    line: int,
    power: int,
    rate: int,
) -> int:
    """Add a block from POSITION to target (mm, bits of floats). Returns 1, or 0 if it has no
    steps and is not added. flags: see layout.py; with PLACED, TARGET in the table is set already,
    and target is not read. line: the N word. power: of the spindle. rate: real, mm/s, or 1/s with
    INVERSE_TIME. With SYSTEM_MOTION it is the system's own block; else a row must be free: full().
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
    compute_profile(table, ring, at)
    step_ratios(ring, at, table[MOTOR_COUNT])
    if flags & SYSTEM_MOTION:
        flow[SYSTEM] = 1
    else:
        append_block(table, ring, flow)
    return 1


@micropython.viper
def reverse_pass(ring: ptr32, flow: ptr32, everything: int) -> int:
    """Raise entry speeds to what the machine can brake from by the end of the newest block.

    entry**2 = min(MAX_ENTRY_SQR, entry of the next block**2 + DELTA_SQR), from the newest back. It
    ends at the first block, before the new ones, where nothing changes, because nothing changes
    before that either; with everything set it goes on (an override has changed them all). The
    block at TAIL is being executed, so its entry is past. There is no forward pass: the interrupt
    accelerates as it can, and a promised speed that is not reached is a limit, no more. Returns
    how many blocks were visited.
    """
    size = flow[ROW_SIZE]
    row = flow[HEAD]  # number of the row, from the newest block back
    tail = flow[TAIL]
    exit_sqr = 0  # entry speed squared of the following block: the newest one ends at speed 0
    visited = 0
    while row != tail:
        row = row - 1 if row else flow[ROWS] - 1
        if row == tail:
            break
        at = row * size
        entry = exit_sqr + ring[at + DELTA_SQR]
        if entry > ring[at + MAX_ENTRY_SQR]:
            entry = ring[at + MAX_ENTRY_SQR]
        visited += 1
        if entry == ring[at + ENTRY_SQR] and everything == 0 and visited > flow[UNPLANNED]:
            break
        ring[at + ENTRY_SQR] = entry
        exit_sqr = entry
    flow[UNPLANNED] = 0
    return visited
