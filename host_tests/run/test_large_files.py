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
    """Lines behaves like a list: indexes from both ends, slices, slices of slices."""
    lines, wanted = Lines(data), split_lines(data)
    assert list(lines) == wanted and len(lines) == len(wanted)
    assert [lines[n] for n in range(-len(lines), len(lines))] == wanted + wanted
    for part in (slice(1, -1), slice(None, None, -2), slice(2, 1200), slice(5, 3)):
        assert list(lines[part]) == wanted[part]
        assert list(lines[1:][part]) == wanted[1:][part]
    with pytest.raises(IndexError):
        lines[len(lines)]


def test_changed_lines_are_made_on_demand_and_can_be_pickled() -> None:
    """A check in another process receives them pickled. sanitize() replaces real-time
    characters."""
    lines = Changed(Lines(b"G0 (!)\nG1\n"), sanitize)
    unpickled: Sequence[bytes] = pickle.loads(pickle.dumps(lines))
    assert (
        list(unpickled)
        == [unpickled[0], unpickled[1]]
        == list(unpickled[:2])
        == [b"G0 (.)", b"G1"]
    )


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
    """Peak memory of checks of 4000 and 16000 lines: the difference is below 1.5 times that of the
    files."""
    files = [tmp_path / "short.nc", tmp_path / "long.nc"]
    for file, count in zip(files, (4000, 16_000), strict=True):
        file.write_bytes(moves(count))
    process = subprocess.run(
        [sys.executable, "-c", _PEAK, command, *map(str, files)],
        capture_output=True,
        text=True,
        check=True,
        env=as_users(),
    )
    # each: lines, peak memory in bytes
    short, long = ([int(word) for word in line.split()] for line in process.stdout.splitlines())
    assert (short[0], long[0]) == (4001, 16_001)
    more_bytes = files[1].stat().st_size - files[0].stat().st_size
    assert long[1] - short[1] < 1.5 * more_bytes


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
    """Return the result if load() refuses to check many lines at once."""
    with monkeypatch.context() as patched:
        patched.setattr(CheckedLines, "load", lambda self, lines: False)
        return checked(lines, *settings)


@pytest.mark.parametrize("seed", range(3))
def test_many_lines_at_once_give_the_same_result_as_single_lines(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = random.Random(seed)
    simple = [f"G1 X{n}" for n in range(5)] + [f"Y{n} F{n}00 S{n}" for n in range(5)]
    texts = [rng.choice(MESSY if rng.random() < 0.4 else simple) for _ in range(500)]
    if seed == 0:  # without real-time characters, which end a stretch of lines checked at once
        texts = [text for text in texts if text not in ("?", "(!)", "~")]
    lines = [text.encode() for text in texts]
    assert checked(lines, "$32=1") == sent_one_by_one(lines, monkeypatch, "$32=1")


def test_a_program_may_end_check_mode_itself() -> None:
    """Check mode is on from the start: the first $C ends it, and lines move until the second."""
    lines = [b"G21 G91 F900", *[b"G1 X.5"] * 20, b"$C", b"F900", *[b"G1 X.25 G91"] * 20, b"$C"]
    result = checked([*lines, b"G1 X1", b"Q1"])
    # The $C that ends check mode is a reset, and has no answer.
    assert result.lines == 45 and result.errors == [(46, "error:20")]
    assert result.totals.steps_made["X"] == 20 * 0.25 * 250  # mm, steps/mm


def test_an_alarm_among_many_lines_names_its_line() -> None:
    lines = [b"G21 G90 F900", *[b"G1 X-2"] * 50, b"G1 X-3000", b"G1 X-1"]
    # homing and soft limits are on: X-3000 is beyond the travel
    result, line = rehearsal.check(rehearsal.Job(lines, ["$22=1", "$20=1"]))
    assert (result.stopped, line) == ("ALARM:2", 52)


def test_move_only_lines_are_not_sent_in_check_mode(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stretches of them go to the firmware's kernel at once, not through the simulated link."""
    numbers_sent = []
    real_send = ProgramLink._send

    def send(link: ProgramLink, number: int, line: bytes) -> None:
        numbers_sent.append(number)
        real_send(link, number, line)

    monkeypatch.setattr(ProgramLink, "_send", send)
    result, _ = run_program(split_lines(moves(1500)), check=True)
    assert result.lines == 1501 and not result.errors
    assert len(numbers_sent) < 10  # lines


# Progress


@pytest.mark.parametrize(("check", "count"), [(True, 1500), (False, 300)])
def test_progress_is_reported_every_few_lines(check: bool, count: int) -> None:
    counts: list[int] = []
    lines = [b"G21 G91 F3000", *[b"G1 X.01"] * count]
    run_program(lines, check=check, progress=counts.append)
    steps = [b - a for a, b in zip([0, *counts], counts, strict=False)]
    assert max(steps) <= 1000 and len(counts) > 1 and counts[-1] == len(lines)


def test_a_terminal_shows_the_progress_of_a_check(tmp_path: Path) -> None:
    """In a pseudo-terminal; 5001 lines take long enough for the progress to be drawn more than
    twice."""
    file = tmp_path / "arcs.nc"
    arcs = (f"G2 X{5 + n % 2} Y0 R30\n" for n in range(5000))
    file.write_text(_START + "".join(arcs))
    our_end, its_end = pty.openpty()
    command = [sys.executable, "-m", "ugrbl.cli", "run", "--check", str(file)]
    with subprocess.Popen(
        command, stdout=its_end, stderr=its_end, env=as_users(TERM="xterm")
    ) as process:
        os.close(its_end)
        output = b""
        try:
            while data := os.read(our_end, 4096):
                output += data
        except OSError:  # the process has ended
            pass
    os.close(our_end)
    assert process.returncode == 0, output.decode()
    counts = {int(count) for count in re.findall(rb"(\d+)/5001", output)}
    assert {0, 5001} < counts  # others between them
