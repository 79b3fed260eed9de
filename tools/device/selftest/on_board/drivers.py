# mypy: ignore-errors
"""Switch motor drivers off before any check, and ignore inputs that are not wired."""

import board
from machine import Pin
from ports.storage.flash_store import FlashStore


def drivers_off():
    """Make ENABLE inactive, according to $4 in the stored settings, and keep the firmware from
    changing it. Returns its pins."""
    inverted = getattr(board, "DEFAULTS", {}).get(4, 0)
    for line in FlashStore().load("settings") or []:
        if line.startswith("$4="):
            inverted = int(line[3:])
    enables = getattr(board, "ENABLE", None)
    enables = enables if isinstance(enables, tuple) else (enables,)
    wired = [pin for pin in enables if pin is not None]
    for pin in wired:
        Pin(pin, Pin.OUT, value=0 if inverted else 1)
    board.ENABLE = None  # the firmware then uses none
    return wired


def ignore_inputs():
    """Disable inputs that would be active when not wired, and settings that could prevent
    motion."""
    board.ESTOP = None
    board.CONTROL_INVERT = 0
    board.LIMIT_DEBOUNCE_MS = 0
    board.DEFAULTS = dict(getattr(board, "DEFAULTS", {}))
    for number in (5, 20, 21, 22):  # limits inverted, soft limits, hard limits, homing
        board.DEFAULTS[number] = 0
