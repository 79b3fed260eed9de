"""The simulator, speaking as grblHAL."""

from boards.sim import *  # noqa: F403

DIALECT = "hal"
