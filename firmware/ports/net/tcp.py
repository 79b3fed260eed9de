"""TCP by MicroPython's sockets, without waiting: new connections and their bytes."""

import select
import socket

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import Any

    from interfaces import Connection

_WAITING = const(2)  # connections that may wait to be accepted; lwIP has memory for five in all
_IPPROTO_TCP = const(6)


class Calls:
    """An Incoming. Listens at a port of every address of the board; OSError if that fails."""

    def __init__(self, port: int) -> None:
        self._listener: "Any" = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._listener.bind(socket.getaddrinfo("0.0.0.0", port)[0][-1])  # the first's address
        self._listener.listen(_WAITING)
        self._listener.setblocking(False)
        self._input_poll: "Any" = select.poll()
        self._input_poll.register(self._listener, select.POLLIN)
        self._no_delay: int = getattr(socket, "TCP_NODELAY", 0)  # desktops' MicroPython has none

    def next(self) -> "tuple[Connection, str] | None":
        """Return a new connection and the address of its other end; None if there is none."""
        for _ in self._input_poll.ipoll(0):
            try:
                client, address = self._listener.accept()
                client.setblocking(False)
                if self._no_delay:
                    client.setsockopt(_IPPROTO_TCP, self._no_delay, 1)
            except OSError:
                return None  # closed again
            return client, str(address[0])
        return None

    def close(self) -> None:
        """Stop listening."""
        self._listener.close()
