"""Segmenter: cuts a path into chords short enough for evenly moving motors.

Between two positions all motors move in the same time, each at a constant rate. With nonlinear
kinematics the tool leaves the straight line meanwhile. The deviation is computed at a quarter and
at three quarters of the chord. A bend shows at both, and so does an S-shaped deviation, which is 0
in the middle.
"""

import math

from base.float32 import copy, vector
from micropython import const
from motion.arc_geometry import CENTRE_0, CENTRE_1, CLOCKWISE

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array

    from interfaces import Geometry
    from motion.arc_geometry import Arc

# Share of the tolerance allowed at a quarter of a chord: in its middle a bend is 4/3 of that.
_SAMPLE_SHARE = 0.7  # of the tolerance, at a quarter of a chord
_FINEST_MM = 0.0005  # least tolerance: single precision cannot follow a path more closely
_LONGEST_MM = 5.0  # longest chord: two samples do not show every bend of a longer one
_FAR_MM = 1e9  # a longer path is out of reach of every machine
_SHORTEST_CHORD = 0.25  # in tolerances; not cut further, because there motors turn on the spot
_MOST_DEVIATION = 2.0  # of such a chord, in tolerances; beyond it the position is out of reach
_MOST_GROWTH = 2.0  # length ratio of a chord to the one before, at most
_CAUTION = 9 / 10  # a chord's length is corrected to this share of the one that just fits
_MOST_CHECKS = const(40)  # positions that is_in_reach() checks
_SAMPLES = (0.25, 0.75)  # parts of a chord at which its deviation is computed
_END_PART = 1 - 1e-6  # a chord that ends after this part of the path ends with it
_SHORTEST_CUT = 0.25  # a chord is never cut to less than this share of its length at once


class Path:
    """A straight line, or an arc during which the other axes move evenly. length: mm.

    _change: per axis, by how much it moves evenly, mm; for those of an arc's plane, what is added
    to the circle. _plane: the axes of that plane; (-1, -1) for a line.
    """

    def __init__(self, axes: int) -> None:
        self._start = vector(axes)
        self._change = vector(axes)
        self._centre_0 = self._centre_1 = self._from = self._sweep = self._radius = 0.0
        self._plane = (-1, -1)
        self.length = 0.0

    def set_path(self, start: "array[float]", target: "array[float]", arc: "Arc | None") -> None:
        """Set the path from start to target, in mm. arc: None for a straight line."""
        copy(start, self._start, len(start))
        self._plane = (arc.plane[0], arc.plane[1]) if arc else (-1, -1)
        squares = 0.0
        for i in range(len(start)):
            self._change[i] = target[i] - start[i]
            if i not in self._plane:
                squares += self._change[i] * self._change[i]
        if arc:
            self._set_circle(start, target, arc)
            squares += (self._radius * self._sweep) ** 2
        self.length = math.sqrt(squares)

    def _set_circle(self, start: "array[float]", target: "array[float]", arc: "Arc") -> None:
        """Set the circle of an arc from start to target: its centre and radius (mm), the angle at
        its start (_from) and the angle that it turns by (_sweep), in rad, counterclockwise.

        centre_0, centre_1: its centre, from start; a, b: the axes of its plane.
        """
        a, b = self._plane
        centre_0, centre_1 = arc.numbers[CENTRE_0], arc.numbers[CENTRE_1]
        self._radius = math.sqrt(centre_0 * centre_0 + centre_1 * centre_1)
        self._centre_0, self._centre_1 = start[a] + centre_0, start[b] + centre_1
        self._from = math.atan2(-centre_1, -centre_0)
        self._sweep = arc.sweep(start, target)
        if arc.plane[CLOCKWISE]:
            self._sweep = -self._sweep
        # A program's numbers are rounded. The circle's miss of its target is spread over the arc.
        end = self._from + self._sweep
        self._change[a] = target[a] - self._centre_0 - self._radius * math.cos(end)
        self._change[b] = target[b] - self._centre_1 - self._radius * math.sin(end)

    def point_at(self, part: float, place: "array[float]") -> None:
        """Compute the position after a part of the path, 0 to 1, into place (mm)."""
        start, change = self._start, self._change
        for i in range(len(place)):
            place[i] = start[i] + part * change[i]
        if self._plane[0] >= 0:
            a, b = self._plane
            angle = self._from + part * self._sweep
            place[a] = self._centre_0 + self._radius * math.cos(angle) + part * change[a]
            place[b] = self._centre_1 + self._radius * math.sin(angle) + part * change[b]


class Segmenter:
    """Cuts a path into chords. place, joints: the tool's position (mm) and the joints' at the end
    of the last chord. Methods copy their arguments.

    As parts of the path, 0 to 1: _chord_begin, where the next chord begins; _next_length, its
    length at the first try. _ahead: the joints at its end.
    """

    def __init__(self, axes: int, geometry: "Geometry") -> None:
        self._geometry = geometry
        self._axes = axes
        self.path = Path(axes)
        self.place = vector(axes)
        self.joints = vector(axes)
        self._ahead = vector(axes)
        # At a sample of a chord: the joints, the tool's position that they give, and the path's.
        self._between = vector(axes)
        self._made = vector(axes)
        self._meant = vector(axes)
        self._chord_begin = self._next_length = 1.0
        self.tolerance = 0.002  # mm

    def start_path(
        self,
        start: "array[float]",
        joints: "array[float]",
        target: "array[float]",
        arc: "Arc | None",
        tolerance: float,
    ) -> None:
        """Start a path from start, where the joints are `joints`, to target, in mm. arc: None for
        a straight line. tolerance: how far chords may leave the path, mm; _FINEST_MM if less."""
        self.path.set_path(start, target, arc)
        copy(start, self.place, self._axes)
        copy(joints, self.joints, self._axes)
        self.tolerance = max(tolerance, _FINEST_MM)
        self._chord_begin = 0.0
        self._next_length = min(1.0, _LONGEST_MM / (self.path.length or 1.0))

    def is_in_reach(self) -> bool:
        """Return whether the path is in reach: by positions on it at equal distances, at most
        _MOST_CHECKS.

        If not, place is the first of them that is out of reach.
        """
        copy(self.joints, self._ahead, self._axes)
        checks = min(int(self.path.length / _LONGEST_MM) + 1, _MOST_CHECKS)
        for i in range(checks + 1):
            self.path.point_at(i / checks, self.place)
            if not self._geometry.inverse(self.place, self._ahead):
                return False
        return True

    def has_next(self) -> bool:
        """Return whether there is another chord."""
        return self._chord_begin < 1

    def next_chord(self) -> bool:
        """Compute the next chord: its end goes to place and joints. Return False if it is out of
        reach; place is its end then, too.

        The first try has the length predicted from the chord before. It is cut until its deviation
        is within the tolerance. step, longest: lengths as parts of the path.
        """
        if not self.path.length < _FAR_MM:  # also NaN
            return False
        longest = _LONGEST_MM / (self.path.length or 1.0)
        step = min(self._next_length, 1 - self._chord_begin)
        allowed = self.tolerance * _SAMPLE_SHARE
        while True:
            end = self._chord_begin + step
            if end > _END_PART:
                end = 1.0
            self.path.point_at(end, self.place)
            copy(self.joints, self._ahead, self._axes)  # inverse() chooses the nearest solution
            if not self._geometry.inverse(self.place, self._ahead):
                return False
            deviation = self._deviation(end)
            if deviation <= allowed:
                break
            if step * self.path.length < self.tolerance * _SHORTEST_CHORD:
                if deviation > _MOST_DEVIATION * self.tolerance:
                    return False
                break
            # A bend's deviation grows as the square of the chord's length.
            step *= max(_SHORTEST_CUT, _CAUTION * math.sqrt(allowed / deviation))
        copy(self._ahead, self.joints, self._axes)
        self._chord_begin = end
        growth = _CAUTION * math.sqrt(allowed / deviation) if deviation else _MOST_GROWTH
        self._next_length = min(step * min(_MOST_GROWTH, growth), longest)
        return True

    def _deviation(self, end: float) -> float:
        """Return the largest deviation of the tool within the next chord, in mm.

        end: the part of the path at which the chord ends. Its joints are in _ahead. `made` is
        where evenly moving joints put the tool, `meant` the path's position.
        """
        between, made, meant = self._between, self._made, self._meant
        largest = 0.0  # square of a deviation
        for part in _SAMPLES:
            for i in range(self._axes):
                between[i] = self.joints[i] + part * (self._ahead[i] - self.joints[i])
            self._geometry.forward(between, made)
            self.path.point_at(self._chord_begin + part * (end - self._chord_begin), meant)
            squares = 0.0
            for i in range(self._axes):
                deviation = made[i] - meant[i]
                squares += deviation * deviation
            largest = max(largest, squares)
        return math.sqrt(largest)
