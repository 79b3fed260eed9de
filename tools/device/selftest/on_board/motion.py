# mypy: ignore-errors
"""Checks on an RP2: steps counted, pulses measured, stops at random instants, starts from
standstill."""

import time

import board
from machine import Pin, Timer

from .config import CONFIG
from .drive import WATCHED, sampler
from .rows import AXES, random_between, settle
from .runs import count_steps, plan_random, start_from_rest, watch_others
from .say import say
from .watch import FIRST, Counter


def see_pads():
    """Return whether counters and sampler see the pins. Software makes a known number of steps,
    forward and backward, and two levels."""
    step, direction = Pin(board.STEP[0], Pin.OUT, value=0), Pin(board.DIR[0], Pin.OUT, value=0)
    counter = Counter(FIRST, board.STEP[0], board.DIR[0])
    made = CONFIG["seen"]  # steps forward, backward
    for level, count in ((0, made[0]), (1, made[1])):
        direction.value(level)
        for _ in range(count):
            step.value(1)
            time.sleep_us(5)
            step.value(0)
            time.sleep_us(5)
    seen = counter.steps()
    counter.close()
    levels = []
    for level in (1, 0):
        step.value(level)
        sampler.look()
        levels.append(sampler.level(board.STEP[0], sampler.length // 2))
    direction.value(0)
    say("watchers", made=made, seen=seen, levels=levels)
    return seen == tuple(made)


def sample_pulses(drive, hz, us):
    """Report the edges of all step and direction pins in some windows of a run at `hz`, with
    pulses of `us` microseconds."""
    drive.pulse(us)
    drive.count(0)  # no counters: the sampler needs a state machine
    for _ in range(CONFIG["windows"]):
        drive.plan_even(hz, 1 << 20)  # longer than the window
        drive.start()
        time.sleep_us(random_between(2000, 8000))
        sampler.look()
        drive.stop()
        say(
            "pulses",
            hz=hz,
            us=us,
            steps=[sampler.edges(board.STEP[i]) for i in range(AXES)],
            dirs=[sampler.edges(board.DIR[i]) for i in range(AXES)],
        )


def sample_turns(drive):
    """Report the edges in some windows while all axes reverse sooner than the times of direction
    hold and set-up allow, so that the engine must wait."""
    drive.pulse(3)
    drive.count(0)  # no counters: the sampler needs a state machine
    for _ in range(CONFIG["windows"]):
        drive.plan(gap=100, counts=[16] * AXES, rows=60, flip=(1 << AXES) - 1)
        drive.start()
        time.sleep_us(random_between(2000, 4000))
        sampler.look()
        drive.stop()
        say(
            "turns",
            hold_us=getattr(board, "DIR_HOLD_US", 2),
            setup_us=getattr(board, "DIR_SETUP_US", 5),
            steps=[sampler.edges(board.STEP[i]) for i in range(AXES)],
            dirs=[sampler.edges(board.DIR[i]) for i in range(AXES)],
        )


def stop_at_random(drive):
    """Stop at random instants, every other time in a hard interrupt, as for a limit.

    wrong: stops after which the engine's position is not what the counters say. late: stops after
    which another step was counted.
    """
    drive.pulse(3)
    drive.count(WATCHED)
    wrong, first_wrong, late = 0, [], 0
    timer = Timer()
    stop = drive.engine.stop

    def interrupt(_timer):
        stop()

    for index in range(CONFIG["stops"]):
        watch_others(drive, index)
        plan_random(drive, rows=1000)
        drive.start()
        delay_us = random_between(300, 9000)
        if index & 1:
            timer.init(
                mode=Timer.ONE_SHOT,
                period=delay_us,
                tick_hz=1_000_000,
                callback=interrupt,
                hard=True,
            )
            time.sleep_us(delay_us + 300)  # the interrupt stops it meanwhile
        else:
            time.sleep_us(delay_us)
        drive.stop()
        position, counted = drive.position(), drive.counted()
        time.sleep_us(100)
        late += drive.counted() != counted
        if drive.of_watched(position) != counted:
            wrong += 1
            first_wrong = first_wrong or [index, delay_us, position, counted]
            drive.count(WATCHED)  # from 0 again
    timer.deinit()
    say(
        "stops",
        count=CONFIG["stops"],
        wrong=wrong,
        late=late,
        first=first_wrong,
        end=drive.position(),
    )


def check_motion(drive):
    """Run all checks of this file in turn."""
    most_hz = drive.engine.max_step_hz(3)  # with pulses of 3 us
    for hz, us, name in ((1000, 10, "1 kHz"), (50_000, 10, "50 kHz"), (most_hz, 3, "the highest")):
        drive.pulse(us)
        count_steps(drive, hz, name)
    sample_pulses(drive, hz=50_000, us=10)
    sample_pulses(drive, hz=most_hz, us=3)
    sample_turns(drive)
    settle()
    stop_at_random(drive)
    drive.pulse(3)
    start_from_rest(drive)
