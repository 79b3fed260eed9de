"""A line's path through the firmware agrees with docs/architecture.md."""

import subprocess
import sys
from pathlib import Path

import pytest

_PROGRAM = Path(__file__).parents[1] / "support" / "line_ways.py"
_PAGE = Path(__file__).parents[2] / "docs" / "architecture.md"


def functions_passed(*lines: str) -> "list[str]":
    done = subprocess.run(
        [sys.executable, _PROGRAM, *lines], capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines()


@pytest.mark.thorough
def test_the_table_matches_the_docs() -> None:
    assert "\n".join(functions_passed()) in _PAGE.read_text("utf-8")


def test_a_custom_word_goes_to_its_handler() -> None:
    """Through custom_codes.py, after motion has ended: these functions are called in this order.

    line_ways.py prints a row for each function that a line passes through.
    """
    rows = functions_passed("M100")
    order = ["custom_codes.py: execute", "canon.py: synchronise", "runner.py: run"]
    places = [next(i for i, row in enumerate(rows) if row.endswith(name)) for name in order]
    assert places == sorted(places)


def test_a_move_only_line_runs_no_python() -> None:
    """All of its functions are kernels."""
    rows = functions_passed("T1 G90 G1 X4 F600")
    assert not [row for row in rows if "interpreter" in row or "protocol" in row]
    assert sum(row.endswith(": scan") for row in rows) == 1
