# mypy: ignore-errors
"""Segments for the deployed engine, whichever it is, without planner, and what the engine makes of
them.

A segment is a row of integers: ticks, direction bits, power, and per axis: steps, tick of the
first one, tick of the last one. `plan` is an array that an interrupt reads: places LEFT to ROW.
"""

import gc
import random
import time
from array import array

import board
import micropython

AXES = len(board.STEP)

LEFT = 0  # place in `plan`: segments still to come
DIRS = 1  # directions of the next one, a bit per axis
FLIP = 2  # direction bits that change after each segment
LENGTH = 3  # of a row
ROW = 4  # the row itself begins here
KEEP_POWER = 0x3FFFFFFF  # as a row's power: the laser's power stays


@micropython.viper
def serve(plan: ptr32, row: ptr32) -> int:
    """Write the next segment into `row`; returns 0 if none is left. Called by the engine's
    interrupt. The places of `plan` are numbers here, because viper looks up names slowly: 0 LEFT,
    1 DIRS, 2 FLIP, 3 LENGTH, 4 ROW."""
    if plan[0] <= 0:
        return 0
    plan[0] -= 1
    k = plan[3]
    while k > 0:
        k -= 1
        row[k] = plan[4 + k]
    row[1] = plan[1]  # the row's directions
    plan[1] = plan[1] ^ plan[2]
    return 1


def make_serve(plan):
    """Return serve() for this plan as the engine calls it. It is a closure, because an interrupt
    must not look up global names."""
    kernel = serve

    def next_segment(row):
        return kernel(plan, row)

    return next_segment


def nothing(*_):
    """Do nothing: a callback without a listener."""


class Mover:
    """An engine with segments of our own. Step counts are signed like its position: backward is
    negative.

    watched: number of axes whose steps can be counted at a time. long_ticks: the longest segment.
    random_gaps, start_gaps: lowest and highest number of ticks between two steps, in random motion
    and for starts from standstill. random_ticks: length of a segment in random motion.
    """

    def __init__(
        self, engine, tick_hz, watched, long_ticks, random_gaps, start_gaps, random_ticks
    ):
        self.engine, self._tick_hz, self.watched = engine, tick_hz, watched
        self._long_ticks = long_ticks
        self.motors = list(range(watched))  # those whose steps are counted now
        self.rounds = -(-AXES // watched)  # after so many rounds each motor has been watched once
        self.random_gaps, self.start_gaps, self.random_ticks = (
            random_gaps,
            start_gaps,
            random_ticks,
        )
        self._plan = array("i", [0] * (ROW + 3 + 3 * AXES))
        self._plan[LENGTH] = 3 + 3 * AXES
        self._steps = array("i", [0] * AXES)
        self.engine.attach(make_serve(self._plan), nothing, nothing)  # no on_power, on_rest
        self.pulse(10)

    def pulse(self, us):
        """Set the length of a step pulse, in us."""
        self.engine.configure(us, 0, 0)

    def set_zero(self):
        """Set the position to 0."""
        self.engine.set_position(array("i", [0] * AXES))

    def plan(self, gap, counts, rows, dirs=0, flip=0, ticks=0):
        """Plan `rows` equal segments with `counts` steps per axis. The steps of the axis with the
        most are `gap` ticks apart. dirs: mask of axes that move backward; flip: of those that
        reverse after each segment. ticks: length of a segment; 0: as the steps need."""
        plan = self._plan
        plan[LEFT] = 0  # first, because the interrupt must not read half a plan
        plan[DIRS], plan[FLIP] = dirs, flip
        ticks = ticks or gap * max(counts)
        plan[ROW], plan[ROW + 2] = ticks, KEEP_POWER  # serve() sets the directions, ROW + 1
        for i in range(AXES):
            steps = counts[i] if i < len(counts) else 0
            own_gap = gap * max(counts) // steps if steps else 0
            # Per axis: steps, tick of the first one, tick of the last one.
            plan[ROW + 3 + 3 * i] = steps
            plan[ROW + 4 + 3 * i] = own_gap // 2
            plan[ROW + 5 + 3 * i] = own_gap // 2 + own_gap * (steps - 1) if steps else 0
        plan[LEFT] = rows

    def plan_even(self, hz, steps, dirs=0):
        """Plan about `steps` steps for each axis, at that rate, in equal segments. Returns how
        many they will be. dirs: mask of axes that move backward."""
        gap = self._tick_hz // hz
        per_row = max(min(self._long_ticks // gap, steps), 1)
        rows = max(steps // per_row, 1)
        self.plan(gap, [per_row] * AXES, rows, dirs)
        return rows * per_row

    def start(self):
        """Start motion."""
        self.engine.arm()
        self.engine.start()

    def wait_for_end(self, limit_ms=10_000):
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
