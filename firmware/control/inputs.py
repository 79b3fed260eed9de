"""Inputs: limit switches, probe and control buttons, with their polarity.

The port reports which pins are low; $5 and $6 say what that means, and for control inputs the
board file.
"""

from base.controls import DOOR, HOLD, LIMITS_AT, PROBE_AT, RESET, START
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from base.settings import Settings
    from interfaces import Port


class Inputs:
    """The inputs as active or not. axes: the number of limit inputs; has_door: the hold input is a
    safety door's. _limit_invert, _all: masks, bit 0 is X. _inverted, _watched: masks of the bits
    of Port.levels()."""

    def __init__(self, port: "Port", settings: "Settings", axes: int, has_door: bool) -> None:
        self._port = port
        self._levels = port.levels
        self._settings = settings
        self._all = (1 << axes) - 1
        self.has_door = has_door
        self._limit_invert = 0
        self._probe_invert = False
        self._inverted = 0
        self._watched = self._all << LIMITS_AT | 1 << PROBE_AT | DOOR | START | HOLD | RESET

    def configure(self) -> None:
        """Apply $5, which inverts the limit inputs, and $6, which inverts the probe."""
        settings = self._settings
        self._limit_invert = self._all if settings.limit_invert else 0
        self._probe_invert = bool(settings.probe_invert)
        self._inverted = self._limit_invert << LIMITS_AT | self._probe_invert << PROBE_AT
        self._port.limit_invert = self._limit_invert

    def limits(self) -> int:
        """Return a mask of the axes whose limit switch is hit."""
        return self._port.limits() ^ self._limit_invert  # a low pin is a 1, unless $5

    def active(self) -> int:
        """Return a mask of all active inputs, from bit 0 on in the order of a status report's Pn:
        probe, limits of six axes, door, reset, hold, start."""
        levels = (self._levels() ^ self._inverted) & self._watched
        if not levels:
            return 0  # the common case
        # In `levels` the controls are the lowest bits, below the probe and the limits; in the
        # result they come after these: door is bit 7, reset 8, hold 9, start 10.
        return levels >> PROBE_AT | (levels & DOOR) << 4 | (levels & (RESET | HOLD | START)) << 8

    def estop(self) -> bool:
        """Return whether the emergency stop is pressed; False without one."""
        estop = self._port.estop
        return estop is not None and estop()

    def probe(self) -> bool:
        """Return whether the probe touches: its contact is closed, or open if $6 inverts it."""
        return self._port.probe() != self._probe_invert

    def contact_level(self, away: bool) -> bool:
        """Return what Port.probe() reports once a probing cycle is to end: contact or, if away,
        the loss of contact."""
        return (not away) != self._probe_invert

    def door_open(self) -> bool:
        """Return whether the safety door is open; False without a door input."""
        return self.has_door and bool(self._port.controls() & DOOR)
