# mypy: ignore-errors
"""Rows of our own for the deployed engine, whichever it is, and what it makes of them."""

import gc
import random
import time
from array import array

import board
import micropython

AXES = len(board.STEP)

# What is served: rows still to come, directions, what changes of them after each, length of a
# row, and the row itself.
LEFT, DIRS, FLIP, LENGTH, ROW = 0, 1, 2, 3, 4
KEEP_POWER = 0x3FFFFFFF


@micropython.viper
def serve(plan: ptr32, row: ptr32) -> int:
    """The next segment; 0 where none is left. The engine's interrupt asks for it."""
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
    """What the engine calls: a closure, for an interrupt looks nothing up."""
    act = serve

    def following(row):
        return act(plan, row)

    return following


def nothing(*_):
    """Nobody is told."""


class Mover:
    """An engine. Steps are named as its position names them: backward ones are negative.

    long: ticks of a long segment. gaps, rest_gaps: from step to step in moves of any kind, and
    from rest. row: ticks of a segment in the former.
    """

    def __init__(self, engine, tick_hz, watched, long, gaps, rest_gaps, row):
        self.engine, self._tick_hz, self.watched, self._long = engine, tick_hz, watched, long
        self.motors = list(range(watched))
        self.rounds = -(-AXES // watched)  # in which each motor is watched once
        self.gaps, self.rest_gaps, self.row = gaps, rest_gaps, row
        self._plan = array("i", [0] * (ROW + 3 + 3 * AXES))
        self._plan[LENGTH] = 3 + 3 * AXES
        self._steps = array("i", [0] * AXES)
        self.engine.attach(make_serve(self._plan), nothing, nothing)
        self.pulse(10)

    def pulse(self, us):
        """Length of a step's pulse."""
        self.engine.configure(us, 0, 0)

    def name_here(self):
        """This place is 0."""
        self.engine.set_position(array("i", [0] * AXES))

    def plan(self, gap, counts, rows, dirs=0, flip=0, ticks=0):
        """So many segments with these steps per axis, those with most of them gap ticks apart."""
        plan = self._plan
        plan[LEFT] = 0
        plan[DIRS], plan[FLIP] = dirs, flip
        ticks = ticks or gap * max(counts)
        plan[ROW], plan[ROW + 2] = ticks, KEEP_POWER
        for i in range(AXES):
            steps = counts[i] if i < len(counts) else 0
            own = gap * max(counts) // steps if steps else 0
            plan[ROW + 3 + 3 * i] = steps
            plan[ROW + 4 + 3 * i] = own // 2
            plan[ROW + 5 + 3 * i] = own // 2 + own * (steps - 1) if steps else 0
        plan[LEFT] = rows

    def even(self, hz, steps, dirs=0):
        """All axes together, at that rate, so many steps each; how many they will be."""
        gap = self._tick_hz // hz
        each = max(min(self._long // gap, steps), 1)
        rows = max(steps // each, 1)
        self.plan(gap, [each] * AXES, rows, dirs)
        return rows * each

    def start(self):
        """Go."""
        self.engine.arm()
        self.engine.start()

    def rest(self, limit_ms=10_000):
        """Wait for the end of all motion; False where it does not come."""
        begun = time.ticks_ms()
        while self._plan[LEFT] or not self.engine.idle():
            if time.ticks_diff(time.ticks_ms(), begun) > limit_ms:
                self.stop()
                return False
        return True

    def stop(self):
        """At once, and nothing is left to do."""
        self.engine.stop()
        self._plan[LEFT] = 0

    def of_watched(self, steps):
        """Those of the motors that are watched."""
        return [steps[motor] for motor in self.motors]

    def position(self):
        """What the engine says it has made."""
        self.engine.position(self._steps)
        return list(self._steps)


def some(low, high):
    """A random number, both ends included."""
    return random.randint(low, high)


def settle():
    """Memory in order: a collection comes when it is asked for."""
    gc.collect()
