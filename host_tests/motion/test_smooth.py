"""The law of smooth ramps: the interval between successive steps changes little.

Segments of even steps make a staircase of a ramp. The reference is the time when all segments
were 10 ms long: near rest, two successive intervals differed by a factor of 2.
"""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from laws import TICK_HZ, Bench, Limits, pulses, some
from motion.layout import DYNAMIC

# The largest jump of that time after the first steps; an eighth of it is allowed.
_FORMER_JUMP = 0.96
_LARGEST_JUMP = _FORMER_JUMP / 8
# Steps at either end, too far apart for any law: at constant acceleration the tenth interval
# differs from the eleventh by 5 %.
_SKIPPED_STEPS = 10
_ROUNDING_TICKS = 4  # rounding error of a difference
_SEGMENT_S = 0.01
# Where a ramp begins or ends within a segment, the segment blends two accelerations.
_BLEND_FACTOR = 1.25


def intervals(
    travel_mm: "tuple[float, ...]", feed: float, acceleration: float, per_mm: float
) -> "list[list[int]]":
    """Return the ticks between steps of each motor, in a single move. feed: in mm/min."""
    bench = Bench(Limits((per_mm,) * 3, (30_000.0,) * 3, (acceleration,) * 3))
    bench.line(travel_mm, feed)
    bench.finish()
    rows = [(segment.start, segment.row) for segment in bench.watch.made]
    by_motor = []
    for axis in range(3):
        ticks = [tick for tick, _ in pulses(rows, axis)]
        by_motor.append([b - a for a, b in pairwise(ticks)])
    return by_motor


def largest_jump(gaps: "list[int]", slight_hz: float = 0) -> float:
    """Return the largest difference of two successive intervals, relative to the shorter one.

    The ends are left out. slight_hz: changes of the rate that do not count.
    """
    largest = 0.0
    for a, b in pairwise(gaps[_SKIPPED_STEPS:-_SKIPPED_STEPS]):
        if abs(b - a) > _ROUNDING_TICKS and abs(TICK_HZ / a - TICK_HZ / b) > slight_hz:
            largest = max(largest, max(a, b) / min(a, b) - 1)
    return largest


@pytest.mark.parametrize("feed", [600, 1500, 3000, 6000, 12_000])
@pytest.mark.parametrize("acceleration", [100.0, 1000.0])
def test_intervals_change_by_an_eighth_of_the_former_jump(feed: int, acceleration: float) -> None:
    for gaps in intervals((40.0, 13.37, -2.0), feed, acceleration, 250.0):
        assert largest_jump(gaps) <= _LARGEST_JUMP


@some(20)
@given(
    st.tuples(*[st.floats(-30, 30).map(lambda x: round(x, 2))] * 3),
    st.integers(60, 15_000),
    st.floats(50, 8000),
    st.sampled_from([80.0, 250.0, 400.0]),
)
def test_ramps_of_any_move_are_smooth(
    travel_mm, feed: int, acceleration: float, per_mm: float
) -> None:
    """Intervals change by an eighth of the former jump, or the rate changes by less than an eighth
    of what it changes in 10 ms (slight_hz), with a small margin."""
    slight_hz = acceleration * per_mm * _SEGMENT_S / 8 * _BLEND_FACTOR
    for gaps in intervals(travel_mm, feed, acceleration, per_mm):
        assert largest_jump(gaps, slight_hz) <= _LARGEST_JUMP * _BLEND_FACTOR


@pytest.mark.parametrize("feed", [1500, 6000, 9000, 30_000])
def test_successive_speeds_differ_by_at_most_an_eighth_of_a_segments_change(feed: int) -> None:
    """Or by a thirty-second of the speed: motors feel relative changes."""
    acceleration = 1000.0
    (gaps, *_) = intervals((300.0, 0.0, 0.0), feed, acceleration, 100.0)
    speeds = [
        TICK_HZ / gap / 100 for gap in gaps[_SKIPPED_STEPS:-_SKIPPED_STEPS]
    ]  # mm/s, at 100 steps/mm
    for a, b in pairwise(speeds):
        # Rounding to ticks: within a segment two intervals differ by one.
        rounding = a * a * 100 * 2 / TICK_HZ
        largest_change = max(acceleration * _SEGMENT_S / 8, max(a, b) / 32)
        assert abs(b - a) <= largest_change * 1.1 + rounding


def test_a_hold_is_smooth() -> None:
    bench = Bench(Limits(rate=(6000.0,) * 3, acceleration=(1000.0,) * 3))
    bench.line((60.0, 0.0, 0.0), 6000)
    bench.pull(120)  # segments, before the hold begins
    bench.hold()
    rows = [(segment.start, segment.row) for segment in bench.watch.made]
    ticks = [tick for tick, _ in pulses(rows, 0)]
    assert largest_jump([b - a for a, b in pairwise(ticks)]) <= _LARGEST_JUMP


def test_m4_power_follows_the_speed_within_a_millisecond() -> None:
    """A segment has one power, that of the speed at its end."""
    acceleration = 1000.0
    bench = Bench(Limits(rate=(6000.0,) * 3, acceleration=(acceleration,) * 3))
    bench.line((20.0, 5.0, 0.0), 6000, DYNAMIC)
    bench.finish()
    differences = [
        abs(piece.speed - piece.mean) for piece in bench.watch.pieces if piece.mean > 10
    ]
    assert max(differences) <= acceleration * 0.001  # mm/s: the change of speed in 1 ms
