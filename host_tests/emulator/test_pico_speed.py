"""Speed on the emulated Pico does not get worse by more than a tenth, nor does memory per line."""

import sys
from pathlib import Path

import pytest
from emulated import Board

sys.path.append(str(Path(__file__).parent.parent / "bench"))

from bench_board import MAIN, inside
from streaming import SETTINGS, idle, short_moves, stream
from wire import EmulatedWire, Talk

pytestmark = pytest.mark.xdist_group("pico speed")

# What `make bench-board` has measured.
_STREAMED = 565  # lines/s, 700 asked
_CHECKED = 1300  # lines/s
_WORSE = 0.9
_BYTES_PER_LINE = 8  # of the command that tells; the lines have none


@pytest.fixture(scope="module")
def talk(uf2: Path) -> Talk:
    made = Talk(EmulatedWire(Board(uf2, {"main.py": MAIN}).boot().settled()))
    for line in (*SETTINGS, "G90", "G0X10Y10"):
        made.ask(line)
    idle(made)
    return made


MOVES = [line.replace("F9000", "F2100") for line in short_moves(150)]


def test_short_moves_are_streamed_as_fast_as_ever(talk: Talk) -> None:
    before, _ = inside(talk, "$ALLOC")
    stream(talk, MOVES[:2], 15)  # the way back to a plain line
    made = stream(talk, MOVES[2:], 15)
    after, _ = inside(talk, "$ALLOC")
    assert made.lines_s >= _WORSE * _STREAMED
    assert after - before <= _BYTES_PER_LINE * len(MOVES) + 4_000


def test_check_mode_is_as_fast_as_ever(talk: Talk) -> None:
    idle(talk)
    talk.ask("$C")
    assert stream(talk, MOVES, 15).lines_s >= _WORSE * _CHECKED
