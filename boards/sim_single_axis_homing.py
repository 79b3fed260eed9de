"""The simulator, built as the recorded Grbl to set the origin by homing, axis by axis."""

from boards.sim import *  # noqa: F403

FORCE_SET_ORIGIN = True
SINGLE_AXIS_HOMING = True
