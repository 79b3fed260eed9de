"""Programs whose lines come faster than a board can process them are found before sending."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from test_run import _PROGRAMS, ugrbl
from ugrbl.boardfile import rates
from ugrbl.boardfile.files import load_board
from ugrbl.boardfile.rates import PICO
from ugrbl.grbl.gcode_file import read_lines
from ugrbl.run import pace
from ugrbl.run.pace import Stretch
from ugrbl.run.program import run_program
from ugrbl.sim.replay import factory_store
from ugrbl.sim.rig import Rig
from ugrbl.sim.sender import Sender

# Real programs at real rates.
pytestmark = pytest.mark.thorough

SPEED = (Path(__file__).parents[2] / "docs" / "speed.md").read_text(encoding="utf-8")
FAST = [f"${n + axis}={v}" for n, v in ((110, 30_000), (120, 5000)) for axis in range(3)]
LASER = [*FAST, "$32=1", "$30=1000"]
FEED = 15_000
NEEDED_LINES_S = 2500  # dots per second, at that feed
DOTS = 800  # per row


def raster(feed: int, rows: int = 1, dots: int = DOTS) -> "list[bytes]":
    """Return a laser raster, feed in mm/min: a distance to accelerate, then 0.1 mm per dot, back
    and forth."""
    lines = [b"G21G90M4S0F%d" % feed]
    for row in range(rows):
        dot_order = range(dots) if row % 2 == 0 else range(dots - 1, -1, -1)
        lines.append(b"G1X%dY%d" % (10 + dots // 10 if row % 2 else 0, row))
        lines += [b"G1X%.1fS%d" % (5 + x / 10, 37 * x % 1000) for x in dot_order]
    return lines


def stretches(lines: "list[bytes]", settings: "list[str]", board: str = "sim") -> "list[Stretch]":
    """Run a program; return the stretches of lines that a real board would process too slowly."""
    result, recorder = run_program(lines, settings=settings, board=board)
    assert not result.errors and not result.stopped
    return recorder.starves(lines)


@pytest.mark.sampled(3)
def test_a_raster_faster_than_the_board_is_reported_with_its_lines() -> None:
    """Rates are in lines per second; feed: the feed at which the board is fast enough, in
    percent."""
    (worst,) = stretches(raster(FEED), LASER, "rpi_pico2")
    assert worst.kind == "power" and worst.taken == pytest.approx(PICO.power, rel=0.01)
    assert worst.needed == pytest.approx(NEEDED_LINES_S, rel=0.05)
    # it begins after the planner's blocks have run out
    assert DOTS >= worst.last > worst.first > 20 and worst.last - worst.first > 300
    assert worst.feed == pytest.approx(100 * PICO.power / NEEDED_LINES_S, abs=3)  # percent


def test_each_row_of_a_raster_is_reported() -> None:
    by_line = sorted(
        stretches(raster(FEED, rows=3), LASER, "rpi_pico2"), key=lambda stretch: stretch.first
    )
    # a row has about DOTS lines
    assert [stretch.first // DOTS for stretch in by_line] == [0, 1, 2]


def test_the_recommended_feed_is_in_time() -> None:
    """At the percentage of the feed that the report recommends."""
    worst = stretches(raster(FEED), LASER, "rpi_pico2")[0]
    assert stretches(raster(FEED * worst.feed // 100), LASER, "rpi_pico2") == []


def test_dwells_and_the_start_of_a_program_are_no_delay() -> None:
    """The planner is empty then, too, but not because lines come too slowly."""
    lines = [b"G91F6000", *[b"G1X0.5", b"G4P0.01"] * 60]
    assert stretches(lines, FAST) == []


@pytest.mark.parametrize(
    ("lines", "kind", "settings"),
    [
        ([b"G91F30000", *[b"G1X0.05"] * 1500], "plain", FAST),
        ([b"G91", *[b"G1X0.05F%d" % (30_000 + k % 2) for k in range(900)]], "plain", FAST),
        ([b"F9000", b"G91", *[b"G2X0.1R9", b"G3X0.1R9"] * 200], "in_python_ms", FAST),
        ([b"F9000", b"G91", *[b"G1X0.3", *[b"(nothing)"] * 9] * 99], "no_words_ms", FAST),
        (
            [b"F30000", *[b"G2X0Y0I5"] * 5],
            "chords",
            ["$12=0.00005", *FAST[:3], *(f"${n}=50000" for n in (120, 121, 122))],
        ),
    ],
)
def test_the_kind_of_slow_lines_is_reported(
    lines: "list[bytes]", kind: str, settings: "list[str]"
) -> None:
    """kind: name of the rate in rates.py that limits these lines: "plain" moves, lines executed by
    the Python interpreter, lines without words, chords of arcs."""
    (stretch, *_) = stretches(lines, settings, "rpi_pico2")
    assert stretch.kind == kind and stretch.needed > stretch.taken


@pytest.mark.parametrize(
    ("line", "before", "kind"),
    [
        (b"X1Y2", b"G1X0F100", "plain"),
        (b"N20 g1 x1 (dot)", b"G1X0F100", "plain"),
        (b"G01X1F100", b"G1X0F100", "plain"),
        (b"X1S5", b"G1X0F100", "power"),
        (b"G0X1", b"G1X0F100", "plain"),
        (b"X1F101", b"G1X0F100", "plain"),
        (b"X1", b"M3", "plain"),
        (b"G0X1S5", b"G0X0", "power"),
        (b"G2X1I5", b"G1X0F100", "in_python_ms"),
        (b"X1R5", b"G2X1R5", "in_python_ms"),
        (b"G91X1", b"G1X0F100", "plain"),
        (b"G93X1F5", b"G1X0F100", "plain"),
        (b"G20G91", b"G1X0F100", "no_words_ms"),
        (b"T2X1", b"G1X0F100", "plain"),
        (b"G90X1M5", b"G1X0F100", "plain"),
        (b"G01G90M05", b"G1X0F100", "no_words_ms"),
        (b"G90M05", b"G1X0F100", "no_words_ms"),
        (b"M9X1", b"M9", "plain"),
        (b"M8X1", b"M9", "in_python_ms"),
        (b"G55X1", b"G1X0F100", "in_python_ms"),
        (b"G92X1", b"G1X0F100", "in_python_ms"),
        (b"S5", b"G1X0F100", "no_words_ms"),
        (b"; nothing", b"G1X0F100", "no_words_ms"),
    ],
)
def test_lines_are_classified_by_their_path_through_the_firmware(
    line: bytes, before: bytes, kind: str
) -> None:
    """kind: name in rates.py of the rate that limits `line`, if `before` precedes it."""
    lines = [b"G1X3F100", before, line]
    assert list(pace._kinds(lines, laser=True))[2] == kind


def test_an_s_without_laser_mode_may_change_the_spindle() -> None:
    assert list(pace._kinds([b"G1X1F9", b"X2S3"], laser=False))[1] == "in_python_ms"


def test_a_serial_line_limits_the_rate_of_bytes() -> None:
    """USB (esp32_s3) is in time, 115200 baud (esp32_devkit) is not."""
    lines = [b"G91F9000", *[b"G1X0.20000000Y0.00000000"] * 600]
    # 5 steps/mm, because these boards allow 5000 steps/s
    settings = ["$100=5", "$101=5", "$102=5", *FAST]
    assert stretches(lines, settings, "esp32_s3") == []
    worst = stretches(lines, settings, "esp32_devkit")[0]
    # bytes per second, bytes of a line with its end
    assert worst.taken == pytest.approx(11520 / 25, rel=0.01)


@pytest.mark.parametrize(
    ("board", "words"),
    [
        ("sim", "a Pico"),
        ("rpi_pico", "a Pico"),
        ("esp32_s3", "an ESP32S3 has not been measured"),
        ("esp32_devkit", "an ESP32 has not"),
    ],
)
def test_the_board_of_the_measured_rates_is_named(board: str, words: str) -> None:
    """An ESP32 has not been measured: the rates are those of a Pico, and the text says so."""
    text = rates.intake(load_board(board)).whose
    assert words in text and text.startswith("a Pico")


# Against a machine that takes this time for each line


def streamed_s(lines: "list[bytes]", answer_us: int) -> float:
    """Return the duration of motion in s if the board needs answer_us for each line."""
    board = ModuleType("board")
    sim = load_board("sim")
    vars(board).update(vars(sim), ANSWER_US=answer_us, LOOP_US=0, PLANNER_BLOCKS=64)
    rig = Rig(board, factory_store(sim))
    sender = Sender(rig)
    sender.allow(3_600_000)
    ticks: list[int] = []

    def script() -> Iterator[Any]:
        """Set up a laser, then stream the lines and note the times of all segments."""
        yield from sender.wait("banner", "")
        for line in LASER:
            yield from sender.wait("ok", line + "\n")
        # start and end of each segment
        rig.engine.trace = lambda start, row: ticks.extend((start, start + row[0]))
        yield from sender.wait("stream", b"".join(line + b"\n" for line in lines).decode())
        yield from sender.wait("idle", "\n")

    rig.link._rx_ticks = rig.link._tx_ticks = 1  # no delay on the wire
    rig.run(script())
    return (ticks[-1] - ticks[0]) / rig.engine.tick_hz


def test_motion_takes_longer_by_about_the_reported_time() -> None:
    lines = raster(FEED, dots=1800)
    reported_s = sum(stretch.lost_s for stretch in stretches(lines, LASER, "rpi_pico2"))
    delay_s = streamed_s(lines, round(1e6 / PICO.power)) - streamed_s(lines, 0)
    assert reported_s > 0.2 and delay_s == pytest.approx(reported_s, rel=0.2)


# Real programs


@pytest.mark.parametrize("name", ["jscut_jsdc.gcode", "inkscape_gcodetools_sun.ngc"])
def test_real_programs_at_common_speeds_are_in_time(name: str) -> None:
    if not (_PROGRAMS / name).exists():
        pytest.skip(f"{_PROGRAMS} is not there")
    settings = [f"${n + axis}={v}" for n, v in ((110, 5000), (120, 500)) for axis in range(3)]
    _, recorder = run_program(read_lines(_PROGRAMS / name), settings=settings, board="rpi_pico")
    assert recorder.starves(read_lines(_PROGRAMS / name)) == []


def test_every_tick_of_motion_belongs_to_a_line() -> None:
    """The recorder counts ticks and blocks per line: their sums are those of the run."""
    _, recorder = run_program(raster(9000), settings=LASER)
    moved = sum(recorder.ticks) / recorder._rig.engine.tick_hz
    assert moved == pytest.approx(recorder.totals().time_s, abs=0.05)
    assert sum(recorder.blocks) >= DOTS  # at least one per dot


# Output of the command


def test_run_reports_where_motion_is_too_fast_and_what_to_do(tmp_path: Path) -> None:
    file, json_file = tmp_path / "raster.nc", tmp_path / "told.json"
    file.write_bytes(b"\n".join(raster(FEED, rows=2)))
    settings = [word for line in LASER for word in ("--set", line)]
    result = ugrbl("run", file, "--board", "rpi_pico2", "--json", json_file, *settings)
    output = " ".join(result.stdout.split())
    assert result.returncode == 0
    assert re.search(r"lines \d+ to \d+ need [23]\d\d\d lines a second, mostly moves", output)
    assert "fewer pixels per mm" in output and "lines in time │ no, for a Pico" in output
    (stretch, *_) = json.loads(json_file.read_text())["too_fast"]
    assert stretch["kind"] == "power" and stretch["lost_s"] > 0.05


def test_run_reports_that_all_lines_are_in_time(tmp_path: Path) -> None:
    file, json_file = tmp_path / "slow.nc", tmp_path / "told.json"
    file.write_bytes(b"G91F600\n" + b"G1X1\n" * 20)
    result = ugrbl("run", file, "--json", json_file)
    assert "lines in time  │ yes, for a Pico" in result.stdout
    assert json.loads(json_file.read_text())["too_fast"] == []


# The rates


def documented_figure(row: str, index: int = 0) -> float:
    """Return a number of the row of docs/speed.md that begins so, in the column with the cache;
    which: 0 for its first number."""
    (line,) = [line for line in SPEED.splitlines() if line.startswith(f"| {row}")]
    return float(re.findall(r"[\d.,]+", line.split("|")[3])[index].rstrip(",").replace(",", ""))


@pytest.mark.parametrize(
    ("figure", "row"),
    [
        (PICO.plain, "the same without `?`"),
        (PICO.power, "a laser's raster"),
        (PICO.chords, "circles of 702 chords"),
    ],
)
def test_rates_match_the_document(figure: float, row: str) -> None:
    assert figure == documented_figure(row)


def test_time_of_a_python_line_is_an_arc_of_two_chords_minus_its_chords() -> None:
    arc_ms = documented_figure("an arc of one chord, and of two", 1)
    # two chords, in ms
    assert PICO.in_python_ms == pytest.approx(arc_ms - 2000 / PICO.chords, abs=0.05)


def test_time_of_a_line_without_words_is_reception_and_assembly() -> None:
    # "received …" and "put together …" in docs/speed.md; the second number is with the cache
    row = r"^\| (received|put)[^|]* \| \d+, (\d+) \|"
    stages_us = [int(us) for _, us in re.findall(row, SPEED, re.MULTILINE)]
    assert len(stages_us) == 2
    assert PICO.no_words_ms == pytest.approx(sum(stages_us) / 1000, rel=0.05)
