"""The simulator with a rotary axis: A turns the work, in degrees, for ever ($133=0)."""

from boards.sim_xyza import *  # noqa: F403

ROTARY = "A"
DEFAULTS = {
    103: 100.0,
    113: 3600.0,
    123: 1000.0,
    133: 0.0,
}
