"""Coordinate systems: where work is, in mm of machine coordinates.

Sole owner of G54-G59, G28 and G30 (kept), G92 and tool length (not kept).
"""

from array import array

from base.f32 import copy, vector
from base.singles import add
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from interfaces import Store

SYSTEMS = const(6)
G28 = const(6)
G30 = const(7)
_COUNT = const(8)
_NONE = const(-1)
_FILE = "coords"

NAMES = ("G54", "G55", "G56", "G57", "G58", "G59", "G28", "G30")


class Coords:
    """All offsets."""

    def __init__(self, store: "Store", axes: int, length_axis: int) -> None:
        self._store = store
        self._axes = axes
        self.length_axis = length_axis
        self.systems = [vector(axes) for _ in range(_COUNT)]
        self.active = 0  # keep-name: esp32.RMT has active(), too
        self.g92 = vector(axes)
        self.tool_length = 0.0
        # What zero() has worked out last, and for which system.
        self._zero = vector(max(axes, length_axis + 1))
        self._zero_of = _NONE

    def load(self) -> bool:
        """Read what is kept; False, and zero, where there was nothing valid."""
        self._zero_of = _NONE
        lines = self._store.load(_FILE)
        if lines is None or not self._parse(lines):
            self.restore()
            return False
        return True

    def _parse(self, lines: "list[str]") -> bool:
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
        lines = []
        for i in range(_COUNT):
            lines.append(NAMES[i] + "=" + ",".join(["%.9g" % x for x in self.systems[i]]))
        self._store.save(_FILE, lines)

    def restore(self) -> None:
        """Everything that is kept to zero ($RST=#)."""
        for system in self.systems:
            for i in range(self._axes):
                system[i] = 0.0
        self._zero_of = _NONE
        self._save()

    def clear(self) -> None:
        """What a reset forgets: the active system, G92 and tool length."""
        self.active = 0
        self.tool_length = 0.0
        self.clear_g92()

    def clear_g92(self) -> None:
        """G92.1: work begins where its system does."""
        self.set_g92(vector(self._axes))

    def set_g92(self, values: "array[float]") -> None:
        """G92: work begins so far from where its system does."""
        self.g92[:] = values
        self._zero_of = _NONE

    def write(self, index: int, values: "array[float]") -> None:
        """Set and keep a system, or G28, G30."""
        self.change(index, values)
        self._save()

    def change(self, index: int, values: "array[float]") -> None:
        """Set one without keeping it."""
        self.systems[index][:] = values
        self._zero_of = _NONE

    def zero(self, system: int) -> "array[float]":
        """Where work in that system begins, with G92, without tool length. Not to be changed."""
        zero = self._zero
        if system != self._zero_of:
            self._zero_of = system
            copy(self.systems[system], zero, self._axes)
            add(self.g92, 0, zero, self._axes)
        return zero
