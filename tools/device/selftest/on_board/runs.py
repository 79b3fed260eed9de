# mypy: ignore-errors
"""Checks for every engine: count steps, start from standstill."""

import time

from .config import CONFIG
from .rows import AXES, random_between
from .say import say


def count_steps(drive, hz, name):
    """Move all axes forth and back, and count. Repeated until each motor has been watched, because
    not all may be watched at once."""
    for index in range(2 * drive.rounds):
        backwards = (1 << AXES) - 1 if index & 1 else 0  # a mask of axes
        if not backwards:
            drive.count(drive.watched)
        begun = time.ticks_us()
        asked = drive.even(hz, hz * CONFIG["run_ms"] // 1000, backwards)
        drive.start()
        rested = drive.rest()
        took_us = time.ticks_diff(time.ticks_us(), begun)
        say(
            "steps",
            rate=name,
            hz=hz,
            back=backwards != 0,
            asked=asked,
            rested=rested,
            took_us=took_us,
            position=drive.position(),
            counted=drive.counted(),
            motors=drive.motors,
        )


def any_motion(drive, rows):
    """Plan segments at a random rate in random directions."""
    gap = random_between(drive.gaps[0], drive.gaps[1])
    most = max(min(4000, drive.row // gap), 1)
    counts = [random_between(0, most) for _ in range(AXES)]
    counts[random_between(0, AXES - 1)] = most
    flips = random_between(0, (1 << AXES) - 1)
    drive.plan(gap, counts, rows, random_between(0, (1 << AXES) - 1), flips, drive.row)


def watch_others(drive, k):
    """If not all motors can be watched at once, watch the next ones at every fourth call. The
    engine must be idle."""
    if drive.rounds > 1 and k % 4 == 0:
        drive.count(drive.watched)


def start_from_rest(drive):
    """Make short moves, each to its end, and check that every step was made."""
    drive.count(drive.watched)
    wrong, first, stuck = 0, [], 0
    for index in range(CONFIG["starts"]):
        watch_others(drive, index)
        before = drive.position()
        gap = random_between(drive.rest_gaps[0], drive.rest_gaps[1])
        counts = [random_between(0, 12) for _ in range(AXES)]
        counts[random_between(0, AXES - 1)] = 12
        backwards = random_between(0, (1 << AXES) - 1)  # a mask: axes that move backwards
        drive.plan(gap, counts, 1, backwards)
        drive.start()
        if not drive.rest(500):
            stuck += 1
        due = [before[i] + (-counts[i] if backwards >> i & 1 else counts[i]) for i in range(AXES)]
        position, counted = drive.position(), drive.counted()
        if position != due or counted != drive.of_watched(due):
            wrong += 1
            first = first or [index, due, position, counted]
            drive.count(drive.watched)
    say("starts", count=CONFIG["starts"], wrong=wrong, stuck=stuck, first=first)
