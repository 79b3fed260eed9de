"""Test arcs limited to the acceleration of their axes, if the board asks for it."""

from types import ModuleType

import pytest
from laws import check_segments
from rig_bench import Machine
from ugrbl.boardfile.files import load_board

# The junction deviation ($11) is five times the arc tolerance ($12), so the corners of chords
# allow five times the acceleration.
_SETTINGS = {
    11: 0.01,
    12: 0.002,
    110: 9000.0,
    111: 9000.0,
    112: 9000.0,
    120: 200.0,
    121: 300.0,
    122: 300.0,
}


def highest_speed(line: str, limited: bool, settings: "dict[int, float] | None" = None) -> float:
    """Return the highest speed, in mm/s, at which a machine executes the line.

    limited: the board's ARC_ACCELERATION. settings: values by $-number, added to _SETTINGS.
    """
    board = ModuleType("board")
    vars(board).update(vars(load_board("sim")), ARC_ACCELERATION=limited)
    machine = Machine({**_SETTINGS, **(settings or {})}, board)
    machine.play([line])
    check_segments(machine.watch)  # rate, acceleration and junctions are within the settings
    return max(piece.mean for piece in machine.watch.pieces)  # mean speed of each segment


@pytest.mark.parametrize("radius", [0.5, 2.0, 9.0])
@pytest.mark.parametrize("words", ["G2", "G3", "G2Z-1", "G93G2"])
def test_arc_keeps_the_acceleration_of_its_axes(radius: float, words: str) -> None:
    half_circle = f"{words}X{2 * radius}I{radius}F9000"
    allowed = (200 * radius) ** 0.5  # v**2 / r = 200 mm/s2, the acceleration of X ($120)
    assert highest_speed(half_circle, limited=False) > 1.4 * allowed
    assert highest_speed(half_circle, limited=True) == pytest.approx(allowed, rel=0.02)


def test_weaker_axis_of_the_plane_limits_the_arc() -> None:
    assert highest_speed("G19G2Y8J4F9000", limited=True, settings={122: 50.0}) == pytest.approx(
        200**0.5, rel=0.02
    )


@pytest.mark.parametrize("line", ["G2X8I4F600", "G1X30F3000", "G0X30"])
def test_slow_or_straight_lines_are_unchanged(line: str) -> None:
    assert highest_speed(line, limited=True) == highest_speed(line, limited=False)
