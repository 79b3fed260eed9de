"""Run the simulator in its own process, so that it keeps real time under any load from browsers.

Run as a program, this is that process. It reads its options as a line of JSON on stdin and prints
its TCP address, or why it cannot start, as a line of JSON on stdout. It ends when stdin closes,
and so with the server, however that ends.
"""

import json
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..device.connection import SendError
from ..run import machine
from ..run.live import LiveLink
from ..run.tcp_link import LOOPBACK, Tcp, address

_READ_S = 0.05
_READ_BYTES = 4096
_PATIENCE_S = 5.0  # time limit for a connection, and for the end of the process


class TcpPort:
    """A TCP connection with the part of pyserial's Serial that board_link.py uses.

    Raises OSError when the connection breaks, as pyserial does. pyserial's own TCP port sends
    small messages late and reads byte by byte.
    """

    def __init__(self, place: str) -> None:
        self._socket = socket.create_connection(address(place), _PATIENCE_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._received = b""  # and not yet read

    @property
    def in_waiting(self) -> int:
        """Return the number of bytes already received."""
        return len(self._received)

    def read(self, limit: int) -> bytes:
        """Return at most limit bytes; wait up to 0.05 s for the first. b"": none have come."""
        if not self._received and select.select([self._socket], [], [], _READ_S)[0]:
            self._received = self._socket.recv(_READ_BYTES)
            if not self._received:
                raise ConnectionResetError("it has hung up")
        data, self._received = self._received[:limit], self._received[limit:]
        return data

    def write(self, data: bytes) -> None:
        """Send all bytes."""
        self._socket.sendall(data)

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


class Simulator:
    """Replace a board at a serial port. settings: the file that stores its settings, if any.

    It has limit switches at both ends of its travel if each motor moves one axis.
    """

    name = "sim"

    def __init__(self, board: str, settings: Path | None = None) -> None:
        self._options = {"board": board, "settings": str(settings) if settings else ""}
        self._process: subprocess.Popen[str] | None = None
        self._address = ""  # its TCP address, HOST:PORT

    def open(self) -> TcpPort:
        """Return its port; start it if it is not running. Raises SendError."""
        if self._process is None or self._process.poll() is not None:
            self._start()
        try:
            return TcpPort(self._address)
        except OSError as error:
            raise SendError("the simulator does not answer") from error

    def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        if process is None:
            return
        try:
            process.communicate(timeout=_PATIENCE_S)  # closes its stdin
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()

    def _start(self) -> None:
        """Start the process and learn its address. Raises SendError if it does not start."""
        self.close()
        process = subprocess.Popen(
            [sys.executable, "-m", f"{__package__}.simulator"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            start_new_session=True,  # Ctrl-C is for the server
        )
        assert process.stdin and process.stdout
        try:
            process.stdin.write(json.dumps(self._options) + "\n")
            process.stdin.flush()
            answer = json.loads(process.stdout.readline() or "{}")
        except (OSError, ValueError):
            answer = {}  # it ended, or printed something else than its address
        self._process = process
        if "place" not in answer:
            self.close()
            raise SendError(answer.get("refused", "the simulator ended while it was starting"))
        self._address = answer["place"]


def main() -> None:
    """Simulate in real time until stdin ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    options = json.loads(sys.stdin.readline())
    out, sys.stdout = sys.stdout, sys.stderr  # other prints go to stderr
    wire = Tcp(LOOPBACK, 0)
    try:
        rig = _build(options, wire)
    except (ValueError, OSError) as error:
        print(json.dumps({"refused": str(error)}), file=out, flush=True)
        return
    print(json.dumps({"place": wire.name}), file=out, flush=True)
    threading.Thread(target=_end_with_stdin, args=(rig.link,), daemon=True).start()
    machine.run(rig)
    wire.close()


def _build(options: Mapping[str, str], wire: Tcp) -> Any:
    """Build a rig on the wire, with switches. Raises ValueError for an invalid board or file."""
    file = Path(options["settings"]) if options["settings"] else None
    rig = machine.build(
        options["board"], lambda rig: LiveLink(rig, wire, fast=False), file, keeps_jobs=True
    )
    from ..sim import motor_names, switches

    if not motor_names.shared(rig.board):
        switches.fit(rig)
    return rig


def _end_with_stdin(link: LiveLink) -> None:
    """End the simulation when stdin ends. This is a thread."""
    sys.stdin.read()
    link.stopping = True


if __name__ == "__main__":
    main()
