"""Arcs that leave the part: probably a mistake in the program, although it is valid."""

from collections.abc import Sequence
from math import atan2, hypot, pi
from typing import Any

# An arc that reaches further beyond its two ends is reported. So is an arc that goes round almost
# completely although its ends differ, if they are closer than this part of its radius.
_REACH_MM = 1000.0  # an arc may go so far beyond its ends
_NEAR = 0.01  # ends that are closer, relative to the radius, may be meant to be the same
_SAME_MM = 0.00005  # as in motion/arc_geometry.py


def warning(start: Sequence[float], target: Sequence[float], arc: Any) -> str:
    """Return a warning about an arc, or "". Positions in mm; arc: a motion.arc_geometry.Arc."""
    from motion.arc_geometry import CENTRE_0, CENTRE_1, CLOCKWISE

    axis_0, axis_1, is_clockwise = arc.plane[0], arc.plane[1], arc.plane[CLOCKWISE]
    # Centre and end are relative to the start.
    centre = arc.numbers[CENTRE_0], arc.numbers[CENTRE_1]
    radius = hypot(*centre)
    end = target[axis_0] - start[axis_0], target[axis_1] - start[axis_1]
    turn = arc.sweep(start, target)  # radians
    begin = atan2(-centre[1], -centre[0])  # angle of the start, as seen from the centre
    # Clockwise, the arc is the counterclockwise one that begins at its end.
    reach = _reach(centre, end, begin - turn if is_clockwise else begin, turn)
    if reach > _REACH_MM:
        return f"an arc of {radius:.0f} mm radius, which goes {reach:.0f} mm beyond its ends"
    gap = hypot(*end)
    if _SAME_MM < gap < _NEAR * radius and turn > pi:
        circle = f"a whole circle of {radius:g} mm radius between ends that are {gap:.4f} mm apart"
        return f"{circle}: in the other direction the arc would be short"
    return ""


def _reach(centre: Sequence[float], end: Sequence[float], first: float, turn: float) -> float:
    """Return how far in mm the arc reaches beyond the box of its two ends.

    centre, end: relative to the start, in mm. first, turn: the angle at which the arc begins as
    seen from the centre, and the angle of the arc, counterclockwise, in radians.
    """
    radius = hypot(*centre)
    reach = 0.0
    # The circle's furthest points: in the directions of the two axes, and opposite.
    for quarter in range(4):
        if (quarter * pi / 2 - first) % (2 * pi) > turn:
            continue  # the arc does not reach this point
        axis, sign = quarter % 2, 1 if quarter < 2 else -1
        reach = max(reach, sign * centre[axis] + radius - max(0.0, sign * end[axis]))
    return reach
