"""Speed on the emulated Pico does not get worse by more than a tenth, nor does memory per line."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from emulated import Board

sys.path.append(str(Path(__file__).parent.parent / "bench"))

from bench_setup import inside, set_up
from on_board import MAIN
from streaming import (
    CIRCLE,
    CIRCLE_CHORDS,
    circles,
    idle,
    raster,
    short_moves,
    stream,
)
from wire import EmulatedWire, Talk

pytestmark = pytest.mark.xdist_group("pico speed")

# What `make bench-board` has measured.
_STREAMED = 1150  # lines/s, 1200 asked
_CHECKED = 2150  # lines/s
_CHORDS = 2840  # a second
_WORSE = 0.9
_RASTER_BYTES = 256  # of heap for a line with a new S; lines that only move have none
_MORE = 1.1
_ROUNDED = 4  # bytes per line: what comes before and after the lines differs by blocks of 16


@pytest.fixture(scope="module")
def talk(uf2: Path) -> Talk:
    made = Talk(EmulatedWire(Board(uf2, {"main.py": MAIN}).boot().settled()))
    set_up(made)
    return made


MOVES = list(short_moves(150, 1200))


def _left(talk: Talk, lines: "list[str]") -> int:
    """Bytes of heap that lines leave."""
    inside(talk, "$COLLECT=1")
    inside(talk, "$GC=0")
    (before,) = inside(talk, "$ALLOC")
    stream(talk, lines, 15)
    (after,) = inside(talk, "$ALLOC")
    inside(talk, "$GC=1")
    return after - before


def test_short_moves_are_streamed_as_fast_as_ever(talk: Talk) -> None:
    assert stream(talk, MOVES, 15).lines_s >= _WORSE * _STREAMED


@pytest.mark.parametrize(
    ("lines", "before", "most"),
    [(MOVES, "G90G1X10Y10F3600", 0), (list(raster(72)), "G90G1X10Y10F4000", _RASTER_BYTES)],
)
def test_lines_leave_no_more_on_the_heap_than_ever(
    talk: Talk, lines: "list[str]", before: str, most: int
) -> None:
    idle(talk)
    for line in ("$32=1", "M4S0" if most else "M5", before):
        talk.ask(line)
    idle(talk)
    fewer = _left(talk, lines[:24])
    idle(talk)
    assert (_left(talk, lines[24:72]) - fewer) / 24 <= _MORE * most + _ROUNDED


@pytest.fixture
def circling(talk: Talk) -> "Iterator[Talk]":
    """Settings of circles, meanwhile."""
    idle(talk)
    for line in ("M5", "$32=0", *CIRCLE, "G90G0X10Y10"):
        talk.ask(line)
    idle(talk)
    yield talk
    idle(talk)
    talk.ask("$12=0.002")
    set_up(talk)


def test_chords_are_planned_as_fast_as_ever(circling: Talk) -> None:
    chords_s = stream(circling, circles(2), 15).lines_s * CIRCLE_CHORDS
    assert chords_s >= _WORSE * _CHORDS


def test_chords_leave_nothing_on_the_heap(circling: Talk) -> None:
    many = _left(circling, circles(1))
    idle(circling)
    circling.ask("$12=0.002")
    fewer = _left(circling, circles(1))
    assert (many - fewer) / CIRCLE_CHORDS <= 1


def test_check_mode_is_as_fast_as_ever(talk: Talk) -> None:
    idle(talk)
    talk.ask("M5")
    talk.ask("$C")
    assert stream(talk, MOVES, 15).lines_s >= _WORSE * _CHECKED
