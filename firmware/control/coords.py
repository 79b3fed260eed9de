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

SYSTEMS = const(6)  # number of work coordinate systems: G54 is index 0, G59 is 5
G28 = const(6)  # index after these: the stored positions
G30 = const(7)
G92 = const(8)
_COUNT = const(8)  # entries that are stored: six systems, G28, G30
_FILE = "coords"  # name of the stored file

NAMES = ("G54", "G55", "G56", "G57", "G58", "G59", "G28", "G30")


class Coords:
    """All offsets, in one array of floats: G54 to G59, G28, G30 and G92, one float per axis each;
    then the tool length.

    store: where they are saved; axes: the number of axes; length_axis: index of the axis along
    the tool. systems[i] is a view of entry i, g92 of G92; active: index of the selected system.
    """

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
        # Result of zero(). A machine without the axis of the tool length may still read there.
        self._zero = vector(max(axes, length_axis + 1))

    @property
    def tool_length(self) -> float:
        """Length of the tool, relative to no offset, in mm."""
        return self.offsets[-1]

    @tool_length.setter
    def tool_length(self, mm: float) -> None:
        """Set the tool length, which a reset clears."""
        self.offsets[-1] = mm

    def load(self) -> bool:
        """Read the stored offsets; those that were never stored are 0. If the stored data is lost
        or invalid, store zeros and return False."""
        lines = self._store.load(_FILE)
        if lines is None or not self._parse(lines):
            self.restore()
            return False
        return True

    def _parse(self, lines: "list[str]") -> bool:
        """Read lines such as "G54=1,2,3", in mm; unknown names and surplus axes are ignored.
        Returns False if a value is no number."""
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
        """Store G54 to G59, G28 and G30, a line each, with the digits that a float needs."""
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
        """Set the G92 offset, in mm, which adds to that of the system."""
        copy(values, self.g92, self._axes)

    def write(self, index: int, values: "array[float]") -> None:
        """Set and store a system, or G28, G30. index: of NAMES; values: mm, one per axis."""
        self.change(index, values)
        self._save()

    def change(self, index: int, values: "array[float]") -> None:
        """Do as write(), but only in memory."""
        copy(values, self.systems[index], self._axes)

    def zero(self, system: int) -> "array[float]":
        """Return the work zero of a system (index), with G92, without tool length: mm of machine
        coordinates, one float per axis. The next call overwrites the array: do not change it."""
        zero = self._zero
        copy(self.systems[system], zero, self._axes)
        add(self.g92, 0, zero, self._axes)  # 0: not subtracted
        return zero

    def work_zero(self, system: int, axis: int) -> float:
        """Return the work zero of a system (index) on one axis, with G92 and, on length_axis, the
        tool length; in mm of machine coordinates."""
        length = self.tool_length if axis == self.length_axis else 0.0
        return self.zero(system)[axis] + length
