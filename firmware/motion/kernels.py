# mypy: disable-error-code=arg-type
"""Kernels: integers only, from a move in steps to segments of pulses.

Everything here is viper: it allocates nothing, knows no objects, and takes
and returns values from 0 to 2**30 - 1, so that it means the same on a 32-bit
board, on the 64-bit desktop MicroPython and under CPython.

A real is a positive number in one integer: see reals.py.

Speeds are squared and linear on one scale per machine, `machine[SQR_SCALE]`:
2**30 is the square of the highest speed any move can have. Within a block
speeds are in units of 2**-18 step of its longest axis per full segment.
"""

import micropython
from micropython import const

from motion.reals import div, mul, pack, product, ratio, square_root

# One row of the planner's ring: a block.
EVENTS = const(0)  # steps of its longest axis
DIRS = const(1)  # mask of motors that turn backwards
FLAGS = const(2)  # what the planner was told about it (planner.py)
LINE = const(3)  # line number N
POWER = const(4)  # spindle power while it runs; DYNAMIC blocks: at the programmed rate, in 1/64
LENGTH = const(5)  # real, mm
RATE = const(6)  # real, mm/s as programmed
RAPID = const(7)  # real, mm/s: what its axes allow
ACCEL = const(8)  # real, mm/s2: what its axes allow
NOMINAL = const(9)  # real, mm/s, overrides included
NOMINAL_SQR = const(10)
ENTRY_SQR = const(11)  # the planner's promise: from here, it can always stop in time
MAX_ENTRY_SQR = const(12)
JUNCTION_SQR = const(13)
DELTA_SQR = const(14)  # how much speed squared can change over the block
FACTOR = const(15)  # real: block speed units per (mm/s)
RAMP = const(16)  # acceleration in block speed units per segment
CRUISE = const(17)  # nominal speed in block speed units
PROGRAMMED = const(18)  # rate as programmed in block speed units
STEPS = const(19)  # per motor, without sign; behind them, per motor, steps * 2**29 / EVENTS


# What the kernels know of the machine.
AXES = const(0)
MOTOR_COUNT = const(1)
SQR_SCALE = const(2)  # real: scaled speed squared per (mm/s)2
JUNCTION = const(3)  # real: 2**16 * junction deviation * SQR_SCALE
SEGMENT_RATE = const(4)  # real: block speed units per (step/s)
SEGMENT_ACCEL = const(5)  # real: block speed units per segment, per (step/s2)
SEGMENT_LOG2 = const(6)  # a full segment is 2**SEGMENT_LOG2 ticks, 17 at the most
POWER_FLOOR = const(7)  # spindle power, in 1/64, up to which a DYNAMIC block gets the least power
POWER_MAX = const(8)  # spindle power at the most
SLOWEST = const(9)  # real, mm/s: no block is slower
FEED_PERCENT = const(10)  # overrides
RAPID_PERCENT = const(11)
ROOT_SCALE = const(12)  # real: mm/s per root of a scaled speed squared
LIMITS = const(13)  # three reals per axis: mm per step, mm/s, mm/s2
# Behind the limits, one of each per axis: direction of the last block, of the present one, its
# distances; and, so many times the axes behind the limits:
RESOLUTION = const(6)  # steps/mm, bits of a float
TARGET = const(7)  # steps + 2**29
POSITION = const(8)  # steps + 2**29 where the last block ends
MOVES = const(9)  # per motor: bit n, its steps go up with those of axis n; bit n + REVERSE, down
REVERSE = const(8)

# The flow: what planner (main loop) and segments (interrupt) share, and where motion is.
ROW_SIZE = const(0)  # integers in a block
ROWS = const(1)  # blocks in the ring; one more behind them is the system's own
HEAD = const(2)  # the main loop's: where the next block goes
TAIL = const(3)  # the interrupt's: the block being executed
HOLD = const(4)  # the main loop's: come to rest, and stay
SYSTEM = const(5)  # 1: run the system's own block and no other; 2: that is done
LOADED = const(6)  # the interrupt's from here on
AT = const(7)  # where in the ring the loaded block begins
NOW = const(8)  # speed in block speed units
CARRY = const(9)  # real, mm/s: speed between blocks
LEAVE = const(10)  # speed at which to leave the block
LEAVE_SQR = const(11)  # the same as the planner put it
WHOLE = const(12)  # steps of the longest axis still to go,
FRACTION = const(13)  # and 2**-18 of one
PARTIAL = const(14)  # distance come since the last step of the longest axis, in 2**-18 step,
SPARE = const(15)  # and its time, in ticks: both go into the next segment
ADVANCE = const(16)  # distance of the segment being made,
LEFT = const(17)  # and what it still lacks of a full one, in 2**-17
BRAKE_FROM = const(18)  # braking from this speed to that takes so many whole steps,
BRAKE_TO = const(19)
BRAKE_WAY = const(20)
BRAKE_UNIT = const(21)  # or, where this is 18, so much in 2**-18 step
MOTORS = const(22)  # per motor: steps still to go; phase, 2**18 is a step
FLOW_LENGTH = const(22)

# Flags of a block that the kernels look at; planner.py has the others.
RAPID_MOTION = const(0x01)
SYSTEM_MOTION = const(0x02)  # homing and parking: from rest, to rest, outside the ring's order
NO_FEED_OVERRIDE = const(0x04)
INVERSE_TIME = const(0x08)  # RATE is per block, not per mm
DYNAMIC = const(0x40)  # spindle power follows speed (laser, M4)

# A row that goes to the pulse engine: a segment.
ROW_TICKS = const(0)  # how long it lasts
ROW_DIRS = const(1)  # mask of motors that turn backwards
ROW_POWER = const(2)  # spindle power, or KEEP_POWER
# Per motor: steps, tick of the first, tick of the last, the others evenly between.
ROW_AXES = const(3)
ROW_STRIDE = const(3)
KEEP_POWER = const(0x3FFFFFFF)

# From motion/reals.py.
_SMALLEST = const(16384)
_LIMIT = const(32768)
_BIAS = const(64)
_HIGHEST = const(0x3FFFFFFF)

_ONE = const(0x194000)  # the real 1
_LEAST = const(0x50000)  # a segment covers 1.25 steps, where the block reaches that far,
_LONGEST = const(0x8000000)  # or lasts as long as 1024 full ones
_HAIR = const(0x800)  # ahead of the truth, so that rounding does not cost the last step of a hold
_SPLINTER = const(64)  # a segment is not filled up with pieces as short as that, in 2**-17


def block_length(motors: int) -> int:
    """Integers in a row of the planner's ring."""
    return STEPS + 2 * motors


def machine_length(axes: int, motors: int) -> int:
    """Integers in the table of what the kernels know of the machine."""
    return LIMITS + MOVES * axes + motors


def row_length(motors: int) -> int:
    """Integers in a segment row."""
    return ROW_AXES + ROW_STRIDE * motors


@micropython.viper
def copy(source: ptr32, target: ptr32, count: int) -> int:
    """Copy integers, or floats as bits."""
    for i in range(count):
        target[i] = source[i]
    return 0


@micropython.viper
def to_steps(target: ptr32, machine: ptr32) -> int:
    """Round mm times steps/mm to whole steps, halves away from zero, into TARGET of the machine.

    mm and steps/mm are single precision, seen as integers; the product is
    rounded to single precision first, as Grbl's is. Returns 0 where an axis
    leaves +-2**29 steps.
    """
    inside = 1
    axes = machine[AXES]
    resolution = LIMITS + RESOLUTION * axes
    signs = ptr8(target)
    for i in range(axes):
        a = target[i] & 0x3FFFFFFF
        high = (signs[4 * i + 3] & 0x40) << 24
        b = machine[resolution + i]
        exponent = ((a + high) >> 23) + (b >> 23) - 254
        a = (a & 0x7FFFFF) | 0x800000
        b = (b & 0x7FFFFF) | 0x800000
        middle = (a >> 12) * (b & 0xFFF) + (a & 0xFFF) * (b >> 12)
        low = (a & 0xFFF) * (b & 0xFFF) + ((middle & 0xFFF) << 12)
        product = (a >> 12) * (b >> 12) + (middle >> 12) + (low >> 24)
        low &= 0xFFFFFF
        if product >= 0x800000:
            exponent += 1
        else:
            product = (product << 1) | (low >> 23)
            low = (low << 1) & 0xFFFFFF
        if low > 0x800000 or (low == 0x800000 and product & 1):
            product += 1
        if exponent > 28:
            inside = 0
            product = 0x1FFFFFFF  # as far as it goes, on the right side
        elif exponent >= 23:
            product <<= exponent - 23
        elif exponent >= -1:
            product = ((product >> (22 - exponent)) + 1) >> 1
        else:
            product = 0
        if signs[4 * i + 3] & 0x80:
            product = 0 - product
        machine[resolution + axes + i] = 0x20000000 + product
    return inside


@micropython.viper
def motor_steps(places: ptr32, at: int, axes: int, moves: int) -> int:
    """Steps of a motor on the way to a place of the axes, from the one that stands behind it.

    moves: what the motor does; see MOVES.
    """
    steps = 0
    for i in range(axes):
        turns = ((moves >> i) & 1) - ((moves >> (i + REVERSE)) & 1)
        steps += turns * (places[at + i] - places[at + axes + i])
    return steps


@micropython.viper
def measure(machine: ptr32, ring: ptr32, at: int) -> int:
    """Begin a block, from POSITION to TARGET: steps, directions, length in mm. Returns EVENTS.

    As in Grbl, length is that of the motors' way, one per axis. Their distances (reals) are left
    in the table of the machine for limit().
    """
    axes = machine[AXES]
    distance = LIMITS + 5 * axes
    target = LIMITS + TARGET * axes
    moves = LIMITS + MOVES * axes
    top = 0
    dirs = 0
    events = 0
    for i in range(machine[MOTOR_COUNT]):
        does = machine[moves + i]
        if does == 1 << i:
            steps = machine[target + i] - machine[target + axes + i]
        else:
            steps = int(motor_steps(machine, target, axes, does))
        if steps < 0:
            dirs |= 1 << i
            steps = 0 - steps
        ring[at + STEPS + i] = steps
        if i >= axes:
            continue  # the way is that of the motor that it goes with
        mantissa = 0
        exponent = 0
        if steps:
            mantissa = steps
            while mantissa >= _LIMIT:
                mantissa >>= 1
                exponent += 1
            mm_per_step = machine[LIMITS + 3 * i]
            mantissa *= mm_per_step & 32767
            exponent += mm_per_step >> 15
            while mantissa >= _LIMIT:
                mantissa >>= 1
                exponent += 1
            if exponent > top:
                top = exponent
            if steps > events:
                events = steps
        machine[distance + i] = (exponent << 15) + mantissa
    squares = 0
    for i in range(axes):
        mantissa = machine[distance + i]
        if mantissa:
            shift = top - (mantissa >> 15) + 1
            mantissa = (mantissa & 32767) >> shift if shift < 15 else 0
            squares += mantissa * mantissa
    ring[at + EVENTS] = events
    ring[at + DIRS] = dirs
    if events:
        ring[at + LENGTH] = int(pack(int(square_root(squares)), top + 1))
    return events


@micropython.viper
def limit(machine: ptr32, ring: ptr32, at: int) -> int:
    """What the axes of a measured block allow: its RAPID and ACCEL; and its direction.

    A limit is the smallest, over the axes, of axis limit * length / distance.
    Unit vectors are kept per axis as 16384 + component * 16384.
    """
    axes = machine[AXES]
    length = ring[at + LENGTH]
    rapid = _HIGHEST
    accel = _HIGHEST
    direction = LIMITS + 4 * axes
    for i in range(axes):
        mm = machine[direction + axes + i]
        component = 0
        if mm:
            shift = (length >> 15) - (mm >> 15)
            if shift < 15:
                component = (((mm & 32767) << 14) // (length & 32767)) >> shift
            if component > 16384:
                component = 16384
            scale = ((length & 32767) << 14) // (mm & 32767)
            for k in range(1, 3):
                limiting = machine[LIMITS + 3 * i + k]
                mantissa = ((limiting & 32767) * scale) >> 14
                exponent = (limiting >> 15) + shift
                if mantissa >= _LIMIT:
                    mantissa >>= 1
                    exponent += 1
                elif mantissa < _SMALLEST:
                    mantissa <<= 1
                    exponent -= 1
                limiting = (exponent << 15) + mantissa
                if k == 1:
                    if limiting < rapid:
                        rapid = limiting
                elif limiting < accel:
                    accel = limiting
        machine[direction + i] = component
    ring[at + RAPID] = rapid
    ring[at + ACCEL] = accel
    return 0


@micropython.viper
def turn(machine: ptr32, dirs: int) -> int:
    """How fast, squared, the machine may go from the previous block into this one.

    Junction deviation: the speed at which an arc that keeps within $11 of the
    corner would need the axes' acceleration. With the change of direction D,
    its cosine of half the angle c, and the acceleration along it that no axis
    exceeds, v2 = accel * deviation * 4 c (1 + c) / D2.
    """
    axes = machine[AXES]
    previous = LIMITS + 3 * axes
    squares = 0
    least = _HIGHEST
    for i in range(axes):
        component = machine[previous + axes + i]
        component = 16384 - component if (dirs >> i) & 1 else 16384 + component
        change = component - machine[previous + i]
        machine[previous + i] = component
        if change < 0:
            change = 0 - change
        squares += change * change
        if change or component != 16384:
            # One more than it seems: a weak axis that hardly turns is not overlooked.
            accel = machine[LIMITS + 3 * i + 2]
            mantissa = ((accel & 32767) << 15) // (change + 1)
            exponent = (accel >> 15) - 15
            while mantissa >= _LIMIT:
                mantissa >>= 1
                exponent += 1
            accel = (exponent << 15) + mantissa
            if accel < least:
                least = accel
    if squares < 16:
        return _HIGHEST
    if squares >= 0x3FFFFC00:
        return 0
    change = int(square_root(squares))
    cosine = int(square_root(0x3FFFFFFF - squares)) >> 1
    shape = (((cosine * (16384 + cosine)) >> 14) << 15) // change
    return int(product(int(pack(shape, _BIAS - 15)), least, machine[JUNCTION]))


@micropython.viper
def schedule(machine: ptr32, ring: ptr32, at: int) -> int:
    """What the interrupt will want to know of a block; also after an override has changed."""
    flags = ring[at + FLAGS]
    rate = ring[at + RATE]
    nominal = rate
    percent = machine[RAPID_PERCENT] if flags & RAPID_MOTION else machine[FEED_PERCENT]
    if percent != 100 and not flags & NO_FEED_OVERRIDE:
        nominal = int(div(int(mul(nominal, int(pack(percent, _BIAS)))), int(pack(100, _BIAS))))
    if nominal > ring[at + RAPID]:
        nominal = ring[at + RAPID]
    if nominal < machine[SLOWEST]:
        nominal = machine[SLOWEST]
    ring[at + NOMINAL] = nominal
    accel = ring[at + ACCEL]
    scale = machine[SQR_SCALE]
    per_mm = int(ratio(ring[at + EVENTS], ring[at + LENGTH]))
    factor = int(mul(per_mm, machine[SEGMENT_RATE]))
    ring[at + FACTOR] = factor
    ramp = int(product(accel, per_mm, machine[SEGMENT_ACCEL]))
    ring[at + RAMP] = ramp if ramp else 1
    cruise = int(product(nominal, factor, _ONE))
    ring[at + CRUISE] = cruise if cruise else 1
    ring[at + PROGRAMMED] = cruise if rate == nominal else int(product(rate, factor, _ONE))
    ring[at + NOMINAL_SQR] = int(product(nominal, nominal, scale))
    ring[at + DELTA_SQR] = int(product(accel + _LIMIT, ring[at + LENGTH], scale))  # twice
    return 0


@micropython.viper
def ratios(ring: ptr32, at: int, motors: int) -> int:
    """A block's steps per motor as parts of its EVENTS, in 2**-29."""
    events = ring[at + EVENTS]
    width = 15 if events < _LIMIT else (9 if events < 1 << 21 else 1)
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
def join(machine: ptr32, ring: ptr32, flow: ptr32) -> int:
    """Put the block that has been made at HEAD into the ring."""
    size = flow[ROW_SIZE]
    head = flow[HEAD]
    at = head * size
    junction = int(turn(machine, ring[at + DIRS]))
    if head == flow[TAIL]:
        junction = 0  # from rest
    ring[at + JUNCTION_SQR] = junction
    ring[at + ENTRY_SQR] = 0
    limit_entry(ring, flow, head)
    axes = machine[AXES]
    target = LIMITS + TARGET * axes
    for i in range(axes):
        machine[target + axes + i] = machine[target + i]
    head += 1
    flow[HEAD] = head if head < flow[ROWS] else 0
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
    machine: ptr32,
    ring: ptr32,
    flow: ptr32,
    flags: int,
    line: int,
    power: int,
    rate: int,
) -> int:
    """Add a block from POSITION to target, in mm. Returns 0 where it has no steps.

    rate: real, mm/s, or 1/s with INVERSE_TIME. There has to be room.
    """
    at = flow[ROWS] if flags & SYSTEM_MOTION else flow[HEAD]
    at *= flow[ROW_SIZE]
    to_steps(target, machine)
    if int(measure(machine, ring, at)) == 0:
        return 0
    limit(machine, ring, at)
    ring[at + FLAGS] = flags
    ring[at + LINE] = line
    ring[at + POWER] = power
    if flags & RAPID_MOTION:
        rate = ring[at + RAPID]
    elif flags & INVERSE_TIME:
        rate = int(mul(rate, ring[at + LENGTH]))
    ring[at + RATE] = rate
    schedule(machine, ring, at)
    ratios(ring, at, machine[MOTOR_COUNT])
    if flags & SYSTEM_MOTION:
        flow[SYSTEM] = 1
    else:
        join(machine, ring, flow)
    return 1


@micropython.viper
def reverse_pass(ring: ptr32, flow: ptr32, everything: int) -> int:
    """Raise the blocks' entry speeds to what they can brake from by the end of the last one.

    Works from the newest block back and stops where nothing changes, unless
    everything is to be done. The block at the tail is being executed: its
    entry is history. Returns how many blocks were looked at.
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
        if entry == ring[at + ENTRY_SQR] and everything == 0 and seen > 1:
            break
        ring[at + ENTRY_SQR] = entry
        exit_sqr = entry
    return seen


# From here on everything runs in the engine's interrupt.


@micropython.viper
def share(part: int, all: int) -> int:
    """part / all in 2**-17, for part <= all; 2**17 where it is more."""
    if part >= all:
        return 131072
    while all >= 1 << 22:
        all >>= 1
        part >>= 1
    part <<= 9
    high = part // all
    return (high << 8) + (((part - high * all) << 8) // all)


@micropython.viper
def times(x: int, part: int) -> int:
    """x * part for a part in 2**-17, as in share()."""
    return (x >> 15) * (part >> 2) + (((x & 32767) * (part >> 2)) >> 15)


@micropython.viper
def braking(fast: int, slow: int, ramp: int, unit: int) -> int:
    """Distance, in 2**-unit steps, over which ramp changes one speed into the other."""
    if fast == slow:
        return 0
    total = fast + slow
    change = fast - slow
    exponent = unit - 19
    while total >= _LIMIT:
        total >>= 1
        exponent += 1
    while change >= _LIMIT:
        change >>= 1
        exponent += 1
    while change < _SMALLEST:
        change <<= 1
        exponent -= 1
    while ramp >= _LIMIT:
        ramp >>= 1
        exponent -= 1
    change = total * change // ramp
    if exponent < 0:
        return change >> (0 - exponent) if exponent > -31 else 0
    if exponent > 30 or change > _HIGHEST >> exponent:
        return _HIGHEST
    return change << exponent


@micropython.viper
def after(speed: int, ramp: int, distance: int, down: int) -> int:
    """Speed after speeding up, or slowing down, by ramp over a distance: v2 +- 2 ramp distance."""
    square = int(pack(speed, _BIAS))
    square = int(mul(square, square))
    change = int(mul(int(pack(ramp, _BIAS + 1)), int(pack(distance, _BIAS))))
    exponent = square >> 15
    if change >> 15 > exponent:
        exponent = change >> 15
    shift = exponent - (square >> 15)
    mantissa = ((square & 32767) << 14) >> shift if shift < 30 else 0
    shift = exponent - (change >> 15)
    other = ((change & 32767) << 14) >> shift if shift < 30 else 0
    mantissa = mantissa - other if down else mantissa + other
    if mantissa <= 0:
        return 0
    exponent -= _BIAS + 14
    if exponent & 1:
        mantissa >>= 1
        exponent += 1
    root = int(square_root(mantissa))
    exponent >>= 1
    if exponent < 0:
        return root >> (0 - exponent)
    return root << exponent if exponent < 30 and root <= _HIGHEST >> exponent else _HIGHEST


@micropython.viper
def load(flow: ptr32, ring: ptr32, motors: int) -> int:
    """Take up the next block. Returns 0 where there is none."""
    at = flow[ROWS] if flow[SYSTEM] else flow[TAIL]
    if flow[SYSTEM] == 2 or at == flow[HEAD]:
        return 0
    at *= flow[ROW_SIZE]
    flow[AT] = at
    speed = int(product(flow[CARRY], ring[at + FACTOR], _ONE))
    cruise = ring[at + CRUISE]
    if speed < cruise and speed + (cruise >> 9) >= cruise:
        speed = cruise  # what rounding took off between blocks
    flow[NOW] = speed
    flow[LEAVE] = 0
    flow[LEAVE_SQR] = 0
    flow[WHOLE] = ring[at + EVENTS]
    flow[FRACTION] = 0
    flow[PARTIAL] = _HAIR
    flow[BRAKE_FROM] = 0
    flow[SPARE] = 0
    for i in range(motors):
        flow[MOTORS + 2 * i] = ring[at + STEPS + i]
        flow[MOTORS + 2 * i + 1] = 131072  # half a step: all step where they are nearest the line
    flow[LOADED] = 1
    return 1


@micropython.viper
def look_ahead(flow: ptr32, ring: ptr32, scale: int) -> int:
    """The speed at which to leave the loaded block: the planner's promise for the next one."""
    sqr = 0
    following = flow[TAIL] + 1
    if following == flow[ROWS]:
        following = 0
    if flow[SYSTEM] == 0 and following != flow[HEAD]:
        sqr = ring[following * flow[ROW_SIZE] + ENTRY_SQR]
    if sqr != flow[LEAVE_SQR]:
        flow[LEAVE_SQR] = sqr
        exponent = _BIAS
        while sqr and sqr < 1 << 28:
            sqr <<= 2
            exponent -= 1
        root = int(square_root(sqr))  # 15 bits, unless 0
        root = (exponent << 15) + root if root else 0
        flow[LEAVE] = int(product(root, scale, ring[flow[AT] + FACTOR]))
    return flow[LEAVE]


@micropython.viper
def approach(flow: ptr32, ramp: int, goal: int, room: int) -> int:
    """The next piece speeds up, or slows down, by ramp to a goal, as far as there is room."""
    speed = flow[NOW]
    down = 1 if goal < speed else 0
    part = int(share(speed - goal if down else goal - speed, ramp))
    end = goal
    if part >= flow[LEFT]:
        part = flow[LEFT]
        end = speed - int(times(ramp, part)) if down else speed + int(times(ramp, part))
    distance = int(times((speed + end) >> 1, part))
    if distance >= room:
        distance = room
        end = int(after(speed, ramp, room, down))
        part = -1
    if end < goal if down else end > goal:
        end = goal
    if part < 0:
        part = int(share(room, (speed + end) >> 1))
    return int(piece(flow, end, distance, part))


@micropython.viper
def brake(flow: ptr32, ramp: int, leave: int, rest: int) -> int:
    """The next piece brakes so as to leave the block, rest ahead, at the speed planned.

    The rate of braking follows from what is left of the way, so that rounding
    never adds up; it stays within a sixteenth of the ramp.
    """
    speed = flow[NOW]
    left = flow[LEFT]
    end = leave
    mean = (speed + leave) >> 1
    if rest > int(times(mean, left)):
        most = int(times(ramp, left))
        change = most
        if rest < _HIGHEST:
            change = int(times(speed - leave, int(share(int(times(mean, left)), rest))))
            most += most >> 4
            if change > most:
                change = most
        end = speed - change
        mean = speed - (change >> 1)
        distance = int(times(mean, left))
        if distance > rest:
            distance = rest
            left = int(share(rest, mean))
    else:
        distance = rest
        left = int(share(rest, mean)) if mean else 1
        if speed - leave > int(times(ramp + (ramp >> 4), left)) + 4:
            end = int(after(speed, ramp, rest, 1))
            if end < leave:
                end = leave
            left = int(share(rest, (speed + end) >> 1))
    return int(piece(flow, end, distance, left))


# inline: always, for it runs several times for each block and segment
@micropython.viper
def piece(flow: ptr32, end: int, distance: int, part: int) -> int:
    """Add a piece to the segment being made. part: its duration in 2**-17 of a full segment."""
    if part > flow[LEFT]:
        part = flow[LEFT]
    flow[LEFT] = flow[LEFT] - part
    flow[NOW] = end
    flow[ADVANCE] = flow[ADVANCE] + distance
    distance = flow[FRACTION] - distance
    if distance < 0:
        steps = (0 - distance + 0x3FFFF) >> 18
        distance += steps << 18
        flow[WHOLE] = flow[WHOLE] - steps
    flow[FRACTION] = distance
    return flow[WHOLE] or distance


@micropython.viper
def proceed(flow: ptr32, ring: ptr32, scale: int) -> int:
    """Choose the next piece of the segment. Returns 0 at the end of the block.

    speed        ________            A piece is one of: speed up, cruise, brake,
                /        `.          slow down to a lowered nominal speed or to a hold.
               /           `. leave  It brakes as soon as the way left is no longer
      entry __/              `.__    than what braking takes.
    """
    at = flow[AT]
    ramp = ring[at + RAMP]
    top = ring[at + CRUISE]
    speed = flow[NOW]
    unit = 18 if flow[WHOLE] < 4095 else 0
    rest = (flow[WHOLE] << 18) + flow[FRACTION] if unit else _HIGHEST
    room = rest
    due = 0
    if flow[HOLD]:
        top = 0
    else:
        leave = int(look_ahead(flow, ring, scale))
        if leave > top:
            leave = top
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
            if speed < leave:
                slack += way if way < slack else slack
            else:
                slack -= way
                if slack <= (speed >> 8 if unit else 1):
                    due = 1
        if due == 0 and speed <= top:
            if unit == 0:
                slack = slack << 18 if slack < 2048 else _HIGHEST
            if speed < top:
                slack = (slack + 1) >> 1
            if slack < rest:
                room = slack
    if due:
        return int(brake(flow, ramp, leave, rest))
    if speed != top:
        return int(approach(flow, ramp, top, room))
    part = flow[LEFT]
    distance = speed if part == 131072 else int(times(speed, part))
    if room <= distance:
        distance = room
        part = int(share(room, speed))
    return int(piece(flow, speed, distance, part))


@micropython.viper
def close(flow: ptr32, row: ptr32, ticks: int) -> int:
    """End the segment with a step of the longest axis: whole steps, and the time they take.

    What is left over, distance and time, goes into the next segment. So every
    interval of a segment is the same, and at a constant speed every interval
    of a block. Returns the steps.
    """
    distance = flow[PARTIAL] + flow[ADVANCE]
    ticks += flow[SPARE]
    steps = distance >> 18
    rest = distance & 0x3FFFF
    flow[PARTIAL] = rest
    flow[SPARE] = 0
    if rest > _HAIR and steps:
        part = int(share(steps << 18, distance))
        whole_ticks = (((ticks >> 15) * part) >> 2) + (((ticks & 32767) * (part >> 2)) >> 15)
        flow[SPARE] = ticks - whole_ticks
        ticks = whole_ticks
    row[ROW_TICKS] = ticks if ticks else 1
    return steps


@micropython.viper
def spread(flow: ptr32, ring: ptr32, row: ptr32, motors: int) -> int:
    """Lay the segment's steps out in time: per motor how many, when the first and the last.

    A motor's phase runs on from segment to segment, so that at a constant
    speed its steps are evenly spaced. The block's last segment makes what is
    left to make.
    """
    high = flow[ADVANCE] >> 15
    low = flow[ADVANCE] & 32767
    ticks = row[ROW_TICKS]
    ratios = flow[AT] + STEPS + motors
    last = flow[WHOLE] == 0 and flow[FRACTION] == 0
    long = 0
    while ticks >> long >= 1 << 18:
        long += 1
    for i in range(motors):
        ratio = ring[ratios + i]
        phase = flow[MOTORS + 2 * i + 1]
        middle = high * (ratio & 32767) + low * (ratio >> 15) + ((low * (ratio & 32767)) >> 15)
        gain = ((high * (ratio >> 15)) << 1) + (middle >> 14)
        steps = (phase + gain) >> 18
        left = flow[MOTORS + 2 * i]
        if last or steps > left:
            steps = left
        at = ROW_AXES + ROW_STRIDE * i
        row[at] = steps
        flow[MOTORS + 2 * i] = left - steps
        flow[MOTORS + 2 * i + 1] = (phase + gain) & 0x3FFFF
        scale = 0
        while gain >= 1 << 21:
            gain >>= 1
            scale += 1
        for k in range(2 if steps else 0):
            part = (((steps if k else 1) << 18) - phase) >> scale
            if part < gain:
                coarse = (ticks >> long >> 9) * part
                quotient = coarse // gain
                rest = ((coarse - quotient * gain) << 9) + ((ticks >> long) & 511) * part
                part = ((quotient << 9) + (rest + (gain >> 1)) // gain) << long
            else:
                part = ticks
            row[at + 1 + k] = part
    return 0


@micropython.viper
def power(flow: ptr32, ring: ptr32, machine: ptr32) -> int:
    """Spindle power of the segment just made, of a block whose power follows speed."""
    at = flow[AT]
    full = ring[at + POWER]
    rate = ring[at + PROGRAMMED]
    if flow[NOW] < rate:
        full = int(times(full, int(share(flow[NOW], rate))))
    if full == 0:
        return 0
    if full <= machine[POWER_FLOOR]:
        return 1
    full = ((full - machine[POWER_FLOOR]) >> 6) + 1
    return full if full < machine[POWER_MAX] else machine[POWER_MAX]


@micropython.viper
def fill(flow: ptr32, ring: ptr32, machine: ptr32, row: ptr32) -> int:
    """Make the next segment. Returns 0 where nothing is to move: no block, or held at rest."""
    motors = machine[MOTOR_COUNT]
    if flow[LOADED] == 0:
        if flow[HOLD] and flow[CARRY] == 0:
            return 0
        if int(load(flow, ring, motors)) == 0:
            return 0
    elif flow[HOLD] and flow[NOW] == 0:
        return 0
    flow[LEFT] = 131072
    flow[ADVANCE] = 0
    span = 131072
    going = 1
    while going and not (flow[HOLD] and flow[NOW] == 0):
        if flow[LEFT] <= _SPLINTER:
            if flow[ADVANCE] + flow[PARTIAL] >= _LEAST or span == _LONGEST:
                break
            flow[LEFT] = flow[LEFT] + 131072
            span += 131072
        going = int(proceed(flow, ring, machine[ROOT_SCALE]))
    steps = int(close(flow, row, (span - flow[LEFT]) >> (17 - machine[SEGMENT_LOG2])))
    if steps == 0 and going and flow[HOLD] and flow[NOW] == 0:
        return 0  # at rest, less than a step further
    flow[ADVANCE] = steps << 18
    at = flow[AT]
    row[ROW_DIRS] = ring[at + DIRS]
    row[ROW_POWER] = ring[at + POWER]
    if ring[at + FLAGS] & DYNAMIC:
        row[ROW_POWER] = int(power(flow, ring, machine))
    spread(flow, ring, row, motors)
    if going == 0:
        flow[CARRY] = int(ratio(flow[NOW], ring[at + FACTOR]))
        flow[LOADED] = 0
        if flow[SYSTEM]:
            flow[SYSTEM] = 2
        else:
            tail = flow[TAIL] + 1
            flow[TAIL] = tail if tail < flow[ROWS] else 0
    return 1
