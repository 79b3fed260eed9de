"""Coordinate systems: the work offsets, in mm of machine coordinates.

Sole owner of G54-G59, G28 and G30 (stored), G92 and tool length (not stored).
"""

from array import array

from base.float32 import copy, vector
from base.float32_math import add
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import Any

    from interfaces import Store

SYSTEMS = const(6)
G28 = const(6)
G30 = const(7)
G92 = const(8)
_COUNT = const(8)
_FILE = "coords"

NAMES = ("G54", "G55", "G56", "G57", "G58", "G59", "G28", "G30")


class Coords:
    """All offsets, in one array of floats: the systems, one float per axis, then G92, then the
    tool length."""

    def __init__(self, store: "Store", axes: int, length_axis: int) -> None:
        self._store = store
        self._axes = axes
        self.length_axis = length_axis
        self.offsets = vector((_COUNT + 1) * axes + 1)
        # Parts of that array: memoryviews, which behave as arrays.
        views: "Any" = memoryview(self.offsets)
        self.systems: "list[array[float]]" = [
            views[i * axes : (i + 1) * axes] for i in range(_COUNT)
        ]
        self.g92: "array[float]" = views[_COUNT * axes : -1]
        self.active = 0
        self._zero = vector(max(axes, length_axis + 1))  # also without an axis for the length

    @property
    def tool_length(self) -> float:
        """Length of the tool, relative to no offset, in mm."""
        return self.offsets[-1]

    @tool_length.setter
    def tool_length(self, mm: float) -> None:
        self.offsets[-1] = mm

    def load(self) -> bool:
        """Read the stored offsets; False, and all 0, if there are no valid ones."""
        lines = self._store.load(_FILE)
        if lines is None or not self._parse(lines):
            self.restore()
            return False
        return True

    def _parse(self, lines: "list[str]") -> bool:
        """Read lines such as "G54=1,2,3". Returns False if a value is no number."""
        for line in lines:
            name, _, values = line.partition("=")
            if name not in NAMES:
                continue
            try:
                numbers = [float(x) for x in values.split(",")]
            except ValueError:
                return False
            system = self.systems[NAMES.index(name)]
            for i in range(min(self._axes, len(numbers))):
                system[i] = numbers[i]
        return True

    def _save(self) -> None:
        """Store the systems and G28, G30, a line each."""
        lines = []
        for i in range(_COUNT):
            lines.append(NAMES[i] + "=" + ",".join(["%.9g" % x for x in self.systems[i]]))
        self._store.save(_FILE, lines)

    def restore(self) -> None:
        """Set and store all stored offsets to zero ($RST=#)."""
        for system in self.systems:
            for i in range(self._axes):
                system[i] = 0.0
        self._save()

    def clear(self) -> None:
        """Clear what a reset clears: the active system, G92 and tool length."""
        self.active = 0
        self.tool_length = 0.0
        self.clear_g92()

    def clear_g92(self) -> None:
        """Clear the G92 offset (G92.1)."""
        self.set_g92(vector(self._axes))

    def set_g92(self, values: "array[float]") -> None:
        """Set the G92 offset, which adds to that of the system."""
        copy(values, self.g92, self._axes)

    def write(self, index: int, values: "array[float]") -> None:
        """Set and store a system, or G28, G30."""
        self.change(index, values)
        self._save()

    def change(self, index: int, values: "array[float]") -> None:
        """Set a system without storing it."""
        copy(values, self.systems[index], self._axes)

    def zero(self, system: int) -> "array[float]":
        """Return the work zero of a system, with G92, without tool length. The array is shared: do
        not change it."""
        zero = self._zero
        copy(self.systems[system], zero, self._axes)
        add(self.g92, 0, zero, self._axes)
        return zero

    def work_zero(self, system: int, axis: int) -> float:
        """Return the work zero of a system on one axis, with tool length, in machine
        coordinates."""
        length = self.tool_length if axis == self.length_axis else 0.0
        return self.zero(system)[axis] + length
