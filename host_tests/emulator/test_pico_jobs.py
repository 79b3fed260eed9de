"""Test jobs on the emulated Pico: from one dragged file to a job resumed after a power cut."""

import math
import subprocess
import sys
import zlib
from pathlib import Path

import pytest
import uf2_model
from chips import CHIP
from emulated import BOARD_FILE, DIR, HOLD, LIMIT, STEP, Board, Odometer
from test_uf2 import garbage, read_back
from ugrbl.device import jobs

pytestmark = pytest.mark.xdist_group("pico jobs")

_PIECE = 2048
_KB_PER_S = 50
_SETTINGS = (
    *[f"${number + axis}={value}" for axis in range(3) for number, value in ((100, 100),)],
    *[f"${number + axis}={value}" for axis in range(3) for number, value in ((110, 6000),)],
    *[f"${number + axis}=500" for axis in range(3) for number in (120, 130)],
    *("$22=1", "$23=0", "$24=100", "$25=3000", "$26=5", "$27=1"),
)
# A spiral staircase below zero, because homing sets its zero above.
_JOB = (
    "G21 G90 G54",
    "M3 S1000",
    *[
        f"G1 X{-3 - i % 7 * 0.3:.2f} Y{-2 - i % 5 * 0.4:.2f} Z{-2 - i * 0.01:.2f} F3000"
        for i in range(100)
    ],
    "G0 Z-1.5",
    "M5",
)


def push(machine: Board, name: str, data: bytes) -> float:
    """Send a file as `ugrbl job push` does; return the time it takes, in us.

    $FU announces name, size and checksum; the board asks for each piece by its offset,
    and reads its lines, of packed bytes in base64, up to an empty one.
    """
    machine.clear_output()
    begun_us = machine.pico.us
    machine.send(f"$FU={name},{len(data)},{zlib.crc32(data):x}\n")
    for offset in range(0, len(data), _PIECE):
        machine.wait_for(f"[FU:{offset}]\r\n", 10_000_000)
        machine.send(b"".join(jobs._lines(data[offset : offset + _PIECE])) + b"\n")
    machine.wait_for("ok\r\n", 10_000_000)
    return machine.pico.us - begun_us


def home(machine: Board) -> Odometer:
    """Home to switches 2 mm (200 steps) above the current position; return the odometer, whose
    origin that position is."""
    odometer = Odometer(machine.pico)
    has_homed: list[bool] = []  # not empty: homing has ended

    def update_switches() -> None:
        """Set the switches for the motors' positions, every 2 ms until homing has ended."""
        for axis, steps in enumerate(odometer.read()):
            machine.pico.drive(LIMIT[axis], 0 if steps >= 200 else 1)
        if not has_homed:
            machine.pico.at_us(2_000, update_switches)

    update_switches()
    machine.ask("$H", limit_us=20_000_000)
    has_homed.append(True)
    machine.pico.run_us(3_000)
    return odometer


def dragged_flash(
    tmp_path: Path, uf2: Path, options: str = "", lines: "tuple[str, ...]" = _SETTINGS
) -> bytes:
    """Return flash with the file of `ugrbl uf2` for a board with jobs, dragged onto other data.

    options: further lines of the board file; lines: its settings.
    """
    board, settings, file = (tmp_path / name for name in ("my.py", "my.settings", "all.uf2"))
    board.write_text(f'{BOARD_FILE.read_text()}\nJOBS = "jobs"\n{options}\n')
    settings.write_text("".join(f"{line}\n" for line in lines))
    command = [sys.executable, "-m", "ugrbl.cli", "uf2", "--board", str(board), "-o", str(file)]
    command += ["--micropython", str(uf2), "--settings", str(settings)]
    subprocess.run(command, capture_output=True, text=True, check=True)
    flash = garbage(CHIP.flash)
    uf2_model.load(flash, file.read_bytes(), CHIP.family)
    return bytes(flash)


def start_with_flash(uf2: Path, flash: bytes) -> Board:
    """Start a Pico with this flash, and wait for its welcome."""
    machine = Board(uf2)
    machine.pico.write_flash(0, flash)
    machine.pico.record([*STEP, *DIR])
    return machine.boot()


def test_dragged_file_becomes_a_machine_whose_job_resumes_after_a_power_cut(
    uf2: Path, tmp_path: Path
) -> None:
    """After the power cut a second Pico starts with the first one's flash; $F=@ resumes."""
    machine = start_with_flash(uf2, dragged_flash(tmp_path, uf2))
    data = "".join(f"{line}\n" for line in _JOB).encode()
    machine.ask("$X")
    push(machine, "STAIRS.NC", data)
    home(machine)
    machine.clear_output()
    machine.send("$F=stairs.nc\n")
    machine.wait_for("Job STAIRS.NC: begins")
    machine.pico.run_us(600_000)
    report = machine.status()
    assert report["state"] == "Run" and report["SD"].endswith(",/STAIRS.NC")
    # The power fails: its supervisor pulls the hold input, and a little energy is left.
    machine.pico.drive(HOLD, 0)
    machine.pico.run_us(600_000)
    flash = machine.pico.read_flash(0, CHIP.flash)

    machine = start_with_flash(uf2, flash)
    message = machine.wait_for("[MSG:Job STAIRS.NC: did not finish; last recorded line: ")
    machine.wait_for("]\r\n")
    line = int(machine.output.partition("last recorded line: ")[2].partition("]")[0])
    assert 5 < line < 90, message
    odometer = home(machine)
    machine.clear_output()
    machine.send("$F=@\n")
    machine.wait_for(f"Job STAIRS.NC: continues at line {line}")
    machine.wait_for("Job STAIRS.NC: done, 104 lines", 60_000_000)
    # The last target, in steps, 100 per mm: X and Y of the last G1, Z of the G0.
    target_steps = [round(100 * mm) for mm in (*xy_of(_JOB[101]), -1.5)]
    # Machine zero is at the switches, 200 steps from the odometer's origin.
    assert odometer.read() == [steps + 200 for steps in target_steps]
    assert read_back(machine.pico.flash_image())["jobs/STAIRS.NC"] == data


def xy_of(line: str) -> list[float]:
    """Return X and Y."""
    return [float(word[1:]) for word in line.split() if word[0] in "XY"]


def test_file_is_received_at_50_kilobytes_a_second(uf2: Path, tmp_path: Path) -> None:
    machine = start_with_flash(uf2, dragged_flash(tmp_path, uf2))
    angles = [i / 100 for i in range(1200)]
    lines = [f"G1X{50 * math.cos(a):.3f}Y{50 * math.sin(a):.3f}F1500" for a in angles]
    data = "\n".join(lines).encode()
    machine.ask("$X")
    push_us = push(machine, "BIG.NC", data)
    assert len(data) / push_us * 1000 >= _KB_PER_S  # bytes/us * 1000 are kB/s
    assert read_back(machine.pico.flash_image())["jobs/BIG.NC"] == data
