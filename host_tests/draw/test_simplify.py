"""Test polylines in fewer points: within the tolerance everywhere, and no more than needed."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ugrbl.draw.simplify import fitted, simplify

_number = st.floats(-100, 100, width=32)
_path = st.lists(st.tuples(_number, _number, _number), min_size=1, max_size=60)


def largest_distance(points: "np.ndarray", rows: "np.ndarray") -> float:
    """Return the largest distance of the path from its drawing, checked at every point."""
    farthest = 0.0
    for begin, end in pairwise(rows):
        a, chord = points[begin], points[end] - points[begin]
        for point in points[begin:end]:
            share = np.dot(point - a, chord) / (np.dot(chord, chord) or 1.0)
            farthest = max(
                farthest, float(np.linalg.norm(point - a - min(max(share, 0), 1) * chord))
            )
    return farthest


@given(_path, st.sampled_from([0.01, 1.0, 30.0]), st.sets(st.integers(0, 59)))
def test_path_is_within_the_tolerance_everywhere(path, tolerance, keep) -> None:
    """keep: rows that must stay, such as those where another line of the program begins."""
    points = np.array(path, float)
    kept = sorted(row for row in keep if row < len(path))
    rows = simplify(points, tolerance, kept)
    assert {0, len(path) - 1, *kept} <= set(rows.tolist())
    assert np.all(np.diff(rows) > 0)
    assert largest_distance(points, rows) <= tolerance * (1 + 1e-9) + 1e-9


def test_straight_line_keeps_few_points() -> None:
    points = np.column_stack([np.linspace(0, 1, 1000)] * 3)
    assert simplify(points, 1e-6).tolist() == [0, 256, 512, 768, 999]


def test_path_there_and_back_is_kept() -> None:
    points = np.array([[0, 0], [5, 0], [10, 0], [5, 0], [0, 0.0]])
    assert simplify(points, 0.1).tolist() == [0, 2, 4]


def test_circle_has_the_points_that_its_tolerance_needs() -> None:
    angle = np.linspace(0, 2 * math.pi, 1001)
    points = np.column_stack([10 * np.cos(angle), 10 * np.sin(angle)])
    rows = simplify(points, 0.01)
    needed = math.pi / math.acos(1 - 0.01 / 10)  # chords that are 0.01 off a circle of radius 10
    assert needed <= len(rows) <= 2.1 * needed
    assert largest_distance(points, rows) <= 0.01


@pytest.mark.parametrize("most", [50, 300])
def test_tolerance_is_widened_until_it_fits_and_reported(most: int) -> None:
    """A spiral; most: points allowed. Row 10000 must stay."""
    angle = np.linspace(0, 60, 20_000)
    points = np.column_stack([angle * np.cos(angle), angle * np.sin(angle)])
    rows, tolerance = fitted(points, 0.001, [0, 10_000], most)
    assert len(rows) <= most + 2 and 10_000 in rows  # kept rows, 2 here, are not counted
    assert largest_distance(points, rows) <= tolerance * (1 + 1e-9)
    assert tolerance > 0.001


@pytest.mark.thorough
def test_two_million_points_take_seconds() -> None:
    import time

    angle = np.linspace(0, 20_000, 2_000_000)
    points = np.column_stack([angle * np.cos(angle), angle * np.sin(angle), angle]) / 100
    begin_s = time.process_time()
    assert 10_000 < len(simplify(points, 0.01)) < 1_000_000
    assert time.process_time() - begin_s < 30


@pytest.mark.parametrize("count", [0, 1, 2])
def test_very_short_path_is_unchanged(count: int) -> None:
    assert len(simplify(np.zeros((count, 3)), 1.0)) == count
