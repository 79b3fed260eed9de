"""`ugrbl send`, against a small stand-in for Grbl on a real pseudo-terminal."""

import os
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner
from ugrbl import send
from ugrbl.cli import app
from ugrbl.gcode_file import CYCLE_START, FEED_HOLD, RESET, STATUS
from ugrbl.messages import meaning
from ugrbl.send import Connection, SendError, Stream

_ANSWER_S = 0.002


class FakeGrbl(threading.Thread):
    """Answers each line after a moment: G64 with error:20, G38 with an alarm, others with ok."""

    def __init__(self, options: str = "V,15,128", state: str = "Idle") -> None:
        super().__init__(daemon=True)
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self.options = options
        self.state = state
        self.lines: list[bytes] = []
        self.realtime = b""
        self.most_waiting = 0
        self.most_bytes = 0
        self._waiting = b""
        self._over = threading.Event()

    def run(self) -> None:
        while not self._over.wait(_ANSWER_S):
            self._receive()
            self.most_waiting = max(self.most_waiting, self._waiting.count(b"\n"))
            self.most_bytes = max(self.most_bytes, len(self._waiting))
            if b"\n" in self._waiting and not self.state.startswith("Hold"):
                line, _, self._waiting = self._waiting.partition(b"\n")
                self.lines.append(line)
                self._answer(line)

    def stop(self) -> None:
        self._over.set()
        self.join()
        os.close(self._master)
        os.close(self._slave)

    def say(self, text: str) -> None:
        os.write(self._master, text.encode() + b"\r\n")

    def _receive(self) -> None:
        try:
            data = os.read(self._master, 4096)
        except BlockingIOError:
            return
        for byte in (bytes([value]) for value in data):
            if byte == STATUS:
                self.say(f"<{self.state}|MPos:1.000,2.000,3.000|FS:0,0>")
            elif byte in (FEED_HOLD, CYCLE_START, RESET):
                self.realtime += byte
                self.state = "Hold:0" if byte == FEED_HOLD else "Idle"
            else:
                self._waiting += byte

    def _answer(self, line: bytes) -> None:
        if line == b"$I":
            self.say(f"[VER:1.1h.20190830:]\r\n[OPT:{self.options}]")
        if line.startswith(b"G38"):
            self.state = "Alarm"
            self.say("ALARM:4")
        elif line == b"M2":
            self.say("[MSG:Pgm End]")
        self.say("error:20" if line.startswith(b"G64") else "ok")


class Watcher:
    """A View that notes what it is shown; `answers` are what it says when asked to resume."""

    def __init__(self) -> None:
        self.messages: list[str] = []
        self.states: list[str] = []
        self.answers: list[bool] = []

    def progress(self, answered: int, status: str) -> None:
        self.states.append(status)

    def message(self, text: str) -> None:
        self.messages.append(text)

    def resume(self) -> bool:
        return self.answers.pop(0)


@pytest.fixture
def grbl() -> Iterator[FakeGrbl]:
    fake = FakeGrbl()
    fake.start()
    yield fake
    fake.stop()


@pytest.fixture
def connection(grbl: FakeGrbl) -> Iterator[Connection]:
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


def test_every_line_is_sent_and_answered(
    grbl: FakeGrbl, connection: Connection, view: Watcher
) -> None:
    report = Stream(connection, program(50), view).run()
    assert grbl.lines == program(50)
    assert (report.answered, report.state, report.ok()) == (50, "Idle", True)


def test_counting_keeps_the_buffer_full_and_never_overfills_it(
    grbl: FakeGrbl, connection: Connection, view: Watcher
) -> None:
    Stream(connection, program(50), view).run()
    assert grbl.most_waiting >= 4
    assert 100 < grbl.most_bytes <= 127


def test_line_by_line_has_one_line_under_way(
    grbl: FakeGrbl, connection: Connection, view: Watcher
) -> None:
    Stream(connection, program(20), view, by_line=True).run()
    assert grbl.lines == program(20)
    assert grbl.most_waiting == 1


def test_a_larger_buffer_is_made_use_of(view: Watcher) -> None:
    grbl = FakeGrbl(options="V,15,512")
    grbl.start()
    connection = Connection(grbl.port)
    connection.start()
    Stream(connection, program(60), view).run()
    connection.close()
    grbl.stop()
    assert 400 < grbl.most_bytes <= 511


def test_an_error_names_its_line_and_meaning_and_the_rest_goes_on(
    connection: Connection, view: Watcher
) -> None:
    report = Stream(connection, [b"G21", b"G64 P0.1", b"G0 X1"], view).run()
    assert report.errors == [(2, "error:20")]
    assert report.answered == 3
    assert view.messages == [f"line 2: G64 P0.1: error:20: {meaning('error:20')}"]


def test_an_alarm_stops_it_and_says_why(connection: Connection, view: Watcher) -> None:
    report = Stream(connection, [b"G21", b"G38.2 Z-1 F10", *program(50)], view).run()
    assert report.stopped == f"ALARM:4: {meaning('ALARM:4')}"
    assert report.answered < 50


def test_a_controller_that_resets_stops_it(
    grbl: FakeGrbl, connection: Connection, view: Watcher
) -> None:
    threading.Timer(0.05, grbl.say, ["Grbl 1.1h ['$' for help]"]).start()
    report = Stream(connection, program(500), view).run()
    assert report.stopped == "the controller was reset"


def test_messages_and_states_are_shown(connection: Connection, view: Watcher) -> None:
    Stream(connection, [b"M2"], view).run()
    assert view.messages == ["[MSG:Pgm End]"]
    assert view.states[-1].startswith("<Idle|MPos:1.000,2.000,3.000")


def test_ctrl_c_holds_and_resume_finishes(
    grbl: FakeGrbl, connection: Connection, view: Watcher
) -> None:
    view.answers = [True]
    stream = Stream(connection, program(30), view)
    stream.interrupt()
    report = stream.run()
    assert grbl.realtime == FEED_HOLD + CYCLE_START
    assert (report.answered, report.stopped) == (30, "")


def test_ctrl_c_and_abort_resets_once_the_machine_is_at_rest(
    grbl: FakeGrbl, connection: Connection, view: Watcher
) -> None:
    view.answers = [False]
    stream = Stream(connection, program(30), view)
    stream.interrupt()
    report = stream.run()
    time.sleep(0.05)
    assert grbl.realtime == FEED_HOLD + RESET
    assert report.stopped == "given up by the user"
    assert len(grbl.lines) < 30


def test_a_locked_machine_is_refused() -> None:
    grbl = FakeGrbl(state="Alarm")
    grbl.start()
    connection = Connection(grbl.port)
    with pytest.raises(SendError, match="locked in Alarm"):
        connection.start()
    connection.close()
    grbl.stop()


def test_a_port_without_grbl_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(send, "_START_S", 0.2)
    master, slave = os.openpty()
    connection = Connection(os.ttyname(slave))
    with pytest.raises(SendError, match="no Grbl answers"):
        connection.start()
    connection.close()
    os.close(master)
    os.close(slave)


def test_a_port_that_is_not_there_is_named() -> None:
    with pytest.raises(SendError, match="/dev/nowhere"):
        Connection("/dev/nowhere")


def test_the_command_tells_errors_and_fails(grbl: FakeGrbl, tmp_path: Path) -> None:
    file = tmp_path / "program.nc"
    file.write_text("G21\nG64\n")
    done = CliRunner().invoke(app, ["send", str(file), "--port", grbl.port])
    assert done.exit_code == 1
    assert "line 2: G64: error:20" in done.output


def test_the_command_succeeds_line_by_line(grbl: FakeGrbl, tmp_path: Path) -> None:
    file = tmp_path / "program.nc"
    file.write_text("G21\nG0 X1\n")
    done = CliRunner().invoke(app, ["send", str(file), "--port", grbl.port, "--mode", "line"])
    assert done.exit_code == 0, done.output
    assert grbl.lines == [b"$I", b"G21", b"G0 X1"]
