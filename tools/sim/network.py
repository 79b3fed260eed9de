"""The network of a simulated machine: the firmware's own link around a simulated cable.

Sockets are the computer's. What they do has the wall's time; the machine knows only its own.
"""

import socket
from array import array
from contextlib import suppress

from ports.net_link import NetLink

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from interfaces import Incoming

    from .rig import Rig


class HostConnection:
    """A socket as MicroPython has it, which never waits."""

    def __init__(self, made: socket.socket) -> None:
        made.setblocking(False)
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = made

    def readinto(self, buf: bytearray) -> "int | None":
        """What has come; None where nothing has, 0 at the end."""
        try:
            return self._socket.recv_into(buf)
        except BlockingIOError:
            return None

    def write(self, data: "bytes | bytearray | memoryview") -> "int | None":
        """As much as there is room for."""
        try:
            return self._socket.send(data)
        except BlockingIOError:
            return None

    def close(self) -> None:
        """Hang up."""
        self._socket.close()


class HostCalls:
    """Listens at a port of this computer; 0: any that is free."""

    def __init__(self, host: str = "127.0.0.1", port: int = 0) -> None:
        try:
            self._listener = socket.create_server((host, port))
        except OSError as fault:
            why = (fault.strerror or str(fault)).partition(" (")[0]
            raise OSError(f"{host}:{port} cannot be listened at: {why}") from fault
        self.host = host
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]

    def next(self) -> "tuple[HostConnection, str] | None":
        """Who has called, and from where."""
        with suppress(BlockingIOError, ConnectionError):
            made, address = self._listener.accept()
            return HostConnection(made), str(address[0])
        return None

    def close(self) -> None:
        """Hear nobody any more."""
        self._listener.close()


class RigLink(NetLink):
    """A NetLink that a rig can have: what the rig, and who is around it, wants besides is the
    cable's."""

    # What is set from outside.
    _OF_CABLE = ("received", "stopping", "turn")

    def __init__(self, rig: "Rig", cable: "Any", calls: "Incoming | None") -> None:
        cable.shared = array("i", (0, 0, 0))
        cable.look = None
        cable.is_slow = False
        self.cable = cable
        super().__init__(cable, calls)
        self._rig = rig
        self._at_rest = self._is_at_rest  # the machine is made later, and perhaps again

    def _is_at_rest(self) -> bool:
        return self._rig.controller.at_rest()

    def __getattr__(self, name: str) -> "Any":
        return getattr(self.__dict__["cable"], name)

    def __setattr__(self, name: str, value: "Any") -> None:
        if name in self._OF_CABLE:
            setattr(self.cable, name, value)
        else:
            super().__setattr__(name, value)
