"""The simulator as the punching machine of the documents: it speaks as Grbl 0.9i."""

from boards.sim_punch import *  # noqa: F403

DIALECT = "0.9i"
