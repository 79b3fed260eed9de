"""A user's day with real senders, each in its own process, at the terminal of `ugrbl sim`.

Each sender meets a locked machine, recognises Grbl 1.1, reads its settings, homes it, jogs, sets
an offset, streams a program, overrides the feed, holds and resumes in the middle, and ends at the
right position, without reading a line that it could not parse. The same is tested with a machine
with a rotary axis, which has more numbers in every answer.
"""

import json
import math
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import serial
from install import NotInstalled, cncjs, python
from sim_bench import SETTINGS, STEPS_PER_MM, SWITCH_STEPS, Bench, free_port

_HERE = Path(__file__).resolve().parent
_PATIENCE_S = 240
_STEPS_PER_DEGREE = 100
_TURNED = -45  # degrees, at the end


def spiral(turning: bool) -> list[str]:
    """Return lines of some seconds: short moves, an arc and a dwell, in work coordinates, ending
    at X-5 Y-7 Z-1. turning: A moves with them, and ends at A-45."""
    points = [
        (-0.4 * n * math.cos(n / 2) - 2, -0.4 * n * math.sin(n / 2) - 2) for n in range(1, 25)
    ]
    angles = [f" A{n / 2}" if turning else "" for n in range(len(points))]
    lines = [f"G1 X{x:.3f} Y{y:.3f}{a} F1200" for (x, y), a in zip(points, angles, strict=True)]
    if turning:
        lines += [f"G0 A{_TURNED}"]
    ending = ["G2 X-5 Y-7 R20 F1200", "G4 P0.1", "G0 X-5 Y-7", "G1 Z-1 F600"]
    return ["G21 G90 G94", "G17 G54", "G0 X0 Y0", *lines, *ending]


PLAN: dict[str, Any] = {
    "homed": [-1.0, -1.0, -1.0],
    "jog": "$J=G91 G21 X-10 Y-20 F3000",
    "jogged": [-11.0, -21.0, -1.0],
    "zero": "G10 L20 P1 X0 Y0 Z0",
    "ended": [-16.0, -28.0, -2.0],
}


# Senders that are in no registry, by the variable that names the folder of each, built there by
# the sender's own tools.
SERVERS = {
    "UGRBL_GSENDER": "drive_gsender.js",
    "UGRBL_OPENBUILDS_CONTROL": "drive_openbuilds.js",
    "UGRBL_LW_COMM_SERVER": "drive_lw_comm_server.js",
}


@pytest.fixture(params=["sim", "sim_rotary"])
def board(request: pytest.FixtureRequest) -> str:
    """Return the board of the simulator: with three axes, or with a rotary A."""
    return str(request.param)


@pytest.fixture
def bench(tmp_path: Path, board: str) -> Iterator[Bench]:
    running = Bench(tmp_path, "--board", board, settings=SETTINGS)
    yield running
    running.kill()


@pytest.fixture
def network(tmp_path: Path) -> Iterator[Bench]:
    """A machine that senders reach over TCP, through the link of a board with Wi-Fi."""
    running = Bench(tmp_path, "--board", "sim_wifi", settings=SETTINGS, network=True)
    yield running
    running.kill()


def available(install: Any) -> Path:
    """Return a sender's path; skip the test with the reason if it is not available."""
    try:
        return Path(install())
    except NotInstalled as error:
        pytest.skip(str(error))


def run_day(bench: Bench, board: str, *command: object, moving: bool = False) -> Any:
    """Run a sender through its day; return its record. command: of its driver; PLAN and RESULT
    stand for the files that it reads and writes. moving: another sender has started motion before.
    """
    folder = bench.port.parent
    plan, result = folder / "plan.json", folder / "result.json"
    program = spiral(turning=board == "sim_rotary")
    run_values = {"program": program, "port": bench.url, "moving": moving}
    plan.write_text(json.dumps({**PLAN, **run_values}))
    words = [str({"PLAN": plan, "RESULT": result}.get(str(word), word)) for word in command]
    process = subprocess.run(
        words, capture_output=True, text=True, timeout=_PATIENCE_S, cwd=folder, check=False
    )
    assert result.exists(), process.stdout[-2000:] + process.stderr[-4000:]
    record = json.loads(result.read_text())
    assert record.get("failed") is None, (record, process.stderr[-2000:])
    return record


def start_motion(bench: Bench) -> None:
    """Start a move of some seconds, and disconnect."""
    with serial.serial_for_url(bench.url, timeout=10) as port:
        port.read_until(b"]\r\n")
        for line in (b"$X\n", b"G1 X-40 F120\n"):
            port.write(line)
            assert port.read_until(b"ok\r\n").endswith(b"ok\r\n")


def check_record(record: Any, bench: Bench, board: str) -> None:
    """Check what holds for every sender's day, by its own record and by the machine's: no unparsed
    line, no error, the settings, the positions, a hold that was resumed."""
    assert record["unparsed"] == []
    assert [text for text in record["errors"] if "error" in text or "ALARM" in text] == []
    assert float(record["settings"]["110"]) == SETTINGS[110]
    assert len(record["settings"]) == (38 if board == "sim_rotary" else 34)  # four more for A
    assert record["homed"] == PLAN["homed"]
    assert record["zeroed"] == [0, 0, 0]
    assert record["held"] != PLAN["ended"]
    assert record["mpos"] == PLAN["ended"]
    assert record["wpos"] == [-5, -7, -1]
    sent = bench.wire(">")
    assert sent.index(b"!") < sent.rindex(b"~")
    # In motor steps. The switch closes at machine position 0. Homing approaches it at $24 mm/min,
    # and a busy computer may poll it 0.1 s late.
    tolerance = 0.1 * SETTINGS[24] / 60 * STEPS_PER_MM
    expected = [SWITCH_STEPS + mm * STEPS_PER_MM for mm in PLAN["ended"]]
    steps = bench.stop()
    assert steps[:3] == pytest.approx(expected, abs=tolerance)
    assert steps[3:] == ([_TURNED * _STEPS_PER_DEGREE] if board == "sim_rotary" else [])


def test_cncjs(bench: Bench, board: str) -> None:
    home = available(cncjs)
    http_port = free_port()
    record = run_day(
        bench, board, "node", _HERE / "drive_cncjs.js", home, "PLAN", "RESULT", http_port
    )
    assert record["controller"] == "Grbl"
    assert max(record["override"]) == 120  # percent
    assert "Hold" in record["states"]
    check_record(record, bench, board)


def test_bcnc(bench: Bench, board: str) -> None:
    check_bcnc(bench, board)


def test_bcnc_over_the_network(network: Bench) -> None:
    check_bcnc(network, "sim_wifi")


def check_bcnc(bench: Bench, board: str) -> None:
    """Drive bCNC, whose window needs Tk, through the day and check it."""
    interpreter = available(python)
    has_tk = subprocess.run(
        [interpreter, "-c", "import tkinter"], check=False, capture_output=True
    )
    if has_tk.returncode:
        pytest.skip("bCNC needs Tk, and this Python has been built without it")
    record = run_day(bench, board, interpreter, _HERE / "drive_bcnc.py", "PLAN", "RESULT")
    assert record["controller"] == "GRBL1"
    assert record["version"] == "1.1h"
    assert max(record["override"]) == 120
    check_record(record, bench, board)


def test_grbl_streamer(bench: Bench, board: str) -> None:
    """override: feeds in mm/min that it has sent; it writes 1500 for the program's 1200."""
    interpreter = available(python)
    record = run_day(bench, board, interpreter, _HERE / "drive_grbl_streamer.py", "PLAN", "RESULT")
    assert record["version"] == "1.1h"
    assert 1500 in record["override"]
    check_record(record, bench, board)


@pytest.mark.parametrize("mode", ["line", "count"])
def test_a_plain_streamer(bench: Bench, board: str, mode: str) -> None:
    """mode: it waits for each answer, or counts the bytes that are unanswered."""
    record = run_day(
        bench, board, sys.executable, _HERE / "drive_plain.py", mode, "PLAN", "RESULT"
    )
    assert record["version"] == "1.1h"
    assert max(record["override"]) == 120
    assert "Hold:0" in record["states"]
    check_record(record, bench, board)


@pytest.mark.parametrize("mode", ["line", "count"])
def test_a_plain_streamer_over_the_network(network: Bench, mode: str) -> None:
    command = sys.executable, _HERE / "drive_plain.py", mode, "PLAN", "RESULT"
    check_record(run_day(network, "sim_wifi", *command), network, "sim_wifi")


@pytest.fixture(params=SERVERS)
def server(request: pytest.FixtureRequest) -> tuple[object, ...]:
    """Return the command that runs a server through the day."""
    variable = str(request.param)
    folder = os.environ.get(variable)
    if not folder:
        pytest.skip(f"{variable} names no folder: this sender is in no registry")
    return "node", _HERE / SERVERS[variable], folder, "PLAN", "RESULT", free_port()


@pytest.mark.parametrize("moving", [False, True], ids=["idle", "moving"])
def test_a_server(bench: Bench, board: str, server: tuple[object, ...], moving: bool) -> None:
    check_server(bench, board, server, moving)


@pytest.mark.parametrize("moving", [False, True], ids=["idle", "moving"])
def test_a_server_over_the_network(
    network: Bench, server: tuple[object, ...], moving: bool
) -> None:
    check_server(network, "sim_wifi", server, moving)


def check_server(bench: Bench, board: str, server: tuple[object, ...], moving: bool) -> None:
    """Run a server through the day and check it; moving: it meets a machine in motion."""
    if moving:
        start_motion(bench)
    record = run_day(bench, board, *server, moving=moving)
    assert record.get("version", "1.1h") == "1.1h"
    assert max(record["override"]) == 120
    if moving:
        resets = "lw_comm" in str(server[1])  # its default when it opens the port
        assert ("Run" in record["met"]) is not resets
    check_record(record, bench, board)


# A router with a rotary axis and jobs, for senders that know grblHAL.
_HAL = """
MPY_ARCH = "armv6m"
ENGINE = "pio"
LINK = "usb"
STEP = (2, 3, 4, 5)
DIR = (6, 7, 8, 9)
ROTARY = "A"
DEFAULTS = {103: 100.0, 113: 3600.0, 123: 1000.0, 133: 0.0}
PWM_MAX = 1000
DIALECT = "hal"
JOBS = "jobs"
"""


def test_gsender_reads_axes_settings_and_programs_in_hal_dialect(tmp_path: Path) -> None:
    folder = os.environ.get("UGRBL_GSENDER")
    if not folder:
        pytest.skip("UGRBL_GSENDER names no folder: this sender is in no registry")
    file = tmp_path / "router.py"
    file.write_text(_HAL)
    bench = Bench(tmp_path, "--board", str(file), settings=SETTINGS)
    try:
        command = "node", _HERE / "drive_gsender.js", folder, "PLAN", "RESULT", free_port()
        record = run_day(bench, "sim_rotary", *command)
        assert record["controller"] == "grblHAL"
        assert record["axes"] == ["X", "Y", "Z", "A"]
        assert {"HOME", "SD"} <= set(record["information"]["NEWOPT"])
        assert set(record["descriptions"]) == set(record["settings"])
        assert record["alarms"]["1"]["description"].startswith("A limit switch was hit")
        assert max(record["override"]) == 120
        check_record(record, bench, "sim_rotary")
        assert b" A4.5 F1200\n" in bench.wire(">")  # a line of the program: A was not lost
    finally:
        bench.kill()
