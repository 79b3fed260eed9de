"""Limit switches of several axes on one input: LIMIT = (9, 9, 11) in the board file.

This is for shields whose switches are in series, and for a Gecko G540. The input reports that one
of the switches is closed, but not which one. So axes that share an input are homed one after the
other, and not while one of their switches is closed already. Pn: lists all of them.
"""

from base import errors
from base.axes import LETTERS, Z
from base.errors import GrblError
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

    from interfaces import Options

    from extras.api import Cnc

_CYCLES = range(44, 50)  # $44 to $49 of home_order.py

_board: "dict[int, list[int]]" = {}  # key 0: masks of axes that share an input


def sharing(limits: "tuple[int | None, ...]", axes: int, motors: str) -> "list[int]":
    """Return a mask of axes for each shared input.

    limits: per motor its pin, or None. motors: the letter of each motor's axis, as MOTORS.
    ValueError if both motors of an axis share one, because neither has a switch of its own then.
    """
    masks = []
    for pin in set(limits):
        motors_of_pin = [i for i in range(len(limits)) if limits[i] == pin and pin is not None]
        mask = 0
        for i in motors_of_pin:
            # The first motors move the axis of their number, further ones that of their letter.
            axis = LETTERS.find(motors[i]) if i >= axes else i
            if mask >> axis & 1:
                letter = LETTERS[axis]
                text = "LIMIT: both switches of %s are on pin %s: None for the second motor's"
                raise ValueError(text % (letter, pin))
            mask |= 1 << axis
        if len(motors_of_pin) > 1:
            masks.append(mask)
    return masks


def clash(shared: "list[int]", cycle: int) -> str:
    """Return the letters of axes that share an input and are in the same cycle (a mask), or "".

    shared: what sharing() returned. Such axes must not be homed together.
    """
    for mask in shared:
        together = mask & cycle
        if together & (together - 1):  # more than one bit is set
            return " and ".join([LETTERS[i] for i in range(len(LETTERS)) if together >> i & 1])
    return ""


def grbl_order(axes: int) -> "tuple[int, int]":
    """Return the masks that $H homes by default: Z, then the others of so many axes together."""
    return 1 << Z, (1 << axes) - 1 & ~(1 << Z)


def prepare(options: "Options", board: "ModuleType") -> None:
    """Find shared inputs. ValueError if the homing order does not fit them."""
    option = board.__dict__.get
    limits: "tuple[int | None, ...]" = option("LIMIT", ())
    _board[0] = shared = sharing(limits, options.axes, option("MOTORS", ""))
    cycles = [int(options.defaults.get(number, 0)) for number in _CYCLES]
    # Without an order in the settings $H homes in Grbl's own.
    for cycle in cycles if any(cycles) else grbl_order(options.axes):
        letters = clash(shared, cycle)
        if letters:
            one_by_one = ["Z"] + [letter for letter in LETTERS[: options.axes] if letter != "Z"]
            text = 'LIMIT: %s share a pin and are homed together: write HOMING = ("%s")'
            raise ValueError(text % (letters, '", "'.join(one_by_one)))


def install(cnc: "Cnc") -> None:
    """Check the inputs before $H, and refuse $44 to $49 with axes that share an input."""
    machine: "Any" = cnc.machine
    shared, hooks, inputs = _board[0], machine.state.hooks, machine.inputs
    shared_axes = 0
    for mask in shared:
        shared_axes |= mask
    previous_home, previous_find = hooks.home, hooks.find_switches

    def give_up(text: str, alarm: int) -> None:
        """Send a message, stop the machine, and set the alarm, a number of base/errors.py."""
        cnc.message(text)
        machine.motor_control.reset()
        machine.state.alarm = alarm

    def home(axes: int) -> bool:
        """Home the axes, unless a shared input is closed: whose switch it is, is not known."""
        if inputs.limits() & shared_axes:
            give_up("Move off the closed limit switch first", errors.ALARM_HARD_LIMIT)
            return False
        return bool(previous_home(axes))

    def find(axes: int) -> None:
        """Search the switches of the axes, a mask, unless two of them share an input."""
        letters = clash(shared, axes)
        if letters:
            text = "%s share a limit input: home them one after the other, by $44 to $49"
            give_up(text % letters, errors.ALARM_HOMING_FAIL_RESET)
            cnc.service()  # raises Abort
        previous_find(axes)

    def check(mask: float) -> None:
        """Refuse a value of $44 to $49, a mask of axes, if two of them share an input."""
        if clash(shared, int(mask)):
            raise GrblError(errors.INVALID_STATEMENT)

    hooks.home, hooks.find_switches = home, find
    for number in _CYCLES:
        cnc.check_setting(number, check)
