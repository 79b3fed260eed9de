"""The beginning of a day with UGS and with Candle over TCP, according to their code.

Neither is installed by these tests: UGS is not in the registries of CNCjs and bCNC, and Candle is
a program with a window. What they send, how long they wait, and how they parse is known from their
sources (UGS: GrblController, GrblControllerInitializer, GrblUtils; Candle: frmmain,
telnetconnection), and for Candle also from observation; the code here is our own.
"""

import re
import socket
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from as_users import as_users

# Real processes in real time: the first ring runs one.
pytestmark = pytest.mark.thorough

_BANNER = re.compile(r"Grbl \d\.\d[a-z]")


class Wire:
    """A TCP connection to its own simulator, with all lines received and their times."""

    def __init__(self, folder: Path, settings: str) -> None:
        """Start `ugrbl sim` and connect. settings: stored ones, lines like "$22=1"."""
        file = folder / "machine.settings"
        file.write_text(settings)
        command = [sys.executable, "-m", "ugrbl.cli", "sim", "--speed", "max", "--tcp", "0"]
        self.process = subprocess.Popen(
            [*command, "--settings", str(file)],
            stdout=subprocess.PIPE,
            env=as_users(),
            text=True,
        )
        assert self.process.stdout
        # --tcp 0 takes a free port; the first line of output ends with it.
        port = self.process.stdout.readline().rpartition(":")[2]
        time.sleep(0.2)
        self._socket = socket.create_connection(("127.0.0.1", int(port)))
        self.begun = time.monotonic()
        self.lines: list[str] = []
        self.times: list[float] = []  # of each line, in s after connecting
        self._rest = ""  # of the text received: an unfinished line

    def send(self, data: bytes) -> None:
        self._socket.sendall(data)

    def listen(self, seconds: float, done: Callable[..., bool] = lambda: False) -> bool:
        """Read for this time, or until it is done; return whether it is."""
        until = time.monotonic() + seconds
        while not done():
            seconds_left = until - time.monotonic()
            if seconds_left <= 0:
                return False
            self._socket.settimeout(seconds_left)
            try:
                self._rest += self._socket.recv(4096).decode("latin-1")
            except TimeoutError:
                continue
            *lines, self._rest = self._rest.split("\r\n")
            self.lines += [line for line in lines if line]
            self.times += [time.monotonic() - self.begun] * (len(self.lines) - len(self.times))
        return True

    def ask(self, line: bytes, seconds: float) -> list[str]:
        """Send a line; return the lines up to its answer (ok; error:9: locked), within this
        time."""
        before = len(self.lines)
        self.send(line)
        assert self.listen(seconds, lambda: self.lines[before:][-1:] in (["ok"], ["error:9"]))
        return self.lines[before:]

    def banners(self) -> list[float]:
        """Return the times of all welcomes."""
        return [at for at, line in zip(self.times, self.lines) if _BANNER.match(line)]

    def forget(self) -> None:
        """Discard the lines received."""
        self.lines.clear()
        self.times.clear()

    def close(self) -> None:
        self._socket.close()
        self.process.terminate()
        self.process.communicate()


@pytest.fixture
def wire(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Wire]:
    made = Wire(tmp_path, getattr(request, "param", "$110=3000\n$120=500\n"))
    yield made
    made.close()


@pytest.mark.parametrize(
    ("wire", "state"), [("$110=3000\n", "Idle"), ("$22=1\n", "Alarm")], indirect=["wire"]
)
def test_ugs_initialises_once_and_gets_all_its_answers(wire: Wire, state: str) -> None:
    """UGS initialises after a welcome, unless it has already done so by itself soon after opening.

    Then it is silent for 2 s, asks for the state at most ten times, is silent for 2 s, and waits
    at most 2 s for each answer. wire: a connection to a machine with these settings.
    """
    wire.listen(2.0)
    queries = 0
    while not (reports := [line for line in wire.lines if line.startswith("<")]):
        assert queries < 10, "UGS gives up"
        wire.send(b"?")
        queries += 1
        wire.listen(1.0, lambda: any(line.startswith("<") for line in wire.lines))
    assert re.match(rf"<{state}\|MPos:[-\d.,]+\|FS:\d+,\d+", reports[0])
    if state == "Alarm":
        assert wire.ask(b"\n", 2.0)[-1] == "ok", "or UGS would reset the machine and start again"
    wire.listen(2.0)
    version = wire.ask(b"$I\n", 2.0)
    assert re.match(r"\[VER:1\.1h\.\d{8}:", version[0]) and version[1].startswith("[OPT:V")
    settings = wire.ask(b"$$\n", 2.0)[:-1]
    assert len(settings) == 34 and all(re.match(r"\$\d+=[\d.]+$", line) for line in settings)
    assert wire.ask(b"$G\n", 2.0)[0].startswith("[GC:G0 G54 ")
    (welcomed,) = wire.banners()  # the time of the only welcome
    assert 0.2 < welcomed < 2.0, "after UGS has opened the port, and before it asks"
    assert not [line for line in wire.lines if line.startswith("error")]


def test_candle_begins_with_its_reset_and_streams(wire: Wire) -> None:
    """Candle asks for reports at once, each after the answer to the last.

    A second after connecting it resets, and ignores everything except the welcome until then. It
    joins the lines of a reply into one text, which ends at "ok" or "error". Observed with version
    11.6.
    """
    for count in range(10):  # one second, with a report each 0.1 s
        wire.send(b"?")
        wire.listen(0.1)
        assert sum(line.startswith("<Idle|MPos:") for line in wire.lines) == count + 1
    wire.send(b"$G\n?")  # not answered any more, or ignored: the reset follows at once
    wire.forget()  # the lines received so far
    wire.send(b"\x18")
    assert wire.listen(3.0, lambda: bool(wire.banners()))
    wire.forget()  # also output from before the reset
    wire.send(b"$$\n$#\n")  # in one piece
    assert wire.listen(2.0, lambda: wire.lines.count("ok") == 2)
    settings, offsets, _ = "; ".join(wire.lines).split("ok")  # as Candle reads the two answers
    assert len(re.findall(r"\$(\d+)\=([^;]+)\; ", settings)) == 34 and "G54:" in offsets
    wire.forget()
    wire.send(b"S100\n$G\n")
    assert wire.listen(2.0, lambda: wire.lines.count("ok") == 2)
    lines = [f"G91G1X0.{n % 9 + 1}Y0.1F1200\n".encode() for n in range(200)]
    _stream(wire, lines)
    wire.send(b"?")
    wire.listen(1.0, lambda: wire.lines[-1].startswith("<"))
    assert re.search(r"MPos:([^,]*),([^,]*),([^,>|]*)", wire.lines[-1])
    assert not wire.banners(), "the welcome after the reset was the last"


def _stream(wire: Wire, lines: list[bytes]) -> None:
    """Send lines with at most 127 bytes unanswered, and ask for a report each 40 ms."""
    unanswered_lengths: deque[int] = deque()  # lengths of the lines that are not answered yet
    sent = answered = lines_read = 0  # numbers of lines; lines_read: reports, too
    last_query_s = time.monotonic()
    wire.forget()
    while answered < len(lines):
        while sent < len(lines) and sum(unanswered_lengths) + len(lines[sent]) <= 127:
            wire.send(lines[sent])
            unanswered_lengths.append(len(lines[sent]))
            sent += 1
        if time.monotonic() - last_query_s > 0.04:
            last_query_s = time.monotonic()
            wire.send(b"?")
        assert wire.listen(5.0, lambda seen=lines_read: len(wire.lines) > seen), "no answer comes"
        for line in wire.lines[lines_read:]:
            assert line.startswith("<") or line == "ok", line
            if line == "ok":
                unanswered_lengths.popleft()
                answered += 1
        lines_read = len(wire.lines)
    assert not unanswered_lengths
