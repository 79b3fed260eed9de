"""`ugrbl sim`: the firmware at a real pseudo-terminal, in a separate process."""

import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
import serial
from as_users import as_users

# Real processes in real time: the first ring runs one.
pytestmark = pytest.mark.thorough

_PATIENCE_S = 60.0
_COMMAND = [sys.executable, "-m", "ugrbl.cli"]


def ugrbl(*words: object) -> subprocess.CompletedProcess[str]:
    """Run a command in a separate process."""
    command = [*_COMMAND, *map(str, words)]
    return subprocess.run(
        command,
        capture_output=True,
        text=True,
        env=as_users(),
        stdin=subprocess.DEVNULL,
        timeout=60,
        check=False,
    )


class Sim:
    """A running simulator, whose pseudo-terminal is linked at `port`."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.port = folder / "grbl"
        command = [*_COMMAND, "sim", "--port", str(self.port), *arguments]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, env=as_users(), text=True)
        until = time.monotonic() + _PATIENCE_S
        while not self.port.is_symlink():
            assert self.process.poll() is None and time.monotonic() < until, "no simulator"
            time.sleep(0.01)

    def open(self) -> "Sender":
        return Sender(self.port)

    def stop(self) -> str:
        """Stop it by SIGTERM; return what it has printed."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.communicate(timeout=_PATIENCE_S)[0]


class Sender:
    """A sender that uses pyserial."""

    def __init__(self, port: Path | str) -> None:
        self._serial = serial.serial_for_url(str(port), 115200, timeout=0.05)
        self.text = ""

    def __enter__(self) -> "Sender":
        return self

    def __exit__(self, *_: object) -> None:
        self._serial.close()

    def send(self, data: bytes) -> None:
        self._serial.write(data)

    def read(self) -> str:
        """Return the bytes received within 50 ms."""
        return str(self._serial.read(4096).decode("latin-1"))

    def wait(self, what: str | Callable[[str], bool], seconds: float = _PATIENCE_S) -> str:
        """Read until a text comes, or a function of the text is true; return everything up to
        then."""
        has_come = what if callable(what) else lambda text: what in text
        deadline = time.monotonic() + seconds
        while not has_come(self.text):
            assert time.monotonic() < deadline, f"no {what!r} in {self.text!r}"
            self.text += self.read()
        text, self.text = self.text, ""
        return text

    def ask(self, line: str) -> str:
        """Send a line; return all output up to its answer."""
        self.send(line.encode() + b"\n")
        return self.wait(lambda text: "ok\r\n" in text or "error:" in text)

    def wait_idle(self) -> str:
        """Ask for the status until the machine is idle; return the report."""
        for _ in range(int(_PATIENCE_S / 0.02)):
            self.send(b"?")
            report = self.wait(">")
            if "<Idle" in report:
                return report
            time.sleep(0.02)
        raise AssertionError("never idle")


@pytest.fixture
def sim(tmp_path: Path) -> Iterator[Sim]:
    """Return a simulator that runs as fast as it can."""
    running = Sim(tmp_path, "--speed", "max")
    yield running
    running.process.kill()
    running.process.communicate()


def test_the_first_sender_gets_the_banner(sim: Sim) -> None:
    with sim.open() as sender:
        assert "Grbl 1.1h ['$' for help]\r\n" in sender.wait("help]\r\n")


@pytest.mark.sampled(1)
def test_lines_are_answered(sim: Sim) -> None:
    with sim.open() as sender:
        assert "[GC:G0 G54 " in sender.ask("$G")
        assert "error:20" in sender.ask("G64")


def test_recorded_conversations_are_replayed_over_a_port(sim: Sim, tmp_path: Path) -> None:
    """Two recordings that the simulator follows, one with a known difference ($I is answered in
    motion), and one that it does not follow (G999 is an error)."""

    def case(line: str, answer: str, moved: "list[int]") -> "dict[str, object]":
        step = {"send": f"{line}\n", "wait": "idle", "t_ms": 50, "expect": [answer]}
        setup = [["G91", ["ok"]]]
        head = {"name": f"{line} {answer}", "init": "defaults", "setup": setup}
        return {**head, "steps": [{**step, "moved": moved}]}

    recorded = [
        case("G1X.1F300", "ok", [25, 0, 0]),
        case("G1", "error:22", [0, 0, 0]),
        case("$I", "error:8", [0, 0, 0]),
        case("G999", "ok", [0, 0, 0]),
    ]
    (tmp_path / "errors.json").write_text(json.dumps(recorded))
    process = ugrbl("conformance", tmp_path, "--port", sim.port)
    assert process.returncode == 1
    assert "G999 ok" in process.stdout and "3 of 4 conform" in process.stdout


def test_a_machine_with_switches_is_homed_at_either_end_and_stops_there(tmp_path: Path) -> None:
    """--switches: limit switches at both ends of travel. $130=30: travel of X in mm; $23=1: X is
    homed at its negative end; $27 is 1 mm."""
    running = Sim(tmp_path, "--speed", "max", "--switches")
    try:
        with running.open() as sender:
            sender.wait("help]")
            for setting in ("$22=1", "$25=5000", "$120=500", "$121=500", "$122=500", "$130=30"):
                assert sender.ask(setting) == "ok\r\n"
            assert sender.ask("$110=5000") == "ok\r\n"
            assert sender.ask("$H") == "ok\r\n"
            assert "MPos:-1.000,-1.000,-1.000|" in sender.wait_idle()
            sender.ask("$23=1")
            sender.ask("$H")
            # at the other end of 30 mm, 1 mm pulled off
            assert "MPos:-29.000,-1.000,-1.000|" in sender.wait_idle()
            sender.ask("$21=1")  # hard limits
            sender.ask("G53 G0 X0")  # a millimetre is between the travel's end and the switch
            assert "MPos:0.000," in sender.wait_idle()
            sender.send(b"G0 X2\n")
            sender.wait("ALARM:1")
    finally:
        running.process.kill()
        running.process.communicate()


def test_homing_finds_the_switches_even_if_the_computer_stalls(
    tmp_path: Path,
) -> None:
    """The simulator's process is stopped for 0.2 s again and again: simulated time must not skip
    the switch."""
    running = Sim(tmp_path, "--switches")
    try:
        with running.open() as sender:
            sender.wait("help]")
            for setting in ("$22=1", "$24=300", "$25=6000", "$27=0.5"):
                assert sender.ask(setting) == "ok\r\n"
            for number in (110, 111, 112):
                assert sender.ask(f"${number}=6000") == "ok\r\n"
                assert sender.ask(f"${number + 10}=2000") == "ok\r\n"
                assert sender.ask(f"${number + 20}=20") == "ok\r\n"
            sender.send(b"$H\n")
            while "ok" not in sender.text and "ALARM" not in sender.text:
                running.process.send_signal(signal.SIGSTOP)
                time.sleep(0.2)  # the switch is 0.15 s away
                running.process.send_signal(signal.SIGCONT)
                time.sleep(0.005)
                sender.text += sender.read()
            assert sender.text == "ok\r\n"
            sender.text = ""
            assert "MPos:-0.500,-0.500,-0.500|" in sender.wait_idle()
    finally:
        running.process.kill()
        running.process.communicate()


def test_a_disconnected_sender_does_not_stop_the_machine(sim: Sim) -> None:
    with sim.open() as sender:
        sender.wait("help]")
        sender.send(b"G91\n" + b"G1 X1 F500\n" * 10)
        sender.wait("ok\r\n")
    time.sleep(0.5)  # no sender is connected; the queued lines are executed
    with sim.open() as sender:
        assert "MPos:10.000,0.000,0.000" in sender.wait_idle()
        assert "G91" in sender.ask("$G")  # no reset has come


def test_the_next_sender_gets_no_old_answers(sim: Sim) -> None:
    with sim.open() as sender:
        sender.send(b"$$\n" * 3)
        time.sleep(0.3)  # answered, and not read
    time.sleep(0.3)
    with sim.open() as sender:
        assert sender.ask("$I").startswith("\r\nGrbl 1.1h ['$' for help]\r\n[VER:")


def test_many_senders_come_and_go(sim: Sim) -> None:
    """20 senders move 1 mm each; every other one leaves before its answer."""
    for count in range(20):
        with sim.open() as sender:
            sender.send(b"G91 G0 X1\n")
            if count % 2:
                sender.wait("ok")
    with sim.open() as sender:
        assert "MPos:20.000" in sender.wait_idle()


def test_a_sender_that_does_not_read_does_not_stop_the_machine(sim: Sim) -> None:
    with sim.open() as sender:
        for _ in range(60):
            sender.send(b"$$\n$$\n")  # far more than a terminal holds
            time.sleep(0.01)
        time.sleep(1.0)
    with sim.open() as sender:
        assert "ok" in sender.ask("G0 X1")


@pytest.mark.parametrize("seed", range(3))
def test_random_bytes_do_no_harm(sim: Sim, seed: int) -> None:
    rng = random.Random(seed)
    with sim.open() as sender:
        sender.wait("help]")
        for _ in range(40):
            sender.send(rng.randbytes(rng.randrange(1, 100)))
            time.sleep(0.005)
    with sim.open() as sender:
        sender.send(b"\x18")
        sender.wait("help]")
        sender.ask("$X")
        assert "[GC:" in sender.ask("$G")
    assert sim.process.poll() is None


def test_settings_are_stored_in_the_file(tmp_path: Path) -> None:
    """The first simulator has the factory value, the second the value that the first has
    stored."""
    file = tmp_path / "settings.txt"
    for value in ("$11=0.010", "$11=0.020"):
        sim = Sim(tmp_path, "--settings", str(file))
        with sim.open() as sender:
            sender.wait("help]")
            assert value in sender.ask("$$")
            sender.ask("$11=0.02")
        sim.stop()


def test_a_new_machine_has_factory_settings_and_reports_no_fault(sim: Sim) -> None:
    with sim.open() as sender:
        assert "error" not in sender.wait("help]")
        assert sender.ask("$N").startswith("$N0=\r\n")
        assert "$110=500.000" in sender.ask("$$")


def test_an_erased_memory_is_reported(tmp_path: Path) -> None:
    sim = Sim(tmp_path, "--blank")
    with sim.open() as sender:
        assert "error:7" in sender.wait("help]")
    sim.stop()


def test_settings_that_depend_on_each_other_may_come_in_any_order(tmp_path: Path) -> None:
    """$20 (soft limits) is refused without $22 (homing): the file has them in the wrong order."""
    file = tmp_path / "mill.settings"
    file.write_text("$20=1\n$22=1\n$7=1\n")
    sim = Sim(tmp_path, "--settings", str(file))
    with sim.open() as sender:
        assert "'$H'|'$X' to unlock" in sender.wait("unlock]")
        assert "$20=1" in sender.ask("$$")
        sender.ask("$110=600")  # so that the file is written
    sim.stop()
    assert file.read_text().startswith("$20=1\n$22=1\n$7=1\n")


def test_settings_refused_by_the_machine_are_named(tmp_path: Path) -> None:
    file = tmp_path / "mill.settings"
    file.write_text("$0=1\n")
    done = ugrbl("sim", "--stdio", "--settings", file)
    assert done.returncode == 1
    assert "$0=1: error:6: " in done.stderr.replace("\n", " ")


@pytest.mark.parametrize("text", ["G21 G90\nG1 X10 F600\n", "$110=fast\n"])
def test_a_file_without_settings_is_not_changed(tmp_path: Path, text: str) -> None:
    file = tmp_path / "precious.nc"
    file.write_text(text)
    done = ugrbl("sim", "--stdio", "--settings", file)
    assert done.returncode == 1
    assert f"{file} was not changed: line" in done.stderr
    assert file.read_text() == text


def test_pulled_settings_can_be_simulated_and_saved_ones_pushed(tmp_path: Path) -> None:
    file, pulled_again = tmp_path / "mill.settings", tmp_path / "kept.settings"
    file.write_text("; [VER:1.1h.20190830:]\n$110=1234.500 ; fast\n$132=70\n")
    sim = Sim(tmp_path, "--settings", str(file))
    with sim.open() as sender:
        assert "$110=1234.500\r\n" in sender.ask("$$")
        sender.ask("$N0=G21")
        sender.ask("$131=300")
    sim.stop()
    assert file.read_text().startswith("; [VER:1.1h.20190830:]\n$110=1234.500 ; fast\n$132=70\n")
    sim = Sim(tmp_path, "--speed", "max")
    with sim.open():
        pass
    process = ugrbl("settings", "push", file, "--port", sim.port, "--yes")
    assert process.returncode == 0, process.stdout + process.stderr
    process = ugrbl("settings", "pull", pulled_again, "--port", sim.port)
    assert process.returncode == 0, process.stdout + process.stderr
    sim.stop()
    assert "$131=300.000" in pulled_again.read_text()
    sim = Sim(tmp_path, "--settings", str(pulled_again))
    with sim.open() as sender:
        sender.wait("help]")
        assert "$132=70.000" in sender.ask("$$")
    sim.stop()


def test_the_link_is_removed_when_the_simulator_ends(tmp_path: Path) -> None:
    sim = Sim(tmp_path)
    printed = sim.stop()
    assert str(tmp_path / "grbl") in printed.replace("\n", "")
    assert sim.process.returncode == 0
    assert not sim.port.is_symlink()


@pytest.mark.parametrize("kind", ["file", "link", "broken link", "folder", "another simulator's"])
def test_the_link_replaces_no_existing_file(tmp_path: Path, kind: str) -> None:
    path, target = tmp_path / "precious", tmp_path / "other"
    other_sim = None
    if kind == "file":
        path.write_text("data")
    elif kind == "folder":
        path.mkdir()
    elif kind == "another simulator's":
        other_sim = Sim(tmp_path)
        path = other_sim.port
    else:
        path.symlink_to(target)
        if kind == "link":
            target.write_text("data")
    # the target of a link, else the number of the file
    before = os.readlink(path) if path.is_symlink() else path.stat().st_ino
    process = ugrbl("sim", "--port", path)
    assert process.returncode == 1
    message = " ".join(process.stderr.split())
    assert "is there already; it is left as it is" in message
    assert ("if no simulator runs there, remove it" in message) == (other_sim is not None)
    assert before == (os.readlink(path) if path.is_symlink() else path.stat().st_ino)
    if other_sim:
        other_sim.stop()


def test_the_link_of_a_killed_simulator_is_replaced(tmp_path: Path) -> None:
    """A killed simulator leaves a link to a terminal that does not exist any more."""
    killed = Sim(tmp_path)
    killed.process.kill()
    killed.process.communicate()
    # Its own terminal may belong to another process by now.
    killed.port.unlink()
    killed.port.symlink_to("/dev/./pts/9999999")
    process = subprocess.Popen(
        [*_COMMAND, "sim", "--port", str(killed.port)], stdout=subprocess.PIPE, env=as_users()
    )
    assert process.stdout and str(killed.port).encode() in process.stdout.readline()
    assert killed.port.exists()
    process.terminate()
    process.communicate()
    assert not killed.port.is_symlink()


def test_a_link_replaced_by_another_program_is_kept(tmp_path: Path) -> None:
    """At its end the simulator removes the link only if it is its own."""
    sim = Sim(tmp_path)
    sim.port.unlink()
    sim.port.symlink_to("/dev/null")
    sim.stop()
    assert os.readlink(sim.port) == "/dev/null"


def test_a_silent_sender_is_greeted_after_a_short_delay(sim: Sim) -> None:
    """The Universal G-Code Sender is ready for the greeting only some time after opening the
    port."""
    time.sleep(0.5)
    with sim.open() as sender:
        begin_s = time.monotonic()
        sender.wait("help]")
        assert 0.2 < time.monotonic() - begin_s < 2
        assert sender.ask("$I").count("[VER") == 1  # the delay has not repeated anything


def test_a_sender_that_speaks_first_is_greeted_at_once(sim: Sim) -> None:
    """Without the delay that a silent sender sees."""
    time.sleep(0.5)
    with sim.open() as sender:
        begin_s = time.monotonic()
        sender.send(b"\n")
        assert sender.wait("ok").index("Grbl") < 10
        assert time.monotonic() - begin_s < 0.25


# On TCP


class TcpSim:
    """A simulator that listens on TCP; place: its address and port."""

    def __init__(self, *arguments: str) -> None:
        command = [*_COMMAND, "sim", "--speed", "max", "--tcp", *(arguments or ("0",))]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, env=as_users(), text=True)
        assert self.process.stdout
        self.place = self.process.stdout.readline().rpartition(" ")[2].strip()

    def open(self) -> Sender:
        return Sender(f"socket://{self.place}")

    def stop(self) -> int:
        self.process.terminate()
        self.process.communicate()
        return self.process.returncode


@pytest.fixture
def tcp_sim() -> Iterator[TcpSim]:
    running = TcpSim()
    yield running
    assert running.stop() == 0


def test_senders_on_tcp_are_served_one_after_another(tcp_sim: TcpSim) -> None:
    """The machine continues for the next sender: X moves on by 1 mm each time."""
    assert tcp_sim.place.startswith("127.0.0.1:")
    with tcp_sim.open() as sender:
        sender.wait("help]")
        assert sender.ask("G91 G0 X1") == "ok\r\n"
    for x_mm in range(2, 5):
        with tcp_sim.open() as sender:
            sender.wait("help]")
            assert sender.ask("G91 G0 X1") == "ok\r\n"
            assert f"MPos:{x_mm}.000," in sender.wait_idle()


def test_a_new_sender_is_greeted_during_a_hold(tcp_sim: TcpSim) -> None:
    """Otherwise it takes the machine for dead, and resets it."""
    with tcp_sim.open() as sender:
        sender.wait("help]")
        sender.send(b"!")
        report = ""
        while "<Hold" not in report:
            sender.send(b"?")
            report = sender.wait(">")
    with tcp_sim.open() as sender:
        sender.wait("help]\r\n")
        sender.send(b"?")
        assert sender.wait(">").startswith("<Hold:")


def test_a_sender_is_greeted_during_motion_and_motion_continues(tmp_path: Path) -> None:
    running = Sim(tmp_path, "--speed", "real")
    with running.open() as sender:
        sender.wait("help]\r\n")
        sender.ask("G91 G1 X4 F24")  # 10 s
    time.sleep(1)  # the simulator checks only now and then whether a sender is connected
    with running.open() as sender:
        sender.wait("help]\r\n")
        sender.send(b"?")
        assert sender.wait(">").startswith("<Run|")
        assert "MPos:4.000," in sender.wait_idle()
    running.stop()


def test_a_second_sender_waits_until_the_first_disconnects(tcp_sim: TcpSim) -> None:
    """Its bytes are read only then: meanwhile the machine stays at X0."""
    with tcp_sim.open() as sender:
        sender.wait("help]")
        second = tcp_sim.open()
        second.send(b"G91 G0 X7\n?")
        sender.ask("G4 P0.1")
        assert "MPos:0.000," in sender.wait_idle()
    with second:
        second.wait("ok")
        assert "MPos:7.000," in second.wait_idle()


@pytest.mark.filterwarnings("ignore::DeprecationWarning:serial")
def test_a_serial_port_over_the_network_works_like_a_local_one(tmp_path: Path) -> None:
    simulator = TcpSim("0", "--rfc2217")
    try:
        for x_mm in (2, 4):
            with Sender(f"rfc2217://{simulator.place}") as sender:
                assert sender.ask("G91 G0 X2").endswith("ok\r\n")
                assert f"MPos:{x_mm}.000," in sender.wait_idle()
                assert sender.ask("$$").count("$") == 34  # a `$` for each setting
    finally:
        assert simulator.stop() == 0


def test_a_tcp_sender_that_does_not_read_does_not_stop_the_machine(tcp_sim: TcpSim) -> None:
    host, _, port = tcp_sim.place.rpartition(":")
    with socket.create_connection((host, int(port)), _PATIENCE_S) as silent:
        silent.setblocking(False)
        for _ in range(100):
            with suppress(BlockingIOError):
                silent.send(b"$$\n" * 100)
            time.sleep(0.003)
    with tcp_sim.open() as sender:
        sender.send(b"\x18")
        sender.wait("help]", 5 * _PATIENCE_S)  # after everything that the other has sent
        assert sender.ask("G0 X1").endswith("ok\r\n")  # the welcome may come first


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--plot", "path.tiff"], ".html, .png, .svg"),
        (["--plot", "FOLDER"], ".html, .png, .svg"),
        (["--report", "FOLDER"], "is a folder"),
        (["--report", "FOLDER/mill.settings/x"], "mill.settings is no folder"),
        (["--report", "FOLDER/mill.settings"], "not overwritten"),
        (["--settings", "FOLDER/nowhere/x"], "no folder"),
        (["--settings", "FOLDER"], "FOLDER"),
        (["--board", "toaster"], "no board 'toaster'"),
        (["--rfc2217"], "needs --tcp"),
    ],
)
def test_impossible_options_are_reported_before_the_start(
    tmp_path: Path, words: list[str], why: str
) -> None:
    """why: part of the message. FOLDER stands for a folder with a file mill.settings, which is not
    changed."""
    (tmp_path / "mill.settings").write_text("$110=600\n")
    words = [word.replace("FOLDER", str(tmp_path)) for word in words]
    words = [
        *([] if "--settings" in words else ["--settings", str(tmp_path / "mill.settings")]),
        *words,
    ]
    process = ugrbl("sim", "--stdio", *words)
    assert process.returncode == 1 and not process.stdout
    assert why.replace("FOLDER", str(tmp_path)) in process.stderr.replace("\n", "")
    assert "Traceback" not in process.stderr
    assert (tmp_path / "mill.settings").read_text() == "$110=600\n"


@pytest.mark.parametrize("words", [["0:x"], ["99999"], ["0", "--stdio"], ["256.1.1.1:0"]])
def test_an_unusable_address_is_reported(words: list[str]) -> None:
    done = ugrbl("sim", "--tcp", *words)
    assert done.returncode == 1
    assert done.stderr and "Traceback" not in done.stderr


def test_a_busy_address_is_reported(tcp_sim: TcpSim) -> None:
    done = ugrbl("sim", "--tcp", tcp_sim.place)
    assert done.returncode == 1
    assert "another program listens there" in done.stderr and "Traceback" not in done.stderr


def test_real_speed_takes_real_time(tmp_path: Path) -> None:
    sim = Sim(tmp_path, "--speed", "real")
    with sim.open() as sender:
        sender.wait("help]")
        begin_s = time.monotonic()
        sender.ask("G4 P0.5")
        dwell_s = time.monotonic() - begin_s
        sender.ask("G91 G0 X1")  # 0.63 s with stock settings
        sender.wait_idle()
        move_s = time.monotonic() - begin_s - dwell_s
    sim.stop()
    assert 0.45 < dwell_s < 2
    assert 0.5 < move_s < 3


def test_full_speed_takes_less_than_real_time(sim: Sim) -> None:
    with sim.open() as sender:
        sender.wait("help]")
        begin_s = time.monotonic()
        sender.ask("G4 P60")
        sender.ask("G91 G0 X100")
        sender.wait_idle()
    assert time.monotonic() - begin_s < 10  # s; the dwell alone is 60 s


def test_a_held_machine_stays_held_at_full_speed(sim: Sim) -> None:
    """M0 holds until `~`, however fast simulated time passes."""
    with sim.open() as sender:
        sender.wait("help]")
        sender.send(b"G0 X1\nM0\nG0 X5\n")
        sender.wait("ok\r\n")
        time.sleep(0.3)
        sender.send(b"?")
        assert "<Hold:0|MPos:1.000" in sender.wait(">")
        sender.send(b"~")
        sender.wait(lambda text: text.count("ok\r\n") == 2)
        assert "MPos:5.000" in sender.wait_idle()


def test_the_report_contains_steps_commanded_and_made(tmp_path: Path) -> None:
    """SIGTERM makes the simulator write its report and its plot."""
    report, plot = tmp_path / "report.json", tmp_path / "part.svg"
    sim = Sim(tmp_path, "--speed", "max", "--report", str(report), "--plot", str(plot))
    with sim.open() as sender:
        sender.wait("help]")
        sender.ask("G0 X2 Z-1")
        sender.wait_idle()
    sim.stop()
    totals = json.loads(report.read_text())
    # 250 steps/mm
    assert totals["steps_planned"] == totals["steps_made"] == {"X": 500, "Y": 0, "Z": 250}
    assert "<!-- part -->" in plot.read_text(), "the title is the file's name"


def test_stdio_ends_after_its_input_is_processed() -> None:
    done = subprocess.run(
        [*_COMMAND, "sim", "--stdio", "--speed", "max"],
        input=b"G91 G0 X3\n?\nG4P1\n$G\n",
        capture_output=True,
        env=as_users(),
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count(b"ok\r\n") == 4  # the line with "?" counts as empty
    assert b"[GC:G0 G54 G17 G21 G91 " in done.stdout


def test_the_demonstration_succeeds(tmp_path: Path) -> None:
    process = subprocess.run(
        [*_COMMAND, "demo"],
        cwd=tmp_path,
        env=as_users(),
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert process.returncode == 0, process.stdout + process.stderr
    assert "commanded = " in process.stdout
    assert (tmp_path / "build" / "badge.png").stat().st_size > 10_000
