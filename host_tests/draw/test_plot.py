"""Test `ugrbl plot`: the figures of the curves, the files, and the page in a real browser."""

import html
import json
import math
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text
from typer.testing import CliRunner, Result
from ugrbl.boardfile.files import boards
from ugrbl.cli.app import app
from ugrbl.draw import drawing, image, motion_trace
from ugrbl.draw.job import run_job, short
from ugrbl.draw.motion_trace import Motion, trace_program
from ugrbl.grbl.lines import split_lines

# Drawing is slow: the first ring runs a few.
pytestmark = pytest.mark.thorough

_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
_SQUARE = "G90 G21\nG1 X10 F600\nY10\nX0\nY0\nG0 Z2\nG4 P1\nG2 X5 Y5 R5\n"
needs_plotly = pytest.mark.skipif(find_spec("plotly") is None, reason="plotly is not installed")


def trace(text: str, *settings: str, board: str = "sim") -> Motion:
    """Run a program and return its motion, sampled over time."""
    return trace_program(split_lines(text.encode()), settings=settings, board=board)[1].motion


def ugrbl(*words: object) -> Result:
    return CliRunner().invoke(app, ["plot", *map(str, words)])


@pytest.fixture
def program(tmp_path: Path) -> Path:
    """Return the file of a program of 8 lines: a square, a rise, a dwell and an arc."""
    file = tmp_path / "square.nc"
    file.write_text(_SQUARE)
    return file


# The curves


def test_speed_and_acceleration_are_those_of_the_trapezoid() -> None:
    # 600 mm/min = 10 mm/s; speeding up and braking at 10 mm/s2.
    motion = trace("G1 X20 F600\n", "$110=1000")
    assert max(motion.speed_mm_s) == pytest.approx(10, rel=0.001)
    # 1 s of acceleration, 1 s of cruise, 1 s of braking
    ramp = [a for a, t in zip(motion.acceleration(0), motion.time_s) if 0.1 < t < 0.9]
    assert sum(ramp) / len(ramp) == pytest.approx(10, rel=0.01)
    cruise = [a for a, t in zip(motion.acceleration(0), motion.time_s) if 1.1 < t < 1.9]
    assert max(cruise) == 0
    assert motion.time_s[-1] == pytest.approx(3, rel=0.01)


def test_acceleration_drawn_is_less_than_34_percent_above_its_limit() -> None:
    """It is computed from steps in segments, so it is not exact; limits in mm/s2 per axis."""
    motion = trace_program(lettering(), settings=["$122=40"])[1].motion
    for axis, limit in enumerate((10, 10, 40)):
        assert limit <= max(motion.acceleration(axis)) < 1.34 * limit


def test_step_rates_are_per_axis_and_use_its_resolution() -> None:
    motion = trace(
        "G1 X30 Y40 F600\n", "$110=1000", "$111=1000", "$101=100", "$120=100", "$121=100"
    )
    # 10 mm/s along 30, 40: 6 and 8 mm/s; 250 and 100 steps/mm
    assert max(motion.step_hz(0)) == pytest.approx(6 * 250, rel=0.002)
    assert max(motion.step_hz(1)) == pytest.approx(8 * 100, rel=0.002)
    assert max(motion.step_hz(2)) == 0


def test_motors_of_a_corexy_step_for_both_axes() -> None:
    motion = trace("G1 X10 Y10 F300\n", "$120=100", "$121=100", board="sim_corexy")
    assert max(motion.step_hz(0)) > 1000
    assert max(motion.step_hz(1)) == 0  # along X = Y motor B, x - y, stands still
    assert max(motion.acceleration(0)) == pytest.approx(max(motion.acceleration(1)))


def test_dwell_is_drawn_as_rest() -> None:
    motion = trace("G1 X1 F300\nG4 P2\nG1 X2\n", "$120=100")
    pauses_s = [dt for dt, v in zip(motion.seconds, motion.speed_mm_s) if v == 0]
    assert max(pauses_s) == pytest.approx(2, abs=0.1)
    assert sum(motion.seconds) == pytest.approx(motion.time_s[-1], rel=1e-6)


def test_path_ends_where_the_program_ends() -> None:
    motion = trace(_SQUARE)
    assert [column[-1] for column in motion.place] == pytest.approx([5, 5, 2])


def test_envelope_keeps_the_peaks() -> None:
    """envelope() thins out a curve to at most 500 points, in order, and keeps its extremes."""
    values = np.zeros(10_001)
    values[7777], values[1234], values[10_000] = 9.0, -4.0, 11.0
    times, kept = drawing.envelope(np.arange(10_001.0), values, 500)
    assert len(kept) <= 500 and max(kept) == 11 and min(kept) == -4 and 9 in kept
    assert list(times) == sorted(times)


def test_each_segment_has_its_line_and_whether_it_is_a_rapid() -> None:
    motion = trace("G0 X1\n(nothing)\nG1 X2 F300\nG4 P1\nG2 X4 Y0 R1\nG0 Z1\n")
    is_rapid = {line: bool(rapid) for line, rapid in zip(motion.lines, motion.rapids) if line}
    assert is_rapid == {1: True, 3: False, 5: False, 6: True}
    assert 0 in motion.lines  # at rest


def test_power_of_the_tool_is_recorded() -> None:
    """As a fraction of full power, at $30 = 1000."""
    motion = trace("M3 S500\nG1 X2 F300\nM5\nG0 X4\n")
    cut, rapid = motion.lines == 2, motion.lines == 4
    power = np.array(motion.power)
    assert power[cut] == pytest.approx(0.5, abs=0.01) and not power[rapid].any()


# The drawing


def lettering() -> list[bytes]:
    """Return lines that cut 40 circles of 1 mm radius, with rapids between them; each is 4 mm from
    the next in X, 5 mm in Y. The first one's centre is X-1 Y0."""
    lines = ["G21 G90", "M3 S1000"]
    for number in range(40):
        x, y = 4 * (number % 8), 5 * (number // 8)
        lines += ["G0 Z1", f"G0 X{x} Y{y}", "G1 Z-1 F900"]
        angles = [n * math.pi / 20 for n in range(41)]
        lines += [f"G1 X{x + math.cos(a) - 1:.4f} Y{y + math.sin(a):.4f} F900" for a in angles]
    return [line.encode() for line in lines]


# A path's sides in mm: equal, flat, long in one direction, and along one axis only.
_SHAPES = [(10, 10, 10), (27, 82, 16), (200, 10, 1), (7, 35, 0), (0, 0, 10), (1990, 1500, 3)]
_FAST = ["$110=5000", "$111=5000", "$112=3000", "$120=500", "$121=500", "$122=500"]


def largest_distance(points: Any, rows: Any) -> float:
    """Return the largest distance of the points from the drawn polyline, whose corners are these
    rows."""
    farthest = 0.0
    for begin, end in pairwise(rows):
        stretch = points[begin : end + 1].astype(float)
        chord = stretch[-1] - stretch[0]
        share = np.clip((stretch - stretch[0]) @ chord / ((chord @ chord) or 1.0), 0, 1)
        offsets = stretch - stretch[0] - share[:, None] * chord
        farthest = max(farthest, float(np.sqrt((offsets**2).sum(axis=1)).max()))
    return farthest


def test_longer_segments_of_a_long_job_change_neither_path_nor_time(monkeypatch: Any) -> None:
    """Jobs of more than _MANY_LINES lines are traced in longer segments: fine is traced without,
    coarse with them."""
    lines = lettering()
    fine = run_job("", lines, ["$120=50", "$121=50"])
    monkeypatch.setattr(motion_trace, "_MANY_LINES", 100)
    coarse = run_job("", lines, ["$120=50", "$121=50"])
    assert len(coarse.motion) < 0.6 * len(fine.motion)
    assert coarse.seconds == pytest.approx(fine.seconds, rel=1e-4)
    for totals in (job.result.totals for job in (fine, coarse)):
        assert totals.steps_made == totals.steps_planned == fine.result.totals.steps_planned
    # Every point of the fine path lies on the coarse one, in the same line of the program.
    for line in range(1, len(lines) + 1, 7):
        of_fine, of_coarse = (np.flatnonzero(job.motion.lines == line) for job in (fine, coarse))
        if len(of_fine):
            path = coarse.motion.points[of_coarse[0] - 1 : of_coarse[-1] + 1]
            points = fine.motion.points[of_fine]
            assert max(distance_to_path(point, path) for point in points) < 0.01


def distance_to_path(point: Any, path: Any) -> float:
    """Return the distance of a point from a polyline."""
    nearest = math.inf
    for begin, end in pairwise(path.astype(float)):
        side = end - begin
        share = np.clip((point - begin) @ side / ((side @ side) or 1.0), 0, 1)
        nearest = min(nearest, float(np.linalg.norm(point - begin - share * side)))
    return nearest


@pytest.mark.parametrize("most", [600_000, 900])
def test_drawing_is_within_its_stated_tolerance_of_the_path(most: int) -> None:
    """most: points allowed; with 900 the tolerance must be widened, and the drawing states it."""
    job = run_job("", lettering(), _FAST)
    drawn = drawing.draw(job, most)
    assert (drawn.tolerance_mm > drawing.TOLERANCE_MM) == (most == 900)
    rows = np.searchsorted(job.motion.time_s, drawn.time_s)
    assert largest_distance(job.motion.points, rows) <= drawn.tolerance_mm * 1.001
    assert len(rows) < len(job.motion) / 2


def test_drawn_cuts_are_cuts_and_drawn_rapids_are_rapids() -> None:
    """strokes(False): start and end of each cut; strokes(True): of each rapid."""
    job = run_job("", lettering(), _FAST)
    drawn = drawing.draw(job, 600_000)
    cuts, rapids = drawn.strokes(False), drawn.strokes(True)
    # Only circles of 1 mm are cut, and the moves down to them.
    middles = (cuts[:, 0] + cuts[:, 1]) / 2
    # circles are 4 mm apart in X, 5 in Y: middles relative to the nearest one
    x, y = (middles[:, 0] + 1) % 4, middles[:, 1] % 5
    radius = np.hypot(np.where(x > 2, x - 4, x), np.where(y > 2.5, y - 5, y))
    assert abs(radius - 1).max() < drawn.tolerance_mm + 0.01
    assert (rapids[:, :, 2].min(), rapids[:, :, 2].max()) == pytest.approx((-1, 1))
    assert len(cuts) + len(rapids) == len(drawn.points) - 1


@pytest.mark.thorough
def test_long_job_takes_little_time_and_memory(tmp_path: Path) -> None:
    file, out = tmp_path / "long.nc", tmp_path / "long.html"
    file.write_bytes(b"\n".join(lettering() * 12) + b"\n")  # 21,000 lines
    # ru_maxrss of a process includes the memory of its parent before the start.
    code = (  # VmHWM: the most memory used, in kB
        "import re, sys; from ugrbl.cli.app import app;"
        "app(sys.argv[1:], standalone_mode=False);"
        "print(re.search(r'VmHWM:\\s+(\\d+)', open('/proc/self/status').read())[1])"
    )
    words = [sys.executable, "-c", code, "plot", str(file), "-o", str(out)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=True)
    # 200,000 lines must fit in 500 MB; the part that does not grow with the job is 100.
    assert int(done.stdout.split()[-1]) / 1024 < 140
    assert out.stat().st_size < 8_000_000


def drawn_texts(figure: Any, monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, Any]]:
    """Return every text of a picture with its box in dots, which is known after drawing."""
    drawn = []

    def noted(text: Any, renderer: Any) -> None:
        draw(text, renderer)
        box = text.get_window_extent(renderer)
        if text.get_visible() and box.width > 1:
            drawn.append((text.get_text(), box))

    draw = Text.draw
    FigureCanvasAgg(figure).draw()  # places all
    monkeypatch.setattr(Text, "draw", noted)
    figure.canvas.draw()
    return drawn


@pytest.mark.sampled(1, 4)
@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("x, y, z", _SHAPES)
def test_texts_of_a_picture_are_complete_and_do_not_overlap(
    x: float, y: float, z: float, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A picture of paths of any shape, x by y by z mm; count: jobs compared in it."""
    corners = ((0, 0, -z), (x, 0, -z), (x, y, 0), (0, y, 0), (0, 0, 0))
    lines = [b"G1F5000X%.3fY%.3fZ%.3f" % corner for corner in corners]
    job = run_job("as it is", lines, [*_FAST, "$130=2000"])
    figure = image.draw([job] * count, "a.nc", "")
    texts = drawn_texts(figure, monkeypatch)
    assert len(texts) > 40 * count
    for text, box in texts:
        assert box.x0 >= 0 and box.y0 >= 0, text
        assert box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1, text
    on_others = [
        (a, b) for (a, box_a), (b, box_b) in combinations(texts, 2) if box_a.overlaps(box_b)
    ]
    assert not on_others


# Messages


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.25, "0.25 s"), (42.04, "42.0 s"), (200, "3 min 20 s"), (7500, "2 h 5 min")],
)
def test_times_are_written_in_common_units(seconds: float, words: str) -> None:
    assert short(seconds) == words


def test_what_if_reports_the_time_saved(program: Path) -> None:
    """--set: the program is run twice, with and without these settings."""
    out = program.with_name("out.svg")
    done = ugrbl(program, "-o", out, "--set", "120=200", "--set", "$121=200")
    assert done.exit_code == 0, done.output
    output = " ".join(done.output.split())
    assert "Acceleration X 200 mm/sec^2, Acceleration Y 200 mm/sec^2:" in output
    assert re.search(r"[\d.]+ s instead of [\d.]+ s: [\d.]+ s saved \(\d+ %\)", output)


def test_slower_machine_is_reported(program: Path) -> None:
    done = ugrbl(program, "-o", program.with_name("out.png"), "--set", "110=100")
    assert re.search(r"s more\s+\(\d+ %\)", done.output)


# The files


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("suffix", "start"),
    [
        (".png", b"\x89PNG"),
        (".svg", b"<?xml"),
        pytest.param(".html", b"<!DOCTYPE html>", marks=needs_plotly),
    ],
)
def test_each_format_has_its_file_signature(program: Path, suffix: str, start: bytes) -> None:
    out = program.with_name("out" + suffix)
    done = ugrbl(program, "-o", out)
    assert done.exit_code == 0, done.output
    assert out.read_bytes().startswith(start)


def test_figures_are_written_as_json(program: Path) -> None:
    done = ugrbl(program, "-o", program.with_name("out.png"), "--set", "110=1000", "--json", "-")
    figures = json.loads(done.stdout)
    assert [job["lines"] for job in figures["jobs"]] == [8, 8]
    # The first job is without --set: $110 is 500 mm/min; 250 steps/mm.
    assert figures["jobs"][0]["fastest_step_hz"]["X"] == pytest.approx(500 / 60 * 250, rel=0.01)
    assert "instead of" in figures["verdict"]


def test_pulled_settings_file_describes_the_machine(program: Path) -> None:
    settings = program.with_name("my.settings")
    # Switches and homing are ignored: a simulated job starts at once.
    settings.write_text("; [VER:1.1h.20190830:]\n$20=1\n$21=1\n$22=1\n$110=1000\n$120=100\n")
    out, json_file = program.with_name("out.png"), program.with_name("out.json")
    done = ugrbl(program, "-o", out, "--settings", settings, "--json", json_file)
    assert done.exit_code == 0, done.output
    job = json.loads(json_file.read_text())["jobs"][0]
    assert job["name"] == "my.settings"
    assert job["fastest_step_hz"]["X"] == pytest.approx(2500, rel=0.01)  # 600 mm/min, 250 steps/mm


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--set", "fast"], "write it as 120=500"),
        (["--set", "0=1"], "was refused with error:6"),
        (["-o", "out.pdf"], ".html, .png, .svg"),
        (["-o", "square.nc"], ".html, .png, .svg"),
        (["-o", "FOLDER"], "is a folder"),
        (["-o", "FILE/out.png"], "square.nc is no folder"),
        (["--json", "FOLDER"], "is a folder"),
        (["--json", "FILE"], "it is not overwritten"),
        (["--board", "nowhere.py"], "there is no file nowhere.py"),
    ],
)
def test_impossible_drawing_is_refused_with_the_reason(
    program: Path, words: list[str], why: str
) -> None:
    """why: part of the message, compared without spaces. FOLDER and FILE stand for existing
    ones."""
    folder = program.with_name("folder.png")
    folder.mkdir()
    words = [w.replace("FOLDER", str(folder)).replace("FILE", str(program)) for w in words]
    before = program.read_bytes()
    done = ugrbl(program, "-o", program.with_name("out.png"), *words)
    assert done.exit_code == 1 and isinstance(done.exception, SystemExit)
    assert "".join(why.split()) in "".join(done.output.split())
    # "lines" would be in the result
    assert "--set" in words or "--board" in words or "lines" not in done.output, "before the work"
    assert program.read_bytes() == before


@needs_plotly
def test_foreign_page_is_replaced_only_when_named(
    program: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(program.parent)
    page = program.with_suffix(".html")
    page.write_text("<!DOCTYPE html>\n<title>of the CAM</title>\n")
    done = ugrbl(program)
    assert done.exit_code == 1 and "not drawn by plot: -o square.html replaces it" in " ".join(
        done.output.split()
    )
    assert "of the CAM" in page.read_text() and "Drawing" not in done.output
    for words in ["-o", page], []:  # then it is plot's own page
        assert ugrbl(program, *words).exit_code == 0
        assert "of the CAM" not in page.read_text()


def test_refused_line_is_a_failure_and_the_rest_is_drawn(program: Path) -> None:
    program.write_text("G0 X1\nG64\nG0 X2\n")
    out = program.with_name("out.png")
    done = ugrbl(program, "-o", out)
    assert done.exit_code == 1 and "line 2" in done.output
    assert out.stat().st_size > 10_000


@pytest.mark.parametrize("data", [b"", b"\n \n", b"\x89PNG\r\n\x1a\n\0\0"])
def test_file_that_is_not_a_program_is_not_drawn(program: Path, data: bytes) -> None:
    program.write_bytes(data)
    done = ugrbl(program, "-o", program.with_name("out.png"))
    assert done.exit_code == 1 and isinstance(done.exception, SystemExit)
    assert program.name in done.output


def test_program_without_motion_is_drawn(program: Path) -> None:
    program.write_text("G21\n")
    for suffix in (".png", ".html"):
        assert ugrbl(program, "-o", program.with_name("out" + suffix)).exit_code == 0


@pytest.mark.sampled(1, 5)
@pytest.mark.parametrize("name", boards())
def test_jobs_can_be_drawn_for_every_board(name: str, program: Path) -> None:
    done = ugrbl(program, "-o", program.with_name("out.svg"), "--board", name)
    assert done.exit_code == 0, done.output


def test_program_that_ends_in_an_alarm_is_not_drawn(program: Path) -> None:
    program.write_text("G38.2 Z-5 F100\n")
    done = ugrbl(program, "-o", program.with_name("out.png"))
    assert done.exit_code == 1 and "could not finish: ALARM:5" in done.output


# The page in a browser

_PROBE = """<script>
const until = setInterval(async () => {
  if (!document.body.dataset.drawn) return;
  clearInterval(until);
  document.querySelector('button[data-up="1"]').click();
  const by = (id) => document.getElementById(id);
  const spot = (name) => by(name).data.find((one) => one.hoverinfo === "skip");
  const told = () => by("told").textContent;
  by("moment").value = 1e9;
  by("moment").oninput();
  await new Promise((done) => setTimeout(done, 1500));
  const last = told();
  const cuts = by("space").data[0];
  const pointNumber = cuts.rows.findLastIndex((row) => row >= 0);
  by("space").emit("plotly_hover", { points: [{ data: cuts, pointNumber }] });
  await new Promise((done) => setTimeout(done, 1500));
  const seen = {
    traces: ["space", "flat", "time"].map((name) => by(name).data.map((one) => one.name)),
    points: cuts.x.length,
    up: by("space").layout.scene2.camera.up.y,
    canvases: by("space").querySelectorAll("canvas").length,
    lines: by("time").querySelectorAll(".scatterlayer .js-line").length,
    requests: performance.getEntriesByType("resource").map((entry) => entry.name),
    words: by("words").textContent,
    tables: by("jobs").textContent,
    last, hovered: told(), spot: [...spot("space").x, ...spot("flat").y],
    cursor: by("time").layout.shapes[0].x0, moment: Number(by("moment").value),
  };
  document.body.dataset.seen = JSON.stringify(seen);
}, 50);
</script>"""


def open_in_browser(page: Path) -> Any:
    """Open the page with the script _PROBE in a browser without a window; return what it found, or
    skip if there is no browser."""
    browser = next(filter(None, map(shutil.which, _BROWSERS)), None)
    if browser is None:
        pytest.skip(f"no browser here: none of {', '.join(_BROWSERS)}")
    page.write_text(page.read_text() + _PROBE)
    command = [browser, "--headless", "--no-sandbox", "--enable-unsafe-swiftshader"]
    command += ["--virtual-time-budget=60000", f"--user-data-dir={page.parent / 'profile'}"]
    process = subprocess.run(
        [*command, "--dump-dom", page.as_uri()],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    found = re.search(r'data-seen="([^"]*)"', process.stdout)
    assert found, process.stderr[-2000:] + process.stdout[-500:]
    return json.loads(html.unescape(found[1]))


@needs_plotly
def test_page_draws_itself_in_a_browser_without_a_network(program: Path) -> None:
    """The page compares two machines. What is checked: the curves, a button, no requests, the
    texts, the slider."""
    page = program.with_name("page.html")
    done = ugrbl(program, "-o", page, "--set", "120=200")
    assert done.exit_code == 0, done.output
    assert page.stat().st_size < 3_000_000
    results = open_in_browser(page)
    # traces: names of the curves in the drawings space, flat and time
    assert results["traces"][0][:2] == ["cuts", "rapids"] and len(results["traces"][2]) == 16
    assert "rapids" in results["traces"][1]
    assert results["points"] > 30 and results["canvases"] > 0
    assert results["lines"] == 16
    assert results["up"] == 1  # the button turned it
    assert not [name for name in results["requests"] if not name.startswith(("file:", "blob:"))]
    assert "saved" in results["words"]
    assert "X0.000 to 10.000 mm: 10.000 of 200 ($130)" in results["tables"]
    assert "at most 0.01 mm off the path" in results["tables"]
    # The slider ends where the program ends, and a point under the cursor is shown with its line.
    assert "X 5.000   Y 5.000   Z 2.000" in results["last"]
    assert "line 8: G2 X5 Y5 R5" in results["hovered"]
    assert results["spot"] == pytest.approx([5, 5], abs=0.2)
    assert results["cursor"] == pytest.approx(results["moment"]) and results["moment"] > 1
