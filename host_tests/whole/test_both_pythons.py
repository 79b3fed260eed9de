"""CPython and MicroPython give equal results: vectors give the same integers, lines the same
answers.

Integers are checked for 32 bits under CPython. MicroPython has 64-bit integers on a computer, and
reads words of arrays without their sign: a kernel's value below 0 is found here.
"""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as some
from micropython_runner import needs_micropython, run_micropython
from ugrbl.paths import FIRMWARE
from ugrbl.replay.conformance import replayer

ROOT = Path(__file__).parents[2]
HERE = ROOT / "host_tests" / "support"
STANDINS = ROOT / "tools" / "sim" / "standins"
PATHS = [FIRMWARE, HERE]
VECTORS = HERE / "vectors.py"


def cpython(*arguments: object) -> str:
    """Return the output of vectors.py under CPython, in a fresh process as under MicroPython.

    arguments: what vectors.main() reads from the command line.
    """
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


# Lines of words and settings

# Numbers that may break floats or integers of 30 or 32 bits, or that senders write.
_ODD = (
    " 0 -0 +0 .5 5. 1 -1 2 20 1e3 1E-3 -.0 . - + --1 1-1 1..2 1.0000001 0.0000001 0.00000001 1e9"
    " 0.0005 1000000 9999999 10000000 16777217 100000000 99999999 1073741824 2147483648 4294967295"
    " 4294967296 -2147483648 9999999999 123456789012345678901234567890 00001 0.300000012 nan inf"
).split(" ")
_DIGITS = some.text("0123456789", max_size=22)
_NUMBERS = some.sampled_from(_ODD) | some.builds(
    "{}{}{}{}".format,
    some.sampled_from(("", "", "-", "+")),
    _DIGITS,
    some.sampled_from(".,"),
    _DIGITS,
)
_SMALL = some.sampled_from(("0", "1", "2", "-3", "0.01", "7.5", "20"))
_BEGINNINGS = (
    "|G0|G1|G2|G3|g1|G38.2|G4|G92|G28.1|G30|G43.1|G49|G53G0|G91G1|G93G1|G94G1|G20G1|G21|G18|G10L2P1"
    "|G10L20P0|G80|M3|M4|M5|M7|M9|M0|T1|$J=G91|$J=|$N0=|(c)G1|/G1| G 1"
).split("|")
_WORDS = some.tuples(some.sampled_from("XYZXYZFSNIJKRPLTGMxABCDEHQ"), _SMALL | _NUMBERS)
_BLOCKS = some.builds(
    "{}{}{}".format,
    some.sampled_from(_BEGINNINGS),
    some.lists(_WORDS.map("".join), max_size=4).map(" ".join),
    some.sampled_from(("", "", "", "F300", "(c)", ";c", "(c", "%", "\t")),
)
_SETTINGS = some.builds(
    "${}={}".format,
    some.sampled_from(
        "0 1 2 3 4 5 6 10 11 12 13 20 21 22 23 24 25 26 27 30 31 32 100 101 102 110 111 112 120"
        " 121 122 130 131 132 140 7 256 -1 1.5 N1 I RST".split()
    ),
    _NUMBERS,
)
_OTHERS = some.sampled_from(("$X", "$G", "$#", "$C", "$H", "$N", "$I", "$", "", "?", "~"))
_LINES = some.lists(_BLOCKS | _SETTINGS | _OTHERS, min_size=1, max_size=20)
_BOARDS = (
    "sim",
    "sim",
    "sim_corexy",
    "sim_rotary",
    "sim_09j",
    "sim_jerk",
    "sim_laser",
    "sim_punch",
)
_AT_THE_END = ("?", "\x18", "$X\n", "$$\n", "$#\n", "$G\n", "$N\n", "?")


@pytest.fixture(scope="module")
def pythons() -> "Iterator[list[Any]]":
    """Start a machine under each Python."""
    with ExitStack() as stack:
        yield [stack.enter_context(replayer(python)) for python in ("cpython", "micropython")]


@needs_micropython
@given(_LINES, some.sampled_from(_BOARDS))
@example(["$110=0", "$112=0", "G0X5", "?", "G1Z1F100"], "sim")  # rate limits of 0
@example(["$120=0", "$121=0", "G1X0.004Y5F100", "G93X1F.0001"], "sim")
@example(["N-0", "N-0G1X1F9", "N4294967296", "G99999999", "M-1", "F1e3"], "sim")
def test_both_pythons_give_the_same_answers_and_motion(
    pythons: "list[Any]", lines: "list[str]", board: str
) -> None:
    """Replay the same lines under both Pythons and compare the results: answers, outputs, steps.

    _AT_THE_END then resets the machine, and asks for settings, offsets, modes and startup lines.
    """
    texts = [line if line in ("?", "~") else line + "\n" for line in lines]
    # Every text is followed by a wait of 60 ms of the machine's time, whatever the answer.
    steps = [{"send": text, "wait": "ms 60", "t_ms": 60} for text in (*texts, *_AT_THE_END)]
    case = {"name": "", "init": "defaults", "setup": [], "steps": steps}
    on_cpython, on_micropython = (python.replay(board, case) for python in pythons)
    assert "error" not in on_cpython
    for text, cpython_step, micropython_step in zip(
        (*texts, *_AT_THE_END), on_cpython["steps"], on_micropython["steps"], strict=True
    ):
        assert cpython_step == micropython_step, text
    assert on_cpython == on_micropython
