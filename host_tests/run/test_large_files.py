"""Programs of millions of lines: memory is that of the file, and each check shows its progress."""

import os
import pickle
import pty
import random
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from as_users import as_users
from ugrbl.grbl.gcode_file import sanitize
from ugrbl.grbl.lines import Changed, Lines, split_lines
from ugrbl.run import rehearsal
from ugrbl.run.checked_lines import CheckedLines
from ugrbl.run.program import ProgramLink, Result, run_program

_START = "G21 G90 G17 F900\n"


def moves(count: int) -> bytes:
    """Return lines like those of CAM programs."""
    lines = (f"G1 X{n % 97:.4f} Y{n % 31:.4f} Z-{n % 7:.4f}\n" for n in range(count))
    return (_START + "".join(lines)).encode()


# Lines of bytes

ENDS = [
    b"",
    b"\n",
    b"G0",
    b"a\nb",
    b"a\n\nb\n",
    b"a\r\nb\r\n",
    b"a\r\r\nb\r\rc\r",
    b"\r\r\r\n\n\r",
    b"".join(b"N%d\r\n" % n for n in range(2500)),
]


@pytest.mark.parametrize("data", ENDS, ids=range(len(ENDS)))
def test_lines_split_on_demand_equal_lines_split_at_once(data: bytes) -> None:
    lines, wanted = Lines(data), split_lines(data)
    assert list(lines) == wanted and len(lines) == len(wanted)
    assert [lines[n] for n in range(-len(lines), len(lines))] == wanted + wanted
    for part in (slice(1, -1), slice(None, None, -2), slice(2, 1200), slice(5, 3)):
        assert list(lines[part]) == wanted[part]
        assert list(lines[1:][part]) == wanted[1:][part]
    with pytest.raises(IndexError):
        lines[len(lines)]


def test_changed_lines_are_made_on_demand_and_can_be_pickled() -> None:
    lines = Changed(Lines(b"G0 (!)\nG1\n"), sanitize)
    there: Sequence[bytes] = pickle.loads(pickle.dumps(lines))
    assert list(there) == [there[0], there[1]] == list(there[:2]) == [b"G0 (.)", b"G1"]


# Memory


# In a separate process, as users run it: the checked kernels of the tests are too slow. Memory
# that
# is allocated only once is not counted.
_PEAK = """
import sys, tracemalloc
from pathlib import Path
from ugrbl.grbl.gcode_file import sanitize, read_lines, read_program
from ugrbl.grbl.lines import Changed
from ugrbl.run import rehearsal
from ugrbl.run.program import run_program

def run(file):
    return run_program(read_program(file), check=True)[0]

def send(file):
    return rehearsal.check(rehearsal.Job(Changed(read_lines(file), sanitize), []))[0]

check = {"run": run, "send": send}[sys.argv[1]]
check(Path(sys.argv[2]))
for name in sys.argv[2:]:
    tracemalloc.start()
    lines = check(Path(name)).lines
    print(lines, tracemalloc.get_traced_memory()[1])
    tracemalloc.stop()
"""


@pytest.mark.parametrize("command", ["run", "send"])
def test_a_check_uses_no_more_memory_than_the_files_size(command: str, tmp_path: Path) -> None:
    files = [tmp_path / "short.nc", tmp_path / "long.nc"]
    for file, count in zip(files, (4000, 16_000), strict=True):
        file.write_bytes(moves(count))
    done = subprocess.run(
        [sys.executable, "-c", _PEAK, command, *map(str, files)],
        capture_output=True,
        text=True,
        check=True,
        env=as_users(),
    )
    few, many = ([int(word) for word in line.split()] for line in done.stdout.splitlines())
    assert (few[0], many[0]) == (4001, 16_001)
    longer = files[1].stat().st_size - files[0].stat().st_size
    assert many[1] - few[1] < 1.5 * longer


# Many lines at once

MESSY = (
    *("G1 X1 Y2", "x3 f500", "N7 G0 Z1 (rapid)", "G2 X9 Y9 R30", "G3 X0 Y0 I-4.5 J-4.5"),
    *("", "(a comment)", "; another", "/G1X2", "M3 S500", "S700", "G1 X5 S100", "M8", "M5"),
    *("G20", "G21", "G91", "G90", "G18", "G17", "G93", "G94", "F1", "G1 X1 F", "G4 P0.1"),
    *("G1 X1 X2", "T1", "M6", "G64", "Q", "G1 X--1", "G1X1e5", "N10000000", "G5 X1", "%"),
    *("G55", "G54", "G92 X1", "G92.1", "G10 L2 P1 X1", "G43.1 Z1", "G49", "$G", "$$", "?", "(!)"),
    *("(" + 90 * "x" + ")", "G1" + 90 * " " + "X2", "G1 X" + 90 * "0" + "1", "G38.2 Z-1 F9"),
    *("$X", "G28", "G53 G0 X1", "M0", "M30", "~"),
)


def checked(lines: Sequence[bytes], *settings: str) -> Result:
    """Return the result without its time, because turns of an idle machine count there."""
    result = run_program(lines, settings=settings, check=True)[0]
    result.totals.time_s = 0.0
    return result


def sent_one_by_one(
    lines: Sequence[bytes], monkeypatch: pytest.MonkeyPatch, *settings: str
) -> Result:
    with monkeypatch.context() as patched:
        patched.setattr(CheckedLines, "load", lambda self, lines: False)
        return checked(lines, *settings)


@pytest.mark.parametrize("seed", range(3))
def test_many_lines_at_once_give_the_same_result_as_single_lines(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw = random.Random(seed)
    plain = [f"G1 X{n}" for n in range(5)] + [f"Y{n} F{n}00 S{n}" for n in range(5)]
    texts = [draw.choice(MESSY if draw.random() < 0.4 else plain) for _ in range(500)]
    if seed == 0:
        texts = [text for text in texts if text not in ("?", "(!)", "~")]
    lines = [text.encode() for text in texts]
    assert checked(lines, "$32=1") == sent_one_by_one(lines, monkeypatch, "$32=1")


def test_a_program_may_end_check_mode_itself() -> None:
    lines = [b"G21 G91 F900", *[b"G1 X.5"] * 20, b"$C", b"F900", *[b"G1 X.25 G91"] * 20, b"$C"]
    result = checked([*lines, b"G1 X1", b"Q1"])
    # The $C that ends check mode is a reset, and has no answer.
    assert result.lines == 45 and result.errors == [(46, "error:20")]
    assert result.totals.steps_made["X"] == 20 * 0.25 * 250


def test_an_alarm_among_many_lines_names_its_line() -> None:
    lines = [b"G21 G90 F900", *[b"G1 X-2"] * 50, b"G1 X-3000", b"G1 X-1"]
    result, line = rehearsal.check(rehearsal.Job(lines, ["$22=1", "$20=1"]))
    assert (result.stopped, line) == ("ALARM:2", 52)


def test_move_only_lines_are_not_sent_in_check_mode(monkeypatch: pytest.MonkeyPatch) -> None:
    sent = []
    usual = ProgramLink._send

    def send(link: ProgramLink, number: int, line: bytes) -> None:
        sent.append(number)
        usual(link, number, line)

    monkeypatch.setattr(ProgramLink, "_send", send)
    result, _ = run_program(split_lines(moves(1500)), check=True)
    assert result.lines == 1501 and not result.errors
    assert len(sent) < 10


# Progress


@pytest.mark.parametrize(("check", "count"), [(True, 1500), (False, 300)])
def test_progress_is_reported_every_few_lines(check: bool, count: int) -> None:
    seen: list[int] = []
    lines = [b"G21 G91 F3000", *[b"G1 X.01"] * count]
    run_program(lines, check=check, progress=seen.append)
    steps = [b - a for a, b in zip([0, *seen], seen, strict=False)]
    assert max(steps) <= 1000 and len(seen) > 1 and seen[-1] == len(lines)


def test_a_terminal_shows_the_progress_of_a_check(tmp_path: Path) -> None:
    file = tmp_path / "arcs.nc"
    arcs = (f"G2 X{5 + n % 2} Y0 R30\n" for n in range(5000))
    file.write_text(_START + "".join(arcs))
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "ugrbl.cli", "run", "--check", str(file)]
    with subprocess.Popen(
        command, stdout=theirs, stderr=theirs, env=as_users(TERM="xterm")
    ) as run:
        os.close(theirs)
        said = b""
        try:
            while piece := os.read(ours, 4096):
                said += piece
        except OSError:  # the process has ended
            pass
    os.close(ours)
    assert run.returncode == 0, said.decode()
    shown = {int(count) for count in re.findall(rb"(\d+)/5001", said)}
    assert {0, 5001} < shown
