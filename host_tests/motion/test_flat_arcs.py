"""Arcs whose ends are so close that single precision loses their angle take the short way."""

from array import array
from fractions import Fraction
from math import atan2, hypot, pi
from pathlib import Path

import pytest
from base.float32 import f32, vector
from hypothesis import assume, example, given
from hypothesis import strategies as st
from laws import some
from motion.arc_geometry import CENTRE_0, CENTRE_1, RADIUS, Arc
from typer.testing import CliRunner
from ugrbl.cli.app import app
from ugrbl.grbl.lines import split_lines
from ugrbl.run import rehearsal
from ugrbl.run.program import Result, run_program
from ugrbl.web.preview import preview

PLANES = {"G17": "XYIJ", "G18": "ZXKI", "G19": "YZJK"}
_NEAR_MM = 0.6  # largest error of an arc's end, and a margin


def simulate(*lines: str) -> Result:
    """Run a program on the simulator, without an error; return the result."""
    result, _ = run_program(split_lines("\n".join(lines).encode()), settings=("$110=60000",))
    assert not result.errors and not result.stopped, result
    return result


def in_plane(plane: str, line: str) -> str:
    """Return a line of G17 rewritten for another plane."""
    return line.translate(str.maketrans(PLANES["G17"], PLANES[plane]))


@pytest.mark.parametrize("plane", PLANES)
@pytest.mark.parametrize(
    ("begin", "arc"),
    [
        ("X-26.4249 Y49.0743", "G3 X-26.4352 Y49.0642 I20195 J0"),
        ("X-26.4249 Y49.0743", "G3 X-26.4352 Y49.0642 I20194 J0"),
        ("X26.4249 Y49.0743", "G2 X26.4352 Y49.0642 I-20195 J0"),
        ("X0 Y0", "G3 X0 Y-0.01 I30000 J0"),
        ("X0 Y0", "G2 X0 Y0.01 I30000 J0"),
        ("X0 Y0", "G3 X0 Y-0.01 R30000"),
        ("X0 Y0", "G2 X0 Y-0.01 R30000"),
        ("X0 Y0", "G3 X-0.01 Y0 I30000 J0"),  # only its end is off the circle
    ],
)
def test_an_arc_with_close_ends_takes_the_short_way(plane: str, begin: str, arc: str) -> None:
    """The other way is a whole circle of 20 to 30 m radius: 120 m and more."""
    result = simulate(
        f"G21 G90 {plane}", in_plane(plane, f"G1 {begin} F60000"), in_plane(plane, arc)
    )
    without_arc = simulate(f"G21 G90 {plane}", in_plane(plane, f"G1 {begin} F60000"))
    assert result.totals.distance_mm - without_arc.totals.distance_mm < 0.03


def test_a_helix_with_close_ends_is_short() -> None:
    assert simulate("G21 G90", "G3 X0 Y-0.01 Z-2 I30000 J0 F60000").totals.distance_mm < 2.01


@pytest.mark.parametrize("arc", ["G2 X0 I5", "G3 Y0 J-5", "G3 X0 Y0 I5", "G2 X0 Y0 Z-1 I3 J4"])
def test_an_arc_with_equal_ends_is_a_full_circle(arc: str) -> None:
    result = simulate("G21 G90", f"{arc} F6000")
    # all have a radius of 5 mm
    assert result.totals.distance_mm == pytest.approx(10 * pi, rel=0.02)


def test_ends_equal_after_rounding_are_a_full_circle() -> None:
    """A position reached in G91 and the same position in G90: rounding is no distance."""
    result = simulate("G21 G91 F6000", *["G1 X0.1 Y0.1"] * 30, "G90 G2 X3 Y3 I-5 J0", "G1 X0 Y0")
    # the circle, there and back
    assert result.totals.distance_mm == pytest.approx(10 * pi + 2 * hypot(3, 3), rel=0.02)


def exact_angle(
    start: "tuple[Fraction, ...]", target: "tuple[Fraction, ...]", centre: "tuple[Fraction, ...]"
) -> float:
    """Return the counterclockwise angle from start to target. centre: relative to the start."""
    x, y = (-part for part in centre)
    to_x, to_y = (b - a - c for a, b, c in zip(start, target, centre, strict=True))
    return atan2(x * to_y - y * to_x, x * to_x + y * to_y) % (2 * pi)


def decimals(low: float, high: float, digits: int = 4) -> "st.SearchStrategy[Fraction]":
    """Return a strategy for numbers as programs have them."""
    scale = 10**digits
    return st.integers(int(low * scale), int(high * scale)).map(lambda n: Fraction(n, scale))


coordinates = st.one_of(decimals(-10, 10), decimals(-1000, 1000))
close_coordinates = st.one_of(decimals(-0.01, 0.01), decimals(-_NEAR_MM, _NEAR_MM))
centres = st.one_of(decimals(-10, 10), decimals(-1000, 1000), decimals(-1e6, 1e6, 0))
pairs = st.tuples(coordinates, coordinates)


@some(200)
@given(
    pairs,
    st.tuples(close_coordinates, close_coordinates),
    st.tuples(centres, centres),
    st.booleans(),
)
@example(
    (Fraction("-26.4249"), Fraction("49.0743")),
    (Fraction("-0.0103"), Fraction("-0.0101")),
    (Fraction(20195), Fraction(0)),
    False,
)
def test_an_arc_that_is_short_in_exact_numbers_is_planned_short(
    start: "tuple[Fraction, ...]",
    to_target: "tuple[Fraction, ...]",
    centre: "tuple[Fraction, ...]",
    clockwise: bool,
) -> None:
    """Exact fractions give the angle; Arc.sweep() in single precision must find about the same
    length."""
    radius = hypot(*centre)
    assume(radius > 0.02)  # below it an end may be as far off as the centre
    target = tuple(a + b for a, b in zip(start, to_target, strict=True))
    # The firmware's own check: the end lies near the circle.
    off_circle = abs(
        hypot(*(b - a - c for a, b, c in zip(start, target, centre, strict=True))) - radius
    )
    assume(off_circle < 0.005 or off_circle < min(0.5, 0.001 * radius))
    ends = vector(3), vector(3)
    for i in range(2):
        ends[0][i], ends[1][i] = float(start[i]), float(target[i])
    # Ends equal in single precision are the same position: a full circle.
    differ = [abs(a - b) > 2.0**-22 * max(abs(a), abs(b)) for a, b in zip(*ends, strict=True)]
    assume(any(differ))
    arc = Arc()
    arc.plane[:] = array("i", (0, 1, clockwise))
    for i, number in zip((CENTRE_0, CENTRE_1, RADIUS), (*map(float, centre), radius), strict=True):
        arc.numbers[i] = f32(number)
    angle = exact_angle(start, target, centre)
    if clockwise:
        angle = -angle % (2 * pi)
    length = radius * arc.sweep(*ends)
    if angle < 0.1:
        assert length <= 1.001 * (radius * angle + hypot(*to_target)) + 0.001
    elif angle < 6.2:  # above: nearly a circle, where rounding decides
        assert length == pytest.approx(radius * angle, rel=0.01, abs=0.001)


# Warnings of arcs that leave the part


@pytest.mark.parametrize(
    ("arc", "words"),
    [
        ("G3 X0 Y0 I30000", "an arc of 30000 mm radius, which goes 60000 mm beyond its ends"),
        ("G2 X0 Y-0.1 I700", "an arc of 700 mm radius, which goes 1400 mm beyond its ends"),
        (
            "G2 X0 Y-0.01 I10",
            "a whole circle of 10 mm radius between ends that are 0.0100 mm apart",
        ),
        ("G3 X0 Y-0.01 I10", ""),
        ("G2 X0 Y0 I10", ""),
        ("G2 X0.0501 Y-1 I10", ""),  # an intended gap
        ("G2 X900 Y900 I900 J0", ""),
        ("G3 X0 Y-0.01 I30000", ""),  # a short arc
    ],
)
def test_an_arc_that_leaves_the_part_is_reported(arc: str, words: str) -> None:
    """words: how the warning of line 2 begins; "": none."""
    result, _ = run_program([b"G21 G90", f"{arc} F600".encode()], check=True)
    assert not result.errors
    assert [text[: len(words)] for _, text in result.wide_arcs] == ([words] if words else [])
    assert [line for line, _ in result.wide_arcs] == [2][: bool(words)]


def test_run_send_and_page_show_the_warning(tmp_path: Path) -> None:
    """The output of `ugrbl run`, the check before sending, and the preview of the page."""
    program = "G21 G90\nG2 X0 Y-0.01 I10 F6000\n"
    (tmp_path / "part.nc").write_text(program)
    output = CliRunner().invoke(app, ["run", str(tmp_path / "part.nc"), "--check"]).output
    assert "line 2: a whole circle of 10 mm radius" in output
    checked, _ = rehearsal.check(rehearsal.Job(program.encode().splitlines(), []))
    assert [line for line, _ in checked.wide_arcs] == [2]
    (problem,) = preview({"name": "part.nc", "program": program}, "sim")["problems"]
    assert problem["line"] == 2 and "a whole circle" in problem["text"]
