# mypy: ignore-errors
"""Motor drivers are off, before anything else is done."""

import board
from machine import Pin
from store_flash import FlashStore


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
