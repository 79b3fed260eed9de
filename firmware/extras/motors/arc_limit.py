"""Arcs within the acceleration of their axes: ARC_ACCELERATION = True in the board file.

Grbl plans an arc as lines whose corners may be taken as fast as $11 allows, which may pull more
than $120 and $121 for as long as the arc is. Here its feed rate is no more than their acceleration
allows on its radius: v2 = a r. Overrides above 100 % are added to that.
"""

from math import sqrt

from micropython import const
from motion.arc_geometry import ONE_AXIS, OTHER_AXIS, RADIUS

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from typing import Any

    from motion.arc_geometry import Arc
    from motion.planner import Move

    from extras.api import Cnc


def install(cnc: "Cnc") -> None:
    """Around what makes arcs."""
    canon: "Any" = cnc.machine.canon
    settings: "Any" = cnc.machine.settings
    usual = canon.arc

    def arc(start: "array[float]", target: "array[float]", arc: "Arc", move: "Move") -> None:
        usual(start, target, arc, move)  # made by finish(); its feed is in mm/min by now
        plane, accelerations = arc.plane, settings.acceleration  # mm/min2
        accel = min(accelerations[plane[ONE_AXIS]], accelerations[plane[OTHER_AXIS]])
        move.feed = min(move.feed, sqrt(accel * arc.numbers[RADIUS]))

    canon.arc = arc
