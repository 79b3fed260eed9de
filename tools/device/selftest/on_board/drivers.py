# mypy: ignore-errors
"""Motor drivers are off, before anything else is done; inputs that are not wired say nothing."""

import board
from machine import Pin
from ports.storage.flash_store import FlashStore


def drivers_off():
    """ENABLE inactive, as the stored settings want it ($4); from here on nobody touches it."""
    kept = FlashStore().load("settings") or []
    inverted = getattr(board, "DEFAULTS", {}).get(4, 0)
    for line in kept:
        if line.startswith("$4="):
            inverted = int(line[3:])
    enables = getattr(board, "ENABLE", None)
    enables = enables if isinstance(enables, tuple) else (enables,)
    wired = [pin for pin in enables if pin is not None]
    for pin in wired:
        Pin(pin, Pin.OUT, value=0 if inverted else 1)
    board.ENABLE = None
    return wired


def hear_nothing():
    """What would be active with nothing wired, or keep a machine from moving, is not."""
    board.ESTOP = None
    board.CONTROL_INVERT = 0
    board.LIMIT_DEBOUNCE_MS = 0
    board.DEFAULTS = dict(getattr(board, "DEFAULTS", {}))
    for number in (5, 20, 21, 22):
        board.DEFAULTS[number] = 0
