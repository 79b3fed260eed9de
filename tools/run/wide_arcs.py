"""Arcs that leave the part: hardly what their program means, but what it says."""

from collections.abc import Sequence
from math import atan2, hypot, pi
from typing import Any

# An arc may reach so far beyond its two ends, and one that goes all the way round between ends
# that are not the same is to have them so far apart, as a part of its radius.
_REACH_MM = 1000.0
_NEAR = 0.01
_SAME_MM = 0.00005  # as motion/arc_geometry.py has it


def warning(start: Sequence[float], target: Sequence[float], arc: Any) -> str:
    """What is to be said of an arc, if anything. Places in mm; arc: a motion.arc_geometry.Arc."""
    from motion.arc_geometry import CENTRE_0, CENTRE_1, CLOCKWISE

    one, other, is_clockwise = arc.plane[0], arc.plane[1], arc.plane[CLOCKWISE]
    centre = arc.numbers[CENTRE_0], arc.numbers[CENTRE_1]
    radius = hypot(*centre)
    way = target[one] - start[one], target[other] - start[other]
    turn = arc.sweep(start, target)
    begin = atan2(-centre[1], -centre[0])
    reach = _reach(centre, way, begin - turn if is_clockwise else begin, turn)
    if reach > _REACH_MM:
        return f"an arc of {radius:.0f} mm radius, which goes {reach:.0f} mm beyond its ends"
    apart = hypot(*way)
    if _SAME_MM < apart < _NEAR * radius and turn > pi:
        words = (
            f"a whole circle of {radius:g} mm radius between ends that are {apart:.4f} mm apart"
        )
        return f"{words}: the other way round it would be short"
    return ""


def _reach(centre: Sequence[float], way: Sequence[float], first: float, turn: float) -> float:
    """How far the arc goes beyond the box of its ends. Seen from its start; first, turn: where it
    is, from its centre, and how far it goes on counterclockwise, in radians."""
    radius = hypot(*centre)
    reach = 0.0
    for quarter in range(4):
        if (quarter * pi / 2 - first) % (2 * pi) > turn:
            continue
        axis, sign = quarter % 2, 1 if quarter < 2 else -1
        reach = max(reach, sign * centre[axis] + radius - max(0.0, sign * way[axis]))
    return reach
