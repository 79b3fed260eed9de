"""The simulator as a punching machine: M3 arms the punch, M5 disarms it."""

from boards.sim import *  # noqa: F403

TOOL = "punch"
PUNCH_DOWN = 20
PUNCH_UP = 21
PUNCH_DOWN_SENSOR = 22
PUNCH_UP_SENSOR = 23
# The limit for a stroke, down or up.
PUNCH_TIMEOUT_MS = 1000
# The time of a simulated stroke, one way.
PUNCH_STROKE_MS = 40
