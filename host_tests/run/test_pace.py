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
ASKED = 2500  # dots per second, at that feed
DOTS = 800  # per row


def raster(feed: int, rows: int = 1, dots: int = DOTS) -> "list[bytes]":
    """Return a raster: a distance to accelerate, then 0.1 mm per dot, back and forth."""
    lines = [b"G21G90M4S0F%d" % feed]
    for row in range(rows):
        way = range(dots) if row % 2 == 0 else range(dots - 1, -1, -1)
        lines.append(b"G1X%dY%d" % (10 + dots // 10 if row % 2 else 0, row))
        lines += [b"G1X%.1fS%d" % (5 + x / 10, 37 * x % 1000) for x in way]
    return lines


def stretches(lines: "list[bytes]", settings: "list[str]", board: str = "sim") -> "list[Stretch]":
    result, paced = run_program(lines, settings=settings, board=board)
    assert not result.errors and not result.stopped
    return paced.starves(lines)


@pytest.mark.sampled(3)
def test_a_raster_faster_than_the_board_is_reported_with_its_lines() -> None:
    (worst,) = stretches(raster(FEED), LASER, "rpi_pico2")
    assert worst.kind == "power" and worst.taken == pytest.approx(PICO.power, rel=0.01)
    assert worst.needed == pytest.approx(ASKED, rel=0.05)
    assert DOTS >= worst.last > worst.first > 20 and worst.last - worst.first > 300
    assert worst.feed == pytest.approx(100 * PICO.power / ASKED, abs=3)


def test_each_row_of_a_raster_is_reported() -> None:
    found = sorted(stretches(raster(FEED, rows=3), LASER, "rpi_pico2"), key=lambda one: one.first)
    assert [one.first // DOTS for one in found] == [0, 1, 2]


def test_the_recommended_feed_is_in_time() -> None:
    worst = stretches(raster(FEED), LASER, "rpi_pico2")[0]
    assert stretches(raster(FEED * worst.feed // 100), LASER, "rpi_pico2") == []


def test_dwells_and_the_start_of_a_program_are_no_delay() -> None:
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
    modal = [b"G1X3F100", before, line]
    assert list(pace._kinds(modal, laser=True))[2] == kind


def test_an_s_without_laser_mode_may_change_the_spindle() -> None:
    assert list(pace._kinds([b"G1X1F9", b"X2S3"], laser=False))[1] == "in_python_ms"


def test_a_serial_line_limits_the_rate_of_bytes() -> None:
    lines = [b"G91F9000", *[b"G1X0.20000000Y0.00000000"] * 600]
    settings = ["$100=5", "$101=5", "$102=5", *FAST]
    assert stretches(lines, settings, "esp32_s3") == []
    worst = stretches(lines, settings, "esp32_devkit")[0]
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
    said = rates.intake(load_board(board)).whose
    assert words in said and said.startswith("a Pico")


# Against a machine that takes this time for each line


def streamed_s(lines: "list[bytes]", answer_us: int) -> float:
    """Return the duration of motion if each answer takes answer_us."""
    board = ModuleType("board")
    usual = load_board("sim")
    vars(board).update(vars(usual), ANSWER_US=answer_us, LOOP_US=0, PLANNER_BLOCKS=64)
    rig = Rig(board, factory_store(usual))
    sender = Sender(rig)
    sender.allow(3_600_000)
    ticks: list[int] = []

    def script() -> Iterator[Any]:
        yield from sender.wait("banner", "")
        for line in LASER:
            yield from sender.wait("ok", line + "\n")
        rig.engine.trace = lambda start, row: ticks.extend((start, start + row[0]))
        yield from sender.wait("stream", b"".join(line + b"\n" for line in lines).decode())
        yield from sender.wait("idle", "\n")

    rig.link._rx_ticks = rig.link._tx_ticks = 1  # no delay on the wire
    rig.run(script())
    return (ticks[-1] - ticks[0]) / rig.engine.tick_hz


def test_motion_takes_longer_by_about_the_reported_time() -> None:
    lines = raster(FEED, dots=1800)
    told = sum(stretch.lost_s for stretch in stretches(lines, LASER, "rpi_pico2"))
    delay = streamed_s(lines, round(1e6 / PICO.power)) - streamed_s(lines, 0)
    assert told > 0.2 and delay == pytest.approx(told, rel=0.2)


# Real programs


@pytest.mark.parametrize("name", ["jscut_jsdc.gcode", "inkscape_gcodetools_sun.ngc"])
def test_real_programs_at_common_speeds_are_in_time(name: str) -> None:
    if not (_PROGRAMS / name).exists():
        pytest.skip(f"{_PROGRAMS} is not there")
    usual = [f"${n + axis}={v}" for n, v in ((110, 5000), (120, 500)) for axis in range(3)]
    _, paced = run_program(read_lines(_PROGRAMS / name), settings=usual, board="rpi_pico")
    assert paced.starves(read_lines(_PROGRAMS / name)) == []


def test_every_tick_of_motion_belongs_to_a_line() -> None:
    _, paced = run_program(raster(9000), settings=LASER)
    moved = sum(paced.ticks) / paced._rig.engine.tick_hz
    assert moved == pytest.approx(paced.totals().time_s, abs=0.05)
    assert sum(paced.blocks) >= DOTS


# Output of the command


def test_run_reports_where_motion_is_too_fast_and_what_to_do(tmp_path: Path) -> None:
    file, told = tmp_path / "raster.nc", tmp_path / "told.json"
    file.write_bytes(b"\n".join(raster(FEED, rows=2)))
    settings = [word for line in LASER for word in ("--set", line)]
    done = ugrbl("run", file, "--board", "rpi_pico2", "--json", told, *settings)
    words = " ".join(done.stdout.split())
    assert done.returncode == 0
    assert re.search(r"lines \d+ to \d+ need [23]\d\d\d lines a second, mostly moves", words)
    assert "fewer pixels per mm" in words and "lines in time │ no, for a Pico" in words
    (one, *_) = json.loads(told.read_text())["too_fast"]
    assert one["kind"] == "power" and one["lost_s"] > 0.05


def test_run_reports_that_all_lines_are_in_time(tmp_path: Path) -> None:
    file, told = tmp_path / "slow.nc", tmp_path / "told.json"
    file.write_bytes(b"G91F600\n" + b"G1X1\n" * 20)
    done = ugrbl("run", file, "--json", told)
    assert "lines in time  │ yes, for a Pico" in done.stdout
    assert json.loads(told.read_text())["too_fast"] == []


# The rates


def cached(row: str, which: int = 0) -> float:
    """Return a number of docs/speed.md, in the column with the cache, of the row with this
    beginning."""
    (line,) = [line for line in SPEED.splitlines() if line.startswith(f"| {row}")]
    return float(re.findall(r"[\d.,]+", line.split("|")[3])[which].rstrip(",").replace(",", ""))


@pytest.mark.parametrize(
    ("figure", "row"),
    [
        (PICO.plain, "the same without `?`"),
        (PICO.power, "a laser's raster"),
        (PICO.chords, "circles of 702 chords"),
    ],
)
def test_rates_match_the_document(figure: float, row: str) -> None:
    assert figure == cached(row)


def test_time_of_a_python_line_is_an_arc_of_two_chords_minus_its_chords() -> None:
    arc_ms = cached("an arc of one chord, and of two", 1)
    assert PICO.in_python_ms == pytest.approx(arc_ms - 2000 / PICO.chords, abs=0.05)


def test_time_of_a_line_without_words_is_reception_and_assembly() -> None:
    row = r"^\| (received|put)[^|]* \| \d+, (\d+) \|"
    stages = [int(us) for _, us in re.findall(row, SPEED, re.MULTILINE)]
    assert len(stages) == 2
    assert PICO.no_words_ms == pytest.approx(sum(stages) / 1000, rel=0.05)
