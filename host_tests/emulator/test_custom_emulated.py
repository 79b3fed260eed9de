"""`ugrbl custom` at an emulated Pico: pushed, failing, told of by the doctor, removed."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from test_deploy_emulated import ask, grbl, pico
from ugrbl.boardfile import files
from ugrbl.compiling import build

pytestmark = pytest.mark.xdist_group("pico custom")

_PATIENCE = {"UGRBL_PATIENCE": "10", "COLUMNS": "200"}
_BOARD = files.board_file("rpi_pico")
_FILE = """\
from ugrbl import mcode

@mcode(100, "P")
def share(m, P):
    m.out("vacuum", P)
    m.message("%.2f" % (1 / (P - 2)))
"""


def ugrbl(*words: object) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-m", "ugrbl.cli", *map(str, words)]
    return subprocess.run(
        command, env={**os.environ, **_PATIENCE}, capture_output=True, text=True, check=False
    )


def test_a_file_is_pushed_runs_fails_and_goes(uf2: Path, tmp_path: Path) -> None:
    board = tmp_path / "router.py"
    board.write_text(_BOARD.read_text() + '\nOUTPUTS = {"vacuum": 20}\n')
    mine = tmp_path / "mine.py"
    mine.write_text(_FILE)
    with pico(uf2, tmp_path, build.for_board(board)) as port:
        with grbl(port):
            pass
        done = ugrbl("custom", "push", mine, "--port", port, "--board", board)
        assert done.returncode == 0, done.stdout + done.stderr
        assert f"custom.py at {port}: M100" in done.stdout
        with grbl(port) as machine:
            assert "[MSG:-1.00]" in ask(machine, "M100 P1")
            assert any("custom.py, line 6" in line for line in ask(machine, "M100 P2"))
            ask(machine, "$X")
        done = ugrbl("doctor", "--port", port, "--json", "-", "--no-move", "--pins", "0")
        (found,) = [
            row for row in json.loads(done.stdout)["findings"] if row["what"] == "custom.py"
        ]
        assert found["text"].startswith("M100 has failed\nTraceback")
        assert 'File "custom.py", line 6, in share' in found["text"]
        assert found["text"].endswith("ZeroDivisionError: divide by zero")
        got = tmp_path / "got.py"
        assert ugrbl("custom", "pull", got, "--port", port).returncode == 0
        assert got.read_text() == _FILE
        done = ugrbl("custom", "remove", "--yes", "--port", port)
        assert done.returncode == 0, done.stdout + done.stderr
        with grbl(port) as machine:
            assert "error:20" in ask(machine, "M100 P1")


def test_a_folder_takes_the_place_of_a_file_and_of_a_folder(uf2: Path, tmp_path: Path) -> None:
    made = build.for_board(_BOARD)
    made.files["custom.py"] = b"1 / 0\n"
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "a.py").write_text("def hello(m):\n    m.message('hello')\n")
    text = "from ugrbl import mcode\nfrom custom.a import hello\nmcode(100)(hello)\n"
    (mine / "b.py").write_text(text)
    with pico(uf2, tmp_path, made) as port:
        with grbl(port) as machine:
            left_out = "[MSG:Custom left out: custom.py, line 1: ZeroDivisionErr: divide by zero]"
            assert left_out in [line.replace(", in <module>", "") for line in ask(machine, "$I")]
        for word in (100, 101):
            (mine / "b.py").write_text(text.replace("100", str(word)))
            done = ugrbl("custom", "push", mine, "--port", port)
            assert done.returncode == 0, done.stdout + done.stderr
        with grbl(port) as machine:
            assert "[MSG:hello]" in ask(machine, "M101")
        there = ugrbl("custom", "pull", tmp_path / "got", "--port", port)
        assert there.returncode == 0, there.stderr
        assert sorted(file.name for file in (tmp_path / "got").iterdir()) == ["a.py", "b.py"]
