"""Test `ugrbl custom` at an emulated Pico: push, failure, doctor's report, removal."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from emulated import BOARD_FILE
from test_deploy_emulated import ask, grbl, pico
from ugrbl.compiling import build

pytestmark = pytest.mark.xdist_group("pico custom")

_ENVIRONMENT = {"UGRBL_PATIENCE": "30", "COLUMNS": "200"}  # time limits * 30; no wrapped lines
_EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "custom"
_FILE = """\
from ugrbl import mcode

@mcode(100, "P")
def share(m, P):
    m.out("vacuum", P)
    m.message("%.2f" % (1 / (P - 2)))
"""


def ugrbl(*words: object) -> "subprocess.CompletedProcess[str]":
    """Run the command `ugrbl` with these words; return its exit code and output."""
    command = [sys.executable, "-m", "ugrbl.cli", *map(str, words)]
    return subprocess.run(
        command, env={**os.environ, **_ENVIRONMENT}, capture_output=True, text=True, check=False
    )


def test_file_is_pushed_runs_fails_and_is_removed(uf2: Path, tmp_path: Path) -> None:
    """The file's M100 divides by P - 2: M100 P1 reports -1.00, M100 P2 fails in line 6."""
    board = tmp_path / "router.py"
    board.write_text(BOARD_FILE.read_text() + '\nOUTPUTS = {"vacuum": 20}\n')
    mine = tmp_path / "mine.py"
    mine.write_text(_FILE)
    with pico(uf2, tmp_path, build.for_board(board)) as port:
        with grbl(port):
            pass  # it has started
        done = ugrbl("custom", "push", mine, "--port", port, "--board", board)
        assert done.returncode == 0, done.stdout + done.stderr
        assert f"custom.py at {port}: M100" in done.stdout
        with grbl(port) as machine:
            assert "[MSG:-1.00]" in ask(machine, "M100 P1")
            assert any("custom.py, line 6" in line for line in ask(machine, "M100 P2"))
            ask(machine, "$X")
        # It watches the inputs for 0 s.
        done = ugrbl("doctor", "--port", port, "--json", "-", "--no-move", "--pins", "0")
        (finding,) = [
            row for row in json.loads(done.stdout)["findings"] if row["what"] == "custom.py"
        ]
        assert finding["text"].startswith("M100 has failed\nTraceback")
        assert 'File "custom.py", line 6, in share' in finding["text"]
        assert finding["text"].endswith("ZeroDivisionError: divide by zero")
        pulled = tmp_path / "got.py"
        assert ugrbl("custom", "pull", pulled, "--port", port).returncode == 0
        assert pulled.read_text() == _FILE
        done = ugrbl("custom", "remove", "--yes", "--port", port)
        assert done.returncode == 0, done.stdout + done.stderr
        with grbl(port) as machine:
            assert "error:20" in ask(machine, "M100 P1")  # an unknown word again


def test_folder_replaces_a_file_and_a_folder(uf2: Path, tmp_path: Path) -> None:
    """The board has a file that fails. A folder is pushed over it, then a changed folder.

    text: the folder's b.py, with M100 first and M101 in the end.
    """
    made = build.for_board(BOARD_FILE)
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
        pull = ugrbl("custom", "pull", tmp_path / "got", "--port", port)
        assert pull.returncode == 0, pull.stderr
        assert sorted(file.name for file in (tmp_path / "got").iterdir()) == ["a.py", "b.py"]


def test_three_examples_do_what_they_say(uf2: Path, tmp_path: Path) -> None:
    """talks: per example, each line to send and the lines that its answer must contain."""
    board = tmp_path / "router.py"
    pins = 'OUTPUTS = {"air": 20, "lamp": 21, "fan": 26}\nINPUTS = {"part": 27, "door": 28}\n'
    board.write_text(BOARD_FILE.read_text() + "\n" + pins)
    talks = {
        "digital_io": {
            "M64 P1": ["ok"],
            "M66 P0": ["[MSG:M66 P0: 0]", "ok"],
            "M66 P1 L3 Q0.1": ["[MSG:M66 P1: nothing for 0.1 s]", "ok"],
            "M68 E2 Q0.5": ["ok"],
            "M64 P7": ["[MSG:P and E go from 0 to 2]", "error:3"],
        },
        "tool_table": {
            "G10 L1 P2 Z-12.5": ["ok"],
            "G43 H2": ["ok"],
            "$#": ["[TLO:-12.500]"],
            "G43 H3": ["[MSG:tool 3 has no length: G10 L1 P3 Z and the length]", "error:3"],
        },
        "counter": {
            "M120 Q2": ["ok"],
            "M30": ["ok"],
            "M121": ["ok"],
            "M2": ["ok"],
            "G4P0": ["ok"],
        },
    }
    with pico(uf2, tmp_path, build.for_board(board)) as port:
        for example, talk in talks.items():
            file = _EXAMPLES / f"{example}.py"
            done = ugrbl("custom", "push", file, "--port", port, "--board", board)
            assert done.returncode == 0, done.stdout + done.stderr
            with grbl(port) as machine:
                for line, expected in talk.items():
                    answers = ask(machine, line)
                    missing = [answer for answer in expected if answer not in answers]
                    assert missing == [], (line, answers)
                reports = [line for line in ask(machine, "?") if line[0] == "<"]
        # The last example, counter: 1 part is made (M2 after M121, which sets 0), 2 are wanted.
        assert "|Pn:1,2" in reports[-1]
