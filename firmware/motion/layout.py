"""Layout: the places (indexes) in the arrays of integers that motion uses.

Blocks are the rows of the planner's ring. The table has what the kernels need to know of the
machine. The flow is shared by main loop and interrupt. Segments are the rows that go to a pulse
engine. Planner, kernels and engines use these names; `ugrbl build` replaces them by the numbers.

Speeds are squared and linear on one scale per machine, `table[SQR_SCALE]`: 2**30 is the square
of the highest speed any move can have. Within a block speeds are in units of 2**-18 step of its
longest axis per full segment. A real is a positive number in one integer: see minifloat.py.
"""

from array import array

from micropython import const

# One row of the planner's ring: a block.
EVENTS = const(0)  # steps of its longest axis
DIRS = const(1)  # mask of motors that turn backwards
FLAGS = const(2)  # flags of the move: below, and planner.py
LINE = const(3)  # line number N
POWER = const(4)  # spindle power while it runs; DYNAMIC blocks: at the programmed rate, in 1/64
LENGTH = const(5)  # real, mm
RATE = const(6)  # real, mm/s as programmed
RAPID = const(7)  # real, mm/s: limit of its axes
ACCEL = const(8)  # real, mm/s2: limit of its axes
NOMINAL = const(9)  # real, mm/s, overrides included
ENTRY_SQR = const(10)  # the planner's promise: after it, motion can always stop in time
MAX_ENTRY_SQR = const(11)
JUNCTION_SQR = const(12)
FACTOR = const(13)  # real: block speed units per (mm/s)
RAMP = const(14)  # acceleration in block speed units per segment
CRUISE = const(15)  # nominal speed in block speed units
PROGRAMMED = const(16)  # programmed rate in block speed units
NOMINAL_SQR = const(17)
DELTA_SQR = const(18)  # largest change of speed squared over the block
STEPS = const(19)  # per motor, without sign; then, per motor, steps * 2**29 / EVENTS


# The table of the machine, for the kernels.
AXES = const(0)
MOTOR_COUNT = const(1)
SQR_SCALE = const(2)  # real: scaled speed squared per (mm/s)2
JUNCTION = const(3)  # real: 2**16 * junction deviation * SQR_SCALE
SEGMENT_RATE = const(4)  # real: block speed units per (step/s)
SEGMENT_ACCEL = const(5)  # real: block speed units per segment, per (step/s2)
SEGMENT_LOG2 = const(6)  # a full segment is 2**SEGMENT_LOG2 ticks, 17 at most
POWER_FLOOR = const(7)  # spindle power, in 1/64, up to which a DYNAMIC block gets the least power
POWER_MAX = const(8)  # highest spindle power
SLOWEST = const(9)  # real, mm/s: no block is slower
FEED_OVERRIDE = const(10)  # reals: as a fraction, 1 for 100 %
RAPID_OVERRIDE = const(11)
ROOT_SCALE = const(12)  # real: mm/s per root of a scaled speed squared
SLICE = const(13)  # length of a row where the speed changes, in 2**-17 of a full segment
# Real: how much slower corners are planned, per mm/s2, as a root of a scaled speed squared; 0
# unless an extra sets it.
JUNCTION_DERATE = const(14)
LIMITS = const(15)  # three reals per axis: mm per step, mm/s, mm/s2
# After the limits, one each per axis: direction of the last block, direction of the present one,
# its distances. Then, at these multiples of the number of axes after LIMITS:
RESOLUTION = const(6)  # steps/mm: a float, as its bits
TARGET = const(7)  # steps + 2**29
POSITION = const(8)  # steps + 2**29 where the last block ends
MOVES = const(9)  # per motor: bit n, its steps go up with those of axis n; bit n + REVERSE, down
REVERSE = const(8)

# The flow: what planner (main loop) and segments (interrupt) share, and where motion is.
ROW_SIZE = const(0)  # integers in a block
ROWS = const(1)  # blocks in the ring; the system's own block follows them
HEAD = const(2)  # the main loop's: number of the row where the next block is put
TAIL = const(3)  # the interrupt's: number of the row of the block being executed
HOLD = const(4)  # the main loop's: 1: stop, and stay stopped
SYSTEM = const(5)  # 1: execute only the system's own block; 2: it has been executed
LOADED = const(6)  # the interrupt's, from here on: 1: a block is loaded
BLOCK_AT = const(7)  # index in the ring of the loaded block's first integer
END_SPEED = const(8)  # speed in block speed units, at the end of the segment planned
JOIN_SPEED = const(9)  # real, mm/s: speed between blocks
LEAVE_SPEED = const(10)  # speed at which to leave the block, in block speed units
LEAVE_SQR = const(11)  # the same as the planner set it: squared and scaled
STEPS_LEFT = const(12)  # steps of the longest axis still to be planned
FRACTION_LEFT = const(13)  # 2**-18 of a step still to be planned, too
PARTIAL_STEP = const(14)  # distance since the last step of the longest axis, in 2**-18 step
SPARE_TICKS = const(15)  # time since then, in ticks: both are added to the next row
PLANNED_DISTANCE = const(16)  # distance of the segment planned that is not yet in a row
TIME_TO_FILL = const(17)  # time that the segment lacks to a full one, in 2**-17 of that
BRAKE_FROM = const(18)  # speed from which BRAKE_DISTANCE is the way to brake to BRAKE_TO
BRAKE_TO = const(19)
BRAKE_DISTANCE = const(20)
BRAKE_UNIT = const(21)  # BRAKE_DISTANCE is in 2**-BRAKE_UNIT step: 18, or 0
UNPLANNED = const(22)  # the main loop's: blocks that reverse_pass() has not visited yet
SLICES = const(23)  # most rows into which the rest of the planned segment is cut;
PLANNED_TIME = const(24)  # how long they last, in 2**-17 of a full segment;
ROW_SPEED = const(25)  # speed at the end of the last row, where the next one begins
PIECE_AT = const(26)  # index in the flow of the piece being planned, or later cut
PIECE_DISTANCE = const(27)  # distance of the piece being planned, in 2**-18 step
PIECES = const(28)  # four times, a piece of the segment: its time, its final speed
MOTORS = const(36)  # per motor: steps still to go; phase, 2**18 is a step
FLOW_LENGTH = const(36)

# Flags of a block that the kernels test; planner.py has the others.
RAPID_MOTION = const(0x01)
SYSTEM_MOTION = const(0x02)  # homing and parking: from and to standstill, outside the ring's order
NO_FEED_OVERRIDE = const(0x04)
INVERSE_TIME = const(0x08)  # RATE is per block, not per mm
DYNAMIC = const(0x40)  # spindle power follows speed (laser, M4)
PLACED = const(0x80)  # its TARGET is already in the table

# A row for the pulse engine: a segment, or a slice of it.
ROW_TICKS = const(0)  # its time
ROW_DIRS = const(1)  # mask of motors that turn backwards
ROW_POWER = const(2)  # spindle power, or KEEP_POWER
# Per motor: steps, tick of the first, tick of the last; the others are evenly spaced.
ROW_AXES = const(3)
ROW_STRIDE = const(3)
KEEP_POWER = const(0x3FFFFFFF)


def block_length(motors: int) -> int:
    """Return how many integers a row of the planner's ring has."""
    return STEPS + 2 * motors


def ring(motors: int, blocks: int) -> "array[int]":
    """Return the planner's ring, empty: so many blocks, then the system's own."""
    return array("i", bytes(4 * block_length(motors) * (blocks + 1)))


def table_length(axes: int, motors: int) -> int:
    """Return how many integers the table of the machine has."""
    return LIMITS + MOVES * axes + motors


def row_length(motors: int) -> int:
    """Return how many integers a segment's row has."""
    return ROW_AXES + ROW_STRIDE * motors
