"""Attacks on the network of a working machine, at real sockets of the desktop MicroPython.

None of the attackers has the key. Each segment of each job is the same as without them; a client
that has the key is answered, reconnects, and finally stops the machine. UGRBL_ATTACK: seconds of
attack (600 is a good number) instead of a few.
"""

import itertools
import json
import os
import random
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from micropython_runner import MICROPYTHON, needs_micropython, placed_firmware
from net_bench import KEY
from page_bench import PING, PONG, WS_UPGRADE, frame, request
from sim_bench import free_port
from ugrbl.boardfile import page_files
from ugrbl.paths import TOOLS

pytestmark = [needs_micropython, pytest.mark.thorough]

_SECONDS = float(os.environ.get("UGRBL_ATTACK", "6"))
_ROOT = Path(__file__).parents[2]
_PATIENCE_S = 120.0  # for the machine to end
_EACH_S = 0.004  # between two acts of an attacker
_LONGEST_US = 1_000_000  # lwIP would wait up to ten seconds
_LWIP_BYTES = 8000  # all memory that the board's network stack has for output
_OPEN = 10  # sockets of each attacker
_GREETED = b"for help]"


def _reset(connection: socket.socket) -> None:
    """Let close() reset the connection (TCP RST) instead of ending it."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")


class Attacker(threading.Thread):
    """Connect from its own address, send its kind of data, read nothing, and disconnect.

    number: of the address, and seed; says: pieces of data, without end; acts: pieces sent so far;
    over: set to end the thread."""

    def __init__(self, number: int, port: int, says: "Iterator[bytes]") -> None:
        super().__init__(daemon=True)
        self.over = threading.Event()
        self.acts = 0
        self._from, self._port, self._says = f"127.0.1.{number}", port, says
        self._chance = random.Random(number)
        self._open: list[socket.socket] = []

    def run(self) -> None:
        """Every 4 ms: perhaps connect, send the next piece on a random connection, perhaps
        close one."""
        while not self.over.wait(_EACH_S):
            if len(self._open) < _OPEN and self._chance.random() < 0.3:
                self._connect()
            with suppress(OSError, IndexError):  # the board may close the connection
                self._chance.choice(self._open).send(next(self._says))
                self.acts += 1
            if len(self._open) >= _OPEN and self._chance.random() < 0.1:
                closing = self._open.pop(self._chance.randrange(len(self._open)))
                if self._chance.random() < 0.5:  # else an orderly end
                    _reset(closing)
                closing.close()
        for connection in self._open:
            connection.close()

    def _connect(self) -> None:
        """Connect without waiting: the board may accept it later or never."""
        connection = socket.socket()
        # bytes: soon full, as it reads nothing
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
        connection.bind((self._from, 0))
        connection.setblocking(False)
        connection.connect_ex(("127.0.0.1", self._port))
        self._open.append(connection)


def _bytes_of(data: bytes) -> "Iterator[bytes]":
    return itertools.cycle(bytes((byte,)) for byte in data)


def _chance(number: int) -> "Iterator[bytes]":
    chance = random.Random(number)
    while True:
        yield chance.randbytes(chance.randrange(1, 2000))


def _keys() -> "Iterator[bytes]":
    for number in itertools.count():
        yield b"$NET/KEY=%08d\n" % number


_SOCKET = request("/ws", **{**WS_UPGRADE, "Origin": "http://ugrbl.local"})
_BY_TCP: "tuple[Iterator[bytes], ...]" = (
    itertools.cycle([b"?" * 99]),
    itertools.cycle(
        [b"$$\n$G\n?", b"!\x18~\x84\x85\x90\xa0", b"G1X9F9000\n$J=G91X9F900\n", b"\x03" * 9]
    ),
    itertools.cycle(
        [b"POST /!~ HTTP/1.1\r\nHost: a\r\n\r\n$J=G91X9F900\n", b"\x16\x03\x01\x02\x00"]
    ),
    itertools.cycle([b"$X\n$H\n$RST=*\n$NET/KEY=NEW\n$NET/OFF\n", b"(" * 4000, b"\n" * 500]),
    _keys(),
    _chance(1),
    itertools.cycle([b""]),  # half-open
)
_BY_HTTP: "tuple[Iterator[bytes], ...]" = (
    itertools.cycle([request("/"), request("/0"), request("/1"), request("/2?0000")]),
    _bytes_of(request("/0")),  # byte by byte
    itertools.cycle([b"GET / HTTP/1.1\r\n", b"X-%d: y\r\n" % 7 * 50, b"z" * 3000]),
    itertools.cycle(
        [request("/", Host="evil.example"), request("/", Transfer_Encoding="chunked")]
    ),
    itertools.cycle(
        [_SOCKET, frame("?" * 90), frame("x" * 125, PING), frame("$$\n"), frame("abcd", PONG)]
    ),
    itertools.cycle(
        [
            _SOCKET,
            frame("!\x18~G1X9\n"),
            b"\x82\xff" + b"\xff" * 12,
            b"\x82\xfe\xff\xff" + b"x" * 999,
        ]
    ),
    _chance(2),
)


class Client(threading.Thread):
    """A client with the key: it polls reports, reconnects now and then, and holds the machine at
    the end.

    stop: set to hold the machine with the next report; over: set to end the thread. visits: its
    connections that the machine answered; longest_s: longest time until a report came."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self.over, self.stop = threading.Event(), threading.Event()
        self.reports = self.visits = 0
        self.longest_s = 0.0
        self._port = port

    def run(self) -> None:
        while not self.over.is_set():
            with (
                suppress(OSError),
                socket.create_connection(("127.0.0.1", self._port), 2) as connection,
            ):
                connection.settimeout(2)
                connection.sendall(f"$NET/KEY={KEY}\n".encode())
                self._visit(connection)

    def _visit(self, connection: socket.socket) -> None:
        """Poll 20 reports on a connection on which the key was sent; "!" is a feed hold."""
        if b"ok\r\n" not in self._until(connection, b"ok\r\n"):
            return
        self.visits += 1
        for _ in range(20):
            if self.over.is_set():
                return
            asked_at_s = time.monotonic()
            connection.sendall(b"!?" if self.stop.is_set() else b"?")
            if b">" not in self._until(connection, b">"):
                return
            self.reports += 1
            self.longest_s = max(self.longest_s, time.monotonic() - asked_at_s)
            time.sleep(0.05)

    def _until(self, connection: socket.socket, end: bytes) -> bytes:
        """Return the bytes received until `end` is among them or the machine has closed."""
        received = b""
        while end not in received and (data := connection.recv(999)):
            received += data
        return received


def _machine(ports: "list[int]", folder: Path, seconds: float) -> "subprocess.Popen[str]":
    """Start attacked_machine.py, which runs jobs for some seconds and then one last job.

    ports: TCP, HTTP; folder: gets the page that is served."""
    page_files.save(folder)
    firmware = str(placed_firmware())
    paths = [firmware, str(_ROOT), str(TOOLS), ".frozen"]
    script = _ROOT / "host_tests" / "support" / "attacked_machine.py"
    return subprocess.Popen(
        [
            str(MICROPYTHON),
            "-X",
            "heapsize=16M",
            str(script),
            *map(str, ports),
            f"{folder}/",
            KEY,
            str(seconds),
        ],
        env={**os.environ, "MICROPYPATH": ":".join(paths)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def _has_said_last(machine: "subprocess.Popen[str]") -> None:
    """Wait until the machine says "last"; from now on a hold ends it."""
    assert machine.stdout
    line = machine.stdout.readline()
    assert line == "last\n", line + machine.stdout.read()


def _ended(machine: "subprocess.Popen[str]") -> "tuple[list[str], int, int, bool]":
    """Wait for the machine's end; return the digest of each job's segments, the longest turn of
    its network link in us, the most bytes that lwIP would have held, and whether a client has held
    the last job."""
    try:
        out, _ = machine.communicate(timeout=_PATIENCE_S)
    finally:
        machine.kill()
    assert machine.returncode == 0, out
    digests, longest_us, most_bytes, held = json.loads(out.splitlines()[-1])
    print(
        f"{len(digests)} jobs, the longest turn {longest_us} us,"
        f" {most_bytes} bytes held at the most"
    )
    return digests, longest_us, most_bytes, held


@pytest.mark.timeout(_SECONDS + 3 * _PATIENCE_S)
def test_attacks_change_no_segment_and_a_client_with_the_key_stops_the_machine(
    tmp_path: Path,
) -> None:
    """All attackers of both ports act at once while a client with the key polls and finally
    holds."""
    expected_digests = _quiet(tmp_path)  # without attackers
    tcp, http = ports = [free_port(), free_port()]
    machine = _machine(ports, tmp_path, _SECONDS)
    client = Client(tcp)
    attackers = [
        Attacker(number, port, says)
        for port, kinds in ((tcp, _BY_TCP), (http, _BY_HTTP))
        # each attacker has a number, and so an address, of its own
        for number, says in enumerate(kinds, 1 + (port == http) * len(_BY_TCP))
    ]
    client.start()
    for attacker in attackers:
        attacker.start()
    _has_said_last(machine)
    client.stop.set()  # hold the last job
    digests, longest_us, most_bytes, held = _ended(machine)
    for thread in (client, *attackers):
        thread.over.set()
    for thread in (client, *attackers):
        thread.join(10)
    print(
        f"{client.reports} reports, {client.visits} visits, {client.longest_s:.3f} s at the most"
    )
    print("acts:", [attacker.acts for attacker in attackers])
    assert set(digests) == expected_digests and digests
    assert held, "the machine did not hear the client with the key"
    assert longest_us < _LONGEST_US and most_bytes < _LWIP_BYTES
    assert client.reports > 5 * client.visits > 0  # few connections are lost early
    assert all(attacker.acts > 10 for attacker in attackers)


def _quiet(folder: Path) -> "set[str]":
    """Return the segments' digests of a job without attackers, held at the end by a client."""
    ports = [free_port(), free_port()]
    machine = _machine(ports, folder, 2)
    _has_said_last(machine)
    client = Client(ports[0])
    client.stop.set()
    client.start()
    digests, _, _, held = _ended(machine)
    client.over.set()
    client.join(10)
    assert held and len(set(digests)) == 1
    return set(digests)
