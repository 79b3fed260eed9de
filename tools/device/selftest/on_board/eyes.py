# mypy: ignore-errors
"""What the hang is watched with on an RP2 board."""

import board
from machine import mem32

from .config import CONFIG
from .watch import FIRST, LAST, Counter

counters = [
    Counter(FIRST + i, board.STEP[i], board.DIR[i])
    for i in range(min(len(board.STEP), LAST - FIRST + 1))
]


def watch():
    """They have been there from the beginning."""


def count_all():
    """Steps of each axis so far, there and back."""
    return [forward + backward for forward, backward in [one.steps() for one in counters]]


def used_stack():
    """Bytes of the C stack at most."""
    from pio import stack

    return stack.used()


def mem_level(pin):
    """Whether the pad is on, whoever drives it: bit 17 of its status."""
    address = CONFIG["io_bank"] + 8 * pin
    off = "SPINDLE_PWM" in getattr(board, "INVERT", ())

    def level():
        return mem32[address] >> 17 & 1 ^ off

    return level
