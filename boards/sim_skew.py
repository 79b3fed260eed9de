"""The simulator with axes that are not at right angles: $780, $781, $782."""

from boards.sim import *  # noqa: F403

SKEW = True
