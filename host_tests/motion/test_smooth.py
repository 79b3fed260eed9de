"""The law of smooth ramps: between successive steps the interval changes little.

Segments of even steps make a staircase of a ramp. Held here against what it was when a segment
was 10 ms long throughout: near rest, two intervals in a row differed by the factor 2.
"""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from laws import TICK_HZ, Bench, Limits, pulses, some
from motion.layout import DYNAMIC

# At the largest; the eighth part of what it was after the first steps.
_WAS = 0.96
_MOST = _WAS / 8
# Steps at either end that are too far apart for any law: at constant acceleration the tenth
# interval differs from the eleventh by 5 %.
_FIRST = 10
_TICKS = 4  # what rounding leaves open of a difference
_SEGMENT_S = 0.01
# Where a ramp begins or ends within a segment, that is part of one and part of the other.
_BLENDED = 1.25


def intervals(
    way: "tuple[float, ...]", feed: float, acceleration: float, per_mm: float
) -> "list[list[int]]":
    """Ticks from step to step of each motor that moves, in a move from rest to rest."""
    bench = Bench(Limits((per_mm,) * 3, (30_000.0,) * 3, (acceleration,) * 3))
    bench.line(way, feed)
    bench.finish()
    rows = [(segment.start, segment.row) for segment in bench.watch.made]
    found = []
    for axis in range(3):
        ticks = [tick for tick, _ in pulses(rows, axis)]
        found.append([b - a for a, b in pairwise(ticks)])
    return found


def largest_jump(gaps: "list[int]", slight_hz: float = 0) -> float:
    """By which part of the shorter one two intervals in a row differ, away from the ends.

    slight_hz: changes of the rate that do not count.
    """
    worst = 0.0
    for a, b in pairwise(gaps[_FIRST:-_FIRST]):
        if abs(b - a) > _TICKS and abs(TICK_HZ / a - TICK_HZ / b) > slight_hz:
            worst = max(worst, max(a, b) / min(a, b) - 1)
    return worst


@pytest.mark.parametrize("feed", [600, 1500, 3000, 6000, 12_000])
@pytest.mark.parametrize("acceleration", [100.0, 1000.0])
def test_intervals_change_by_an_eighth_of_what_they_did(feed: int, acceleration: float) -> None:
    for gaps in intervals((40.0, 13.37, -2.0), feed, acceleration, 250.0):
        assert largest_jump(gaps) <= _MOST


@some(20)
@given(
    st.tuples(*[st.floats(-30, 30).map(lambda x: round(x, 2))] * 3),
    st.integers(60, 15_000),
    st.floats(50, 8000),
    st.sampled_from([80.0, 250.0, 400.0]),
)
def test_ramps_of_any_move_are_smooth(way, feed: int, acceleration: float, per_mm: float) -> None:
    """Or the rate changes by less than an eighth of what it does in 10 ms, or little more."""
    slight = acceleration * per_mm * _SEGMENT_S / 8 * _BLENDED
    for gaps in intervals(way, feed, acceleration, per_mm):
        assert largest_jump(gaps, slight) <= _MOST * _BLENDED


@pytest.mark.parametrize("feed", [1500, 6000, 9000, 30_000])
def test_no_speed_is_further_from_the_next_than_an_eighth_of_a_segment_makes_it(feed: int) -> None:
    """Or than a thirty-second: that is what a motor feels."""
    acceleration = 1000.0
    (gaps, *_) = intervals((300.0, 0.0, 0.0), feed, acceleration, 100.0)
    speeds = [TICK_HZ / gap / 100 for gap in gaps[_FIRST:-_FIRST]]
    for a, b in pairwise(speeds):
        # Rounding to ticks: within a segment two intervals differ by one.
        rounding = a * a * 100 * 2 / TICK_HZ
        most = max(acceleration * _SEGMENT_S / 8, max(a, b) / 32)
        assert abs(b - a) <= most * 1.1 + rounding


def test_a_hold_is_smooth() -> None:
    bench = Bench(Limits(rate=(6000.0,) * 3, acceleration=(1000.0,) * 3))
    bench.line((60.0, 0.0, 0.0), 6000)
    bench.pull(120)
    bench.hold()
    rows = [(segment.start, segment.row) for segment in bench.watch.made]
    ticks = [tick for tick, _ in pulses(rows, 0)]
    assert largest_jump([b - a for a, b in pairwise(ticks)]) <= _MOST


def test_power_follows_the_speed_of_its_own_millisecond() -> None:
    """Of a laser in M4: a segment has one power, that of the speed at its end."""
    acceleration = 1000.0
    bench = Bench(Limits(rate=(6000.0,) * 3, acceleration=(acceleration,) * 3))
    bench.line((20.0, 5.0, 0.0), 6000, DYNAMIC)
    bench.finish()
    off = [abs(piece.speed - piece.mean) for piece in bench.watch.pieces if piece.mean > 10]
    assert max(off) <= acceleration * 0.001
