"""The beam: the seam between a laser and an engine that changes its power.

To such an engine a beam is one more motor: its steps are changes of power. They stand in a
segment's row behind those of the motors, first, last, the others evenly between, as steps do, and
hardware counts them out at the same tick as the steps that they belong to. What power changes to
goes into a ring, a level per change.
"""

from micropython import const

# The beam, an array: levels made since power-up; the last one's power, or UNKNOWN;
COUNT = const(0)
LEVEL = const(1)
# ticks from the last change to the end of what has been made, and the least from one to the next;
SINCE = const(2)
GAP = const(3)
# what makes a level of a power, in 2**-FULL_LOG2, see full(), and what all are multiplied with.
FULL = const(4)
BOTH = const(5)
LENGTH = const(6)

UNKNOWN = const(-1)

# The ring of levels: as many as all rows that wait may have.
LEVELS_LOG2 = const(8)
LEVELS_MASK = const(255)

# Levels have 16 bits, and there are as many powers as 14 bits can tell, or fewer.
FULL_LOG2 = const(14)


def full(level: int, power: int) -> int:
    """FULL, where the highest power has that level: no product of it needs more than 31 bits."""
    return ((level << FULL_LOG2) + power - 1) // power
