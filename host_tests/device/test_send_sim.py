"""Test `ugrbl send` as a process at the simulator: how it ends, and how it continues.

Bench is the simulator as a process on a pseudo-terminal, in real time: bench.wire(">") returns all
bytes sent to it, bench.wire("<") all that it has sent. Send is the running command: end() returns
its exit code and output."""

import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from as_users import as_users
from sim_bench import Bench
from typer.testing import CliRunner
from ugrbl.cli.app import app
from ugrbl.device.connection import Connection

# Real processes in real time: the first ring runs one.
pytestmark = pytest.mark.thorough

_PATIENCE_S = 60.0
# Fast enough that the planner's 15 blocks pass quickly, slow enough to press a key meanwhile.
SETTINGS = {1: 255, 110: 2000, 111: 2000, 112: 2000, 120: 200, 121: 200, 122: 200}
# Line n ends at X n/2; the speed is 15 mm/s.
STAIRS = ["G21 G90 F900", *(f"G1 X{n / 2:g}" for n in range(2, 400))]


def _environment(terminal: str = "dumb") -> "dict[str, str]":
    return as_users(COLUMNS="120", TERM=terminal)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    running = Bench(tmp_path, settings=SETTINGS)
    unlock(running)
    yield running
    running.kill()


def unlock(bench: Bench) -> None:
    """Unlock the machine: with stored settings but no offsets it may start in an alarm."""
    connection = Connection(str(bench.port))
    assert connection.answers()
    connection.ask("$X")
    connection.close()


class Send:
    """A running `ugrbl send` of these lines with these options (words).

    terminal: it has a terminal, which the test uses. dumb: a terminal without a live display."""

    def __init__(
        self,
        bench: Bench,
        folder: Path,
        lines: list[str],
        *words: str,
        terminal: bool = False,
        dumb: bool = True,
    ) -> None:
        file = folder / "job.nc"
        file.write_text("\n".join(lines) + "\n")
        command = [sys.executable, "-m", "ugrbl.cli", "send", str(file), "--port"]
        command += [str(bench.port), *words]
        self.text = ""
        self.master = -1
        if terminal:
            pid, self.master = pty.fork()
            if pid == 0:  # the child process
                os.execve(sys.executable, command, _environment("dumb" if dumb else "xterm"))
            self.pid = pid
            return
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=_environment(),
            text=True,
        )
        self.pid = self.process.pid

    def press(self, keys: str) -> None:
        os.write(self.master, keys.encode())

    def wait_text(self, what: str) -> str:
        """Read from the terminal until a text arrives."""
        end_s = time.monotonic() + _PATIENCE_S
        while what not in self.text:
            assert time.monotonic() < end_s, self.text
            self._read()
        return self.text

    def end(self) -> tuple[int, str]:
        """Return exit code and the whole output."""
        if self.master < 0:
            text, _ = self.process.communicate(timeout=_PATIENCE_S)
            return self.process.returncode, text
        end_s = time.monotonic() + _PATIENCE_S
        pid = 0
        while not pid:
            assert time.monotonic() < end_s, self.text
            self._read()
            pid, status = os.waitpid(self.pid, os.WNOHANG)
        self._read()
        os.close(self.master)
        return os.waitstatus_to_exitcode(status), self.text

    def _read(self) -> None:
        """Read the terminal's output; after the end of the command reading raises OSError."""
        while select.select([self.master], [], [], 0.1)[0]:
            try:
                self.text += os.read(self.master, 4096).decode(errors="replace")
            except OSError:
                return


def wait_until_x(bench: Bench, mm: float) -> None:
    """Wait until a status report on the wire has passed this X."""
    end_s = time.monotonic() + _PATIENCE_S
    while time.monotonic() < end_s:
        x_mm = re.findall(rb"<Run\|MPos:([\d.]+)", bench.wire("<"))
        if x_mm and float(x_mm[-1]) >= mm:
            return
        time.sleep(0.05)
    raise AssertionError(f"never at {mm} mm")


def last_reported_x(bench: Bench) -> float:
    """Return X of the last report on the wire."""
    return float(re.findall(rb"MPos:(-?[\d.]+)", bench.wire("<"))[-1])


def state_and_position(bench: Bench) -> tuple[str, list[float]]:
    """Ask for state and position: its name, and X, Y, Z in mm."""
    connection = Connection(str(bench.port))
    assert connection.answers()
    connection.close()
    return connection.state(), connection.place()


def line_executed(text: str) -> int:
    """Return the number of the line that was being executed, by the output."""
    named = re.search(r"line (\d+) was being executed", text)
    assert named, text
    return int(named[1])


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_signal_holds_resets_and_names_the_line(
    bench: Bench, tmp_path: Path, number: signal.Signals
) -> None:
    """128 + its number is the usual exit code after a signal. The line named is the one whose
    part of the stairs has this X."""
    send = Send(bench, tmp_path, STAIRS)
    wait_until_x(bench, 5)
    os.kill(send.pid, number)
    code, text = send.end()
    state, (x, _, _) = state_and_position(bench)
    assert code == 128 + number
    sent = bench.wire(">")
    assert 0 < sent.index(b"!") < sent.index(b"\x18")
    assert state == "Idle" and x < 100
    # Line n is from X (n-1)/2 to n/2; the last report may be from the line before.
    assert (line_executed(text) - 2) / 2 <= x <= line_executed(text) / 2 + 0.02
    assert f"stopped: {number.name}" in text and "the machine is in Idle" in text


@pytest.mark.parametrize("answer", ["r", "a"])
def test_ctrl_c_holds_and_asks_whether_to_continue(
    bench: Bench, tmp_path: Path, answer: str
) -> None:
    """The last line ends at X30; an answer that is neither r nor a is asked for again."""
    send = Send(bench, tmp_path, STAIRS[:60], terminal=True)
    wait_until_x(bench, 5)
    send.press("\x03")
    send.wait_text("Type r to resume, or a to abort, then Enter")
    send.wait_text("r or a> ")
    send.press("what?\n")
    assert last_reported_x(bench) < 30
    send.press(f"{answer}\n")
    code, text = send.end()
    state, (x, _, _) = state_and_position(bench)
    assert (code, state) == (0 if answer == "r" else 1, "Idle")
    assert (x == 30.0) == ("being executed" not in text) == (answer == "r")


def test_closed_terminal_holds_first(bench: Bench, tmp_path: Path) -> None:
    """The process receives SIGHUP and ends by itself."""
    send = Send(bench, tmp_path, STAIRS, terminal=True)
    send.wait_text("keys:")
    wait_until_x(bench, 5)
    os.close(send.master)
    _, status = os.waitpid(send.pid, 0)
    assert os.waitstatus_to_exitcode(status) == 128 + signal.SIGHUP
    state, (x, _, _) = state_and_position(bench)
    assert state == "Idle" and 5 <= x < 100
    sent = bench.wire(">")
    assert sent.index(b"!") < sent.index(b"\x18")


@pytest.mark.sampled(1)
def test_refused_line_ends_the_program_without_a_terminal(bench: Bench, tmp_path: Path) -> None:
    """Nobody can be asked how to continue."""
    lines = [*STAIRS[:20], "T1 M6", *STAIRS[20:]]
    send = Send(bench, tmp_path, lines, "--no-check")
    code, text = send.end()
    state, (x, _, _) = state_and_position(bench)
    assert code == 1 and state == "Idle"
    assert "line 21: T1 M6: error:20" in text and x < 25


@pytest.mark.parametrize("mode", ["count", "line"])
def test_only_the_refused_line_is_named_as_the_last_one(
    bench: Bench, tmp_path: Path, mode: str
) -> None:
    """The simulator's machine refuses line 2, O1000. With character counting all lines were
    sent by then, with --mode line only those before."""
    lines = ["%", "O1000", "(one)", "", "N10 G21 G90", "N20 G1 X1 F900", "N30 T1 M6", "%"]
    code, text = Send(bench, tmp_path, lines, "--no-check", "-y", "--mode", mode).end()
    assert code == 1 and "stopped: line 2 was refused" in text
    assert ("lines up to 8 had already been sent" in text) == (mode == "count")
    assert ("line 2 was answered last" in text) == (mode == "line")


def test_refused_line_asks_and_can_be_skipped(bench: Bench, tmp_path: Path) -> None:
    """k: keep going, which also skips the second refusal (G64)."""
    lines = ["G21 G90 F900", "G1 X1", "T1 M6", "G1 X2", "G64", "G1 X3"]
    send = Send(bench, tmp_path, lines, "--no-check", terminal=True)
    send.wait_text("keep going")
    send.press("k\n")
    code, text = send.end()
    assert code == 1 and "6 lines, 2 errors" in text
    assert state_and_position(bench) == ("Idle", [3.0, 0.0, 0.0])


def test_keys_hold_and_resume_and_m0_shows_its_comment(bench: Bench, tmp_path: Path) -> None:
    """Space holds, ~ resumes, Enter continues after M0."""
    lines = ["G21 G90 F900", "G1 X8", "M0 (Fräser 3 mm)", "G1 X9"]
    send = Send(bench, tmp_path, lines, terminal=True)
    wait_until_x(bench, 1)
    send.press(" ")
    send.wait_text("the machine is in Hold")
    send.press("~")
    send.wait_text("line 3: M0 pauses: Fräser 3 mm")
    send.press("\n")
    code, text = send.end()
    assert code == 0, text
    assert state_and_position(bench)[1][0] == 9.0


def test_soft_limits_of_the_machine_are_used(bench: Bench, tmp_path: Path) -> None:
    """X0 of work is at -50 of the machine, whose travel ends at -100: X-60 would be at -110."""
    connection = Connection(str(bench.port))
    assert connection.answers()
    for setting in ("$22=1", "$20=1", "$130=100"):
        assert connection.ask(setting)[-1] == "ok"
    connection.ask("G10 L2 P1 X-50")
    connection.close()
    code, text = Send(bench, tmp_path, ["G21 G90 G1 X40 F900", "X-60"]).end()
    assert code == 1 and "line 2: ALARM:2" in text and "1 line would be refused" in text
    assert state_and_position(bench) == ("Idle", [0.0, 0.0, 0.0])


def test_alarm_names_the_line_being_executed(bench: Bench, tmp_path: Path) -> None:
    """Hard limits are on, and X moves into a switch."""
    connection = Connection(str(bench.port))
    assert connection.answers()
    assert connection.ask("$21=1")[-1] == "ok"  # the bench's switch is at 20 mm
    connection.close()
    code, text = Send(bench, tmp_path, STAIRS).end()
    assert code == 1 and "stopped: ALARM:1" in text
    # Line 40 ends at the switch, 20 mm; the line is that of the last report before the alarm.
    assert 30 <= line_executed(text) <= 41
    assert "the machine is in Alarm: reset it (Ctrl-X), then home it" in text


def test_from_line_restores_modes_tool_and_position(bench: Bench, tmp_path: Path) -> None:
    """The program is in inches: X0.8 is 20.32 mm. It starts at its sixth line, after a lead
    that the tool computes in mm: up, spindle on, across, down."""
    lines = ["G20 G91.1 G90", "M3 S1000", "G0 Z0.2", "G0 X0.4", "G1 Z-0.1 F20", "X0.8", "Z0.2"]
    send = Send(bench, tmp_path, lines, "--from-line", "6", "--yes")
    code, text = send.end()
    assert code == 0, text
    assert state_and_position(bench)[1] == [20.32, 0.0, 5.08]
    assert "up to Z5.080" in text and "across to X10.160 Y0.000" in text
    assert "down to Z-2.540 at 508 mm/min" in text and "spindle on: M3 S1000" in text
    sent = [line for line in bench.wire(">").replace(b"?", b"").split(b"\n") if line]
    lead = [b"G53 G0 Z5.080", b"M3 S1000", b"G4 P4", b"G53 G0 X10.160 Y0.000"]
    assert sent[-10:-3] == [b"G21 G90 G94 M5", *lead, b"G53 G1 Z-2.540 F508", b"F508"]
    assert {b"G1", b"G20", b"G90", b"S1000"} <= set(sent[-3].split())
    assert sent[-2:] == [b"X0.8", b"Z0.2"]  # lines 6 and 7 of the program


def test_from_line_sends_g93_and_large_numbers_in_a_form_that_grbl_accepts(
    bench: Bench, tmp_path: Path
) -> None:
    """G93 (inverse time) must stand alone, because each move under it needs its own F."""
    lines = ["G21 G90 S2000000", "G10 P1 L20 X0", "G1 X1 F2000000", "G93", "X2 F60", "G1 X3 F60"]
    code, text = Send(bench, tmp_path, lines, "--from-line", "6", "--yes").end()
    assert code == 0 and "line 2 sets the origin where the tool is" in text, text
    assert state_and_position(bench)[1][0] == 3.0
    sent = bench.wire(">").replace(b"?", b"").split(b"\n")
    assert sent[-4:-1] == [b"G1 G54 G17 G21 G90 S2000000", b"G93", b"G1 X3 F60"]


def test_from_line_keeps_a_laser_dark_until_it_moves(bench: Bench, tmp_path: Path) -> None:
    """M3 with G1 in force would burn a dot into the work: the lead switches to G0 first. Line 4
    continues a G1 cut, which cannot begin in the middle."""
    connection = Connection(str(bench.port))
    assert connection.answers() and connection.ask("$32=1")[-1] == "ok"
    connection.close()
    lines = ["G21 G90 M3 S500", "G0 X10 Y10", "G1 X12 F1000", "X13", "G0 X14", "G1 X15", "M5"]
    code, text = Send(bench, tmp_path, lines, "--from-line", "4", "--yes").end()
    assert code == 1 and "line 4 continues G1" in text
    code, text = Send(bench, tmp_path, lines, "--from-line", "5", "--yes").end()
    assert code == 0, text
    sent = bench.wire(">").replace(b"?", b"").split(b"\n")
    lead = sent[sent.index(b"G0 M3 S500") :]
    assert not [line for line in lead[: lead.index(b"G0 X14")] if b"G1 " in line]
    assert state_and_position(bench)[1][0] == 15.0


CUSTOM = """\
from ugrbl import gcode, mcode, on

@gcode(101, "xy", sync=None)
def cut(m, X=0, Y=0):
    m.g("G1 X%g Y%g" % (X, Y))

@mcode(100, "P")
def vacuum(m, P):
    m.out("vacuum", P)

@on.tool_change
def change(m, tool):
    m.message("tool %d" % tool)
"""
CUSTOM_PROGRAM = [
    *("G21 G90", "G0 Z5", "M100 P1", "T1 M6", "M3 S1000", "G1 Z-1 F900"),
    *("G101 X5 Y2", "G101 X5 Y4", "G1 X6 Y4", "G0 Z5"),
]


@pytest.fixture
def own_bench(tmp_path: Path) -> Iterator[Bench]:
    """Start a machine with its own Python in mine.py."""
    (tmp_path / "mine.py").write_text(CUSTOM)
    running = Bench(tmp_path, "--custom", str(tmp_path / "mine.py"), settings=SETTINGS)
    unlock(running)
    yield running
    running.kill()


def test_user_words_unknown_to_the_simulator_are_not_refusals(
    own_bench: Bench, tmp_path: Path
) -> None:
    """The rehearsal does not know M100, T1 M6 and G101, but the machine has them by its own
    Python."""
    code, text = Send(own_bench, tmp_path, CUSTOM_PROGRAM).end()
    assert code == 0, text
    assert (
        "unknown to the simulator: line 3, M100, and 3 more lines; --custom FILE simulates them"
        in text
    )
    assert state_and_position(own_bench)[1] == [6.0, 4.0, 5.0]


def test_line_unknown_to_the_machine_is_refused_in_spite_of_user_words(
    own_bench: Bench, tmp_path: Path
) -> None:
    """M102 is not in the list that the machine reports of its own words."""
    code, text = Send(own_bench, tmp_path, [*CUSTOM_PROGRAM, "M102"]).end()
    assert code == 1 and "line 11: M102" in text and "1 line would be refused" in text
    assert state_and_position(own_bench) == ("Idle", [0.0, 0.0, 0.0])


def test_user_words_are_rehearsed_with_their_file(own_bench: Bench, tmp_path: Path) -> None:
    code, text = Send(
        own_bench, tmp_path, CUSTOM_PROGRAM, "--custom", str(tmp_path / "mine.py")
    ).end()
    assert code == 0 and "not known" not in text, text


@pytest.mark.parametrize("check", ["--check", "--no-check"])
def test_from_line_refuses_to_start_after_user_words_that_may_have_moved(
    own_bench: Bench, tmp_path: Path, check: str
) -> None:
    """Without their Python the tool cannot know where M100 or G101 have moved the machine."""
    words = (check, "--from-line", "9", "--yes")
    code, text = Send(own_bench, tmp_path, CUSTOM_PROGRAM, *words).end()
    assert code == 1 and "--custom FILE" in text
    assert "the simulator refuses line 3: M100 P1" in text
    assert state_and_position(own_bench) == ("Idle", [0.0, 0.0, 0.0])
    assert b"G53" not in own_bench.wire(">")


def test_from_line_follows_the_moves_of_user_words_in_their_file(
    own_bench: Bench, tmp_path: Path
) -> None:
    """With their Python the rehearsal knows the position before line 9: X5 Y4."""
    words = ("--from-line", "9", "--yes", "--custom", str(tmp_path / "mine.py"))
    code, text = Send(own_bench, tmp_path, CUSTOM_PROGRAM, *words).end()
    assert code == 0, text
    assert "across to X5.000 Y4.000" in text and "note: vacuum has to be on" in text
    assert b"G53 G0 X5.000 Y4.000" in own_bench.wire(">")
    assert state_and_position(own_bench)[1] == [6.0, 4.0, 5.0]


@pytest.mark.parametrize("words", [[], ["--no-check", "--from-line", "4", "--yes"]])
def test_file_that_differs_from_the_machines_is_refused(
    own_bench: Bench, tmp_path: Path, words: list[str]
) -> None:
    """The file given has another event handler (tool_select)."""
    other = tmp_path / "other.py"
    other.write_text(CUSTOM.replace("tool_change", "tool_select"))
    code, text = Send(own_bench, tmp_path, CUSTOM_PROGRAM, *words, "--custom", str(other)).end()
    expected = (
        "differs from the Python on the machine: G101, M100, on.tool_change there, G101, M100, on"
    )
    assert code == 1 and expected in " ".join(text.split())
    assert state_and_position(own_bench) == ("Idle", [0.0, 0.0, 0.0])


def test_from_line_refuses_to_start_after_a_refused_line(bench: Bench, tmp_path: Path) -> None:
    """The refused line (G64) may have meant something that later lines need."""
    lines = [*STAIRS[:5], "G64", *STAIRS[5:9]]
    words = ("--no-check", "--from-line", "8", "--yes")
    code, text = Send(bench, tmp_path, lines, *words).end()
    assert code == 1 and "the simulator refuses line 6: G64" in text
    assert state_and_position(bench) == ("Idle", [0.0, 0.0, 0.0])


def test_unreadable_custom_file_is_reported_before_the_machine_is_asked(
    bench: Bench, tmp_path: Path
) -> None:
    code, text = Send(bench, tmp_path, STAIRS, "--custom", str(tmp_path / "none.py")).end()
    assert code == 1 and "none.py cannot be read" in text and "Traceback" not in text


def test_from_line_moves_nothing_without_consent(bench: Bench, tmp_path: Path) -> None:
    code, text = Send(bench, tmp_path, STAIRS, "--from", "50").end()
    assert code == 1 and "--yes" in text
    assert state_and_position(bench) == ("Idle", [0.0, 0.0, 0.0])


def test_remaining_time_comes_from_the_simulation(bench: Bench, tmp_path: Path) -> None:
    """On a terminal with a live display; the job is checked by a simulation first."""
    send = Send(bench, tmp_path, STAIRS[:160], terminal=True, dumb=False)
    text = send.wait_text(" left")
    time_left = re.search(r"0:00:(\d\d) left", text)
    assert time_left and 1 <= int(time_left[1]) <= 6  # 80 mm at 15 mm/s: 5.3 s
    assert send.end()[0] == 0


def test_program_is_read_from_stdin(bench: Bench, tmp_path: Path) -> None:
    """The file name "-" means standard input."""
    command = [sys.executable, "-m", "ugrbl.cli", "send", "-", "--port", str(bench.port)]
    done = subprocess.run(
        command,
        input="G21 G90\nG1 X2 F900\n",
        capture_output=True,
        text=True,
        env=_environment(),
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert state_and_position(bench)[1][0] == 2.0


def test_line_is_named_from_reports_of_work_positions(bench: Bench, tmp_path: Path) -> None:
    """$10=2: reports have the work position (WPos), which differs from the machine's by the
    offset."""
    connection = Connection(str(bench.port))
    assert connection.answers()
    for line in ("$10=2", "G10 L2 P1 Y-30"):
        assert connection.ask(line)[-1] == "ok"
    connection.close()
    send = Send(bench, tmp_path, STAIRS)
    end_s = time.monotonic() + _PATIENCE_S
    while not re.search(rb"<Run\|WPos:[5-9]", bench.wire("<")):
        assert time.monotonic() < end_s
        time.sleep(0.05)
    os.kill(send.pid, signal.SIGTERM)
    _, text = send.end()
    named_line = line_executed(text)
    connection = Connection(str(bench.port))
    assert connection.wait_for(lambda line: bool(connection.place()), 5)
    connection.close()
    x = connection.work_place()[0]
    # Line n is from X (n-1)/2 to n/2; the last report may be from the line before.
    assert (named_line - 2) / 2 <= x <= named_line / 2 + 0.02, text


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no full disk to test with")
@pytest.mark.parametrize(("words", "x"), [([], 0.0), (["--no-check"], 20.0)])
def test_full_disk_starts_no_job_and_ends_none(
    bench: Bench, tmp_path: Path, words: list[str], x: float
) -> None:
    """/dev/full refuses each write as a full disk does. The check before the job fails then;
    without it (--no-check) the job runs to its end, X20."""
    file = tmp_path / "job.nc"
    file.write_text("\n".join(STAIRS[:40]))
    command = [sys.executable, "-m", "ugrbl.cli", "send", str(file), "--port", str(bench.port)]
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [*command, *words],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            env=_environment(),
            check=False,
        )
    assert "the disk is full" in done.stderr and "Traceback" not in done.stderr
    assert state_and_position(bench) == ("Idle", [x, 0.0, 0.0])
    assert (done.returncode == 0) == ("40 lines, 0 errors" in done.stderr) == (x > 0)


def test_closed_output_pipe_ends_no_job(bench: Bench, tmp_path: Path) -> None:
    """Nobody reads the output of the command."""
    file = tmp_path / "job.nc"
    file.write_text("\n".join(STAIRS[:40]))
    command = [sys.executable, "-m", "ugrbl.cli", "send", str(file), "--port", str(bench.port)]
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [*command, "--no-check"],
        stdin=subprocess.DEVNULL,
        stdout=write,
        stderr=subprocess.PIPE,
        text=True,
        env=_environment(),
        check=False,
    )
    os.close(write)
    assert "40 lines, 0 errors" in done.stderr and "Traceback" not in done.stderr
    assert state_and_position(bench) == ("Idle", [20.0, 0.0, 0.0])


def test_command_that_needs_a_board_reports_the_simulator(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    custom_pull = CliRunner().invoke(app, ["custom", "pull", "x.py", "--port", str(bench.port)])
    assert custom_pull.exit_code == 1 and "the simulator answers on" in custom_pull.output
    doctor = ["doctor", "--port", str(bench.port), "--pins", "0", "--no-move"]
    assert "Grbl sim: it is the simulator" in CliRunner().invoke(app, doctor).output


def test_unplugged_cable_is_reported_with_line_and_state(bench: Bench, tmp_path: Path) -> None:
    send = Send(bench, tmp_path, STAIRS)
    wait_until_x(bench, 5)
    bench.kill()
    code, text = send.end()
    assert code == 1 and "has the simulator ended?" in text and line_executed(text) > 10
    assert "was in Run, and goes on" in text
