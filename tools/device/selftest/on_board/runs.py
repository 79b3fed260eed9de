# mypy: ignore-errors
"""Checks for every engine: count steps, start from standstill."""

import time

from .config import CONFIG
from .rows import AXES, random_between
from .say import say


def count_steps(drive, hz, name):
    """Move all axes forth and back at a rate, and count. Repeated until each motor has been
    watched, because not all may be watched at once. name: of the rate, for the report."""
    for index in range(2 * drive.rounds):
        backward = (1 << AXES) - 1 if index & 1 else 0  # a mask of axes
        if not backward:
            drive.count(drive.watched)
        begun = time.ticks_us()
        asked = drive.plan_even(hz, hz * CONFIG["run_ms"] // 1000, backward)
        drive.start()
        rested = drive.wait_for_end()
        took_us = time.ticks_diff(time.ticks_us(), begun)
        say(
            "steps",
            rate=name,
            hz=hz,
            back=backward != 0,
            asked=asked,
            rested=rested,
            took_us=took_us,
            position=drive.position(),
            counted=drive.counted(),
            motors=drive.motors,
        )


def plan_random(drive, rows):
    """Plan `rows` segments with random steps, at a random rate in random directions."""
    gap = random_between(drive.random_gaps[0], drive.random_gaps[1])
    most = max(min(4000, drive.random_ticks // gap), 1)  # PIO rows have 4095 at most
    counts = [random_between(0, most) for _ in range(AXES)]
    counts[random_between(0, AXES - 1)] = most  # one axis makes all of them
    drive.plan(
        gap,
        counts,
        rows,
        dirs=random_between(0, (1 << AXES) - 1),
        flip=random_between(0, (1 << AXES) - 1),
        ticks=drive.random_ticks,
    )


def watch_others(drive, k):
    """If not all motors can be watched at once, watch the next ones at every fourth call. The
    engine must be idle."""
    if drive.rounds > 1 and k % 4 == 0:
        drive.count(drive.watched)


def start_from_rest(drive):
    """Make short moves, each to its end, and check that every step was made.

    wrong: moves after which engine or counters say otherwise; first: the first of them. stuck:
    moves that did not end.
    """
    drive.count(drive.watched)
    wrong, first, stuck = 0, [], 0
    for index in range(CONFIG["starts"]):
        watch_others(drive, index)
        before = drive.position()
        gap = random_between(drive.start_gaps[0], drive.start_gaps[1])
        counts = [random_between(0, 12) for _ in range(AXES)]
        counts[random_between(0, AXES - 1)] = 12
        backward = random_between(0, (1 << AXES) - 1)  # a mask of axes
        drive.plan(gap, counts, rows=1, dirs=backward)
        drive.start()
        if not drive.wait_for_end(limit_ms=500):
            stuck += 1
        due = [before[i] + (-counts[i] if backward >> i & 1 else counts[i]) for i in range(AXES)]
        position, counted = drive.position(), drive.counted()
        if position != due or counted != drive.of_watched(due):
            wrong += 1
            first = first or [index, due, position, counted]
            drive.count(drive.watched)  # from 0 again
    say("starts", count=CONFIG["starts"], wrong=wrong, stuck=stuck, first=first)
