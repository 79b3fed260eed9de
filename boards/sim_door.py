"""The simulator, built as the recorded Grbl with a safety door in place of the hold input."""

from boards.sim import *  # noqa: F403

SAFETY_DOOR = True
