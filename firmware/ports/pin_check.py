"""The pins of a board file, before anything is done with one of them."""

from machine import Pin
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType

# Names that stand for pins of the chip, or for tuples of them; None is not wired.
_MOTORS = "STEP DIR ENABLE"
_OTHERS = "LIMIT PROBE CONTROL ESTOP REPL_PIN SPINDLE_PWM SPINDLE_DIR SPINDLE_ON FLOOD MIST_PIN"

# Motors behind shift registers have numbers of their own, and these pins.
_REGISTERS = "I2S"

# What an engine wants to be told.
_NEEDED = {
    "pio": ("STEP", "DIR"),
    "rmt": ("STEP", "DIR"),
    "i2s": ("STEP", "DIR", "ENABLE", "I2S", "I2S_RATE_HZ", "I2S_BUFFERS"),
}


def check(board: "ModuleType", others: "tuple[str, ...]" = ()) -> None:
    """An engine there is, all that it needs, no pin twice, and none that the chip has not.

    others: names that extras have for pins. Raises ValueError, which says what or where.
    """
    if board.ENGINE not in _NEEDED:
        raise ValueError("ENGINE %s is not one there is" % board.ENGINE)
    missing = [name for name in _NEEDED[board.ENGINE] if not hasattr(board, name)]
    if missing:
        names = ", ".join(missing)
        raise ValueError("ENGINE = %s: the board file names no %s" % (board.ENGINE, names))
    names = (_REGISTERS if board.ENGINE == "i2s" else _MOTORS) + " " + _OTHERS
    used: "dict[int, str]" = {}
    for name in names.split() + list(others):
        value = board.__dict__.get(name)  # getattr() would keep the names for good
        for pin in value if isinstance(value, tuple) else (value,):
            if pin is None:
                continue
            if pin in used:
                raise ValueError("%s: pin %s is %s already" % (name, pin, used[pin]))
            used[pin] = name
            try:
                Pin(pin)
            except (TypeError, ValueError):
                raise ValueError("%s: there is no pin %s" % (name, pin))
    controls = board.__dict__.get("CONTROL", ())
    for bit in range(4):
        wired = bit < len(controls) and controls[bit] is not None
        if board.__dict__.get("CONTROL_INVERT", 0) >> bit & 1 and not wired:
            raise ValueError("CONTROL_INVERT: there is no input of value %d" % (1 << bit))
