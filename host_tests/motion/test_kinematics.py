"""Which motor moves which axes: the tables, in both directions, and the plans made with them."""

from array import array
from collections.abc import Sequence
from dataclasses import replace

import pytest
from base.state import State
from fakes import FakeKinematics
from hypothesis import given
from hypothesis import strategies as st
from laws import Bench, Limits
from motion import layout
from motion.kinematics import COREXY, Kinematics
from motion.layout import ROW_AXES, ROW_DIRS, ROW_STRIDE, ROW_TICKS
from motion.planner import Planner
from motion.steps import motor_steps

CARTESIAN: "tuple[int, ...]" = ()  # a machine without a table: each motor moves its own axis
# A mask per motor: bit n, it turns with axis n; bit 8 + n, against it (layout.MOVES).
# Two motors on Y: the second, after one motor for each axis, is mounted reversed.
PAIR = (0x001, 0x002, 0x004, 0x200)
PAIR_ALONGSIDE = (0x001, 0x002, 0x004, 0x002)
COREXZ = (0x005, 0x002, 0x401)
TABLES = {
    "cartesian": CARTESIAN,
    "corexy": COREXY,
    "corexz": COREXZ,
    "pair": PAIR,
    "alongside": PAIR_ALONGSIDE,
}

each_table = pytest.mark.parametrize("moves", TABLES.values(), ids=TABLES)
places = st.lists(st.integers(-(2**28), 2**28 - 1), min_size=3, max_size=3)
FAST_LIMITS = Limits((250.0, 250.0, 250.0), (3000.0, 3000.0, 1500.0), (500.0, 500.0, 200.0))


def motors_at(kinematics: Kinematics, place: Sequence[int]) -> "array[int]":
    """Return the motors' steps when the axes have moved from 0 to this position."""
    axis_steps = array("i", [*place, 0, 0, 0])
    return array("i", [motor_steps(axis_steps, 0, 3, moves) for moves in kinematics.moves])


@pytest.mark.parametrize(
    ("moves", "motors"),
    [
        (CARTESIAN, [10, 3, 7]),
        (COREXY, [13, 7, 7]),
        (COREXZ, [17, 3, 3]),
        (PAIR, [10, 3, 7, -3]),
        (PAIR_ALONGSIDE, [10, 3, 7, 3]),
    ],
    ids=TABLES,
)
def test_motors_sum_the_travel_of_their_axes(moves: Sequence[int], motors: "list[int]") -> None:
    kinematics = Kinematics(3, moves)
    assert len(kinematics.moves) == len(motors)
    assert list(motors_at(kinematics, [10, 3, 7])) == motors


@each_table
@given(places)
def test_axis_positions_are_computed_from_motors(moves: Sequence[int], place: "list[int]") -> None:
    """axis_steps() computes one axis, to_axes() all of them in place."""
    kinematics = Kinematics(3, moves)
    motors = motors_at(kinematics, place)
    assert [kinematics.axis_steps(motors, i) for i in range(3)] == place
    kinematics.to_axes(motors)
    assert list(motors[:3]) == place


@each_table
@given(places, st.integers(0, 2), st.integers(-(2**28), 2**28 - 1))
def test_setting_one_axis_keeps_the_others(
    moves: Sequence[int], place: "list[int]", axis: int, steps: int
) -> None:
    """set_axis() moves the motors as if this axis had been set to `steps`."""
    kinematics = Kinematics(3, moves)
    motors = motors_at(kinematics, place)
    kinematics.set_axis(motors, axis, steps)
    place[axis] = steps
    assert motors == motors_at(kinematics, place)


@pytest.mark.parametrize(("a", "b", "x", "y"), [(1, 0, 0, 0), (-1, 0, 0, 0), (7, -2, 2, 4)])
def test_half_a_step_of_corexy_is_rounded_towards_0(a: int, b: int, x: int, y: int) -> None:
    """x = (a + b) / 2, y = (a - b) / 2: a position that no whole step of X and Y makes."""
    kinematics = Kinematics(3, COREXY)
    motors = array("i", [a, b, 5])
    assert [kinematics.axis_steps(motors, i) for i in range(3)] == [x, y, 5]
    kinematics.set_axis(motors, 2, 9)
    assert list(motors) == [a, b, 9], "the motors of other axes keep their steps"
    kinematics.set_axis(motors, 0, 10)
    assert list(motors) == [10 + y, 10 - y, 9]  # x = 10, y as before


@pytest.mark.parametrize(
    ("moves", "masks"),
    [
        (CARTESIAN, [0b001, 0b010, 0b100]),
        (COREXY, [0b011, 0b011, 0b100]),  # one motor alone would move both axes
        (COREXZ, [0b101, 0b010, 0b101]),
        (PAIR, [0b0001, 0b1010, 0b0100]),
        (PAIR_ALONGSIDE, [0b0001, 0b1010, 0b0100]),
    ],
    ids=TABLES,
)
def test_all_motors_of_an_axis_stop_at_its_switch(
    moves: Sequence[int], masks: "list[int]"
) -> None:
    """motors_of() takes a mask of axes and returns the mask of their motors."""
    kinematics = Kinematics(3, moves)
    assert [kinematics.motors_of(1 << i) for i in range(3)] == masks
    assert kinematics.motors_of(0) == 0
    assert kinematics.motors_of(0b111) == (1 << len(kinematics.moves)) - 1


@each_table
def test_each_further_motor_follows_one_of_the_first(moves: Sequence[int]) -> None:
    """As the same motor, or reversed. steps.measure() relies on it: a block's length is that of
    the first motors."""
    # a mask, and that of the reversed motor
    masks = [{m, (m & 0xFF) << 8 | m >> 8} for m in Kinematics(3, moves).moves]
    assert all(any(mask_pair == first for first in masks[:3]) for mask_pair in masks[3:])


def run_zigzag(moves: Sequence[int]) -> "tuple[Bench, list[array[int]]]":
    """Run a program and check all laws; return the bench and the rows of its segments."""
    bench = Bench(replace(FAST_LIMITS, moves=moves))
    for i in range(12):
        bench.line((i % 2 * 3.0, i * 0.3, -0.1 * (i % 3)), 2000)
    bench.check()
    return bench, [segment.row for segment in bench.watch.made]


def steps_and_ticks(row: "array[int]", i: int) -> "list[int]":
    """Return a motor's steps in a segment, and the ticks of the first and the last; [0]: none."""
    count, *ticks = row[ROW_AXES + ROW_STRIDE * i :][:ROW_STRIDE]
    return [count, *ticks] if count else [0]


@pytest.mark.parametrize(("moves", "reverse"), [(PAIR, 1), (PAIR_ALONGSIDE, 0)])
def test_a_second_motor_of_an_axis_makes_its_steps_and_changes_nothing_else(
    moves: Sequence[int], reverse: int
) -> None:
    """Rows with a second motor on Y (motor 3) are those without it. reverse: 1, it turns against
    Y."""
    (_, rows_alone), (bench, rows) = run_zigzag(CARTESIAN), run_zigzag(moves)
    # motor 3 makes as many as motor 1, Y
    assert bench.planner.ring[layout.STEPS + 3] == bench.planner.ring[layout.STEPS + 1] > 0
    assert len(rows) == len(rows_alone)
    for row, row_alone in zip(rows, rows_alone, strict=True):
        assert row[ROW_TICKS] == row_alone[ROW_TICKS]
        assert row[ROW_DIRS] & 0b111 == row_alone[ROW_DIRS]
        assert [steps_and_ticks(row, i) for i in range(3)] == [
            steps_and_ticks(row_alone, i) for i in range(3)
        ]
        assert steps_and_ticks(row, 3) == steps_and_ticks(row, 1)
        if row[ROW_AXES + ROW_STRIDE]:
            assert row[ROW_DIRS] >> 3 ^ reverse == row[ROW_DIRS] >> 1 & 1


@each_table
def test_planning_continues_from_the_motors_position(moves: Sequence[int]) -> None:
    bench = Bench(replace(FAST_LIMITS, moves=moves))
    bench.planner.sync_motors(motors_at(Kinematics(3, moves), [500, -250, 750]))
    # 500, -250, 750 steps at 250 steps/mm
    assert not bench.line((2.0, -1.0, 3.0)), "it is already there"
    assert bench.line((3.0, -1.0, 3.0))  # 1 mm of X: 250 steps
    ring, count = bench.planner.ring, bench.planner.motors
    expected = motors_at(Kinematics(3, moves), [250, 0, 0])
    assert list(ring[layout.STEPS :][:count]) == [abs(n) for n in expected]


def test_the_planner_asks_kinematics_for_axis_positions() -> None:
    """FakeKinematics exchanges the axes: X is motor 1, Y is motor 0."""
    planner = Planner(3, 4, FakeKinematics(), State())
    motors = array("i", [10, 20, 30])
    assert [planner.axis_steps(motors, axis) for axis in range(3)] == [20, 10, 30]
    planner.sync_motors(motors)
    # 20, 10, 30, relative to 20
    assert [planner.position[axis] - planner.position[0] for axis in range(3)] == [0, -10, 10]
