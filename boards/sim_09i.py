"""The simulator, speaking as Grbl 0.9i."""

from boards.sim import *  # noqa: F403

DIALECT = "0.9i"
