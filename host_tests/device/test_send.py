"""Test `ugrbl send` against a small stand-in for Grbl on a real pseudo-terminal.

Stream sends lines to the controller: with character counting it fills the receive buffer of 128
bytes, with by_line it waits for each answer. It asks the user (a View) how to continue after a
refused line or Ctrl-C. "!" is a feed hold, "~" resumes, Ctrl-X resets."""

import errno
import io
import os
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import serial
from rich.console import Console
from typer.testing import CliRunner, Result
from ugrbl.cli import keys
from ugrbl.cli.app import app
from ugrbl.cli.screen import Screen
from ugrbl.device import connection as connection_module
from ugrbl.device.connection import Connection, SendError, broke
from ugrbl.device.send import Choice, Line, Ready, Stream
from ugrbl.grbl.gcode_file import CYCLE_START, FEED_HOLD, RESET, STATUS
from ugrbl.grbl.messages import meaning

_ANSWER_S = 0.002


class FakeGrbl(threading.Thread):
    """Answers each line after a moment: G64 with error:20, G38 with an alarm, others with ok.

    options: of its build, with the receive buffer's size. old: it talks like Grbl 0.9, and slows
    down for three reports before its hold is complete. lines: executed; realtime: real-time bytes
    received, except "?"; most_waiting, most_bytes: the most lines and bytes that have waited.
    """

    def __init__(self, options: str = "V,15,128", state: str = "Idle", old: bool = False) -> None:
        super().__init__(daemon=True)
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self.options = options
        self.state = state
        self.old = old
        self._braking = 0
        self.drains: list[int] = []  # in the next reports; the last one stays
        self.reports_after_answers = False  # in one write with the next answer
        self._report_due = ""
        self.lines: list[bytes] = []
        self.realtime = b""
        self.most_waiting = 0
        self.most_bytes = 0
        self._waiting = b""
        self._stopped = threading.Event()

    def run(self) -> None:
        """Every 2 ms: receive, and execute one waiting line unless the machine is held."""
        while not self._stopped.wait(_ANSWER_S):
            self._receive()
            self.most_waiting = max(self.most_waiting, self._waiting.count(b"\n"))
            self.most_bytes = max(self.most_bytes, len(self._waiting))
            if b"\n" in self._waiting and not self.state.startswith(("Hold", "Door", "Sleep")):
                line, _, self._waiting = self._waiting.partition(b"\n")
                self.lines.append(line)
                self._answer(line)

    def stop(self) -> None:
        self._stopped.set()
        self.join()
        os.close(self._master)
        os.close(self._slave)

    def say(self, text: str) -> None:
        os.write(self._master, text.encode() + b"\r\n")

    def _receive(self) -> None:
        """Separate real-time bytes, which act at once, from lines."""
        try:
            data = os.read(self._master, 4096)
        except BlockingIOError:
            return
        for byte in (bytes([value]) for value in data):
            if byte == STATUS:
                self._report()
            elif byte in (FEED_HOLD, CYCLE_START, RESET) or byte[0] >= 0x80:
                self._command(byte)
            else:
                self._waiting += byte

    def _report(self) -> None:
        """Send a status report; "Dr:" is our count of underruns."""
        self._braking = max(0, self._braking - 1)
        position = f"{1 - self._braking / 10:.3f},2.000,3.000"
        if self.old:
            self.say(f"<{self.state},MPos:{position},WPos:{position}>")
        else:
            drains = self.drains[0] if self.drains else 0
            if len(self.drains) > 1:
                del self.drains[0]
            underrun_field = f"|Dr:{drains}" if drains else ""
            report = f"<{self.state}|MPos:{position}|FS:0,0{underrun_field}>"
            if self.reports_after_answers and self._waiting:
                self._report_due = f"\r\n{report}"
            else:
                self.say(report)

    def _command(self, byte: bytes) -> None:
        """Act on a real-time byte; others than these three are only recorded."""
        self.realtime += byte
        if byte == FEED_HOLD:
            self.state = "Hold" if self.old else "Hold:0"
            self._braking = 4 if self.old else 0  # the fourth report from now shows 0
        elif byte == CYCLE_START:
            self.state = "Idle"
        elif byte == RESET:
            self.braking_at_reset = self._braking
            self.state = "Idle"
            self._waiting = b""
            self.say("\r\nGrbl 1.1h ['$' for help]")

    def _answer(self, line: bytes) -> None:
        """Answer a line that is executed now, with its messages."""
        if line == b"$I":
            self.say(f"[VER:1.1h.20190830:]\r\n[OPT:{self.options}]")
        if line.startswith(b"G38"):
            self.state = "Alarm"
            self.say("ALARM:4")
        elif line == b"M2":
            self.say("[MSG:Pgm End]")
        report, self._report_due = self._report_due, ""
        self.say(("error:20" if line.startswith(b"G64") else "ok") + report)


class Watcher:
    """A View that records what it is shown; `answers` are its answers to questions."""

    def __init__(self) -> None:
        self.messages: list[str] = []
        self.states: list[str] = []
        self.answers: list[Choice] = []
        self.questions: list[str] = []
        self.pressed: list[bytes] = []

    def progress(self, answered: int, status: str) -> None:
        self.states.append(status)

    def message(self, text: str) -> None:
        self.messages.append(text)

    def ask(self, why: str) -> Choice:
        self.questions.append(why)
        return self.answers.pop(0)

    def keys(self) -> bytes:
        return self.pressed.pop(0) if self.pressed else b""


@pytest.fixture
def grbl() -> Iterator[FakeGrbl]:
    """Return a running stand-in."""
    fake = FakeGrbl()
    fake.start()
    yield fake
    fake.stop()


@pytest.fixture
def connection(grbl: FakeGrbl) -> Iterator[Connection]:
    """Return a connection to it after the start queries."""
    opened = Connection(grbl.port)
    opened.start()
    grbl.lines.clear()
    yield opened
    opened.close()


@pytest.fixture
def view() -> Watcher:
    return Watcher()


def program(count: int) -> list[bytes]:
    return [b"G1 X%d.125 Y%d.250 F1200" % (n, n) for n in range(count)]


def ready_lines(*lines: bytes) -> Ready:
    return Ready(lines)


def ready_program(count: int) -> Ready:
    return Ready(program(count))


@pytest.mark.parametrize(("reported", "drains"), [([], 0), ([4], 0), ([4, 5, 7], 3), ([0, 1], 1)])
def test_underruns_caused_by_this_program_are_counted(
    grbl: FakeGrbl, connection: Connection, view: Watcher, reported: list[int], drains: int
) -> None:
    """reported: the counts in successive reports; the first one is from before."""
    grbl.drains = reported
    assert Stream(connection, ready_program(300), view).run().drains == drains


def test_report_sent_together_with_an_answer_counts_no_earlier_underrun(
    grbl: FakeGrbl, connection: Connection, view: Watcher
) -> None:
    """The first report with a count arrives only with an answer to the program; its underruns
    are earlier ones."""
    grbl.drains = [4]
    grbl.reports_after_answers = True
    assert Stream(connection, ready_program(300), view).run().drains == 0


def test_every_line_is_sent_and_answered(
    grbl: FakeGrbl, connection: Connection, view: Watcher
) -> None:
    report = Stream(connection, ready_program(50), view).run()
    assert grbl.lines == program(50)
    assert (report.answered, report.state, report.ok()) == (50, "Idle", True)


def test_counting_keeps_the_buffer_full_and_never_overfills_it(
    grbl: FakeGrbl, connection: Connection, view: Watcher
) -> None:
    Stream(connection, ready_program(50), view).run()
    assert grbl.most_waiting >= 4  # lines
    assert 100 < grbl.most_bytes <= 127  # of 128, of which Grbl can use 127


def test_mode_line_has_one_unanswered_line(
    grbl: FakeGrbl, connection: Connection, view: Watcher
) -> None:
    Stream(connection, ready_program(20), view, by_line=True).run()
    assert grbl.lines == program(20)
    assert grbl.most_waiting == 1


def test_larger_buffer_is_used(view: Watcher) -> None:
    """The machine reports a receive buffer of 512 bytes."""
    grbl = FakeGrbl(options="V,15,512")
    grbl.start()
    connection = Connection(grbl.port)
    connection.start()
    Stream(connection, ready_program(60), view).run()
    connection.close()
    grbl.stop()
    assert 400 < grbl.most_bytes <= 511


def test_refused_line_is_named_with_meaning_holds_and_asks(
    grbl: FakeGrbl, connection: Connection, view: Watcher
) -> None:
    """The stand-in refuses G64 with error:20; the user chooses to resume."""
    view.answers = [Choice.RESUME]
    report = Stream(connection, ready_lines(b"G21", b"G64 P0.1", b"G0 X1"), view).run()
    assert report.errors == [(2, "error:20")] and report.answered == 3
    assert view.messages == [f"line 2: G64 P0.1: error:20: {meaning('error:20')}"]
    assert view.questions == ["line 2 was refused"]
    assert grbl.realtime == FEED_HOLD + CYCLE_START


def test_lines_after_a_refused_lead_line_are_not_sent(
    grbl: FakeGrbl, connection: Connection, view: Watcher
) -> None:
    """Lead lines restore the state for a start in the middle of a program; without one of them
    the rest is dangerous."""
    view.answers = [Choice.ABORT]
    lead = [Line(0, line, "") for line in (b"G21", b"G64", b"G53 G0 Z5")]
    report = Stream(connection, [*lead, *ready_program(3)], view).run()
    assert report.stopped and grbl.lines == [b"G21", b"G64"]


def test_program_stops_after_a_refused_line_unless_the_user_continues(
    grbl: FakeGrbl, connection: Connection, view: Watcher
) -> None:
    view.answers = [Choice.ABORT]
    report = Stream(connection, ready_lines(b"G64", *program(50)), view).run()
    assert report.stopped == "line 1 was refused"
    assert grbl.realtime == FEED_HOLD + RESET
    assert len(grbl.lines) < 10  # those sent before the answer arrived


def test_keep_going_asks_only_once(grbl: FakeGrbl, connection: Connection, view: Watcher) -> None:
    view.answers = [Choice.KEEP_GOING]
    report = Stream(connection, ready_lines(b"G64", b"G64", b"G64"), view).run()
    assert len(view.questions) == 1 and len(report.errors) == 3 and not report.stopped


def test_refused_line_does_not_hold_with_keep_going(
    grbl: FakeGrbl, connection: Connection, view: Watcher
) -> None:
    report = Stream(connection, ready_lines(b"G64", b"G0 X1"), view, keep_going=True).run()
    assert len(report.errors) == 1 and grbl.realtime == b"" and len(grbl.lines) == 2


def test_alarm_stops_the_program_with_its_cause(connection: Connection, view: Watcher) -> None:
    report = Stream(connection, ready_lines(b"G21", b"G38.2 Z-1 F10", *program(50)), view).run()
    assert report.stopped == f"ALARM:4: {meaning('ALARM:4')}"
    assert report.answered < 50


def test_reset_of_the_controller_stops_the_program(
    grbl: FakeGrbl, connection: Connection, view: Watcher
) -> None:
    # after 50 ms of about a second
    threading.Timer(0.05, grbl.say, ["Grbl 1.1h ['$' for help]"]).start()
    report = Stream(connection, ready_program(500), view).run()
    assert report.stopped == "the controller was reset"


def test_messages_and_states_are_shown(connection: Connection, view: Watcher) -> None:
    Stream(connection, ready_lines(b"M2"), view).run()
    assert view.messages == ["[MSG:Pgm End]"]
    assert view.states[-1].startswith("<Idle|MPos:1.000,2.000,3.000")


def test_program_finishes_after_ctrl_c_and_resume(
    grbl: FakeGrbl, connection: Connection, view: Watcher
) -> None:
    """interrupt() is what Ctrl-C calls."""
    view.answers = [Choice.RESUME]
    stream = Stream(connection, ready_program(30), view)
    stream.interrupt()
    report = stream.run()
    assert view.questions == ["Ctrl-C"]
    assert grbl.realtime == FEED_HOLD + CYCLE_START
    assert (report.answered, report.stopped) == (30, "")


def test_waiting_for_the_users_answer_is_not_reported_as_silence(
    connection: Connection, view: Watcher, monkeypatch: pytest.MonkeyPatch
) -> None:
    """connection.heard: when bytes arrived last, in s. The view sees no message about a silent
    machine."""

    def think(why: str) -> Choice:
        time.sleep(0.3)  # reports of the hold arrive meanwhile
        connection.heard -= 3600
        return Choice.RESUME

    monkeypatch.setattr(view, "ask", think)
    connection.heard -= 3600  # as if the simulator had checked the program for an hour
    stream = Stream(connection, ready_program(50), view)
    stream.interrupt()
    assert stream.run().ok() and view.messages == []


def test_clock_runs_until_motion_ends() -> None:
    """All lines are answered after 5 s; the move ends after 65 s."""
    now = 0.0
    console = Console(file=io.StringIO(), get_time=lambda: now, width=100)
    with Screen(console, "job.nc", 1) as screen:
        now = 5.0
        screen.progress(1, "<Run|MPos:0.000,0.000,0.000>")
        now = 65.0
    assert "1/1 lines 0:01:05" in console.file.getvalue()


def test_refused_line_is_called_a_command_only_when_it_is_one() -> None:
    assert "'$' command" in meaning("error:3", "$X1") and "'$' command" in meaning("error:3")
    assert "custom.py" in meaning("error:3", "T2 M6") and "$" not in meaning("error:3", "T2 M6")
    assert meaning("error:20", "T2 M6") == meaning("error:20")


@pytest.mark.parametrize(
    ("reply", "line"), [("error:1", "G1 X10,5"), ("error:2", "X,5"), ("error:3", "$110=1,5")]
)
def test_decimal_comma_is_named_when_a_line_is_refused(reply: str, line: str) -> None:
    assert "decimal point, not a comma" in meaning(reply, line)
    assert "comma" not in meaning(reply, line.replace(",", ".") + " (1,5)")


def test_refused_setting_is_called_a_setting() -> None:
    assert meaning("error:3", "$999=1").startswith("This machine has no setting $999, or")
    assert "'$' command" in meaning("error:3", "$H=")


def test_ctrl_c_and_abort_reset_after_the_machine_has_stopped(
    grbl: FakeGrbl, connection: Connection, view: Watcher
) -> None:
    """The feed hold comes before the reset."""
    view.answers = [Choice.ABORT]
    stream = Stream(connection, ready_program(30), view)
    stream.interrupt()
    report = stream.run()
    time.sleep(0.05)  # s: the reset has arrived
    assert grbl.realtime == FEED_HOLD + RESET
    assert report.stopped == "Ctrl-C"
    assert len(grbl.lines) < 30


def test_locked_machine_is_refused() -> None:
    grbl = FakeGrbl(state="Alarm")
    grbl.start()
    connection = Connection(grbl.port)
    with pytest.raises(SendError, match="locked in Alarm"):
        connection.start()
    connection.close()
    grbl.stop()


def test_port_without_grbl_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody answers at the other end of this terminal."""
    monkeypatch.setattr(connection_module, "_START_S", 0.2)
    master, slave = os.openpty()
    connection = Connection(os.ttyname(slave))
    with pytest.raises(SendError, match="no Grbl answers"):
        connection.start()
    connection.close()
    os.close(master)
    os.close(slave)


def test_greeting_right_after_an_answer_is_not_the_answer() -> None:
    """A board greets a port some milliseconds after it was opened."""
    master, slave = os.openpty()
    connection = Connection(os.ttyname(slave))
    os.write(master, b"[VER:1.1h.20261121:]\r\nok\r\n\r\nGrbl 1.1h ['$' for help]\r\n")
    assert connection.ask("$I") == ["[VER:1.1h.20261121:]", "ok"]
    connection.close()
    os.close(master)
    os.close(slave)


def test_missing_port_is_named() -> None:
    with pytest.raises(SendError, match="/dev/nowhere"):
        Connection("/dev/nowhere")


def test_command_reports_refused_lines_and_fails(grbl: FakeGrbl, tmp_path: Path) -> None:
    file = tmp_path / "program.nc"
    file.write_text("G21\nG64\n")
    done = CliRunner().invoke(app, ["send", str(file), "--port", grbl.port, "--no-check"])
    assert done.exit_code == 1
    assert "line 2: G64: error:20" in done.output and "line 2 was refused" in done.output


def test_command_succeeds_in_mode_line(grbl: FakeGrbl, tmp_path: Path) -> None:
    """The command reads build, settings, offsets and modes before it sends the program."""
    file = tmp_path / "program.nc"
    file.write_text("G21\nG0 X1\n")
    done = CliRunner().invoke(app, ["send", str(file), "--port", grbl.port, "--mode", "line"])
    assert done.exit_code == 0, done.output
    assert grbl.lines == [b"$I", b"$$", b"$#", b"$G", b"G21", b"G0 X1"]


# Bytes that are sent, and bytes that are not


def send_file(grbl: FakeGrbl, folder: Path, text: str, *words: str) -> Result:
    """Run `ugrbl send` with a program of this text."""
    file = folder / "program.nc"
    file.write_bytes(text.encode("utf-8"))
    return CliRunner().invoke(app, ["send", str(file), "--port", grbl.port, *words])


def test_comments_are_sent_as_ascii_without_realtime_bytes(grbl: FakeGrbl, tmp_path: Path) -> None:
    """In a comment letters lose their accents, and "!" and "?", which are real-time commands,
    become dots."""
    done = send_file(grbl, tmp_path, "(Ä Ö à!)\nG0 X1 ; Größe?\n")
    assert done.exit_code == 0, done.output
    assert grbl.lines[-2:] == [b"(A O a.)", b"G0 X1 ; Grosse."]
    assert grbl.realtime == b""
    assert "line 1: 'Ä'" in done.output


def test_underruns_are_reported_with_the_remedy(grbl: FakeGrbl, tmp_path: Path) -> None:
    grbl.drains = list(range(1000))  # one more with each report
    done = send_file(grbl, tmp_path, "G0 X1\n" * 400, "--no-check", "--mode", "line")
    words = " ".join(done.output.split())
    assert "because lines came too late: `ugrbl run FILE --board NAME` names lines" in words


def test_percent_signs_at_the_ends_of_a_file_are_not_sent(grbl: FakeGrbl, tmp_path: Path) -> None:
    done = send_file(grbl, tmp_path, "%\nG0 X1\n%\n", "--no-check")
    assert done.exit_code == 0, done.output
    assert b"G0 X1" in grbl.lines and b"%" not in grbl.lines


def test_realtime_byte_outside_a_comment_is_refused_before_sending(
    grbl: FakeGrbl, tmp_path: Path
) -> None:
    """The degree sign has bytes that Grbl takes as real-time commands."""
    done = send_file(grbl, tmp_path, "G0 X1\nG0 X2°\n\x18\n")
    assert done.exit_code == 1 and grbl.lines == []
    assert "line 2: '°'" in done.output and "line 3: Ctrl-X is a reset" in done.output


@pytest.mark.parametrize("text", ["", "\n\n", "PK\0\3"])
def test_file_that_is_not_a_program_is_refused(grbl: FakeGrbl, tmp_path: Path, text: str) -> None:
    done = send_file(grbl, tmp_path, text)
    assert done.exit_code == 1 and grbl.lines == []
    assert "program.nc is" in done.output


def test_program_refused_by_the_simulator_is_not_sent(grbl: FakeGrbl, tmp_path: Path) -> None:
    done = send_file(grbl, tmp_path, "G0 X1\nT1 M6\n")
    assert done.exit_code == 1 and b"G0 X1" not in grbl.lines
    assert "line 2" in done.output and "--no-check" in done.output


@pytest.mark.parametrize(
    ("options", "word", "sent"),
    [("V", "M7", False), ("VM", "M7", True), ("V", "M56", False), ("VR", "M56", True)],
)
def test_check_uses_the_build_options_of_the_machine(
    options: str, word: str, sent: bool, tmp_path: Path
) -> None:
    """M means that M7 is supported, R that M56 is; the rehearsal refuses what the machine
    would."""
    grbl = FakeGrbl(options=f"{options},15,128")
    grbl.start()
    done = send_file(grbl, tmp_path, f"G0 X1\n{word}\n")
    grbl.stop()
    assert (word.encode() in grbl.lines) == sent, done.output
    assert done.exit_code == (0 if sent else 1)


def test_keep_going_sends_lines_that_the_simulator_refuses(grbl: FakeGrbl, tmp_path: Path) -> None:
    done = send_file(grbl, tmp_path, "G0 X1\nG64\nG0 X2\n", "--keep-going")
    assert done.exit_code == 1 and grbl.lines[-1] == b"G0 X2"


# States


@pytest.mark.parametrize(
    ("state", "todo"),
    [
        ("Hold:0", "resume (~)"),
        ("Door:0", "close the safety door"),
        ("Sleep", "reset it"),
        ("Run", "wait until the job has ended"),
        ("Alarm", "$X"),
    ],
)
def test_machine_that_cannot_run_is_reported_with_the_remedy(state: str, todo: str) -> None:
    """The connection is refused at its start in each of these states."""
    grbl = FakeGrbl(state=state)
    grbl.start()
    connection = Connection(grbl.port)
    with pytest.raises(SendError) as raised:
        connection.start()
    connection.close()
    grbl.stop()
    assert state.partition(":")[0] in str(raised.value) and todo in str(raised.value)


def test_unanswered_request_names_the_hold_as_cause(
    grbl: FakeGrbl, connection: Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection_module, "_START_S", 0.5)
    grbl.state = "Hold:0"
    with pytest.raises(SendError, match=r"no answer to \$\$: in Hold:0 .* resume"):
        connection.ask("$$")


def test_grbl_0_9_is_understood(view: Watcher) -> None:
    """Its reports are separated by commas, and have no FS field."""
    grbl = FakeGrbl(old=True)
    grbl.start()
    connection = Connection(grbl.port)
    connection.start()
    assert connection.place() == [1.0, 2.0, 3.0]
    report = Stream(connection, ready_program(20), view).run()
    connection.close()
    grbl.stop()
    assert (report.answered, report.state, report.ok()) == (20, "Idle", True)


def test_grbl_0_9_is_reset_only_after_it_has_stopped(view: Watcher) -> None:
    """A reset in motion loses steps; braking_at_reset: reports for which it still had to brake."""
    grbl = FakeGrbl(old=True)
    grbl.start()
    connection = Connection(grbl.port)
    connection.start()
    view.answers = [Choice.ABORT]
    stream = Stream(connection, ready_program(50), view)
    stream.interrupt()
    stream.run()
    connection.close()
    grbl.stop()
    assert grbl.braking_at_reset == 0


def test_override_keys_are_sent_only_to_grbl_1_1(grbl: FakeGrbl, view: Watcher) -> None:
    """0x91 is an override of the feed rate, which Grbl 0.9 does not have."""
    for old, sent in ((False, b"\x91!~"), (True, b"!~")):
        grbl = FakeGrbl(old=old)
        grbl.start()
        connection = Connection(grbl.port)
        connection.start()
        view.pressed = [b"", b"\x91!", b"~"]
        Stream(connection, ready_program(20), view).run()
        connection.close()
        grbl.stop()
        assert grbl.realtime == sent


def test_arrow_keys_are_not_commands() -> None:
    assert keys.commands("\x1b[A+\x1bOB-\x1b") == b"\x91\x92"
    assert keys.commands(" ~q") == b"!~"


class WindowsConsole:
    """Stands in for msvcrt: one key per read, two reads for arrows and function keys."""

    def __init__(self, pressed: str) -> None:
        self.pressed = list(pressed)

    def kbhit(self) -> bool:
        return bool(self.pressed)

    def getwch(self) -> str:
        return self.pressed.pop(0)


@pytest.mark.parametrize(
    ("pressed", "sent"),
    [(" +", b"!\x91"), ("\xe0H\xe0M", b""), ("\0<\0=\0>-", b"\x92"), ("\r", b"~"), ("", b"")],
)
def test_keys_on_windows(pressed: str, sent: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    """Arrow and function keys are two characters, the first 0xE0 or zero: F2 to F4 are a zero
    and then < = >, which would be commands without the zero."""
    monkeypatch.setattr(keys.sys, "platform", "win32")
    monkeypatch.setattr(keys.sys.stdin, "isatty", lambda: True, raising=False)
    monkeypatch.setitem(sys.modules, "msvcrt", WindowsConsole(pressed))
    with keys.Keys() as listening:
        assert listening.commands() == sent
        assert listening.commands() == b"", "all that was pressed has been read"
    with keys.Keys(listen=False) as not_listening:
        assert not_listening.commands() == b""


def test_sleep_of_the_machine_ends_the_program(
    grbl: FakeGrbl, connection: Connection, view: Watcher
) -> None:
    def sleep() -> None:
        grbl.state = "Sleep"

    threading.Timer(0.1, sleep).start()  # after 0.1 s of about a second
    report = Stream(connection, ready_program(500), view).run()
    assert "gone to sleep" in report.stopped


def test_opened_door_is_reported_once_and_the_job_continues(
    grbl: FakeGrbl, connection: Connection, view: Watcher
) -> None:
    """The door is open from 0.1 to 0.9 s after the start."""

    def door(state: str) -> None:
        grbl.state = state

    threading.Timer(0.1, door, ["Door:0"]).start()
    threading.Timer(0.9, door, ["Idle"]).start()  # s: several reports have Door by then
    report = Stream(connection, ready_program(100), view).run()
    assert view.messages == ["the machine is in Door:0: close the safety door and resume (~)"]
    assert report.ok() and report.answered == 100


# Ends


def test_unplugged_cable_is_reported_with_the_line(grbl: FakeGrbl, view: Watcher) -> None:
    """The other end of the terminal is closed after 0.3 s."""
    master, slave = os.openpty()
    connection = Connection(os.ttyname(slave))
    os.close(slave)
    threading.Timer(0.3, os.close, [master]).start()
    report = Stream(connection, ready_program(10), view).run()
    connection.close()
    assert report.lost and report.stopped == "the connection broke: has the simulator ended?"


def test_internal_fault_holds_the_machine_first(
    grbl: FakeGrbl, connection: Connection, view: Watcher, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The view raises while the program runs."""

    def broken(answered: int, status: str) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(view, "progress", broken)
    with pytest.raises(ZeroDivisionError):
        Stream(connection, ready_program(50), view).run()
    time.sleep(0.05)  # s: all bytes have arrived
    assert grbl.realtime == FEED_HOLD


def test_full_disk_ends_the_program_like_an_abort(
    grbl: FakeGrbl, connection: Connection, view: Watcher, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The view cannot write its output."""

    def full(answered: int, status: str) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(view, "progress", full)
    report = Stream(connection, ready_program(50), view).run()
    assert "the disk is full" in report.stopped and report.answered < 50
    assert grbl.realtime == FEED_HOLD + RESET


def test_port_in_use_is_reported(grbl: FakeGrbl, connection: Connection) -> None:
    with pytest.raises(SendError, match="another program has it"):
        Connection(grbl.port)


def open_port_raising(number: int, text: str) -> Callable[..., None]:
    """Return an open_port that raises what pyserial raises."""

    def open_port(*_: object, **__: object) -> None:
        raise serial.SerialException(number, text) if number else serial.SerialException(text)

    return open_port


@pytest.mark.parametrize(
    ("port", "words"),
    [
        ("/dev/nowhere", "no such port; is the cable one that carries data?"),
        ("nowhere/grbl", "no such port; is its name right, and does the simulator run?"),
        ("socket://127.0.0.1:1", "no program listens there; does the firmware or simulator run"),
        ("socket://127.0.0.1:99999", "needs a host and a port: socket://HOST:PORT"),
        ("rfc2217://127.0.0.1:1", "no program listens there;"),
        ("foo://x", "a port is a device, or socket://HOST:PORT"),
    ],
)
def test_port_that_cannot_be_opened_is_reported_in_our_words(port: str, words: str) -> None:
    with pytest.raises(SendError) as raised:
        Connection(port)
    text = str(raised.value)
    assert text.startswith(f"cannot open {port}: ") and words in text
    assert "Errno" not in text and "could not" not in text.lower()


@pytest.mark.parametrize(
    ("number", "theirs", "words"),
    [
        (errno.EACCES, "could not open port", "permission denied; add yourself to its group"),
        (errno.EBUSY, "could not open port", "another program has it; close that"),
        (
            0,
            "could not open port 'COM3': PermissionError(13, 'Access is denied.')",
            "another prog",
        ),
        (0, "could not open port 'COM3': FileNotFoundError(2, '…')", "no such port"),
        (errno.EPROTO, "could not open port", r"refuses it \(EPROTO\); unplug it, plug it in"),
        (0, "something new", "unplug it, plug it in, and try again"),
    ],
)
def test_refusal_by_the_system_is_reported_in_our_words(
    monkeypatch: pytest.MonkeyPatch, number: int, theirs: str, words: str
) -> None:
    """number, theirs: error number and text of pyserial; without a number the text has the
    cause."""
    monkeypatch.setattr(serial, "serial_for_url", open_port_raising(number, theirs))
    with pytest.raises(SendError, match=words) as raised:
        Connection("/dev/ttyACM0")
    assert theirs not in str(raised.value)


def test_impossible_baud_rate_is_named(grbl: FakeGrbl) -> None:
    with pytest.raises(SendError, match=r"does not support -1 baud; Grbl 1[.]1 uses 115200"):
        Connection(grbl.port, -1)


@pytest.mark.parametrize(
    ("port", "look"),
    [
        ("/dev/ttyACM0", "the cable still plugged in"),
        ("socket://192.168.4.1:23", "in this network"),
        ("/dev/pts/999", "the simulator ended"),
        ("some/link", "the simulator ended"),
    ],
)
def test_broken_connection_names_the_likely_cause(port: str, look: str) -> None:
    assert look in broke(port)


def test_file_is_not_accepted_as_a_port(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(SendError, match="no serial port"):
        Connection(str(file))
