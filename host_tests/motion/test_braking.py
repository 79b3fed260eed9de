"""Braking starts in time at any step rate, up to 500 kHz, with any engine's ticks and segments.

Moves of random length, which reach their speed or not, on a straight line and back; then the
programs that once ended at full speed. laws.check_segments() checks deceleration, the speed at
the end of each block, and the limit of every corner.
"""

from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from laws import STEP_PART, Bench, Limits, Piece, check_plan, check_segments, some
from rig_bench import Machine
from test_jerk import JerkBench

# Ticks per second; log2 of the ticks of a full segment: 10 ms, 10.5 ms, 4.1 ms, 4.1 ms.
ENGINES = {
    "sim": (13_107_200, 17),
    "pio": (12_500_000, 17),
    "i2s": (4_000_000, 14),
    "rmt": (1_000_000, 12),
}
engines = pytest.mark.parametrize("engine", ENGINES)
FASTEST_HZ = 500_000


def make_bench(
    engine: str, hz: float, steps_per_mm: float, ramp_s: float, jerk_s: float = 0
) -> Bench:
    """Return a bench that reaches hz steps/s in ramp_s. jerk_s: duration of the rise and fall of
    acceleration; 0: no jerk limit."""
    mm_s = hz / steps_per_mm
    acceleration = mm_s / ramp_s
    limits = Limits((steps_per_mm,) * 3, (mm_s * 60,) * 3, (acceleration,) * 3, step_hz=FASTEST_HZ)
    if jerk_s:
        # 16 blocks in the planner
        return JerkBench(limits, (2 * acceleration / jerk_s,) * 3, 16, *ENGINES[engine])
    return Bench(limits, 16, *ENGINES[engine])


def check(bench: Bench) -> "list[Piece]":
    """Check all laws except those about each pulse; return the last piece of each block."""
    bench.planner.catch_up()
    check_plan(bench.watch)
    bench.finish()
    assert bench.planner.empty()
    check_segments(bench.watch)
    return [piece for piece in bench.watch.pieces if piece.ends_block]


def hardest_braking(bench: Bench) -> float:
    """Return the largest deceleration between rows, as a fraction of the axes' limit.

    The effect of braking within a small fraction of a step is subtracted: at 1 kHz a row of 2 ms
    brakes a tenth harder, the next a tenth less.
    """
    decelerations = [
        (before.speed - after.speed - after.block.braked(STEP_PART))
        / after.time
        / after.block.acceleration
        for before, after in pairwise(bench.watch.pieces)
        if after.time > 5e-4
    ]
    return max(decelerations, default=0.0)


# Travel as a fraction of the ramps' length, and feed rates as a fraction of the highest.
travels_and_feeds = st.lists(
    st.tuples(
        st.floats(0.02, 1.7) | st.floats(-1.7, -0.02),
        st.just(0.0) | st.floats(0.02, 1.0),
    ),
    min_size=1,
    max_size=3,
)


def any_moves(engine: str, data: Any, jerk_s: float = 0) -> Bench:
    """Draw a bench with moves. Rates of 1-10 kHz are as likely as rates of 50-500 kHz."""
    bench = make_bench(
        engine,
        10 ** data.draw(st.floats(3, 5.699)),  # steps/s: 1 to 500 kHz
        data.draw(st.sampled_from([26.667, 80.0, 400.0, 1600.0])),  # steps/mm
        10 ** data.draw(st.floats(-1.5, -0.4)),  # ramp: 32 to 400 ms
        jerk_s,
    )
    # both ramps, to the speed and back
    full_mm = bench.limits.speed(0) ** 2 / bench.limits.acceleration[0]
    place = 0.0
    for travel, feed in data.draw(travels_and_feeds):
        place += travel * full_mm
        bench.line((place, place / 3, 0), feed * bench.limits.rate[0])
    return bench


@engines
@some(8)
@given(st.data())
def test_moves_of_any_length_brake_in_time(engine: str, data: Any) -> None:
    bench = any_moves(engine, data)
    check(bench)
    assert hardest_braking(bench) <= 1.08  # a sixteenth, and integer rounding


@engines
@some(4)
@given(st.data(), st.floats(0.02, 0.15))
def test_moves_of_any_length_brake_in_time_with_jerk_limited(
    engine: str, data: Any, jerk_s: float
) -> None:
    check(any_moves(engine, data, jerk_s))


@engines
@pytest.mark.parametrize("khz", [90, 110, 160, 204, 250, 333, 390, 420, 500])
@pytest.mark.parametrize("part", [0.6, 1.2])
def test_a_move_ends_at_rest_with_a_full_ramp(engine: str, khz: int, part: float) -> None:
    """part: length of the move, relative to that of both ramps; below 1 it never reaches its
    speed."""
    bench = make_bench(engine, khz * 1000, 1600.0, 0.3)
    travel_mm = part * bench.limits.speed(0) ** 2 / bench.limits.acceleration[0]
    bench.line((travel_mm, 0, 0))
    check(bench)
    assert hardest_braking(bench) <= 1.01
    # v**2 = 2 a s: a shorter move reaches the root of the part
    reached = max(piece.mean for piece in bench.watch.pieces) / bench.limits.speed(0)
    assert reached == pytest.approx(min(part**0.5, 1.0), abs=0.03)


@engines
@pytest.mark.parametrize("khz", [160, 250, 380])
@pytest.mark.parametrize("part", [0.3, 0.75, 0.9, 1.05])
def test_a_move_ends_at_the_planned_speed_with_jerk_limited(
    engine: str, khz: int, part: float
) -> None:
    """A move at a tenth of the speed follows. part: length, relative to both ramps without jerk
    limit."""
    bench = make_bench(engine, khz * 1000, steps_per_mm=1600.0, ramp_s=0.2, jerk_s=0.05)
    travel_mm = part * bench.limits.speed(0) ** 2 / bench.limits.acceleration[0]
    bench.line((travel_mm, 0, 0))
    bench.line((travel_mm * 1.2, 0, 0), bench.limits.rate[0] / 10)
    check(bench)


def test_millions_of_steps_of_braking_end_at_rest() -> None:
    """An error of 2**-13 of the braking distance is more than the last steps can correct."""
    bench = make_bench("pio", FASTEST_HZ, steps_per_mm=1600.0, ramp_s=12.0)
    bench.line((2400.0, 0, 0))
    check(bench)
    assert hardest_braking(bench) <= 1.01


@engines
def test_a_hold_and_the_remaining_distance_brake_in_time(engine: str) -> None:
    bench = make_bench(engine, 300_000, steps_per_mm=400.0, ramp_s=0.3)
    bench.line((300.0, 40.0, 0))
    bench.line((0.0, 0.0, 0))
    bench.pull(25)  # segments: into the first ramp
    bench.hold()  # and resume
    check(bench)


# The programs that once failed: $100=1600 $110=6000 $120=300; mm/s at the end of each line.


@pytest.mark.parametrize(
    ("lines", "end_speeds"),
    [
        ([(32.0, 6000)], [0.0]),
        ([(32.0, 6000), (0.0, 6000)], [0.0, 0.0]),
        ([(29.967, 6000), (34.967, 600)], [10.0, 0.0]),
    ],
    ids=["ended at 16.8", "turned round at 16.8", "went on at 19.1"],
)
def test_a_triangle_profile_of_160_khz_ends_at_the_planned_speed(
    lines: Any, end_speeds: Any
) -> None:
    """lines: position in mm and feed in mm/min; end_speeds: at the end of each, in mm/s;
    piece.mean: the mean speed of a line's last piece."""
    bench = Bench(Limits((1600.0,) * 3, (6000.0,) * 3, (300.0,) * 3, step_hz=FASTEST_HZ))
    for place, feed in lines:
        bench.line((place, 0, 0), feed)
    last_pieces = check(bench)
    assert [piece.speed for piece in last_pieces] == pytest.approx(end_speeds, abs=0.02)
    assert all(piece.mean <= end + 0.4 for piece, end in zip(last_pieces, end_speeds, strict=True))


@pytest.mark.parametrize("travel_mm", [44.0, 52.5, 61.0, 80.0, 93.7, 105.0])
def test_a_triangle_profile_of_fewer_steps_per_mm_ends_at_rest(travel_mm: float) -> None:
    """$100=400 $110=20000 $120=1000 once ended at up to 32 mm/s."""
    bench = Bench(Limits((400.0,) * 3, (20_000.0,) * 3, (1000.0,) * 3, step_hz=FASTEST_HZ))
    bench.line((travel_mm, 0, 0), 20_000)
    assert check(bench)[-1].mean <= 1.5


def test_the_whole_machine_ends_a_triangle_profile_of_160_khz_at_rest() -> None:
    machine = Machine({0: 3, 100: 1600.0, 110: 6000.0, 120: 300.0})
    machine.play(["G1X8F6000", "G1X0"])
    check_segments(machine.watch)
    assert machine.physical()[0] == 0
