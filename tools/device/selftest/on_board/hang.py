# mypy: ignore-errors
# ruff: noqa: I001
"""The whole firmware, which moves and then hangs on purpose until the watchdog resets the
board."""

from boot import power_up  # first, as in main.py: it prepares the memory

import time

import board
from control import realtime
from talk import lines

from .config import CONFIG
from .drivers import FlashStore, drivers_off, hear_nothing
from .eyes import count_all, mem_level, used_stack, watch
from .say import say

BETWEEN_MS = 150  # between lines
SAY_EVERY_MS = 200  # between reports during the hang

usual_run = realtime.Realtime.run
usual_making = lines.LineReader.__init__
readers = []
program = list(CONFIG["program"])
given = [0]


def make_reader(self, *rest, **named):
    """Create the reader of the machine, and keep a reference to it."""
    usual_making(self, *rest, **named)
    readers.append(self)


def run(self):
    """Replace the main loop's read: feed the lines of a sender one by one, then hang."""
    usual_run(self)
    if not readers or time.ticks_diff(time.ticks_ms(), given[0]) < BETWEEN_MS:
        return
    given[0] = time.ticks_ms()
    if program:
        line = bytearray(program.pop(0).encode())
        readers[0].feed(line, len(line))
    else:
        hang()


def hang():
    """Watch the pins for ever, without feeding the watchdog."""
    pwm = getattr(board, "SPINDLE_PWM", None)
    pin = None if pwm is None else mem_level(pwm)
    begun = said_ms = time.ticks_ms()
    before, last_step_ms, last_high_ms, steps = None, -1, -1, 0
    while True:
        now = time.ticks_ms()
        since = time.ticks_diff(now, begun)
        counts = count_all()
        if counts != before:
            if before is not None:
                last_step_ms = since
            before = counts
        if pin and pin():
            last_high_ms = since
        if time.ticks_diff(now, said_ms) >= SAY_EVERY_MS:
            said_ms = now
            steps = sum(counts)
            say(
                "hang",
                ms=since,
                steps=steps,
                last_step_ms=last_step_ms,
                last_high_ms=last_high_ms,
                pwm=CONFIG["pwm"] and pwm is not None,
                used_stack=used_stack(),
            )


drivers_off()
hear_nothing()
FlashStore.load = lambda *_: []  # factory settings; nothing is stored
FlashStore.save = lambda *_: None
realtime.Realtime.run = run
lines.LineReader.__init__ = make_reader
parts = power_up.build()
watch()
power_up.run_machine(parts)
