"""The same vectors give the same integers under CPython, checked for 32 bits, and MicroPython."""

import subprocess
import sys
from pathlib import Path

import pytest
from micropython_runner import needs_micropython, run_micropython
from ugrbl.paths import FIRMWARE

HERE = Path(__file__).parent
STANDINS = HERE.parent / "tools" / "sim" / "standins"
PATHS = [FIRMWARE, HERE]
VECTORS = HERE / "vectors.py"


def cpython(*arguments: object) -> str:
    """What the vectors print here, in a fresh process as there."""
    paths = [str(STANDINS), *map(str, PATHS)]
    start = f"import sys; sys.path[:0] = {paths}; sys.argv[1:] = {[*map(str, arguments)]}; "
    command = [sys.executable, "-c", start + "import vectors; vectors.main()"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@pytest.mark.sampled(2)
@needs_micropython
@pytest.mark.parametrize("part", ["reals", "words", "blocks", "arcs"])
def test_both_pythons_compute_the_same_integers(part: str) -> None:
    here, there = cpython(part), run_micropython(VECTORS, part, paths=PATHS)
    for number, (one, other) in enumerate(zip(here.splitlines(), there.splitlines(), strict=True)):
        assert one == other, f"line {number} of {part}"
    assert len(here.splitlines()) > 300
