# mypy: ignore-errors
"""The board's identity, the cost of writing to flash, and all checks of an RP2 in turn."""

import gc
import os
import random
import sys
import time
from array import array

import board
import micropython
from machine import Timer, freq
from pio.pins import GpioPort

from .config import CONFIG
from .drive import Drive
from .drivers import FlashStore, drivers_off, ignore_inputs
from .limits import check_limits
from .motion import check_motion, see_pads
from .say import say

NAME = "selftest"  # name of the file that is written and removed
BEAT_MS = 1  # period of the interrupt
TIMER = CONFIG["timer"]  # address of its register of microseconds


@micropython.viper
def note_gap(times: ptr32) -> int:
    """Update the longest time between two calls, in us. times: [0] address of the timer's register
    of microseconds, [1] time of the last call, [2] longest time so far."""
    now = ptr32(times[0])[0]
    gap = (now - times[1]) & 0x3FFFFFFF  # what an int holds on the board
    times[1] = now
    if gap > times[2]:
        times[2] = gap
    return 0


def make_interrupt(times):
    """Return note_gap() for these times as a timer calls it. It is a closure, because an interrupt
    must not look up global names."""
    kernel = note_gap

    def interrupt(_timer):
        kernel(times)

    return interrupt


def check_save():
    """Save lines as settings are saved, and measure how long no interrupt was served: the longest
    time between two calls of one that is due every BEAT_MS.

    quiet_us: the same before the saves. wrong: saves that read back differently.
    """
    store = FlashStore()
    lines = ["$%d=%d" % (number, number * 7) for number in range(40)]
    times = array("i", [TIMER, time.ticks_us() & 0x3FFFFFFF, 0])
    timer = Timer(mode=Timer.PERIODIC, period=BEAT_MS, callback=make_interrupt(times), hard=True)
    time.sleep_ms(20)
    quiet_us, longest_us, wrong = times[2], 0, 0  # times[2]: the longest gap
    begun = time.ticks_ms()
    for number in range(CONFIG["saves"]):
        lines[0] = "$0=%d" % number
        times[2] = 0
        store.save(NAME, lines)
        longest_us = max(longest_us, times[2])
        wrong += store.load(NAME) != lines
    took_ms = time.ticks_diff(time.ticks_ms(), begun)
    timer.deinit()
    for name in os.listdir("/"):
        if name.startswith(NAME + "."):
            os.remove("/" + name)
    say(
        "save",
        count=CONFIG["saves"],
        wrong=wrong,
        quiet_us=quiet_us,
        longest_us=longest_us,
        beat_us=1000 * BEAT_MS,
        took_ms=took_ms,
    )


def check_all():
    """Run all checks in turn. Drivers stay off, and outputs are off at the end."""
    wired = drivers_off()
    ignore_inputs()
    random.seed(CONFIG["seed"])
    say(
        "board",
        name=os.uname()[4],
        micropython=".".join(str(x) for x in sys.implementation[1][:3]),
        hz=freq(),
        axes=len(board.STEP),
        enables=len(wired),
        free_bytes=gc.mem_free(),
    )
    if not see_pads():
        return
    port = GpioPort(board)
    drive = Drive()
    try:
        check_motion(drive)
        check_limits(drive, port)
    finally:
        try:
            port.kill()
        finally:
            drive.stop()
    check_save()
    say("end")


check_all()
