"""The simulator as a wire cutter: X and Y move one end of the hot wire, U and V the other."""

from boards.sim import *  # noqa: F403

STEP = (0, 1, 2, 3)
XYUV = True
