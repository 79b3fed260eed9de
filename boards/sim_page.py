"""The simulator with a network that serves the page, too: docs/network.md."""

from boards.sim_wifi import *  # noqa: F403

PAGE = True
