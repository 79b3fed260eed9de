"""A wire cutter: XYUV = True in the board file. Two carriages hold the ends of a hot wire.

The first carriage has the axes X and Y, the second has U and V. They are axes 0 to 3, so U and V
have the settings and the places in reports that Z and A have elsewhere. The feed rate is that of
the end of the wire that has the longer way; the other end arrives at the same time. In an arc only
X and Y turn, and the feed rate is theirs. $H homes all four together, because the wire joins them.
"""

import micropython
from base.axes import X, Y
from micropython import const
from motion import minifloat

from extras.kinematics.rotary import ITS_OWN_RATE, RotaryCanon, RotaryPlanner
from extras.kinematics.rotary_kernel import stretch

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable
    from types import ModuleType
    from typing import Any

    from interfaces import Options

    from extras.api import Cnc

_U = const(2)
_V = const(3)
_XY = const(1 << X | 1 << Y)  # masks of axes
_UV = const(1 << _U | 1 << _V)
_ALL = const(_XY | _UV)
_AXES = const(4)
# The others move Z, or name motors by other letters.
EXCLUDED = (
    "XYUV",
    "COREXY",
    "MOVES",
    "MOTORS",
    "KINEMATICS",
    "BACKLASH",
    "SKEW",
    "ROTARY",
    "JOBS",
    "POWER_FAIL",
    "PARKING",
    "SINGLE_AXIS_HOMING",
)


class WirePlanner(RotaryPlanner):
    """A planner whose feed rates are those of the faster end of the wire."""

    @micropython.native
    def plan_line(
        self, target: "array[float]", flags: int, line: int, power: int, rate: int
    ) -> int:
        """Plan a line, as Planner.plan(). rate: of the faster end of the wire, a real, mm/s.

        Planner.plan() needs the rate along the path of all four axes. Its length is that of one
        end's path times the factor of stretch(), which is 0 for an end that does not move.
        """
        if not flags & ITS_OWN_RATE:
            xy_factor = stretch(target, self.table, self.ring, self.flow, _XY)
            uv_factor = stretch(target, self.table, self.ring, self.flow, _UV)
            # The end with the longer path has the smaller factor, if that is not 0.
            factor = min(xy_factor, uv_factor) or max(xy_factor, uv_factor)
            rate = minifloat.mul(rate, factor)
        return self.plan(target, flags, line, power, rate)


class WireCanon(RotaryCanon):
    """Canon of a wire cutter: on an arc, the feed rate is that of X and Y."""

    axes = (_U, _V)  # those that do not count for the feed rate of an arc

    def endless(self) -> "list[int]":
        """Return the endless axes: none."""
        return []


def prepare(options: "Options", board: "ModuleType") -> None:
    """Select planner, canon and the letters of axes. ValueError if the board file is wrong."""
    if options.axes != _AXES:
        raise ValueError("XYUV needs four pins in STEP and in DIR: for X, Y, U and V")
    options.axis_letters = b"XYUV"
    options.planner, options.canon = WirePlanner, WireCanon


def install(cnc: "Cnc") -> None:
    """Hook the feed rate into planning, and the four axes into $H."""
    machine: "Any" = cnc.machine
    planner, hooks = machine.planner, machine.state.hooks
    planner.move_hook = planner.plan_line
    previous: "Callable[[int], bool]" = hooks.home

    def home(axes: int) -> bool:
        """Home the axes, a mask; 0: all, together. Returns whether that succeeded."""
        return previous(axes or _ALL)

    hooks.home = home
