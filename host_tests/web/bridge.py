"""Serve the page, and a wire to a simulator, to a browser under test.

A small HTTP server on this computer. `/` is the page. `/serial` is a websocket that carries the
bytes of a serial port, for a stand-in of navigator.serial. `/ws` is the websocket of `ugrbl web`,
as far as one browser needs it. `/api/look` answers with `Bridge.look`, which a test sets.
"""

import base64
import hashlib
import json
import re
import struct
import subprocess
import sys
import threading
import time
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from socket import SHUT_RDWR
from tempfile import TemporaryDirectory
from typing import IO, Any

from as_users import as_users
from ugrbl.boardfile import page_files

# Saved as `ugrbl web --save` saves it.
_FOLDER = TemporaryDirectory(prefix="ugrbl-page-")
PAGE = Path(_FOLDER.name) / "ugrbl.html"
PAGE.write_text(page_files.page(), encoding="utf-8")
_GUID = "258EAFA5-E914-47DA-95CA-C5AB0DC85B11"  # RFC 6455
_TEXT, _BINARY, _CLOSE = 1, 2, 8
_PATIENCE_S = 20.0
_COMPILED_S = 200.0
_REPORT = re.compile(rb"<(\w+)[^|>]*\|MPos:([^|>]*)[^>]*?\|FS:(\d+)[^>]*>")


class Machine:
    """Run one `ugrbl sim --stdio` and record all bytes sent and received."""

    def __init__(self, settings: Path, *options: str, command: "list[str] | None" = None) -> None:
        """Start the simulator. command: starts another simulator instead."""
        usual = [sys.executable, "-m", "ugrbl.cli", "sim", "--stdio", "--settings", str(settings)]
        self.process = subprocess.Popen(
            command or [*usual, *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=as_users(),
        )
        self.sent = bytearray()
        self.said = bytearray()
        self.hears = True  # False: bytes sent are recorded, but do not reach the simulator
        self._sinks: list[Socket] = []
        threading.Thread(target=self._read, daemon=True).start()

    def write(self, data: bytes) -> None:
        self.sent += data
        assert self.process.stdin
        if self.hears:
            self.process.stdin.write(data)
            self.process.stdin.flush()

    def say(self, data: bytes) -> None:
        """Send data to all attached sockets, as if the machine had sent it."""
        for sink in list(self._sinks):
            with suppress(OSError):
                sink.send(_BINARY, data)

    def attach(self, sink: "Socket") -> None:
        self._sinks.append(sink)

    def detach(self, sink: "Socket") -> None:
        self._sinks.remove(sink)

    def unplug(self) -> None:
        """Close the connection of every attached socket."""
        for sink in list(self._sinks):
            sink.close()

    def lines(self) -> list[str]:
        """Return the lines sent, without realtime bytes."""
        acts = bytes([0x18, *b"?!~", *range(0x80, 0x100)])
        return self.sent.translate(None, acts).decode("ascii").split("\n")[:-1]

    def reports(self, since: int = 0) -> list[tuple[str, list[float], float]]:
        """Return state, machine position in mm, and feed of each report; since: the first byte."""
        return [
            (state.decode(), [float(mm) for mm in place.split(b",")], float(feed))
            for state, place, feed in _REPORT.findall(self.said, since)
        ]

    def report(self, state: str = "") -> tuple[str, list[float], float]:
        """Request reports directly, not through the page; return the first with that state."""
        until = time.monotonic() + _PATIENCE_S
        while time.monotonic() < until:
            before = len(self.said)
            self.write(b"?")
            for _ in range(20):
                if found := [row for row in self.reports(before) if row[0].startswith(state)]:
                    return found[0]
                time.sleep(0.005)
        raise AssertionError(f"never {state}")

    def waits_for(self, words: bytes) -> None:
        """Wait until the machine has sent words."""
        until = time.monotonic() + _COMPILED_S
        while words not in self.said:
            assert time.monotonic() < until, f"never {words!r}"
            time.sleep(0.05)

    def is_new(self) -> bool:
        """Return whether the machine runs and nothing has been sent to it."""
        return not self.sent and self.process.poll() is None

    def close(self) -> None:
        self.process.kill()
        self.process.communicate()

    def _read(self) -> None:
        out: Any = self.process.stdout
        while data := out.read1(4096):
            self.said += data
            self.say(data)


class Socket:
    """The server's side of a websocket."""

    def __init__(self, reader: IO[bytes], writer: Any) -> None:
        self._reader = reader
        self._writer = writer
        self._lock = threading.Lock()

    def send(self, kind: int, data: bytes) -> None:
        size = len(data)
        length = bytes([size]) if size < 126 else b"\x7e" + struct.pack(">H", size)
        with self._lock:
            self._writer.sendall(bytes([0x80 | kind]) + length + data)

    def tell(self, news: dict[str, object]) -> None:
        self.send(_TEXT, json.dumps(news).encode())

    def receive(self) -> tuple[int, bytes]:
        """Return kind and content of the next message; _CLOSE at the end of the stream."""
        head = self._reader.read(2)
        if len(head) < 2:
            return _CLOSE, b""
        size = head[1] & 0x7F
        if size >= 126:
            size = int.from_bytes(self._reader.read(2 if size == 126 else 8), "big")
        mask = self._reader.read(4)
        data = self._reader.read(size)
        return head[0] & 15, bytes(byte ^ mask[i % 4] for i, byte in enumerate(data))

    def close(self) -> None:
        with suppress(OSError):
            self._writer.shutdown(SHUT_RDWR)


class Bridge(ThreadingHTTPServer):
    """Serve one machine. drives: whether a browser that connects to /ws controls it at once."""

    daemon_threads = True

    def __init__(self, machine: Machine) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.machine = machine
        self.drives = True
        self.look: dict[str, object] | None = None
        self.looked: dict[str, Any] = {}  # the last request to /api/look
        self.asked_for: list[str] = []  # paths, with their queries
        self.address = f"127.0.0.1:{self.server_address[1]}"
        threading.Thread(target=self.serve_forever, daemon=True).start()

    def handle_error(self, *_: object) -> None:
        """Ignore connections that browsers have closed."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: Bridge

    def log_message(self, *_: object) -> None:
        """Suppress the log."""

    def do_GET(self) -> None:
        self.server.asked_for.append(self.path)
        path = self.path.partition("?")[0]
        if path == "/":
            self._answer("text/html; charset=utf-8", PAGE.read_bytes())
        elif path in ("/serial", "/ws"):
            self._websocket(path == "/ws")
        else:
            self.send_error(404)

    def do_POST(self) -> None:
        self.server.asked_for.append(self.path)
        body = self.rfile.read(int(self.headers["Content-Length"]))
        if self.path.partition("?")[0] != "/api/look" or self.server.look is None:
            self.send_error(404)
            return
        self.server.looked = json.loads(body)
        self._answer("application/json", json.dumps(self.server.look).encode())

    def _answer(self, kind: str, body: bytes) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def _websocket(self, serves: bool) -> None:
        key = self.headers["Sec-WebSocket-Key"] + _GUID
        self.send_response(101)
        self.send_header("Upgrade", "websocket")
        self.send_header("Connection", "Upgrade")
        accept = base64.b64encode(hashlib.sha1(key.encode()).digest()).decode()
        self.send_header("Sec-WebSocket-Accept", accept)
        self.end_headers()
        self.wfile.flush()
        self.close_connection = True
        self._carry(Socket(self.rfile, self.connection), serves)

    def _carry(self, socket: Socket, serves: bool) -> None:
        """Carry bytes both ways until one side closes. serves: behave as /ws of `ugrbl web`."""
        machine, drives = self.server.machine, self.server.drives or not serves
        if serves:
            socket.tell(_news(drives, 1))
        machine.attach(socket)
        try:
            while (message := socket.receive())[0] != _CLOSE:
                kind, data = message
                if kind == _TEXT:
                    drives = json.loads(data)["drive"]
                    socket.tell(_news(drives, int(drives)))
                elif kind == _BINARY and drives:
                    machine.write(data)
        finally:
            machine.detach(socket)


def _news(drives: bool, drivers: int) -> dict[str, object]:
    link = {"name": "sim", "open": True}
    return {"link": link, "driver": drives, "drivers": drivers, "watchers": int(not drives)}
