# mypy: ignore-errors
"""What watches the hang on an ESP32."""

import board

from .config import CONFIG
from .pcnt import Counter, Edges, pad_level

counters = []


def watch():
    """Create the counters. Must follow the engine and the port, because these set up the pins."""
    axes = range(len(board.STEP))
    counters.extend([Counter(i, board.STEP[i], board.DIR[i]) for i in axes])


def count_all():
    """Return the steps of each axis so far, without sign."""
    return [abs(one.steps()) for one in counters]


def used_stack():
    """Return None: the C stack is not measured on an ESP32, where it is larger."""
    return None


def mem_level(pin):
    """Return a function that reads whether SPINDLE_PWM, at that pin, was on since the function's
    last call, whatever drives it."""
    unit = min(len(counters), CONFIG["units"] - 1)  # a counter for the pin's edges
    del counters[unit:]  # if there is no other one, the last axis loses its counter
    edges = Edges(unit, pin)
    off_level = "SPINDLE_PWM" in getattr(board, "INVERT", ())  # 1 if the output is inverted

    def was_on():
        return edges.take() or pad_level(pin) ^ off_level

    return was_on
