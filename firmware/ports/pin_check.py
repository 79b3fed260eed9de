"""Check the pins of a board file before one of them is used."""

from machine import Pin
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType

_CONTROLS = const(4)  # reset, hold, start, door: bits of CONTROL_INVERT

# Names whose values are pins of the chip, tuples of pins, or custom.py's dicts of pins by name, on
# every board; None is not wired.
_NAMES = (
    "LIMIT PROBE CONTROL ESTOP REPL_PIN SPINDLE_PWM SPINDLE_DIR SPINDLE_ON FLOOD MIST_PIN "
    "OUTPUTS INPUTS"
)


def check(board: "ModuleType", motors: "tuple[str, ...]", others: "tuple[str, ...]" = ()) -> None:
    """Check that no pin is used twice, except by limit switches that share one, and that the chip
    has each pin.

    motors: names of the board file's entries with the engine's pins; others: of those with pins of
    extras. Raises ValueError, which names the entry. CONTROL_INVERT may only have bits of inputs
    that are wired.
    """
    used: "dict[int, str]" = {}
    for name in list(motors) + _NAMES.split() + list(others):
        value = board.__dict__.get(name)  # getattr() would intern the names for good
        if isinstance(value, dict):
            value = tuple(value.values())
        for pin in value if isinstance(value, tuple) else (value,):
            if pin is None:
                continue
            if pin in used and not name == used[pin] == "LIMIT":  # two limits may share it
                raise ValueError("%s: pin %s is %s already" % (name, pin, used[pin]))
            used[pin] = name
            try:
                Pin(pin)
            except (TypeError, ValueError):
                raise ValueError("%s: this chip has no pin %s" % (name, pin))
    controls = board.__dict__.get("CONTROL", ())
    for bit in range(_CONTROLS):
        is_wired = bit < len(controls) and controls[bit] is not None
        if board.__dict__.get("CONTROL_INVERT", 0) >> bit & 1 and not is_wired:
            raise ValueError(
                "CONTROL_INVERT: %d stands for an input that is not wired" % (1 << bit)
            )
