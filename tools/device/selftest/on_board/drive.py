# mypy: ignore-errors
"""The pulse engine of an RP2 board, with step counters."""

import board

from .config import CONFIG
from .rows import AXES, Mover, settle
from .watch import FIRST, LAST, TICK_HZ, Counter, Sampler

sampler = Sampler(CONFIG["samples"])  # before other allocations fragment the memory

from pio.engine import PioEngine  # noqa: E402

WATCHED = min(AXES, LAST - FIRST + 1)  # a state machine for each counted axis


class Drive(Mover):
    """Moves the motors, and counts the steps of some axes."""

    def __init__(self):
        hold_us = getattr(board, "DIR_HOLD_US", 2)
        setup_us = getattr(board, "DIR_SETUP_US", 5)
        engine = PioEngine(board.STEP, board.DIR, hold_us, setup_us)
        self._counters = []
        self._next = 0  # the motor that is watched first next time
        super().__init__(
            engine,
            TICK_HZ,
            WATCHED,
            long_ticks=65536,
            random_gaps=(60, 2500),
            start_gaps=(60, 1000),
            random_ticks=40_000,
        )

    def count(self, axes):
        """Set the position to 0, and count the steps of so many axes from now on, in rotation:
        each call takes the next ones. The engine must be idle."""
        settle()  # a counter needs memory, and output has left holes in it
        for one in self._counters:
            one.close()
        self.motors = [(self._next + i) % AXES for i in range(axes)]
        self._next = (self._next + axes) % AXES
        self._counters = [
            Counter(FIRST + i, board.STEP[motor], board.DIR[motor])
            for i, motor in enumerate(self.motors)
        ]
        self.set_zero()

    def counted(self):
        """Return the steps counted so far, forward minus backward, per watched axis."""
        counts = [counter.steps() for counter in self._counters]
        return [forward - backward for forward, backward in counts]
