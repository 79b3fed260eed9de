"""The simulator with a network beside its cable: $NET, and what docs/network.md says."""

from boards.sim import *  # noqa: F403

LINK = "wifi"
