"""The simulator with a network that also serves the page: docs/network.md."""

from boards.sim_wifi import *  # noqa: F403

PAGE = True
