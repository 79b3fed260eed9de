# mypy: ignore-errors
"""An ESP32 board: its identity, and all checks in turn."""

import random
import sys

from machine import freq

from .config import CONFIG
from .drive_esp import Drive
from .drivers import drivers_off, ignore_inputs
from .motion_esp import check_limits, check_motion, check_pwm, see_steps
from .rows import AXES
from .say import say


def check_all():
    """Run all checks in turn. Drivers stay off, and outputs are off at the end."""
    wired = drivers_off()
    ignore_inputs()
    random.seed(CONFIG["seed"])
    drive = Drive()  # sets the firmware's CPU clock
    say(
        "board",
        name=getattr(sys.implementation, "_machine", sys.platform),
        micropython=".".join(str(x) for x in sys.implementation.version[:3]),
        hz=freq(),
        axes=AXES,
        enables=len(wired),
    )
    port = drive.port
    try:
        if see_steps(drive):
            check_motion(drive)
            check_limits(drive, port)
            check_pwm(port)
    finally:
        try:
            port.kill()
        finally:
            drive.stop()
    say("end")


check_all()
