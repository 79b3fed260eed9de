"""The simulator as a punching machine: M3 arms the punch, M5 disarms it."""

from boards.sim import *  # noqa: F403

TOOL = "punch"
PUNCH_DOWN = 20
PUNCH_UP = 21
PUNCH_DOWN_SENSOR = 22
PUNCH_UP_SENSOR = 23
# No stroke takes longer, down or up.
PUNCH_TIMEOUT_MS = 1000
# How long the simulated one takes, one way.
PUNCH_STROKE_MS = 40
