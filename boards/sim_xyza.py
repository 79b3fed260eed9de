"""The simulator with a fourth axis: A, in degrees, turns a knife (docs/custom.md) or the work."""

from boards.sim import *  # noqa: F403

STEP = (0, 1, 2, 3)
