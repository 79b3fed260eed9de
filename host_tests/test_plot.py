"""`ugrbl plot`: the curves' numbers, the files, and the page in a real browser."""

import json
import re
import shutil
import subprocess
from importlib.util import find_spec
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result
from ugrbl import plot
from ugrbl.cli import app
from ugrbl.gcode_file import split_lines
from ugrbl.motion_trace import Motion, trace_program

_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
_SQUARE = "G90 G21\nG1 X10 F600\nY10\nX0\nY0\nG0 Z2\nG4 P1\nG2 X5 Y5 R5\n"
needs_plotly = pytest.mark.skipif(find_spec("plotly") is None, reason="plotly is not installed")


def trace(text: str, *settings: str, board: str = "sim") -> Motion:
    return trace_program(split_lines(text.encode()), settings=settings, board=board)[1]


def ugrbl(*words: object) -> Result:
    return CliRunner().invoke(app, ["plot", *map(str, words)])


@pytest.fixture
def program(tmp_path: Path) -> Path:
    file = tmp_path / "square.nc"
    file.write_text(_SQUARE)
    return file


# The curves


def test_speed_and_acceleration_are_those_of_the_trapezoid() -> None:
    # 600 mm/min = 10 mm/s, reached and lost at 10 mm/s2.
    motion = trace("G1 X20 F600\n", "$110=1000")
    assert max(motion.speed_mm_s) == pytest.approx(10, rel=0.001)
    ramp = [a for a, t in zip(motion.acceleration[0], motion.time_s) if 0.1 < t < 0.9]
    assert sum(ramp) / len(ramp) == pytest.approx(10, rel=0.01)
    cruise = [a for a, t in zip(motion.acceleration[0], motion.time_s) if 1.1 < t < 1.9]
    assert max(cruise) == 0
    assert motion.time_s[-1] == pytest.approx(3, rel=0.01)


def test_step_rates_are_per_axis_and_by_its_resolution() -> None:
    motion = trace(
        "G1 X30 Y40 F600\n", "$110=1000", "$111=1000", "$101=100", "$120=100", "$121=100"
    )
    assert max(motion.step_hz[0]) == pytest.approx(6 * 250, rel=0.002)
    assert max(motion.step_hz[1]) == pytest.approx(8 * 100, rel=0.002)
    assert max(motion.step_hz[2]) == 0


def test_motors_of_a_corexy_step_for_both_axes() -> None:
    motion = trace("G1 X10 Y10 F300\n", "$120=100", "$121=100", board="sim_corexy")
    assert max(motion.step_hz[0]) > 1000
    assert max(motion.step_hz[1]) == 0
    assert max(motion.acceleration[0]) == pytest.approx(max(motion.acceleration[1]))


def test_a_dwell_is_rest() -> None:
    motion = trace("G1 X1 F300\nG4 P2\nG1 X2\n", "$120=100")
    rest = [dt for dt, v in zip(motion.seconds, motion.speed_mm_s) if v == 0]
    assert max(rest) == pytest.approx(2, abs=0.1)
    assert sum(motion.seconds) == pytest.approx(motion.time_s[-1], rel=1e-6)


def test_the_path_ends_where_the_program_does() -> None:
    motion = trace(_SQUARE)
    assert [column[-1] for column in motion.place] == pytest.approx([5, 5, 2])


def test_an_envelope_keeps_the_peaks() -> None:
    values = [0.0] * 10_000
    values[7777], values[1234] = 9.0, -4.0
    times, kept = plot.envelope([float(n) for n in range(10_000)], values, 500)
    assert len(kept) <= 500 and max(kept) == 9 and min(kept) == -4
    assert times == sorted(times)


# The words


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.25, "0.25 s"), (42.04, "42.0 s"), (200, "3 min 20 s"), (7500, "2 h 5 min")],
)
def test_times_are_said_as_people_do(seconds: float, words: str) -> None:
    assert plot.short(seconds) == words


def test_what_if_tells_the_time_saved(program: Path) -> None:
    out = program.with_name("out.svg")
    done = ugrbl(program, "-o", out, "--set", "120=200", "--set", "$121=200")
    assert done.exit_code == 0, done.output
    words = " ".join(done.output.split())
    assert "Acceleration X 200 mm/sec^2, Acceleration Y 200 mm/sec^2:" in words
    assert re.search(r"[\d.]+ s instead of [\d.]+ s: [\d.]+ s saved \(\d+ %\)", words)


def test_a_slower_machine_is_told_as_well(program: Path) -> None:
    done = ugrbl(program, "-o", program.with_name("out.png"), "--set", "110=100")
    assert re.search(r"s more\s+\(\d+ %\)", done.output)


# The files


@pytest.mark.parametrize(
    ("suffix", "start"),
    [
        (".png", b"\x89PNG"),
        (".svg", b"<?xml"),
        pytest.param(".html", b"<!DOCTYPE html>", marks=needs_plotly),
    ],
)
def test_each_format_is_what_it_says(program: Path, suffix: str, start: bytes) -> None:
    out = program.with_name("out" + suffix)
    done = ugrbl(program, "-o", out)
    assert done.exit_code == 0, done.output
    assert out.read_bytes().startswith(start)


def test_the_figures_as_json(program: Path) -> None:
    done = ugrbl(program, "-o", program.with_name("out.png"), "--set", "110=1000", "--json", "-")
    found = json.loads(done.stdout)
    assert [job["lines"] for job in found["jobs"]] == [8, 8]
    assert found["jobs"][0]["fastest_step_hz"]["X"] == pytest.approx(500 / 60 * 250, rel=0.01)
    assert "instead of" in found["verdict"]


def test_a_pulled_settings_file_is_the_machine_as_it_is(program: Path) -> None:
    settings = program.with_name("my.settings")
    # Switches and homing are left out: a job on paper begins at once.
    settings.write_text("; [VER:1.1h.20190830:]\n$20=1\n$21=1\n$22=1\n$110=1000\n$120=100\n")
    out, json_file = program.with_name("out.png"), program.with_name("out.json")
    done = ugrbl(program, "-o", out, "--settings", settings, "--json", json_file)
    assert done.exit_code == 0, done.output
    job = json.loads(json_file.read_text())["jobs"][0]
    assert job["name"] == "my.settings"
    assert job["fastest_step_hz"]["X"] == pytest.approx(2500, rel=0.01)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--set", "fast"], "write it as 120=500"),
        (["--set", "0=1"], "was refused with error:6"),
        (["-o", "out.pdf"], ".html, .png, .svg"),
    ],
)
def test_what_cannot_be_drawn_says_why(program: Path, words: list[str], why: str) -> None:
    done = ugrbl(program, "-o", program.with_name("out.png"), *words)
    assert done.exit_code == 1
    assert why in " ".join(done.output.split())


def test_a_program_that_ends_in_an_alarm_is_not_drawn(program: Path) -> None:
    program.write_text("G38.2 Z-5 F100\n")
    done = ugrbl(program, "-o", program.with_name("out.png"))
    assert done.exit_code == 1 and "could not finish: ALARM:5" in done.output


# The page in a browser

_PROBE = """<script>
const until = setInterval(() => {
  if (!document.body.dataset.drawn) return;
  clearInterval(until);
  document.querySelector('button[data-up="1"]').click();
  setTimeout(() => {
    const space = document.getElementById("space");
    const time = document.getElementById("time");
    const seen = {
      traces: [...document.querySelectorAll("#space, #flat, #time")].map((d) => d.data.length),
      points: space.data[0].x.length,
      up: space.layout.scene2.camera.up.y,
      canvases: space.querySelectorAll("canvas").length,
      lines: time.querySelectorAll(".scatterlayer .js-line").length,
      requests: performance.getEntriesByType("resource").map((entry) => entry.name),
      words: document.getElementById("words").textContent,
    };
    document.body.dataset.seen = JSON.stringify(seen);
  }, 1000);
}, 50);
</script>"""


@needs_plotly
def test_the_page_draws_itself_in_a_browser_without_a_network(program: Path) -> None:
    browser = next(filter(None, map(shutil.which, _BROWSERS)), None)
    if browser is None:
        pytest.skip(f"no browser here: none of {', '.join(_BROWSERS)}")
    page = program.with_name("page.html")
    done = ugrbl(program, "-o", page, "--set", "120=200")
    assert done.exit_code == 0, done.output
    assert page.stat().st_size < 3_000_000
    page.write_text(page.read_text() + _PROBE)
    words = [browser, "--headless", "--no-sandbox", "--enable-unsafe-swiftshader"]
    words += ["--virtual-time-budget=60000", f"--user-data-dir={program.parent / 'profile'}"]
    shown = subprocess.run(
        [*words, "--dump-dom", page.as_uri()],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    found = re.search(r'data-seen="([^"]*)"', shown.stdout)
    assert found, shown.stderr[-2000:] + shown.stdout[-500:]
    seen = json.loads(found[1].replace("&quot;", '"'))
    assert seen["traces"][0] == 2 and seen["traces"][2] == 14
    assert seen["points"] > 100 and seen["canvases"] > 0
    assert seen["lines"] == 14
    assert seen["up"] == 1  # the button turned it
    assert not [name for name in seen["requests"] if not name.startswith(("file:", "blob:"))]
    assert "saved" in seen["words"]
