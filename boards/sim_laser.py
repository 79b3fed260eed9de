"""The simulator as a laser: $33, and power that changes at the exact step."""

from boards.sim import *  # noqa: F403

TOOL = "laser"
PWM_MAX = 1000
CLUSTERS = True
