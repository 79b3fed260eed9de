"""Modes: what a program has in force, until a word of its changes it. Data only.

The interpreter writes it; an override switches coolant. Who holds, parks or restores asks what
was wanted here. Lengths are mm in machine coordinates, rates mm/min, speeds rpm.
"""

from base.f32 import vector
from micropython import const
from motion.planner import COOLANT_SHIFT

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array


class Modal:
    """The modal state, or what a block would make of it. The values are in language/block.py."""

    def __init__(self) -> None:
        self.motion = 0
        self.plane = 0
        self.relative = 0
        self.inverse_time = 0
        self.inches = 0
        self.tool_length = 0
        self.system = 0
        self.program_flow = 0
        self.spindle = 0
        self.coolant = 0
        self.override_control = 1

    def copy(self, other: "Modal") -> None:
        """Become equal to another."""
        for name, value in other.__dict__.items():
            setattr(self, name, value)


class Modes:
    """Modal state, position, feed, speed and tool."""

    position: "array[float]"  # the parser's
    feed: float
    spindle_rpm: float
    tool: int

    def __init__(self, axes: int) -> None:
        self.modal = Modal()
        self.position = vector(axes)
        self.reset()

    def reset(self) -> None:
        """Those of a fresh start. The position stays."""
        self.modal.copy(Modal())
        self.feed = 0.0
        self.spindle_rpm = 0.0
        self.tool = 0

    def accessory_flags(self) -> int:
        """Spindle and coolant as flags of a planner block."""
        return self.modal.spindle | self.modal.coolant << COOLANT_SHIFT
