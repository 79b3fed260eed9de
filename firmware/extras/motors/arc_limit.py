"""Arcs within the acceleration of their axes: ARC_ACCELERATION = True in the board file.

Grbl plans an arc as short lines whose corners are limited by $11 only. That may need more than the
acceleration of $120 and $121 for the whole arc. This limits the feed rate by the acceleration a
and the radius r: v = sqrt(a * r). Overrides above 100 % exceed it.
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
    """Hook into the requests of arcs."""
    canon: "Any" = cnc.machine.canon
    settings: "Any" = cnc.machine.settings
    previous = canon.arc

    def limited_arc(
        start: "array[float]", target: "array[float]", arc: "Arc", move: "Move"
    ) -> None:
        """Request an arc (start, target: mm), then limit its feed (mm/min) so that v * v / radius
        is at most the acceleration of the plane's weaker axis."""
        previous(start, target, arc, move)  # planned by finish(); move.feed is in mm/min now
        plane, accelerations = arc.plane, settings.acceleration  # mm/min2
        accel = min(accelerations[plane[ONE_AXIS]], accelerations[plane[OTHER_AXIS]])
        move.feed = min(move.feed, sqrt(accel * arc.numbers[RADIUS]))

    canon.arc = limited_arc
