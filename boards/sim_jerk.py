"""The simulator with a limit of jerk: $800, $801, $802."""

from boards.sim import *  # noqa: F403

JERK = True
