"""The example program: its generator's output, and how Grbl would accept it."""

import re
import runpy
from pathlib import Path

import pytest
from ugrbl.grbl.gcode_file import read_lines
from ugrbl.run.program import run_program

_EXAMPLES = Path(__file__).parents[2] / "examples"
_PROGRAM = _EXAMPLES / "badge.nc"
_FAST = ("$110=6000", "$111=6000", "$112=3000", "$120=500", "$121=500", "$122=300")
_LIMIT_MM = 200.0
_LINE_LENGTH = 80


@pytest.fixture(scope="module")
def text() -> str:
    return _PROGRAM.read_text()


def test_the_generator_makes_the_committed_program(text: str) -> None:
    made = runpy.run_path(str(_EXAMPLES / "make_badge.py"))["badge"]()
    assert "\n".join(made) + "\n" == text


def test_the_example_is_as_long_as_a_real_job(text: str) -> None:
    assert len(text.splitlines()) >= 2000


def test_every_line_fits_grbls_line_buffer(text: str) -> None:
    assert max(map(len, text.splitlines())) < _LINE_LENGTH


@pytest.mark.parametrize(
    "pattern",
    [
        r"^G90 G94 G17$",
        r"^G21$",
        r"^S\d+ M3$",
        r"^G0 Z",
        r"^G1 Z-.* F",  # a plunge
        r"^G2 X.* I.* J",
        r"^G3 X.* I.* J",
        r"^G3 X.* Y.* Z-.* I.* J",  # a helix
        r"^M5$",
        r"^M30$",
        r"^\(.*\)$",
    ],
)
def test_the_example_has_typical_cam_lines(text: str, pattern: str) -> None:
    assert re.search(pattern, text, re.MULTILINE)


def test_grbl_accepts_every_line() -> None:
    result, _ = run_program(read_lines(_PROGRAM), check=True)
    assert (result.errors, result.stopped) == ([], "")


@pytest.mark.thorough
def test_all_steps_are_made_within_a_small_machine() -> None:
    """Run the whole program on the simulated machine: no error, no lost step, within 200 mm.

    _FAST: rates (mm/min) and accelerations (mm/s²), so that the test takes less time.
    """
    lines = read_lines(_PROGRAM)
    result, _ = run_program(lines, settings=_FAST)
    totals = result.totals
    assert (result.lines, result.errors, result.stopped) == (len(lines), [], "")
    assert totals.steps_planned == totals.steps_made
    assert all(high - low <= _LIMIT_MM for low, high in totals.bounds_mm.values())
