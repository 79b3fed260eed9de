"""Polylines with fewer points, within a tolerance of the given ones (Douglas-Peucker).

Many sections are split at once, repeatedly, so that numpy does the work: a path of two million
points takes seconds, and very little memory.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

# One point in so many always stays, because repeatedly splitting a long spiral at its farthest
# point would take too long.
_STRETCH = 256
_AT_ONCE = 256 * _STRETCH  # points whose distances are in memory at once

Points = NDArray[np.float32] | NDArray[np.float64]
Rows = NDArray[np.int64]


def simplify(points: Points, tolerance: float, keep: Sequence[int] | Rows = ()) -> Rows:
    """Return the rows of a polyline that are sufficient. keep: rows that always stay.

    Every point is within the tolerance of the straight line between the kept ones around it, in
    all columns together. Each _STRETCH-th point stays too, which limits the work.
    """
    count = len(points)
    is_kept = np.zeros(count, bool)
    is_kept[::_STRETCH] = is_kept[-1:] = True
    is_kept[np.asarray(keep, np.int64)] = True
    for begin in range(0, count, _AT_ONCE):
        part = slice(begin, begin + _AT_ONCE + 1)  # it ends where the next one begins
        _mark_kept(points[part], is_kept[part], tolerance)
    return np.flatnonzero(is_kept)


def _mark_kept(points: Points, is_kept: NDArray[np.bool_], tolerance: float) -> None:
    """Mark the points to keep, between points that are kept already.

    first, last: rows of the ends of sections. Each section with a point too far from its chord is
    cut there into two, until none is left.
    """
    ends = np.flatnonzero(is_kept)
    first, last = ends[:-1], ends[1:]
    while True:
        has_points = last - first > 1  # between its ends
        first, last = first[has_points], last[has_points]
        if not len(first):
            return
        worst, distance = _farthest(points, first, last)
        is_cut = distance > tolerance
        first, last, worst = first[is_cut], last[is_cut], worst[is_cut]
        is_kept[worst] = True
        # Two sections of each.
        first, last = np.concatenate((first, worst)), np.concatenate((worst, last))


def fitted(
    points: Points, tolerance: float, keep: Sequence[int] | Rows, most: int
) -> tuple[Rows, float]:
    """Simplify as simplify(), with a tolerance doubled until at most `most` rows remain.

    keep: rows that always stay, which are not counted. Returns the tolerance too.
    """
    rows = simplify(points, tolerance, keep)
    while len(rows) > most + len(keep):
        tolerance *= 2
        # The rows left are within half of it already; the other half is for leaving out more.
        kept_of_rows = np.searchsorted(rows, keep)
        rows = rows[simplify(points[rows], tolerance / 2, kept_of_rows)]
    return rows, tolerance


def _farthest(points: Points, first: Rows, last: Rows) -> tuple[Rows, NDArray[np.float64]]:
    """Return for each section the point farthest from its chord: its row, and its distance."""
    sizes = last - first - 1  # points between the ends
    # The points of all sections in one array: their sections, their rows, their distances.
    begins = np.cumsum(sizes) - sizes  # index in it of each section's first point
    section = np.repeat(np.arange(len(first)), sizes)
    rows = np.arange(len(section)) - begins[section] + first[section] + 1
    distance_sqr = _distance_sqr(points, rows, first[section], last[section])
    highest = np.maximum.reduceat(distance_sqr, begins)
    at_highest = np.flatnonzero(distance_sqr == highest[section])
    _, earliest = np.unique(section[at_highest], return_index=True)  # one per section
    return rows[at_highest[earliest]], np.sqrt(highest)


def _distance_sqr(points: Points, rows: Rows, first: Rows, last: Rows) -> NDArray[np.float64]:
    """Return the squared distance of each row from the line segment between two others. rows,
    first, last: indices of points, of equal length."""
    begin = points[first].astype(float)
    chord, offset = points[last] - begin, points[rows] - begin
    # einsum: scalar products, row by row.
    length_sqr = np.einsum("ij,ij->i", chord, chord)
    along = np.einsum("ij,ij->i", offset, chord)
    # 0 at the segment's beginning, 1 at its end; 0 if it has no length.
    share = np.divide(along, length_sqr, out=np.zeros_like(along), where=length_sqr > 0)
    offset -= np.clip(share, 0, 1)[:, None] * chord  # from the nearest point of the segment
    return np.asarray(np.einsum("ij,ij->i", offset, offset))
