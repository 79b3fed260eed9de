# mypy: ignore-errors
"""What the hang is watched with on an ESP32."""

import board

from .config import CONFIG
from .pcnt import Counter, Edges, pad_level

counters = []


def watch():
    """From now on: the engine and the port have made their pins."""
    axes = range(len(board.STEP))
    counters.extend([Counter(i, board.STEP[i], board.DIR[i]) for i in axes])


def count_all():
    """Steps of each axis so far."""
    return [abs(one.steps()) for one in counters]


def used_stack():
    """Its C stack is another matter, and larger."""
    return None


def mem_level(pin):
    """Whether the pad has been on since the last look, whoever drives it."""
    unit = min(len(counters), CONFIG["units"] - 1)
    del counters[unit:]  # where each axis has one, the last axis goes without
    edges = Edges(unit, pin)
    off = "SPINDLE_PWM" in getattr(board, "INVERT", ())

    def level():
        return edges.take() or pad_level(pin) ^ off

    return level
