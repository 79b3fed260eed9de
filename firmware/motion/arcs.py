"""Arcs: from centre and target to chords that stray no further than the tolerance."""

import math

from base.f32 import whole
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array

# Below this a sweep counts as none, which means a full circle.
_NO_SWEEP = 5e-7


class Arc:
    """Geometry of one arc. plane: its two axes and the one across, in that order.

    centre: offset of the centre from the start, in the plane; the radius is the
    parser's, so that a helix's end does not bend it.
    """

    def __init__(self) -> None:
        self.plane = (0, 1, 2)
        self.clockwise = False
        self.radius = 0.0
        self.centre_0 = 0.0
        self.centre_1 = 0.0
        # What point() needs: of where the arc begins, and from chord to chord.
        self._from_0 = 0.0
        self._from_1 = 0.0
        self._base = 0.0
        self._step = 0.0
        self._rise = 0.0

    def sweep(self, start: "array[float]", target: "array[float]") -> float:
        """The angle travelled, in radians; negative is clockwise."""
        a, b, _ = self.plane
        from_0, from_1 = -self.centre_0, -self.centre_1
        to_0 = target[a] - start[a] - self.centre_0
        to_1 = target[b] - start[b] - self.centre_1
        angle = math.atan2(from_0 * to_1 - from_1 * to_0, from_0 * to_0 + from_1 * to_1)
        if self.clockwise:
            if angle >= -_NO_SWEEP:
                angle -= 2 * math.pi
        elif angle <= _NO_SWEEP:
            angle += 2 * math.pi
        return angle

    def chords(self, angle: float, tolerance: float) -> int:
        """How many chords it takes; 0 and 1 mean a straight line."""
        squared = tolerance * (2 * self.radius - tolerance)
        if squared <= 0:
            return 0
        return whole(abs(0.5 * angle * self.radius) / math.sqrt(squared)) & 0xFFFF

    def begin(
        self, start: "array[float]", target: "array[float]", chords: int, angle: float
    ) -> None:
        """Get ready for point(). The centre is absolute from here on."""
        a, b, across = self.plane
        self._from_0, self._from_1 = -self.centre_0, -self.centre_1
        self.centre_0 += start[a]
        self.centre_1 += start[b]
        self._base = start[across]
        if chords:
            self._rise = (target[across] - self._base) / chords
            self._step = angle / chords

    def point(self, chord: int, point: "array[float]") -> None:
        """Where that chord, counted from 1, ends; the last one ends at the target."""
        a, b, across = self.plane
        cosine = math.cos(chord * self._step)
        sine = math.sin(chord * self._step)
        point[a] = self.centre_0 + self._from_0 * cosine - self._from_1 * sine
        point[b] = self.centre_1 + self._from_0 * sine + self._from_1 * cosine
        point[across] = self._base + chord * self._rise
