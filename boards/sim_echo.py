"""The simulator, built as the recorded Grbl with a highest step rate and echoed lines."""

from boards.sim import *  # noqa: F403

MAX_STEP_RATE_HZ = 30000
ECHO = True
