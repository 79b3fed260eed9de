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
from .drivers import FlashStore, drivers_off, ignore_inputs
from .eyes import count_all, mem_level, used_stack, watch
from .say import say

BETWEEN_MS = 150  # between lines
SAY_EVERY_MS = 200  # between reports during the hang

firmware_run = realtime.Realtime.run  # the main loop calls it to read
usual_making = lines.LineReader.__init__
readers = []  # the machine's line reader, once it is created
program = list(CONFIG["program"])  # lines still to be fed
last_fed_ms = [0]  # time of the last one; a list, so that functions can change it


def make_reader(self, *rest, **named):
    """Create the reader of the machine, and keep a reference to it."""
    usual_making(self, *rest, **named)
    readers.append(self)


def read_or_hang(self):
    """Replace Realtime.run: after it, feed the lines of the program one by one, then hang."""
    firmware_run(self)
    if not readers or time.ticks_diff(time.ticks_ms(), last_fed_ms[0]) < BETWEEN_MS:
        return
    last_fed_ms[0] = time.ticks_ms()
    if program:
        line = bytearray(program.pop(0).encode())
        readers[0].feed(line, len(line))
    else:
        hang()


def hang():
    """Watch the pins for ever, without feeding the watchdog, and report what they did.

    In the report: ms since the hang began; the last step, and the last time at which the spindle's
    output was on, in ms since then, -1: never; steps of all axes since power-up.
    """
    pwm_pin = getattr(board, "SPINDLE_PWM", None)
    pwm_is_on = None if pwm_pin is None else mem_level(pwm_pin)
    begun_ms = said_ms = time.ticks_ms()
    counts_before, last_step_ms, last_high_ms = None, -1, -1
    while True:
        now_ms = time.ticks_ms()
        since_ms = time.ticks_diff(now_ms, begun_ms)
        counts = count_all()
        if counts != counts_before:
            if counts_before is not None:
                last_step_ms = since_ms
            counts_before = counts
        if pwm_is_on and pwm_is_on():
            last_high_ms = since_ms
        if time.ticks_diff(now_ms, said_ms) >= SAY_EVERY_MS:
            said_ms = now_ms
            say(
                "hang",
                ms=since_ms,
                steps=sum(counts),
                last_step_ms=last_step_ms,
                last_high_ms=last_high_ms,
                pwm=CONFIG["pwm"] and pwm_pin is not None,
                used_stack=used_stack(),
            )


drivers_off()
ignore_inputs()
FlashStore.load = lambda *_: []  # factory settings; nothing is stored
FlashStore.save = lambda *_: None
realtime.Realtime.run = read_or_hang
lines.LineReader.__init__ = make_reader
parts = power_up.build()
watch()
power_up.run_machine(parts)
