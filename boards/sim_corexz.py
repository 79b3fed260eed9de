"""The simulator as a CoreXZ: motors of X and Z move both axes together."""

from boards.sim import *  # noqa: F403

MOVES = ("X+Z", "Y", "X-Z")
