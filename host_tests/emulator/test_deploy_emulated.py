"""Test `ugrbl deploy` and mpremote at an emulated Pico with a real MicroPython."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import serial
from emulated import BOARD_FILE
from ugrbl.compiling import build
from ugrbl.compiling.folder import save
from ugrbl.device.connection import Connection
from ugrbl.grbl.gcode_file import is_answer

pytestmark = pytest.mark.xdist_group("pico deploy")

_HERE = Path(__file__).parent
# The emulator is 20 to 50 times slower than the chip, and more on a busy computer: an ESP32 takes
# 19 s to its welcome on two cores with three processes, and took more than 150 s with fifteen. So
# all time limits of ugrbl are 30 times as long.
_PATIENCE = {"UGRBL_PATIENCE": "30"}
_LIMIT_S = 1000.0
# The running machine must keep as much memory again as the lines of a program take.
_FREE_BYTES = 30_000


@contextmanager
def pico(uf2: Path, folder: Path, files: "build.Build | None" = None) -> "Iterator[Path]":
    """Start a board with these files, or with none; yield its serial port."""
    link, board_folder = folder / "pico", folder / "board"
    board_folder.mkdir()
    if files:
        save(files, board_folder)
    bridge_words = map(str, (_HERE / "pty_bridge.py", uf2, link, board_folder))
    bridge = subprocess.Popen([sys.executable, *bridge_words])
    try:
        until = time.monotonic() + 30
        while not link.exists():
            assert bridge.poll() is None and time.monotonic() < until, "no emulated board"
            time.sleep(0.1)
        yield link
    finally:
        bridge.terminate()
        bridge.wait()


def deploy(port: Path, board: Path = BOARD_FILE, *words: str) -> "tuple[int, Any]":
    """Run `ugrbl deploy` with these further words; return its exit code and its JSON result."""
    command = [sys.executable, "-m", "ugrbl.cli", "deploy", "--board", str(board)]
    command += ["--port", str(port), "--json", "-", *words]
    done = subprocess.run(
        command, env={**os.environ, **_PATIENCE}, capture_output=True, text=True, check=False
    )
    assert done.stdout, done.stderr
    return done.returncode, json.loads(done.stdout)


def mpremote(port: Path, *words: str) -> str:
    """Run mpremote and return its output."""
    command = [sys.executable, "-m", "mpremote", "connect", str(port), *words]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@contextmanager
def grbl(port: Path) -> "Iterator[Connection]":
    """Yield a connection to the machine, after its first status report; wait_for() sends "?"."""
    connection = Connection(str(port))
    try:
        assert connection.wait_for(lambda line: line.startswith("<"), _LIMIT_S)
        yield connection
    finally:
        connection.close()


def ask(machine: Connection, line: str) -> "list[str]":
    """Return the lines received up to the answer to a line; a setting takes time until it is in
    flash."""
    replies: list[str] = []
    machine.write(line.encode() + b"\n")
    assert machine.wait_for(lambda reply: replies.append(reply) or is_answer(reply), _LIMIT_S)
    return replies


def test_empty_board_is_deployed_and_updated(uf2: Path, tmp_path: Path) -> None:
    """A second deployment copies nothing, a changed board file only that; settings stay."""
    made = build.for_board(BOARD_FILE)
    with pico(uf2, tmp_path) as port:
        code, done = deploy(port)
        assert code == 0, done
        assert sorted(done["copied"]) == sorted(made.files) and done["bytes"] == made.bytes
        assert done["banner"].startswith("Grbl 1.1h") and done["build"].startswith("1.1h.")
        assert done["micropython"].startswith("MicroPython 1.")
        assert done["free_bytes"] > _FREE_BYTES

        with grbl(port) as machine:
            assert "ok" in ask(machine, "$110=777")
        code, again = deploy(port)
        assert (code, again["copied"], again["removed"]) == (0, [], [])
        assert again["unchanged"] == len(made.files)

        mine = tmp_path / "mine.py"
        mine.write_text(BOARD_FILE.read_text() + "PLANNER_BLOCKS = 12\n")
        code, changed = deploy(port, mine)
        assert (code, changed["copied"], changed["removed"]) == (0, ["board.py"], [])
        with grbl(port) as machine:
            assert "$110=777.000" in ask(machine, "$$")
            assert "[OPT:V,11,255]" in ask(machine, "$I")  # 12 blocks are reported as 11


def test_mpremote_enters_and_leaves_the_prompt(uf2: Path, tmp_path: Path) -> None:
    """While the machine is idle. At the prompt it lists files; then the machine starts again."""
    with pico(uf2, tmp_path, build.for_board(BOARD_FILE)) as port:
        with grbl(port):
            pass  # it has started
        # resume: without a soft reset.
        assert mpremote(port, "resume", "exec", "print(6 * 7)") == "42\n"
        assert "words.mpy" in mpremote(port, "fs", "ls", "language")
        with grbl_started_anew(port) as machine:
            assert "ok" in ask(machine, "$I")
        assert mpremote(port, "exec", "print(6 * 7)") == "42\n"  # after a soft reset


@contextmanager
def grbl_started_anew(port: Path) -> "Iterator[Connection]":
    """Restart with Ctrl-D at the prompt; a Connection leaves out bytes that Grbl does not know."""
    with serial.Serial(str(port)) as line:
        line.write(b"\x04")
    with grbl(port) as machine:
        yield machine


def test_moving_machine_is_not_disturbed(uf2: Path, tmp_path: Path) -> None:
    with pico(uf2, tmp_path, build.for_board(BOARD_FILE)) as port:
        with grbl(port) as machine:
            assert "ok" in ask(machine, "G91 G1 X100 F100")  # takes a minute
        code, done = deploy(port)
        assert code == 1 and "is in Run" in done["problems"][0]
        with grbl(port) as machine:
            assert machine.state() == "Run"


def test_sources_copied_by_hand_are_replaced(uf2: Path, tmp_path: Path) -> None:
    """Sources that `mpremote cp -r firmware/. :` leaves would hide the compiled files.

    These two have only functions for other modules, so they work among compiled modules. A file of
    the user's (mine.py) stays.
    """
    made = build.for_board(BOARD_FILE)
    sources = {
        name: (build.paths.FIRMWARE / name).read_bytes()
        for name in ("motion/minifloat.py", "talk/digits.py")
    }
    files = build.Build(made.arch, {**made.files, **sources, "mine.py": b"mine = 1\n"})
    with pico(uf2, tmp_path, files) as port:
        with grbl(port):
            pass  # it has started
        code, done = deploy(port)
        assert (code, done["removed"], done["copied"]) == (
            0,
            ["motion/minifloat.py", "talk/digits.py"],
            [],
        )
        assert "mine.py" in mpremote(port, "fs", "ls")
