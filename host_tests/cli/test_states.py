"""Test send, settings and doctor at a machine that cannot answer, and at a Grbl 0.9.

A `Bench` is a simulator at a port of this computer; `ports.find` is the search for controllers.
ugrbl() runs a command and returns its result. A finding of `doctor` is a row with `what`, `text`
and `todo` (the remedy).
"""

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from sim_bench import Bench
from typer.testing import CliRunner, Result
from ugrbl.cli import ports
from ugrbl.cli.app import app
from ugrbl.device.connection import Connection

# Many cases: the first ring runs a sample of them.
pytestmark = pytest.mark.sampled(1)

# State, the command that causes it, and the remedy in the message.
STATES = [
    ("Hold:0", b"!", "resume (~) or reset (Ctrl-X) it"),
    ("Door:0", b"\x84", "close the safety door and resume (~)"),
    ("Sleep", b"$SLP\n", "reset it (Ctrl-X)"),
    ("Check", b"$C\n", "end check mode ($C)"),
]


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    running = Bench(tmp_path, "--speed", "max")
    yield running
    running.kill()


@pytest.fixture
def old(tmp_path: Path) -> Iterator[Bench]:
    """Start a Grbl 0.9j."""
    running = Bench(tmp_path, "--speed", "max", "--board", "sim_09j")
    yield running
    running.kill()


def bring_into_state(bench: Bench, state: str, command: bytes) -> None:
    """Send the command and wait up to 10 s until the machine reports the state."""
    connection = Connection(str(bench.port))
    assert connection.answers()
    connection.write(command)
    assert connection.wait_for(lambda line: line.startswith(f"<{state}"), 10), connection.status
    connection.close()


def ugrbl(*words: object) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.mark.parametrize(("state", "command", "todo"), STATES)
def test_each_command_names_state_and_remedy(
    bench: Bench, tmp_path: Path, state: str, command: bytes, todo: str
) -> None:
    """send, settings and doctor state why the machine cannot answer, and what to do."""
    bring_into_state(bench, state, command)
    file = tmp_path / "job.nc"
    file.write_text("G0 X1\n")
    sent = ugrbl("send", file, "--port", bench.port)
    if state == "Check":  # lines are accepted then
        assert sent.exit_code == 0 and "not checked: the machine is in Check" in sent.output
    else:
        assert sent.exit_code == 1 and state in sent.output and todo in sent.output
    settings_file = tmp_path / "kept"
    pulled = ugrbl("settings", "pull", settings_file, "--port", bench.port)
    assert pulled.exit_code == 1 and not settings_file.exists()
    assert state in pulled.output and todo in pulled.output
    doctor = ugrbl("doctor", "--port", bench.port, "--json", "-", "--no-move", "--pins", "0")
    findings = {row["what"]: row for row in json.loads(doctor.stdout)["findings"]}
    assert doctor.exit_code == 1
    assert state in findings["state"]["text"] and todo in findings["state"]["todo"]


def test_send_doctor_and_settings_understand_grbl_0_9(old: Bench, tmp_path: Path) -> None:
    """Reports and settings of Grbl 0.9 have another form."""
    file = tmp_path / "job.nc"
    file.write_text("G21 G91 F500\nG1 X1\nY2\n")
    sent = ugrbl("send", file, "--port", old.port)
    assert sent.exit_code == 0, sent.output
    assert "3 lines, 0 errors" in sent.output
    connection = Connection(str(old.port))
    assert connection.answers()
    assert (connection.state(), connection.place()) == ("Idle", [1.0, 2.0, 0.0])
    connection.close()
    kept = tmp_path / "kept"
    pulled = ugrbl("settings", "pull", kept, "--port", old.port)
    assert pulled.exit_code == 0 and "$110=500.000" in kept.read_text()
    doctor = ugrbl("doctor", "--port", old.port, "--json", "-", "--move", "--pins", "0")
    findings = {row["what"]: row for row in json.loads(doctor.stdout)["findings"]}
    assert findings["state"]["text"] == "Idle" and "0.9" in findings["firmware"]["text"]
    assert "no jogging" in findings["move X"]["text"]


# Files


def test_settings_are_written_to_stdout_and_read_from_stdin(bench: Bench) -> None:
    """The file name `-` is stdout or stdin. Without a terminal to ask at, push needs --yes."""
    pulled = ugrbl("settings", "pull", "-", "--port", bench.port)
    assert pulled.exit_code == 0 and "$110=" in pulled.stdout
    words = ["settings", "push", "-", "--port", str(bench.port)]
    pushed = CliRunner().invoke(app, words, input=pulled.stdout)
    assert pushed.exit_code == 1 and "--yes" in pushed.output
    pushed = CliRunner().invoke(app, [*words, "--yes"], input=pulled.stdout)
    assert pushed.exit_code == 0, pushed.output


@pytest.mark.parametrize("name", ["file/kept", "."])
def test_impossible_output_file_is_reported_first(bench: Bench, tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_text("")
    done = ugrbl("settings", "pull", tmp_path / name, "--port", bench.port, "--force")
    assert done.exit_code == 1 and not isinstance(done.exception, OSError)
    assert str(tmp_path) in done.output.replace("\n", "") and b"$$" not in bench.wire(">")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no full disk to test with")
def test_full_disk_is_reported_in_words(bench: Bench) -> None:
    """/dev/full refuses every write as a full disk does."""
    done = ugrbl("settings", "pull", "/dev/full", "--force", "--port", bench.port)
    assert (
        done.exit_code == 1
        and "cannot be written: the disk is full; free some space" in done.output
    )
    done = ugrbl("doctor", "--port", bench.port, "--json", "/dev/full", "--no-move", "--pins", "0")
    assert (
        done.exit_code == 1
        and "cannot be written: the disk is full; free some space" in done.output
    )


def test_replaced_file_is_complete_or_unchanged(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """When the new content cannot be written, the old file stays."""
    file = tmp_path / "kept"
    file.write_text("precious")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")  # ENOSPC

    monkeypatch.setattr(os, "fsync", full)
    done = ugrbl("settings", "pull", file, "--force", "--port", bench.port)
    assert done.exit_code == 1 and file.read_text() == "precious"


# Ports


def test_ports_lists_connected_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    """The list is printed for people or as JSON; without any device the exit code is 1."""
    monkeypatch.setattr(ports, "find", lambda: [ports.Found("/dev/ttyACM0", "a Pico")])
    assert ugrbl("ports").output == "/dev/ttyACM0: a Pico\n"
    assert json.loads(ugrbl("ports", "--json").output) == [
        {"port": "/dev/ttyACM0", "what": "a Pico"}
    ]
    # list() is empty: no port is found.
    monkeypatch.setattr(ports, "find", list)
    done = ugrbl("ports")
    assert done.exit_code == 1 and "no controller" in done.output


def test_send_finds_the_only_port(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without --port the only controller that is found is used."""
    monkeypatch.setattr(ports, "find", lambda: [ports.Found(str(bench.port), "a simulator")])
    file = tmp_path / "job.nc"
    file.write_text("G0 X1\n")
    assert ugrbl("send", file).exit_code == 0
    # list() is empty: no port is found.
    monkeypatch.setattr(ports, "find", list)
    done = ugrbl("send", file)
    assert done.exit_code == 1 and "--port" in done.output
