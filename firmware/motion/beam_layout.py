"""The beam: the interface between a laser and an engine that changes its power.

Such an engine treats the beam as one more motor, whose steps are changes of power. In a segment's
row they follow those of the motors: first tick, last tick, the others evenly spaced, as for steps.
Hardware outputs them at the same tick as the steps that they belong to. The new power is in a
ring, a level per change.
"""

from micropython import const

# Indexes in the array `beam`.
COUNT = const(0)  # levels put into the ring since power-up
LEVEL = const(1)  # spindle power of the last one, or UNKNOWN
SINCE = const(2)  # ticks from the last change to the end of the rows made
GAP = const(3)  # least ticks from one change to the next
FULL = const(4)  # level per power, in 2**-FULL_LOG2: see full()
BOTH = const(5)  # a factor on all levels: the engine's format of a level
LENGTH = const(6)

UNKNOWN = const(-1)

# The ring of levels: enough for all waiting rows.
LEVELS_LOG2 = const(8)
LEVELS_MASK = const(255)

# A level has 16 bits, and power at most 14.
FULL_LOG2 = const(14)


def full(level: int, power: int) -> int:
    """Return FULL, the factor that turns the highest power into that level: level / power in
    2**-FULL_LOG2, rounded up. Power times FULL has no more than 31 bits."""
    return ((level << FULL_LOG2) + power - 1) // power
