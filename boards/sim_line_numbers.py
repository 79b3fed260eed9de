"""The simulator, built as the recorded Grbl with line numbers and mist."""

from boards.sim import *  # noqa: F403

LINE_NUMBERS = True
MIST = True
# Line numbers cost Grbl a planner block.
PLANNER_BLOCKS = 15
