"""The simulator, speaking as Grbl 0.9j."""

from boards.sim import *  # noqa: F403

DIALECT = "0.9j"
