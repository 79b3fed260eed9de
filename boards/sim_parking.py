"""The simulator, built as the recorded Grbl with parking, override control and a safety door."""

from boards.sim import *  # noqa: F403

PARKING = True
OVERRIDE_CONTROL = True
SAFETY_DOOR = True
