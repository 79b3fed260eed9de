"""Test the command `ugrbl web` in its own process.

`web` starts the command: `running.address` is what it has printed, children() are its child
processes. refused() returns the error message of a command that fails.
"""

import json
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from as_users import as_users
from web_process import PATIENCE_S, Web

pytestmark = [pytest.mark.xdist_group("web"), pytest.mark.thorough]

Start = Callable[..., Web]


@pytest.fixture
def web() -> Iterator[Start]:
    """Return a function that starts the server with these words of the command line."""
    running: "list[Web]" = []

    def start(*words: str, **environment: str) -> Web:
        running.append(Web(*words, **environment))
        return running[-1]

    yield start
    for one in running:
        one.close()


def wait_until_gone(number: int) -> None:
    """Wait until a process has ended. number: its process id."""
    until = time.monotonic() + PATIENCE_S
    while Path(f"/proc/{number}/cmdline").exists():
        if not Path(f"/proc/{number}/cmdline").read_bytes():
            return  # a zombie, because nothing here waits for it
        assert time.monotonic() < until, "it goes on"
        time.sleep(0.05)


@pytest.mark.parametrize("signal_number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signal_ends_server_and_its_simulator(signal_number: int, web: Start) -> None:
    """Each of these signals ends the server without an error message. Its simulator ends, too."""
    running = web("--sim", "--no-browser")
    assert running.said.startswith("sim is at http://127.0.0.1:")
    (simulator,) = running.children()
    assert running.stop(signal_number) == ""  # no further output
    assert running.process.returncode == 0
    wait_until_gone(simulator)


def test_simulator_ends_when_server_is_killed(web: Start) -> None:
    running = web("--sim", "--no-browser")
    (simulator,) = running.children()
    running.process.kill()
    wait_until_gone(simulator)


@pytest.mark.sampled(1)
def test_network_address_is_printed_with_token(web: Start) -> None:
    """Open to the network, the server requires a token; the address it prints contains it."""
    running = web("--sim", "--no-browser", "--host", "0.0.0.0")
    bare, _, token = running.address.partition("?token=")
    assert len(token) >= 20 and "0.0.0.0" not in bare
    port = bare.rstrip("/").rpartition(":")[2]
    status, said = running.get(f"http://127.0.0.1:{port}/")
    assert status == 403 and "token" in said
    assert running.get(f"http://127.0.0.1:{port}/?token={token}")[0] != 403


def test_browser_is_opened(tmp_path: Path, web: Start) -> None:
    """The server opens the program named in $BROWSER.

    Here it is a script that writes down the address.
    """
    seen_file = tmp_path / "seen"
    browser = tmp_path / "browser"
    browser.write_text(
        f'#!/bin/sh\necho "$1" > {seen_file}.new && mv {seen_file}.new {seen_file}\n'
    )
    browser.chmod(0o755)
    running = web("--sim", BROWSER=str(browser))
    until = time.monotonic() + PATIENCE_S
    while not seen_file.exists():
        assert time.monotonic() < until, "no browser"
        time.sleep(0.05)
    assert seen_file.read_text().strip() == running.address


def test_simulator_stores_settings_in_file(tmp_path: Path, web: Start) -> None:
    """A settings file is read at the start and kept. Previews use the same board."""
    file = tmp_path / "mill.settings"
    file.write_text("$110=3000\n")
    running = web("--sim", "--no-browser", "--settings", str(file), "--board", "sim_xyza")
    program = json.dumps({"program": "G21\nG0 A5\n"}).encode()
    request = urllib.request.Request(f"{running.address}api/look", program)
    with urllib.request.urlopen(request, timeout=PATIENCE_S) as got:
        preview: Any = json.load(got)
    assert preview["problems"] == [], "that board has an axis A"
    assert file.read_text().startswith("$110=3000\n")


def refused(*words: str) -> str:
    """Return the message of a command that ends with exit code 1."""
    command = [sys.executable, "-m", "ugrbl.cli", "web", "--no-browser", *words]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        env=as_users(COLUMNS="300"),
        timeout=60,
        check=False,
    )
    assert done.returncode == 1 and not done.stdout, done.stdout
    assert "Traceback" not in done.stderr and "Errno" not in done.stderr
    return done.stderr


def test_address_in_use_is_reported() -> None:
    """The message names the cause and the option to choose another port."""
    with socket.create_server(("127.0.0.1", 0)) as other_server:  # 0: any free port
        port = other_server.getsockname()[1]
        message = refused("--sim", "--http", str(port))
    assert f"cannot listen at 127.0.0.1:{port}: another program" in message
    assert "--http" in message


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("--sim --port x", "use only one of --port and --sim"),
        ("--port x --settings y", "--settings is for --sim"),
        ("--port missing", "cannot open missing: no such port; is its name right"),
        ("--sim --board toaster", "no board 'toaster'"),
        ("--sim --settings FOLDER/photo", "photo"),
        ("--sim --host 192.0.2.1 --http 0", "cannot listen at 192.0.2.1:0"),
        ("--sim --host no.such.invalid --http 0", "cannot listen at no.such.invalid:0"),
    ],
)
def test_unusable_options_are_refused_with_reason(words: str, why: str, tmp_path: Path) -> None:
    (tmp_path / "photo").write_bytes(b"\xff\xd8\xff\xe0")
    assert why in refused(*words.replace("FOLDER", str(tmp_path)).split())


def test_missing_board_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without any controller the message names --sim."""
    from typer.testing import CliRunner
    from ugrbl.cli import ports
    from ugrbl.cli.app import app

    # list() is empty: no port is found.
    monkeypatch.setattr(ports, "find", list)
    done = CliRunner().invoke(app, ["web", "--no-browser", "--http", "0"])
    assert done.exit_code == 1
    assert "no controller was found" in done.output and "--sim" in done.output


def test_page_is_saved_for_browser_without_server(tmp_path: Path) -> None:
    """`ugrbl web --save` writes the page to a file that can be opened from disk."""
    file = tmp_path / "ugrbl.html"
    command = [sys.executable, "-m", "ugrbl.cli", "web", "--save", str(file)]
    done = subprocess.run(command, env=as_users(), capture_output=True, text=True, check=True)
    assert f"written: {file}" in done.stdout
    text = file.read_text(encoding="utf-8")
    # The whole page: no part is left to insert.
    assert "<!-- part" not in text and "class Prompt" in text
