"""The simulator with backlash that can be taken up: $160, $161, $162."""

from boards.sim import *  # noqa: F403

BACKLASH = True
