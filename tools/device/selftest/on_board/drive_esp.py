# mypy: ignore-errors
"""The pulse engine of an ESP32 board whose steps have pins, and counters beside it."""

import time

import board
from boot.parts import make

from .pcnt import Counter
from .rows import AXES, Mover

# Rows as the firmware makes them: 4 ms; moves of any kind up to what the board file allows.
TICK_HZ = 1_000_000
LONG = 4096
SLOWEST_US = 4000
PULSE_US = 10
COUNTS_SEEN_US = 25_000  # longer than a train that goes on behind a stop, to nobody


def highest_hz(engine):
    """As the firmware has it."""
    most = engine.max_step_hz(PULSE_US)
    return min(most, getattr(board, "MAX_STEP_RATE_HZ", 0) or most)


class NoLink:
    """Nobody sends; the parts want one all the same, to be called in each of its turns."""


class Drive(Mover):
    """Moves, and counts the steps of all axes. port: of the firmware, working with its engine."""

    def __init__(self):
        engine, self.port, _ = make(board, NoLink())
        self.most_hz = highest_hz(engine)
        gaps = (1_000_000 // self.most_hz, SLOWEST_US)
        super().__init__(engine, TICK_HZ, AXES, LONG, gaps, gaps, 4 * SLOWEST_US)
        self.pulse(PULSE_US)
        self._counters = [Counter(i, board.STEP[i], board.DIR[i]) for i in range(AXES)]

    def count(self, axes):
        """Watch from here on, the engine being at rest: all axes, whatever is asked for."""
        self.name_here()
        for one in self._counters:
            one.reset()

    def counted(self):
        """What the watchers have seen."""
        return [one.steps() for one in self._counters]


def wait_us(us):
    """In Python, so that soft interrupts come in between."""
    begun = time.ticks_us()
    while time.ticks_diff(time.ticks_us(), begun) < us:
        pass
