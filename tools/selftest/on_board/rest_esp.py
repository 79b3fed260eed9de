# mypy: ignore-errors
"""An ESP32 board: who it is, and all checks in turn."""

import os
import random
import sys

import board
from gpio_esp import EspPort
from machine import freq

from .config import CONFIG
from .drive_esp import Drive
from .drivers import drivers_off, hear_nothing
from .motion_esp import check_motion, check_pwm, limits_stop, see_steps
from .rows import AXES
from .say import say


def check_all():
    """In turn; drivers are off all the time, and outputs at the end."""
    wired = drivers_off()
    hear_nothing()
    random.seed(CONFIG["seed"])
    freq(240_000_000)  # as the firmware does
    say(
        "board",
        name=os.uname()[4],
        micropython=".".join(str(x) for x in sys.implementation.version[:3]),
        hz=freq(),
        axes=AXES,
        enables=len(wired),
    )
    port = EspPort(board)
    drive = Drive(port)
    try:
        if see_steps(drive):
            check_motion(drive)
            limits_stop(drive, port)
            check_pwm(port)
    finally:
        try:
            port.kill()
        finally:
            drive.stop()
    say("end")


check_all()
