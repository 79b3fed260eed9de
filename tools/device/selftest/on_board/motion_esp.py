# mypy: ignore-errors
"""Checks on an ESP32: steps counted, stops at random instants, limits pulled, PWM observed."""

import time

import board
from machine import Pin, Timer

from .config import CONFIG
from .drive_esp import COUNTS_SEEN_US, PULSE_US, wait_us
from .pcnt import Edges, pad_level
from .rows import AXES, random_between
from .runs import any_motion, count_steps, start_from_rest
from .say import say

STOPPER = 3  # a timer: 0 is the engine's, 1 and 2 are the port's
LOOKED_MS = 100  # time of observation of a PWM


def see_steps(drive):
    """Return whether the counters see the pins. A known number of steps is made by software."""
    step, direction = Pin(board.STEP[0]), Pin(board.DIR[0])
    made, seen = CONFIG["seen"], []
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


def apart(drive):
    """Return by how many steps position and count differ at most."""
    return max(abs(a - b) for a, b in zip(drive.position(), drive.counted()))


def stop_and_look(drive):
    """Stop. Returns the position's deviation in steps, and whether steps followed the stop."""
    drive.stop()
    counted, off = drive.counted(), apart(drive)
    wait_us(COUNTS_SEEN_US)
    return off, drive.counted() != counted


def stop_at_random(drive):
    """Stop at random instants, every other time in a soft interrupt, as for a limit."""
    offs, late, moved = [0, 0], 0, 0
    worst = []
    timer = Timer(STOPPER)
    stop = drive.engine.stop
    for k in range(CONFIG["stops"]):
        drive.count(AXES)
        any_motion(drive, 1000)
        drive.start()
        delay_ms = random_between(3, 60)
        if k & 1:
            timer.init(mode=Timer.ONE_SHOT, period=delay_ms, callback=lambda _: stop())
            wait_us(1000 * delay_ms + 3000)
        else:
            wait_us(1000 * delay_ms + random_between(0, 999))
        off, has_more = stop_and_look(drive)
        late += has_more
        moved += any(drive.counted())
        offs[min(off, 1)] += 1
        if off > (worst[0] if worst else 0):
            worst = [off, k, drive.position(), drive.counted()]
    timer.deinit()
    say(
        "stops by the clock",
        count=CONFIG["stops"],
        moved=moved,
        exact=offs[0],
        late=late,
        worst=worst[0] if worst else 0,
        first=worst,
    )


def pull(pin, down):
    """Pull an input with the chip's own resistor. Returns whether it follows, that is, is not
    wired."""
    Pin(pin, Pin.IN, Pin.PULL_DOWN if down else Pin.PULL_UP)
    wait_us(20)
    return Pin(pin).value() == (not down)


def hear(drive, port, heard):
    """Make limits switch off and stop. `heard` gets the time in us of each."""
    kill, stop = port.kill, drive.engine.stop

    class Listener:
        def on_limits(self):
            kill()
            stop()
            heard.append(time.ticks_us())

        def on_controls(self, active):
            pass

        def on_fault(self):
            stop()

    port.attach(Listener())


def limits_stop(drive, port):
    """Check each limit input with the chip's pull-up, by pulling it low with the chip's
    pull-down."""
    fixed = getattr(board, "NO_PULL_UP", ())
    pins = [pin for pin in getattr(board, "LIMIT", ()) if pin is not None and pin not in fixed]
    heard, took_us, missed, late, worst, shown = [], [], 0, 0, 0, bool(pins)
    hear(drive, port, heard)
    for k in range(CONFIG["limits"] if pins else 0):
        pin = pins[k % len(pins)]
        drive.count(AXES)
        heard.clear()
        port.enable_limits(True)
        port.revive()
        drive.even(drive.most_hz, 20_000, random_between(0, (1 << AXES) - 1))
        drive.start()
        wait_us(random_between(10_000, 40_000))
        begun = time.ticks_us()
        shown = pull(pin, True)
        wait_us(5000)
        if heard:
            took_us.append(time.ticks_diff(heard[0], begun))
        missed += not heard
        off, has_more = stop_and_look(drive)
        port.enable_limits(False)
        pull(pin, False)
        worst, late = max(worst, off), late + has_more
        if not shown:
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


def look_at(pin, edges):
    """Return the share of time for which a pin is on, in thousandths, and its rising edges in
    LOOKED_MS."""
    off = "SPINDLE_PWM" in getattr(board, "INVERT", ())
    time.sleep_ms(CONFIG["pwm_settles_ms"])
    edges.take()
    begun, high, count = time.ticks_us(), 0, 0
    while time.ticks_diff(time.ticks_us(), begun) < 1000 * LOOKED_MS:
        high += pad_level(pin) ^ off
        count += 1
    return {"high": 1000 * high // count, "looks": count, "edges": edges.take(), "ms": LOOKED_MS}


def check_pwm(port):
    """Check the PWM at zero, half and full power, and when commanded after a kill. The pin is read
    as often as Python can."""
    pin = getattr(board, "SPINDLE_PWM", None)
    if pin is None or not CONFIG["pwm"]:
        say("pwm", asked=CONFIG["pwm"], wired=pin is not None)
        return
    full = getattr(board, "PWM_MAX", 1000)
    edges = Edges(0, pin)
    port.revive()
    for power in (0, full // 2, full):
        port.spindle(power > 0, power)
        say("pwm looked at", power=power, full=full, **look_at(pin, edges))
    port.kill()
    port.spindle(True, full)
    say("pwm looked at", power=0, full=full, killed=True, **look_at(pin, edges))


def check_motion(drive):
    """Run the checks that need only the engine, in turn."""
    drive.pulse(PULSE_US)
    most = drive.most_hz
    for hz, name in ((most // 10, ""), (most // 2, ""), (most, "the highest")):
        count_steps(drive, hz, name or "%g kHz" % (hz / 1000))
    stop_at_random(drive)
    start_from_rest(drive)
