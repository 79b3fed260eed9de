"""The simulator with two motors on Y, each with a limit switch: a gantry that squares itself."""

from boards.sim import *  # noqa: F403

MOTORS = "XYZY"
STEP = (0, 1, 2, 3)
LIMIT = (0, 1, 2, 3)
