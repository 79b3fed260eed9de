# mypy: ignore-errors
"""The pulse engine of an ESP32 board whose steps have pins, with step counters."""

import time

import board
from boot.parts import make

from .pcnt import Counter
from .rows import AXES, Mover

# Segments as the firmware makes them: 4 ms. Random motion is at most as fast as the board file
# allows.
TICK_HZ = 1_000_000
LONG = 4096  # ticks of a segment
SLOWEST_US = 4000  # between two steps
PULSE_US = 10
# longer than a train of pulses that continues after a stop without being counted
COUNTS_SEEN_US = 25_000


def highest_hz(engine):
    """Return the highest step rate, as the firmware computes it."""
    most = engine.max_step_hz(PULSE_US)
    return min(most, getattr(board, "MAX_STEP_RATE_HZ", 0) or most)


class NoLink:
    """A link without bytes. The parts need a link, which they call in each turn of the main
    loop."""


class Drive(Mover):
    """Moves the motors, and counts the steps of all axes. port: the firmware's, with its
    engine."""

    def __init__(self):
        engine, self.port, _ = make(board, NoLink())
        self.most_hz = highest_hz(engine)
        gaps = (1_000_000 // self.most_hz, SLOWEST_US)  # in ticks, which are us
        super().__init__(
            engine,
            TICK_HZ,
            AXES,
            long_ticks=LONG,
            random_gaps=gaps,
            start_gaps=gaps,
            random_ticks=4 * SLOWEST_US,
        )
        self.pulse(PULSE_US)
        self._counters = [Counter(i, board.STEP[i], board.DIR[i]) for i in range(AXES)]

    def count(self, axes):
        """Set the position to 0, and count the steps of all axes from now on, whatever `axes` says
        (on an RP2 it says how many). The engine must be idle."""
        self.set_zero()
        for one in self._counters:
            one.reset()

    def counted(self):
        """Return the steps counted so far, forward minus backward, per axis."""
        return [one.steps() for one in self._counters]


def wait_us(us):
    """Wait in Python, so that soft interrupts are served."""
    begun = time.ticks_us()
    while time.ticks_diff(time.ticks_us(), begun) < us:
        pass
