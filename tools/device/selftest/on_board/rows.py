# mypy: ignore-errors
"""Segments for the deployed engine, whichever it is, without planner, and what the engine makes of
them."""

import gc
import random
import time
from array import array

import board
import micropython

AXES = len(board.STEP)

# Places in `plan`: segments still to come, directions, direction bits that flip after each
# segment, length of a row, and the row itself.
LEFT, DIRS, FLIP, LENGTH, ROW = 0, 1, 2, 3, 4
KEEP_POWER = 0x3FFFFFFF


@micropython.viper
def serve(plan: ptr32, row: ptr32) -> int:
    """Write the next segment into `row`; returns 0 if none is left. Called by the engine's
    interrupt. plan: see the places above; as numbers here, for viper."""
    if plan[0] <= 0:
        return 0
    plan[0] -= 1
    k = plan[3]
    while k > 0:
        k -= 1
        row[k] = plan[4 + k]
    row[1] = plan[1]
    plan[1] = plan[1] ^ plan[2]
    return 1


def make_serve(plan):
    """Return a closure for the engine, because an interrupt must not look up names."""
    act = serve

    def following(row):
        return act(plan, row)

    return following


def nothing(*_):
    """Do nothing: a callback without a listener."""


class Mover:
    """An engine with segments of our own. Step counts are signed like its position: backward is
    negative.

    long: ticks of a long segment. gaps, rest_gaps: range of ticks between steps, in random motion
    and for starts from standstill. row: ticks of a segment in random motion.
    """

    def __init__(self, engine, tick_hz, watched, long, gaps, rest_gaps, row):
        self.engine, self._tick_hz, self.watched, self._long = engine, tick_hz, watched, long
        self.motors = list(range(watched))
        self.rounds = -(-AXES // watched)  # after so many rounds each motor has been watched once
        self.gaps, self.rest_gaps, self.row = gaps, rest_gaps, row
        self._plan = array("i", [0] * (ROW + 3 + 3 * AXES))
        self._plan[LENGTH] = 3 + 3 * AXES
        self._steps = array("i", [0] * AXES)
        self.engine.attach(make_serve(self._plan), nothing, nothing)
        self.pulse(10)

    def pulse(self, us):
        """Set the length of a step pulse, in us."""
        self.engine.configure(us, 0, 0)

    def name_here(self):
        """Set the position to 0."""
        self.engine.set_position(array("i", [0] * AXES))

    def plan(self, gap, counts, rows, dirs=0, flip=0, ticks=0):
        """Plan `rows` segments with these steps per axis. The steps of the axis with the most are
        gap ticks apart."""
        plan = self._plan
        plan[LEFT] = 0  # first, because the interrupt must not read half a plan
        plan[DIRS], plan[FLIP] = dirs, flip
        ticks = ticks or gap * max(counts)
        plan[ROW], plan[ROW + 2] = ticks, KEEP_POWER
        for i in range(AXES):
            steps = counts[i] if i < len(counts) else 0
            own_gap = gap * max(counts) // steps if steps else 0
            # Per axis: steps, tick of the first one, tick of the last one.
            plan[ROW + 3 + 3 * i] = steps
            plan[ROW + 4 + 3 * i] = own_gap // 2
            plan[ROW + 5 + 3 * i] = own_gap // 2 + own_gap * (steps - 1) if steps else 0
        plan[LEFT] = rows

    def even(self, hz, steps, dirs=0):
        """Plan the same number of steps for all axes, at that rate. Returns how many they will
        be."""
        gap = self._tick_hz // hz
        each = max(min(self._long // gap, steps), 1)
        rows = max(steps // each, 1)
        self.plan(gap, [each] * AXES, rows, dirs)
        return rows * each

    def start(self):
        """Start motion."""
        self.engine.arm()
        self.engine.start()

    def rest(self, limit_ms=10_000):
        """Wait for the end of all motion. Returns False, and stops, if it does not come within
        limit_ms."""
        begun = time.ticks_ms()
        while self._plan[LEFT] or not self.engine.idle():
            if time.ticks_diff(time.ticks_ms(), begun) > limit_ms:
                self.stop()
                return False
        return True

    def stop(self):
        """Stop at once and drop the remaining segments."""
        self.engine.stop()
        self._plan[LEFT] = 0

    def of_watched(self, steps):
        """Return the values of the watched motors."""
        return [steps[motor] for motor in self.motors]

    def position(self):
        """Return the steps made, according to the engine."""
        self.engine.position(self._steps)
        return list(self._steps)


def random_between(low, high):
    """Return a random integer from low to high, both included."""
    return random.randint(low, high)


def settle():
    """Collect garbage now, so that no collection falls into the next measurement."""
    gc.collect()
