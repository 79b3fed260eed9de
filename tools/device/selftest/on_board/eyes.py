# mypy: ignore-errors
"""What watches the hang on an RP2 board."""

import board
from machine import mem32

from .config import CONFIG
from .watch import FIRST, LAST, Counter

counters = [
    Counter(FIRST + i, board.STEP[i], board.DIR[i])
    for i in range(min(len(board.STEP), LAST - FIRST + 1))
]


def watch():
    """Do nothing: the counters exist from the beginning."""


def count_all():
    """Return the steps of each axis so far, forward plus backward."""
    return [forward + backward for forward, backward in [one.steps() for one in counters]]


def used_stack():
    """Return the deepest use of the C stack so far, in bytes."""
    from pio import stack

    return stack.used()


def mem_level(pin):
    """Return a function that reads whether SPINDLE_PWM, at that pin, is on, whatever drives it:
    bit 17 of the pin's STATUS."""
    address = CONFIG["io_bank"] + 8 * pin
    off_level = "SPINDLE_PWM" in getattr(board, "INVERT", ())  # 1 if the output is inverted

    def is_on():
        return mem32[address] >> 17 & 1 ^ off_level

    return is_on
