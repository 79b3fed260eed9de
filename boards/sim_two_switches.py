"""The simulator, built as the recorded Grbl with spindle enable pin, two switches per axis."""

from boards.sim import *  # noqa: F403

SPINDLE_ENABLE_PIN = True
DUAL_LIMIT_SWITCHES = True
