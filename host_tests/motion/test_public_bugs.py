"""Programs like those that broke the planners of other controllers, written anew.

Each is named after the fault there. All laws hold for all of them, on all engines, with and
without a jerk limit: speed and acceleration of every axis, corners, steps, pulses; braking for the
end of each block, and the path along lines.
"""

from collections.abc import Iterator
from itertools import groupby, pairwise
from math import ceil, cos, pi, sin
from typing import Any

import pytest
from laws import Bench, Limits, off_line, pulses
from motion.layout import ROW_TICKS
from rig_bench import Machine
from test_braking import ENGINES, FASTEST_HZ
from test_jerk import JerkBench

Place = tuple[float, ...]

# The first ring runs some of them.
pytestmark = pytest.mark.sampled(10)

# The highest step rate of an engine, expressed as steps/mm of the machine.
_PER_MM = {"sim": 400.0, "pio": 400.0, "i2s": 80.0, "rmt": 26.667}


def arc(radius: float, start: float, sweep: float, rise: float = 0.0) -> "list[Place]":
    """Return chords of an arc about 0, each within 0.01 mm of it; angles in turns."""
    chords = max(ceil(abs(sweep) * pi * radius / (0.01 * (2 * radius - 0.01)) ** 0.5), 1)
    angles = [2 * pi * (start + sweep * k / chords) for k in range(1, chords + 1)]
    places = zip(angles, range(1, chords + 1), strict=True)
    return [(radius * cos(a), radius * sin(a), rise * k / chords) for a, k in places]


def joined_arcs() -> "Iterator[Place]":
    """Yield half circles of 4 mm radius and less, one leading into the next."""
    x = 0.0
    for k, radius in enumerate((4.0, 2.0, 4.0, 0.5, 1.0, 0.25, 3.0)):
        sense = 1 if k % 2 else -1
        for a, b, _ in arc(radius, 0.5, -0.5 * sense):
            yield x + radius + a, b, 0.0
        x += 2 * radius


def stairs() -> "Iterator[Place]":
    """Yield 40 lines of 0.0125 mm, alternately along X and Y."""
    for k in range(40):
        yield (k // 2 + k % 2) * 0.0125, k // 2 * 0.0125, 0.0


# The fault; the lines; their feed in mm/min.
PROGRAMS: "dict[str, tuple[list[Place], float]]" = {
    # LinuxCNC 3773: up to 8 times the acceleration where small arcs were blended.
    "acceleration overshot between small arcs": (list(joined_arcs()), 6000),
    # LinuxCNC 4539: braking began too late, and the remaining speed was dropped at once.
    "speed left at a line's end": ([(30, 0, 0), (30.02, 0, 0), (30.02, 5, 0), (0, 5.1, 0)], 9000),
    # LinuxCNC 550: a line of almost no length in which another axis moves far.
    "an axis with a long way beside axes with none": (
        [(2, 2, 1), (2.0001, 2.0001, 40), (0, 0, 0)],
        9000,
    ),
    # LinuxCNC 426: a pause where a helix continues as arcs.
    "a pause behind a helix": (
        [*arc(6, 0, 1, -2), *((x, y, -2) for x, y, _ in [*arc(6, 0, 0.5), *arc(6, 0.5, 0.5)])],
        1500,
    ),
    "a helix faster than its slowest axis": (arc(2, 0, 3, 24), 9000),
    # A corner of so small an angle that an axis' jump in speed was overlooked.
    "nearly straight corners": ([(2.0 * k, 0.02 * (k % 2), 0) for k in range(1, 12)], 9000),
    "a nearly straight corner into a slow axis": ([(20, 0, 0), (40, 0, 0.4), (60, 0, 0)], 9000),
    "lines shorter than what a segment takes": (
        [(0.02 * k, 0.003 * k * k, 0) for k in range(1, 60)],
        3000,
    ),
    "lines of a step": (list(stairs()), 3000),
    "one step in the middle of long lines": ([(20, 0, 0), (20, 0.0376, 0), (40, 0.0376, 0)], 9000),
    "back by a step": ([(10, 0, 0), (9.96, 0, 0), (20, 0, 0), (20.04, 0, 0), (0, 0, 0)], 9000),
    # Marlin 2384: a line into a large arc began with a jolt.
    "a jolt from a line into an arc": ([(19, 0, 0), (20, 0, 0), *arc(20, 0, 0.3)], 6000),
}


def make_bench(engine: str, jerk: float) -> Bench:
    """Return a bench with this engine's step rate; jerk in mm/s3, 0: no limit."""
    per_mm = _PER_MM[engine]
    limits = Limits(
        (per_mm, per_mm, 2.5 * per_mm), (9000.0, 9000.0, 1500.0), (800.0, 800.0, 150.0)
    )
    limits.step_hz = FASTEST_HZ
    # 16 blocks in the planner
    return JerkBench(limits, (jerk, jerk, jerk / 4), 16, *ENGINES[engine])


@pytest.mark.parametrize("jerk", [0.0, 20_000.0], ids=["no limit", "jerk limited"])
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", PROGRAMS)
def test_faults_of_other_controllers_keep_every_law(name: str, engine: str, jerk: float) -> None:
    lines, feed = PROGRAMS[name]
    bench: Any = make_bench(engine, jerk)
    for place in lines:
        bench.line(place, feed)
    bench.planner.catch_up()
    bench.check()
    assert bench.watch.pieces[-1].ends_block
    for _, of_line in groupby(bench.watch.made, lambda segment: segment.block):
        rows = [(segment.start, segment.row) for segment in of_line]
        off_steps = off_line([[tick for tick, _ in pulses(rows, axis)] for axis in range(3)])
        assert off_steps <= 1.05


def test_a_helix_with_arcs_never_stops_between_lines() -> None:
    lines, feed = PROGRAMS["a pause behind a helix"]
    bench = make_bench("sim", 0.0)
    for place in lines:
        bench.line(place, feed)
    bench.finish()
    end_speeds = [piece.speed for piece in bench.watch.pieces if piece.ends_block]
    # mm/s; 3 lines at either end speed up and slow down
    assert min(end_speeds[3:-3]) > 0.2 * feed / 60


@pytest.mark.parametrize("line", ["G1X{x}S{s}", "S{s}G1X{x}", "M3G1X{x}S{s}F6000", "{g}X{x}S{s}"])
@pytest.mark.parametrize(("laser_mode", "expected_stops"), [(1, 0), (0, 60)])
def test_a_raster_stops_for_power_changes_only_without_laser_mode(
    line: str, laser_mode: int, expected_stops: int
) -> None:
    """In laser mode with M3 a block carries its line's S; else motion stops for it.
    expected_stops: one before each of 60 lines; before the first, there is no segment."""
    machine = Machine({1: 255, 32: laser_mode, 110: 6000, 111: 6000, 120: 1000, 121: 1000})
    raster = [
        line.format(x=f"{k / 10:.1f}", s=k * 37 % 1000, g="G0" if k % 2 else "G1")
        for k in range(1, 61)
    ]
    machine.play(["M3S10", "G1X0F6000", *raster, "M5"])
    times = pairwise((start, start + row[ROW_TICKS]) for start, row in machine.rows)
    assert (
        sum(start > end for (_, end), (start, _) in times) + (1 if expected_stops else 0)
        == expected_stops
    )
