"""Layout: what stands where in the line of limited jerk. Constants only."""

from micropython import const

# The plan runs ahead of what is made (jerk_kernel.py). Between them is the line: a flow of the
# plan's own, as motion/layout.py has it, without motors, and behind it, ways in 2**-16 mm:
FILTER_TAPS = const(36)  # full segments that speed is averaged over; 0: jerk is not limited
PER_TAP = const(37)  # real: 1 / FILTER_TAPS
RELEASED = const(38)  # the main loop's: behind it are blocks that the plan is not to see yet
PLAN_LEFT = const(39)  # the interrupt's from here on: what the plan's block has still to go,
PLAN_FRACTION = const(40)  # and 2**-4 of that unit
OPEN = const(41)  # the plan is in the slot that comes next,
SLOT_DISTANCE = const(42)  # and has come so far in it
RESTS = const(43)  # slots for which the plan stands still, until all it did has been made
OLDEST = const(44)  # where in the line the next way goes
SUM = const(45)  # all ways in the line: FILTER_TAPS times the speed at the end of the slot,
BEFORE = const(46)  # and where it has been cut so far
REMAINDER = const(47)  # of the division of sums by 2 * FILTER_TAPS
TO_GO = const(48)  # what the slot has still to go,
TIME_LEFT = const(49)  # and for how long, in 2**-17 slot
MADE_LEFT = const(50)  # what the block being made has still to go
CHAIN = const(51)  # the main loop's: how fast, squared, the last corner of a chain may be passed
TAP_DISTANCES = const(52)  # the plan's in each of the last slots
