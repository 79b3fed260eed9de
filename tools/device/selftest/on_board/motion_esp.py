# mypy: ignore-errors
"""Checks on an ESP32: steps counted, stops at random instants, limits pulled, PWM observed."""

import time

import board
from machine import Pin, Timer

from .config import CONFIG
from .drive_esp import COUNTS_SEEN_US, PULSE_US, wait_us
from .pcnt import Edges, pad_level
from .rows import AXES, random_between
from .runs import count_steps, plan_random, start_from_rest
from .say import say

STOPPER = 3  # a timer: 0 is the engine's, 1 and 2 are the port's
LOOKED_MS = 100  # time of observation of a PWM


def see_steps(drive):
    """Return whether the counters see the pins. Software makes a known number of steps, forward
    and backward."""
    step, direction = Pin(board.STEP[0]), Pin(board.DIR[0])
    made, seen = CONFIG["seen"], []  # steps forward, backward: made, counted
    for level, count in ((0, made[0]), (1, made[1])):
        direction.value(level)
        drive.count(AXES)
        for _ in range(count):
            step.value(1)
            time.sleep_us(5)
            step.value(0)
            time.sleep_us(5)
        seen.append(abs(drive.counted()[0]))
    step.value(1)
    levels = [pad_level(board.STEP[0])]
    step.value(0)
    levels.append(pad_level(board.STEP[0]))
    direction.value(0)
    drive.count(AXES)
    say("watchers", made=made, seen=seen, levels=levels, who="PCNT")
    return seen == list(made)


def deviation(drive):
    """Return by how many steps position and count differ at most."""
    return max(abs(a - b) for a, b in zip(drive.position(), drive.counted()))


def stop_and_look(drive):
    """Stop. Returns by how many steps position and count differ, and whether steps followed the
    stop."""
    drive.stop()
    counted, steps_off = drive.counted(), deviation(drive)
    wait_us(COUNTS_SEEN_US)
    return steps_off, drive.counted() != counted


def stop_at_random(drive):
    """Stop at random instants, every other time in a soft interrupt, as for a limit.

    moved: stops in motion. exact: stops after which the engine's position was what the counters
    say; worst: the largest difference in steps. late: stops after which another step was counted.
    """
    exact, late, moved, worst_off = 0, 0, 0, 0
    worst_case = []  # its difference, index, position and count
    timer = Timer(STOPPER)
    stop = drive.engine.stop
    for k in range(CONFIG["stops"]):
        drive.count(AXES)
        plan_random(drive, rows=1000)
        drive.start()
        delay_ms = random_between(3, 60)
        if k & 1:
            timer.init(mode=Timer.ONE_SHOT, period=delay_ms, callback=lambda _: stop())
            wait_us(1000 * delay_ms + 3000)  # the interrupt stops it meanwhile
        else:
            wait_us(1000 * delay_ms + random_between(0, 999))
        steps_off, has_moved_on = stop_and_look(drive)
        late += has_moved_on
        moved += any(drive.counted())
        exact += steps_off == 0
        if steps_off > worst_off:
            worst_off = steps_off
            worst_case = [steps_off, k, drive.position(), drive.counted()]
    timer.deinit()
    say(
        "stops by the clock",
        count=CONFIG["stops"],
        moved=moved,
        exact=exact,
        late=late,
        worst=worst_off,
        first=worst_case,
    )


def pull(pin, down):
    """Pull an input with the chip's own resistor, down or up. Returns whether it follows, that is,
    nothing wired to it holds it."""
    Pin(pin, Pin.IN, Pin.PULL_DOWN if down else Pin.PULL_UP)
    wait_us(20)
    return Pin(pin).value() == (not down)


def attach_listener(drive, port, limit_times_us):
    """Make a limit switch the outputs off and stop the engine. limit_times_us: a list that gets
    the time of each limit."""
    kill, stop = port.kill, drive.engine.stop

    class Listener:
        def on_limits(self):
            kill()
            stop()
            limit_times_us.append(time.ticks_us())

        def on_controls(self, active):
            pass

        def on_fault(self):
            stop()

    port.attach(Listener())


def check_limits(drive, port):
    """Check each limit input that has the chip's own pull-up: while all axes run, pull it low with
    the chip's pull-down. Report the time until the limit's callback, and the stop.

    shown: the inputs followed. missed, late: limits without a callback, with steps after the stop.
    worst: the largest difference between position and count, in steps.
    """
    no_pull_up = getattr(board, "NO_PULL_UP", ())
    limit_pins = [pin for pin in getattr(board, "LIMIT", ()) if pin is not None]
    pins = [pin for pin in limit_pins if pin not in no_pull_up]
    took_us, missed, late, worst, shown = [], 0, 0, 0, bool(pins)
    limit_times_us = []
    attach_listener(drive, port, limit_times_us)
    for k in range(CONFIG["limits"] if pins else 0):
        pin = pins[k % len(pins)]
        drive.count(AXES)
        limit_times_us.clear()
        port.enable_limits(True)
        port.revive()
        backward = random_between(0, (1 << AXES) - 1)  # a mask of axes
        drive.plan_even(drive.most_hz, 20_000, backward)
        drive.start()
        wait_us(random_between(10_000, 40_000))
        pulled_us = time.ticks_us()
        shown = pull(pin, down=True)
        wait_us(5000)
        if limit_times_us:
            took_us.append(time.ticks_diff(limit_times_us[0], pulled_us))
        missed += not limit_times_us
        steps_off, has_moved_on = stop_and_look(drive)
        port.enable_limits(False)
        pull(pin, down=False)
        worst, late = max(worst, steps_off), late + has_moved_on
        if not shown:  # something wired to it holds it
            break
    say(
        "limits pulled",
        inputs=len(pins),
        shown=shown,
        missed=missed,
        late=late,
        worst=worst,
        us=took_us,
    )


def observe_pwm(pin, edges):
    """Observe SPINDLE_PWM's pin for LOOKED_MS. Returns figures for say(): high, the share of
    readings with the output on, in thousandths; the number of readings; rising edges; ms."""
    off_level = "SPINDLE_PWM" in getattr(board, "INVERT", ())  # 1 if the output is inverted
    time.sleep_ms(CONFIG["pwm_settles_ms"])
    edges.take()  # forgets those before
    begun, on_count, count = time.ticks_us(), 0, 0
    while time.ticks_diff(time.ticks_us(), begun) < 1000 * LOOKED_MS:
        on_count += pad_level(pin) ^ off_level
        count += 1
    high = 1000 * on_count // count
    return {"high": high, "looks": count, "edges": edges.take(), "ms": LOOKED_MS}


def check_pwm(port):
    """Check the spindle's PWM at zero, half and full power, and when commanded after a kill, which
    must have no effect. The pin is read as often as Python can."""
    pin = getattr(board, "SPINDLE_PWM", None)
    if pin is None or not CONFIG["pwm"]:
        say("pwm", asked=CONFIG["pwm"], wired=pin is not None)
        return
    full = getattr(board, "PWM_MAX", 1000)
    edges = Edges(0, pin)
    port.revive()
    for power in (0, full // 2, full):
        port.spindle(power > 0, power)
        say("pwm looked at", power=power, full=full, **observe_pwm(pin, edges))
    port.kill()
    port.spindle(True, full)
    say("pwm looked at", power=0, full=full, killed=True, **observe_pwm(pin, edges))


def check_motion(drive):
    """Run the checks that need only the engine, in turn."""
    drive.pulse(PULSE_US)
    most_hz = drive.most_hz
    for hz, name in ((most_hz // 10, ""), (most_hz // 2, ""), (most_hz, "the highest")):
        count_steps(drive, hz, name or "%g kHz" % (hz / 1000))
    stop_at_random(drive)
    start_from_rest(drive)
