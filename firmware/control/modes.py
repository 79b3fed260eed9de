"""Modes: the modal state of the program. Data only.

The interpreter writes it; an override may switch coolant. Code that holds, parks or restores reads
the programmed state here. Lengths are mm in machine coordinates, rates mm/min, speeds rpm.
"""

from array import array

from base.float32 import vector
from base.float32_math import whole_part
from micropython import const
from motion.planner import COOLANT_SHIFT

# Indices into Modes.modal; language/block_layout.py has the values.
MOTION = const(0)
PLANE = const(1)
RELATIVE = const(2)
INVERSE_TIME = const(3)
INCHES = const(4)
TOOL_LENGTH = const(5)
SYSTEM = const(6)
PROGRAM_FLOW = const(7)
SPINDLE = const(8)
COOLANT = const(9)
OVERRIDE_CONTROL = const(10)
MODAL_LENGTH = const(11)
# Bit i: with motion mode i, of G1, G2 and G3, a laser cuts.
CUTTING = const(1 << 1 | 1 << 2 | 1 << 3)
# Length of Modes.modal: a block has more words after these (language/block_layout.py); 0 here.
MODAL_ROOM = const(18)

# Indices into Modes.rates.
FEED = const(0)  # mm/min
RPM = const(1)
TOOL = const(2)  # number of T
_RATES = const(3)  # length


class Modes:
    """Modal state, position, feed, speed and tool.

    modal: integers, by the indices above. position: where the parsed program is, in mm of machine
    coordinates; motion may still be on its way there. rates: floats, by index.
    """

    position: "array[float]"

    def __init__(self, axes: int) -> None:
        self.modal = array("i", (0 for _ in range(MODAL_ROOM)))
        self.position = vector(axes)
        self.rates = vector(_RATES)
        self.reset()

    def reset(self) -> None:
        """Set the modes of a fresh start: all 0, which is G0 G54 G17 G21 G90 G94 M5 M9, and M56.
        The position stays."""
        for i in range(MODAL_LENGTH):
            self.modal[i] = 0
        self.modal[OVERRIDE_CONTROL] = 1
        self.rates[FEED] = self.rates[RPM] = self.rates[TOOL] = 0.0

    @property
    def tool(self) -> int:
        """T of the last line; Grbl forgets it with the next line."""
        return whole_part(self.rates, TOOL, 0)

    def accessory_flags(self) -> int:
        """Return the programmed spindle and coolant as flags of a planner block."""
        return self.modal[SPINDLE] | self.modal[COOLANT] << COOLANT_SHIFT
