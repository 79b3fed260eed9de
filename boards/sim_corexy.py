"""The simulator, built as the recorded Grbl with CoreXY."""

from boards.sim import *  # noqa: F403

COREXY = True
