"""Inputs: limit switches, probe and control buttons, as the machine means them.

The port says which pins are pulled to ground; $5 and $6 say what that means, of control inputs the
board file.
"""

from base.controls import DOOR, HOLD, RESET, START
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from base.settings import Settings
    from interfaces import Port


class Inputs:
    """axes: how many limit inputs there are; door: the hold input is a safety door's."""

    def __init__(self, port: "Port", settings: "Settings", axes: int, has_door: bool) -> None:
        self._port = port
        self._settings = settings
        self._all = (1 << axes) - 1
        self.has_door = has_door
        self._limit_invert = 0
        self._probe_invert = False

    def configure(self) -> None:
        """Take over $5 and $6."""
        settings = self._settings
        self._limit_invert = self._all if settings.limit_invert else 0
        self._probe_invert = bool(settings.probe_invert)
        self._port.limit_invert = self._limit_invert

    def limits(self) -> int:
        """Mask of axes whose limit switch is hit."""
        return self._port.limits() ^ self._limit_invert

    def closed(self) -> int:
        """All that is closed, a bit each: probe, limits of four axes, door, reset, hold, start."""
        port = self._port
        closed = ((port.limits() ^ self._limit_invert) & self._all) << 1
        if port.probe() != self._probe_invert:
            closed |= 1
        controls = port.controls()
        if controls:
            closed |= (controls & DOOR) << 2 | (controls & (RESET | HOLD | START)) << 6
        return closed

    def estop(self) -> bool:
        """The emergency stop is pressed; never so where there is none."""
        estop = self._port.estop
        return estop is not None and estop()

    def probe(self) -> bool:
        """The probe touches."""
        return self._port.probe() != self._probe_invert

    def contact_level(self, away: bool) -> bool:
        """Level of the probe pin at which a cycle, towards or away, is to end."""
        return (not away) != self._probe_invert

    def door_open(self) -> bool:
        """The safety door is open; never so where there is no door input."""
        return self.has_door and bool(self._port.controls() & DOOR)
