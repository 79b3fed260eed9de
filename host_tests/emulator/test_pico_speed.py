"""Test the table "On a Pico" of docs/speed.md: each of its figures is measured again.

The parts of `make bench-board` run in its order, because the first parts leave traces in memory.
Parts without a row are left out. Of the column with the flash cache only the streams are measured:
the emulator takes twice as long with it.
"""

import re
import sys
from collections.abc import Iterator, Sequence
from itertools import cycle
from pathlib import Path

import pytest
import xip
from emulated import Board

_HOST_TESTS = Path(__file__).parent.parent
sys.path.append(str(_HOST_TESTS / "bench"))

import bench_board  # noqa: E402
from bench_setup import Bench, inside, set_up  # noqa: E402
from on_board import MAIN  # noqa: E402
from streaming import CIRCLE, CIRCLE_CHORDS, circles, idle, stream  # noqa: E402
from wire import EmulatedWire, Talk  # noqa: E402

_DOCUMENT = (_HOST_TESTS.parent / "docs" / "speed.md").read_text(encoding="utf-8")
_WORSE = 0.1
_BYTES = 16  # a block of memory: the figure of a line is the mean of some lines
# Parts of bench_board.py, in its order, that have rows in the table.
_PARTS = (
    *("boot", "memory", "heap", "queries", "lines", "special", "long", "chords"),
    *("share", "hold", "gaps"),
)
_FAR = ("rates", "clusters")  # on boards of their own, so their order does not matter
_CACHED = ("lines", "special", "clusters", "chords")

_LONG = [f"interrupt's share, {x}" for x in ("1 axis, 1 kHz", "1 axis, 100 kHz", "3 axes, 70 kHz")]
# The rows of the table by their beginning; the factor from the benchmark's unit, and the
# benchmark's row for each figure. "" stands for a figure that was given and not measured.
_ROWS: "dict[str, tuple[float, Sequence[str]]]" = {
    "step rate on one": (1, ["step rate, 1 axis", "step rate, 2 axes", "step rate, 3 axes"]),
    "short moves streamed": (
        *(
            1,
            ["short moves, 700 asked, ? every 40 ms", "", "least blocks in the planner then", ""],
        ),
    ),
    "the same without `?`": (1, ["short moves, 2400 asked", ""]),
    "short moves in check mode": (1, ["short moves, check mode"]),
    "a laser's raster": (1, ["raster, G1 X S in M4"]),
    "short moves with a new F": (1, ["short moves, a new F each"]),
    "clusters of 16 dots": (1, ["dots of clusters, M4"]),
    "half circles of 1 mm": (1, ["half circles of 1 mm"]),
    "circles of 702 chords": (1, ["chords of circles"]),
    "half circles in check mode": (1, ["half circles, check mode"]),
    "a line with words in force": (
        *(1, ["a line with words in force", "a line with words in force and a move"]),
    ),
    "a move in inverse time": (1, ["a line with a time (G93) and a move"]),
    "a line with a tool": (*(1, ["a line with a tool", "a line with a tool and a move"]),),
    "an arc of one chord": (
        *(1, ["a line with an arc of one chord", "a line with an arc of two chords"]),
    ),
    "a line that changes how": (
        *(1, ["a line with modes that change", "a line with modes that change and a move"]),
    ),
    "`$J=G91X0.01F3000`": (
        1,
        [
            f"{line} to the end of its answer, mean"
            for line in ("$J=G91X0.01F3000", "$G", "$#", "$$")
        ],
    ),
    "`?` to the end": (1, ["? at rest, whole answer, mean"]),
    "the same while streaming": (
        *(1, ["? while streaming, whole answer, mean", "? while streaming, whole answer, worst"]),
    ),
    "`!` to the first": (
        *(1, ["! to the first slower step, mean", "! to the first slower step, worst"]),
    ),
    "interrupt's share, long moves": (1, ["least of long moves", "most of long moves"]),
    "interrupt's share, 50": (
        *(1, [f"interrupt's share, {rate} blocks/s" for rate in (50, 300, 600)]),
    ),
    "power-up to welcome": (
        *(1e-3, [f"power-up to welcome, {start}" for start in ("first start", "settings kept")]),
    ),
    "longest gap": (
        1,
        [
            f"longest gap between services, {x}"
            for x in ("short moves", "half circles", "half circles and a collection")
        ],
    ),
    "heap allocated by a plain line": (
        1,
        [
            f"heap per line, {x}"
            for x in (
                *("G1 X Y", "G1 X S in M4", "half circle of 1 mm"),
                "a tool, moves, a half circle",
            )
        ],
    ),
    "a collection": (1, ["a collection, mean"]),
    "memory free": (1, ["memory free, nothing but the firmware"]),
}
# Measured by make torture-board.
_NOT_HERE = ("a limit switch to the last edge",)


def table() -> "dict[str, list[str]]":
    """Return the document's table: the cells of each row by its first cell."""
    _, _, section = _DOCUMENT.partition("## On a Pico")
    lines = section[section.index("\n| ---") + 1 :].splitlines()[1:]
    end = next(i for i, line in enumerate(lines) if not line.startswith("|"))
    rows = [line.strip("|").split("|") for line in lines[:end]]
    return {row[0].strip(): [cell.strip() for cell in row[1:]] for row in rows}


TABLE = table()


def figures(cell: str) -> "list[tuple[float, float]]":
    """Return the numbers of a cell, each with half a unit of its last digit: 1.9 with 0.05."""
    numbers = [
        text.replace(",", "") for text in re.findall(r"\d[\d,]*\d(?:\.\d+)?|\d(?:\.\d+)?", cell)
    ]
    return [(float(text), 0.5 * 10.0 ** -len(text.partition(".")[2])) for text in numbers]


def measured(uf2: Path, parts: "Sequence[str]", cached: bool = False) -> "dict[str, float]":
    """Run parts of the benchmark, with or without the flash cache; return its figures by row."""
    bench = Bench(uf2, cache=cached)
    return {row.name: row.figure for part in parts for row in bench_board._PARTS[part](bench)}


def deviations(
    cell: str, row: str, found: "dict[str, float]", of: "Sequence[str]" = ()
) -> "list[str]":
    """Return a message for each figure of a cell that differs by more than 10 % and rounding.

    row: key in _ROWS; found: measured figures by the benchmark's row; of: benchmark rows, if not
    all of the table's row.
    """
    scale, names = _ROWS[row]
    names = of or names
    stated = figures(cell)
    assert stated and len(stated) in (1, len(names)), f"{cell!r} is for {names}"
    faults = []
    for name, (figure, rounding) in zip(names, cycle(stated)):  # one figure may stand for all
        if not name:  # this figure is not measured
            continue
        result = found[name] * scale
        allowed = _WORSE * figure + (_BYTES if "bytes" in cell else rounding)
        if abs(result - figure) > allowed:
            faults.append(f"{name}: {figure:g} stated, {result:.4g} measured")
    return faults


def row_key(row: str) -> str:
    """Return the key in _ROWS of a row of the table."""
    (begin,) = [begin for begin in _ROWS if row.startswith(begin)]
    return begin


def test_figures_of_the_table_are_measured_again(uf2: Path) -> None:
    """The table states the least and the most of some of the benchmark's figures."""
    found = measured(uf2, _PARTS)
    found.update(measured(uf2, _FAR))
    shares = [found[name] for name in _LONG]
    found.update({"least of long moves": min(shares), "most of long moves": max(shares)})
    rows = [row for row in TABLE if row not in _NOT_HERE]
    faults = [fault for row in rows for fault in deviations(TABLE[row][0], row_key(row), found)]
    assert not faults, "\n".join(faults)


_STREAMS = (
    *("the same without `?`", "short moves in check mode", "a laser's raster"),
    *(
        "short moves with a new F",
        "clusters of 16 dots",
        "half circles of 1 mm",
        "circles of 702 chords",
    ),
)


def test_figures_of_streams_hold_with_the_flash_cache(uf2: Path) -> None:
    """The second column of the table."""
    if not xip.is_there():
        pytest.skip("the model of the flash cache is not compiled: make compiled-emulator")
    found = measured(uf2, _CACHED, cached=True)
    faults = []
    for row in TABLE:
        if row.startswith(_STREAMS):
            _, names = _ROWS[row_key(row)]
            # The second column lacks the figures that were given and not measured ("").
            measured_names = [name for name in names if name]
            faults += deviations(TABLE[row][1], row_key(row), found, measured_names)
    assert not faults, "\n".join(faults)


def test_stated_figures_are_compared() -> None:
    """Test figures() and deviations() themselves, and that _ROWS has every row of the table."""
    assert figures("2610 and 23,000 chords/s") == [(2610, 0.5), (23000, 0.5)]
    assert figures("0, 67 and 2600 bytes") == [(0, 0.5), (67, 0.5), (2600, 0.5)]
    assert figures("1.9, 5.3 and 6.7 %")[1] == (5.3, pytest.approx(0.05))
    row = "short moves in check mode"
    # 2200, 10 % and half a unit: from 1979.5 to 2420.5.
    for result, faults in ((2200, 0), (1981, 0), (1970, 1), (2425, 1)):
        assert len(deviations("2200 lines/s", row, {"short moves, check mode": result})) == faults
    assert not deviations(
        "249.5 kHz each", "step rate on one", dict.fromkeys(_ROWS["step rate on one"][1], 249.0)
    )
    assert {row_key(row) for row in TABLE if row not in _NOT_HERE} == set(_ROWS)


# Not in the table


@pytest.fixture(scope="module")
def circling(uf2: Path) -> "Iterator[Talk]":
    """Yield a conversation with a board that has the settings of circles and stands at their
    start."""
    talk = Talk(EmulatedWire(Board(uf2, {"main.py": MAIN}).boot().settled()))
    set_up(talk)
    for line in (*CIRCLE, "G90G0X10Y10"):
        talk.ask(line)
    idle(talk)
    yield talk


def _bytes_left(talk: Talk, lines: "list[str]") -> int:
    """Return the bytes that lines leave on the heap, without a garbage collection."""
    inside(talk, "$COLLECT=1")
    inside(talk, "$GC=0")
    (before,) = inside(talk, "$ALLOC")  # allocated bytes
    stream(talk, lines, blocks=15)
    (after,) = inside(talk, "$ALLOC")
    inside(talk, "$GC=1")
    return after - before


def test_chords_leave_nothing_on_the_heap(circling: Talk) -> None:
    """The same circles with fewer chords, by a larger tolerance ($12), leave as many bytes: the
    difference is at most a byte for each chord."""
    bytes_of_many = _bytes_left(circling, circles(1))
    idle(circling)
    circling.ask("$12=0.002")
    bytes_of_fewer = _bytes_left(circling, circles(1))
    assert (bytes_of_many - bytes_of_fewer) / CIRCLE_CHORDS <= 1
