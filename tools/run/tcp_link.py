"""The simulator over TCP: a wire for senders that cannot open a pseudo-terminal, and the sockets
of a board's network."""

import errno
import select
import socket
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

from serial import serial_for_url
from serial.rfc2217 import PortManager

from ..grbl.wire_bytes import permitted
from .wire import Wire

LOOPBACK = "127.0.0.1"


def address(text: str) -> tuple[str, int]:
    """Parse `[HOST:]PORT`; without a host it is this computer only. ValueError if it is not
    valid."""
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or int(port) > 65535:
        raise ValueError(f"{text} is no address to listen at; write it as 2323 or {LOOPBACK}:2323")
    return host.strip("[]") or LOOPBACK, int(port)


def listener(host: str, port: int, backlog: int | None = None) -> socket.socket:
    """Return a listening socket that never blocks. backlog: number of clients that may wait.
    OSError if listening is not possible."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listening = socket.create_server((host, port), family=family, backlog=backlog)
    except OSError as error:
        raise OSError(f"cannot listen at {host}:{port}: {why_not(error)}") from error
    listening.setblocking(False)
    return listening


def why_not(error: OSError) -> str:
    """Return why listening is not possible, and what to use instead."""
    if error.errno == errno.EADDRINUSE:
        return "another program listens there; choose another port"
    if error.errno == errno.EACCES:
        return "the system reserves such ports; choose one from 1024 on"
    return "this computer has no such address; 0.0.0.0 means all of its own"


class Tcp(Wire):
    """Accepts one sender at a time; another one waits until the first has disconnected."""

    def __init__(self, host: str, port: int) -> None:
        super().__init__()
        self._listener = listener(host, port, backlog=1)
        self._sender: socket.socket | None = None
        self.name = f"{host}:{self._listener.getsockname()[1]}"

    def close(self) -> None:
        """Disconnect."""
        self._hang_up()
        self._listener.close()

    def _take(self, limit: int) -> bytes | None:
        """Return received bytes that a sender may send to Grbl; None without a sender."""
        data = self._receive(limit)
        return permitted(data) if data else data

    def _receive(self, limit: int) -> bytes | None:
        """Return received bytes, from a new sender if there is none; None without a sender."""
        if self._sender is None:
            self._accept()
        if self._sender is None:
            return None
        try:
            data = self._sender.recv(limit)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:  # the sender has disconnected
            self._hang_up()
            return None
        return data

    def _accept(self) -> None:
        """Accept the next sender that waits, if any."""
        with suppress(BlockingIOError):
            sender, _ = self._listener.accept()
            sender.setblocking(False)
            sender.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            sender.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            self._sender = sender

    def _hang_up(self) -> None:
        """Disconnect the sender, if any."""
        if self._sender is not None:
            self._sender.close()
        self._sender = None

    def _put(self, data: bytes) -> int:
        if self._sender is None:
            raise ConnectionError
        return self._sender.send(data)

    def _wait_to_put(self, seconds: float) -> None:
        select.select([], self._open(), [], seconds)

    def _wait_to_take(self, seconds: float) -> None:
        select.select(self._open(), [], [], seconds)

    def _open(self) -> list[socket.socket]:
        """Return the sender's socket, if any, for select()."""
        return [self._sender] if self._sender else []


class Rfc2217(Tcp):
    """The same for senders that open a serial port over the network (RFC 2217).

    Their settings, such as the speed, are accepted and have no effect. Grbl's output is ASCII and
    needs no escape.
    """

    _port: PortManager | None = None

    def _accept(self) -> None:
        """Accept the next sender, with a serial port that takes its settings."""
        super()._accept()
        if self._sender is not None:
            dummy_port: Any = serial_for_url("loop://")  # takes the settings
            answers: Any = SimpleNamespace(write=self._negotiate)  # gets the protocol's answers
            self._port = PortManager(dummy_port, answers)

    def _receive(self, limit: int) -> bytes | None:
        """Return received bytes without the protocol's commands, which are answered."""
        data = super()._receive(limit)
        return b"".join(self._port.filter(data)) if data and self._port else data

    def _negotiate(self, data: bytes) -> None:
        """Send an answer of the protocol."""
        with suppress(OSError):  # the sender does not read, or has disconnected
            self._put(data)


class HostConnection:
    """A non-blocking socket with MicroPython's interface."""

    def __init__(self, accepted: socket.socket) -> None:
        accepted.setblocking(False)
        accepted.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = accepted

    def readinto(self, buf: bytearray) -> int | None:
        """Return the number of bytes received; None if there are none, 0 at the end."""
        try:
            return self._socket.recv_into(buf)
        except BlockingIOError:
            return None

    def write(self, data: bytes | bytearray | memoryview) -> int | None:
        """Send as much as the socket takes; returns the number of bytes, or None."""
        try:
            return self._socket.send(data)
        except BlockingIOError:
            return None

    def close(self) -> None:
        """Disconnect."""
        self._socket.close()


class HostCalls:
    """Accepts clients of a simulated board's network at a port of this computer; 0: any free port.
    Sockets work in wall time; the machine has only virtual time."""

    def __init__(self, host: str = LOOPBACK, port: int = 0) -> None:
        self._listener = listener(host, port)
        self.host = host
        self.port: int = self._listener.getsockname()[1]

    def next(self) -> tuple[HostConnection, str] | None:
        """Return the next client and its address; None if there is none."""
        with suppress(BlockingIOError, ConnectionError):
            accepted, address = self._listener.accept()
            return HostConnection(accepted), str(address[0])
        return None

    def close(self) -> None:
        """Stop listening."""
        self._listener.close()
