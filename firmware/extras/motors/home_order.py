"""Homing order: HOMING = ("Z", "XY") in the board file, and rates per axis.

$44 to $49 change it at run time, as in grblHAL: each is a mask of axes, homed one after the other.
An axis in none of them is not homed: HOMING = ("XY",) is for a laser without a switch on Z. If all
are 0, the order is Grbl's own. $180 and $190 are rates of each axis.
"""

from base import errors
from base.errors import GrblError
from base.settings import AXIS, INT
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable
    from types import ModuleType
    from typing import Any

    from base.settings import Rows
    from interfaces import Options

    from extras.api import Cnc

_FIRST_CYCLE = const(44)  # number of its setting; the other cycles follow
_CYCLES: "Rows" = (
    # Homing cycle 1. The axes that are homed first, together: X = 1, Y = 2, Z = 4; 0: none.
    (44, "home_first", INT, 0, "mask"),
    # Homing cycle 2.
    (45, "home_second", INT, 0, "mask"),
    # Homing cycle 3.
    (46, "home_third", INT, 0, "mask"),
    # Homing cycle 4.
    (47, "home_fourth", INT, 0, "mask"),
    # Homing cycle 5.
    (48, "home_fifth", INT, 0, "mask"),
    # Homing cycle 6.
    (49, "home_sixth", INT, 0, "mask"),
)
_RATES: "Rows" = (
    # Homing locate rate, one value per axis. Replaces $24; 0: $24 holds. Axes that are homed
    # together use the slowest of their rates.
    (180, "homing_feeds", AXIS, 0.0, "mm/min"),
    # Homing search rate, one value per axis. As $180, but replaces $25.
    (190, "homing_seeks", AXIS, 0.0, "mm/min"),
)


def prepare(options: "Options", board: "ModuleType") -> None:
    """Make the board file's HOMING the default of $44 to $49. ValueError if it is wrong."""
    words: "tuple[str, ...]" = board.__dict__["HOMING"]
    if len(words) > len(_CYCLES):
        raise ValueError("HOMING has %d parts: there may be %d" % (len(words), len(_CYCLES)))
    masks = {}  # per number of a setting its value, a mask of axes
    named = 0  # mask of the axes named so far
    for i, word in enumerate(words):
        mask = 0
        for letter in word:
            axis = options.axis_letters[: options.axes].find(letter.encode())
            if axis < 0 or named >> axis & 1:
                raise ValueError("HOMING: %s is no axis, or named twice" % letter)
            named |= 1 << axis
            mask |= 1 << axis
        masks[_FIRST_CYCLE + i] = float(mask)
    masks.update(options.defaults)  # DEFAULTS of the board file take precedence
    options.defaults = masks


def install(cnc: "Cnc") -> None:
    """Let $H use the order of $44 to $49, and the rates of $180 and $190. A command for one axis
    ($HX) has no order."""
    hooks, settings = cnc.machine.state.hooks, cnc.machine.settings
    homing = cnc.machine.homing_probing
    all_axes = (1 << cnc.machine.planner.axes) - 1
    previous = hooks.home

    def home(axes: int) -> bool:
        """Home the axes, a mask; 0: all, in the order of the settings, if there is one."""
        cycles = [getattr(settings, attribute) for _, attribute, _, _, _ in _CYCLES]  # masks
        if axes or not any(cycles):  # $HX, or $H in Grbl's own order
            return previous(axes)
        return homing.home_in_turn(previous, [mask for mask in cycles if mask])

    def check(mask: float) -> None:
        """Refuse a value of $44 to $49 with axes that this machine has not."""
        if not mask <= all_axes:
            raise GrblError(errors.INVALID_STATEMENT)

    hooks.home = home
    _hook_rates(cnc)
    cnc.add_settings(_CYCLES + _RATES)
    for number, _, _, _, _ in _CYCLES:
        cnc.check_setting(number, check)


def _hook_rates(cnc: "Cnc") -> None:
    """Hook into homing: its rates are those of the axes that are homed ($180, $190), which replace
    $24 and $25 meanwhile."""
    machine: "Any" = cnc.machine
    hooks, settings = machine.state.hooks, machine.settings
    previous: "Callable[[int], None]" = hooks.find_switches

    def find(axes: int) -> None:
        """Search the switches of the axes, a mask, at the lowest of their rates."""
        common_feed, common_seek = settings.homing_feed, settings.homing_seek
        settings.homing_feed = _slowest(settings.homing_feeds, common_feed, axes)
        settings.homing_seek = _slowest(settings.homing_seeks, common_seek, axes)
        try:
            previous(axes)
        finally:
            settings.homing_feed, settings.homing_seek = common_feed, common_seek

    hooks.find_switches = find


def _slowest(rates: "array[float]", common_rate: float, axes: int) -> float:
    """Return the slowest rate of these axes (a mask), mm/min. 0 in rates means common_rate."""
    return min([rates[i] or common_rate for i in range(len(rates)) if axes >> i & 1])
