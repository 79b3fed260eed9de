"""The simulator with compensation of backlash: $160, $161, $162."""

from boards.sim import *  # noqa: F403

BACKLASH = True
