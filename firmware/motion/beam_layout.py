"""The beam: the interface between a laser and an engine that changes its power.

Such an engine treats the beam as one more motor, whose steps are changes of power. In a segment's
row they follow those of the motors: first tick, last tick, the others evenly spaced, as for steps.
Hardware outputs them at the same tick as the steps that they belong to. The new power is in a
ring, a level per change.
"""

from micropython import const

# Places in the array `beam`: levels made since power-up; the last one's power, or UNKNOWN;
COUNT = const(0)
LEVEL = const(1)
# ticks from the last change to the end of the rows made, and the least from one to the next;
SINCE = const(2)
GAP = const(3)
# what converts power to a level, in 2**-FULL_LOG2, see full(), and a factor on all levels.
FULL = const(4)
BOTH = const(5)
LENGTH = const(6)

UNKNOWN = const(-1)

# The ring of levels: enough for all waiting rows.
LEVELS_LOG2 = const(8)
LEVELS_MASK = const(255)

# A level has 16 bits, and power at most 14.
FULL_LOG2 = const(14)


def full(level: int, power: int) -> int:
    """Return FULL, if the highest power has that level. No product of it has more than 31 bits."""
    return ((level << FULL_LOG2) + power - 1) // power
