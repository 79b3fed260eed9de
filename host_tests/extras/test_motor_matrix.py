"""Test MOVES: motors that move axes together, as described in the board file.

MOVES has a text for each motor: "X+Y" is a motor that moves by the sum of both. Machine.physical()
returns the steps of the motors, Machine.reported() the last reported position.
"""

from collections.abc import Sequence
from types import ModuleType

import pytest
from extras.kinematics.motor_matrix import parse_words
from hypothesis import given
from hypothesis import strategies as st
from motion.kinematics import COREXY
from rig_bench import Machine
from ugrbl.boardfile import board_check
from ugrbl.boardfile.files import load_board

_PER_MM = (250, 250, 250)  # $100 to $102

places = st.lists(st.tuples(*[st.integers(-200, 200) for _ in "XYZ"]), min_size=1, max_size=8)


def test_words_give_the_table_of_a_corexy() -> None:
    assert parse_words(("X+Y", "X-Y"), 3) == [*COREXY, 4]


@pytest.mark.thorough
@given(places)
def test_motors_move_as_the_words_say(lines: "list[tuple[int, int, int]]") -> None:
    """The motors of the board have MOVES X+Z, Y and X-Z. Lines are in tenths of mm."""
    machine = Machine(board="sim_corexz")
    machine.play([f"G1 X{x / 10} Y{y / 10} Z{z / 10} F2000" for x, y, z in lines])
    axis_steps = [round(n / 10 * per) for n, per in zip(lines[-1], _PER_MM, strict=True)]
    x, y, z = axis_steps
    assert machine.physical() == [x + z, y, x - z]
    assert machine.reported() == [
        pytest.approx(n / per, abs=6e-4) for n, per in zip(axis_steps, _PER_MM, strict=True)
    ]


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("X+Q", "Y"), "MOVES: Q in X+Q is not an axis, or is listed twice"),
        (("X+X", "Y"), "MOVES: X in X+X is not an axis, or is listed twice"),
        (("X+A", "Y"), "MOVES: A in X+A is not an axis, or is listed twice"),
        (("X+Y", "X+Y"), "MOVES: X and Y cannot be moved independently"),
        (("X+Z", "Y", "Z"), "MOVES: X and Z cannot be moved independently"),
        (("X", "Y", ""), "MOVES: no motor moves Z"),
        (("X", "Y", "Z", "X"), "MOVES has 4 entries, but there are 3 axes"),
    ],
)
def test_impossible_words_are_reported(words: Sequence[str], why: str) -> None:
    board = ModuleType("board")
    board.__dict__.update({**vars(load_board("sim")), "MOVES": words})
    assert board_check.problems(board) == [why]


def test_motor_that_moves_one_axis_may_have_a_second() -> None:
    """The second motor of Y moves like the first; an axis that shares its motor has no second."""
    board = ModuleType("board")
    board.__dict__.update({**vars(load_board("sim_ganged")), "MOVES": ("X+Z", "Y", "X-Z")})
    machine = Machine(board=board)
    machine.play(["G1 X1 Y2 Z3 F500"])
    assert machine.physical() == [1000, 500, -500, 500]  # X+Z, Y, X-Z and Y again, 250 steps/mm
    board.MOTORS = "XYZZ"  # type: ignore[attr-defined]
    assert board_check.problems(board) == ["MOTORS: Z shares its motor, and has no second"]


def test_words_and_corexy_exclude_each_other() -> None:
    board = ModuleType("board")
    board.__dict__.update({**vars(load_board("sim_corexz")), "COREXY": True})
    assert board_check.problems(board) == ["MOVES and COREXY exclude each other: use one"]
