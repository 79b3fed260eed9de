"""`ugrbl sim` on a bench: limit switches for homing, inputs to set, a log of the wire.

As a program it is `ugrbl sim` with these additions, see serve(); as a module, Bench runs that
program in a separate process.
"""

import json
import os
import random
import select
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, TextIO

from as_users import as_users

_PATIENCE_S = 60.0
_HERE = Path(__file__).resolve().parent

# Where the simulated machine's limit switches close, in steps from its position at power-up.
SWITCH_STEPS = 5000
STEPS_PER_MM = 250
# Fast enough for a test in real time, with everything enabled that stock settings leave off. A
# busy
# computer sees a switch up to 50 ms late: the overrun must stay within the pull-off ($25, $27).
SETTINGS = {
    1: 255,
    22: 1,
    24: 300,
    25: 600,
    26: 5,
    27: 1,
    110: 3000,
    111: 3000,
    112: 3000,
    120: 400,
    121: 400,
    122: 400,
}


def free_port() -> int:
    """Return a free port that the system never assigns to clients.

    A client that repeatedly connects to such a port before anything listens there finally connects
    to
    itself, and keeps the port."""
    for port in random.SystemRandom().sample(range(20_000, 30_000), 100):
        with socket.socket() as free, suppress(OSError):
            free.bind(("127.0.0.1", port))
            return port
    raise AssertionError("there is no free port")


class Bench:
    """A running simulator.

    settings: stored from the start, by number. network: nobody uses its cable, and clients from
    this
    computer control it."""

    def __init__(
        self,
        folder: Path,
        *arguments: str,
        settings: dict[int, float] = {},  # noqa: B006
        network: bool = False,
    ) -> None:
        self.port = folder / "grbl"
        self.url = str(self.port)
        self.wire_log = folder / "wire.jsonl"
        self._place = Path(f"{self.wire_log}.place")
        kept = folder / "settings.txt"
        if settings:
            lines = [f"${number}={value:g}\n" for number, value in settings.items()]
            if network:
                lines += [";[network] KEY=23456789\n"]
            kept.write_text("".join(lines))
        command = [sys.executable, __file__, str(self.wire_log), "sim", "--port", str(self.port)]
        command += ["--settings", str(kept), *arguments]
        if network:
            place = free_port()
            self.url = f"socket://127.0.0.1:{place}"
            command += ["--network", str(place)]
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            env=as_users(),
            text=True,
        )
        until = time.monotonic() + _PATIENCE_S
        while not self.port.is_symlink():
            assert self.process.poll() is None and time.monotonic() < until, "no simulator"
            time.sleep(0.02)

    def push(self, pin: str, closed: bool = True) -> None:
        """Close or open an input by hand: limit_x … limit_z, probe, reset, hold, start."""
        assert self.process.stdin
        self.process.stdin.write(json.dumps({pin: closed}) + "\n")
        self.process.stdin.flush()

    def stop(self) -> list[int]:
        """Switch it off; return the motors' position, in steps from the start."""
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(_PATIENCE_S)
        place: list[int] = json.loads(self._place.read_text())
        return place

    def kill(self) -> None:
        """Kill the process, whatever happened."""
        self.process.kill()
        self.process.communicate()

    def wire(self, direction: str) -> bytes:
        """Return all bytes that the sender has sent (">"), or received ("<")."""
        rows = [json.loads(line) for line in self.wire_log.read_text().splitlines()]
        return b"".join(row[2].encode("latin-1") for row in rows if row[1] == direction)


def serve(wire_log: Path, arguments: list[str]) -> None:
    """Run `ugrbl sim` with switches; commands for inputs come as JSON on stdin."""
    from ugrbl import paths
    from ugrbl.cli.app import app
    from ugrbl.run import machine, pty_link
    from ugrbl.run.tcp_link import LOOPBACK

    build = machine.build
    rigs = []

    def fitted(*arguments: Any, **options: Any) -> Any:
        rig = build(*arguments, **options)
        _fit_switches(rig)
        _listen(rig)
        rigs.append(rig)
        return rig

    machine.build = fitted
    out = wire_log.open("w", buffering=1)
    _log(pty_link.Pty, out)
    if "--network" in arguments:
        _log_network(out)
        paths.use_firmware()
        from ugrbl.sim.network import RigLink

        RigLink.trusts = (LOOPBACK,)
    app(arguments, standalone_mode=False)
    rig = rigs[0]
    rig.engine.physical(rig.scratch)
    Path(f"{wire_log}.place").write_text(json.dumps(list(rig.scratch)))


def _fit_switches(rig: Any) -> None:
    from ugrbl.sim.engine import Switch

    for axis, letter in enumerate("xyz"):
        rig.engine.switches.append(Switch(f"limit_{letter}", axis, True, SWITCH_STEPS))


def _listen(rig: Any) -> None:
    """Read commands on stdin whenever the firmware reads."""
    read = rig.link.read_into
    rest = ""

    def read_into(buf: bytearray) -> int:
        nonlocal rest
        while select.select([0], [], [], 0)[0] and (data := os.read(0, 4096)):
            *lines, rest = (rest + data.decode()).split("\n")
            for line in lines:
                rig.port.push(json.loads(line))
        return int(read(buf))

    rig.link.read_into = read_into


def _note(out: TextIO, direction: str, data: bytes) -> None:
    if data:
        out.write(json.dumps([time.monotonic(), direction, data.decode("latin-1")]) + "\n")


def _log(pty: Any, out: TextIO) -> None:
    """Log the bytes on the wire, with the time."""
    read, write = pty.read, pty.write

    def logged_read(self: Any, limit: int) -> bytes:
        data: bytes = read(self, limit)
        _note(out, ">", data)
        return data

    def logged_write(self: Any, data: bytes) -> None:
        _note(out, "<", data)
        write(self, data)

    pty.read, pty.write = logged_read, logged_write


def _log_network(out: TextIO) -> None:
    """Log the bytes on connections in the same way."""
    from ugrbl.run import tcp_link

    connection: Any = tcp_link.HostConnection
    read, write = connection.readinto, connection.write

    def logged_read(self: Any, buf: bytearray) -> "int | None":
        count: "int | None" = read(self, buf)
        _note(out, ">", bytes(buf[: count or 0]))
        return count

    def logged_write(self: Any, data: bytes) -> "int | None":
        count: "int | None" = write(self, data)
        _note(out, "<", bytes(data[: count or 0]))
        return count

    connection.readinto, connection.write = logged_read, logged_write


if __name__ == "__main__":
    # This folder holds the stand-ins of the firmware's tests, not the simulator's modules.
    sys.path.remove(str(_HERE))
    serve(Path(sys.argv[1]), sys.argv[2:])
