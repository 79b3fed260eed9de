"""The simulator without a switch on Z: X and Y home one after the other ($44 to $49)."""

from boards.sim import *  # noqa: F403

HOMING = ("X", "Y")
