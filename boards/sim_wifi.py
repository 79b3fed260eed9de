"""The simulator with a network as well as its cable: $NET, see docs/network.md."""

from boards.sim import *  # noqa: F403

LINK = "wifi"
