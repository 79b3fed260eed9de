"""Layout: the places in the line, the array of integers that limits jerk. Constants only."""

from micropython import const

# The line is a flow of the plan's own (motion/layout.py), without motors, which runs ahead of the
# executed motion (jerk_kernel.py). These places follow it. A slot lasts as long as a full segment;
# distances are in 2**-16 mm.
FILTER_TAPS = const(36)  # slots over which speed is averaged; 0: jerk is not limited
PER_TAP = const(37)  # real: 1 / FILTER_TAPS
RELEASED = const(38)  # the main loop's: row of the first block that the plan must not read yet
PLAN_LEFT = const(39)  # the interrupt's, from here on: distance left of the plan's block,
PLAN_FRACTION = const(40)  # and 2**-4 of that unit
SLOT_BEGUN = const(41)  # 1: the plan has begun the next slot,
SLOT_DISTANCE = const(42)  # and this is its distance in it so far
STAND_SLOTS = const(43)  # slots for which the plan still stands, so that the average slows down
OLDEST_TAP = const(44)  # index of the oldest tap, which the next one replaces
TAP_SUM = const(45)  # of all taps: FILTER_TAPS times the speed at the end of the slot; up to 2**29
SUM_LAID_OUT = const(46)  # the same speed at the end of the part of the slot that is laid out
REMAINDER = const(47)  # of the division of sums by 2 * FILTER_TAPS
DISTANCE_TO_LAY = const(48)  # distance of the slot that is not yet laid out,
TIME_TO_LAY = const(49)  # and its time, in 2**-17 slot
EXECUTED_LEFT = const(50)  # distance of the executed block that is not yet laid out
CHAIN_SQR = const(51)  # the main loop's: speed squared (scaled) of the last corner of a chain
TAP_DISTANCES = const(52)  # the taps: the plan's distance in each of the last slots
