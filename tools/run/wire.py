"""The common part of wires to one sender at a time: connection, lost bytes, welcome."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable

# A sender that has not accepted a byte for so long is not listening; further bytes are lost.
_DEAF_S = 0.5
# So many bytes, which have the banner, are kept for the first sender.
_KEPT = 1024
# An Arduino is silent for longer after its port is opened, and a silent sender may rely on it:
# Universal G-Code Sender starts twice if it is greeted before it has noted its own start.
_WELCOME_S = 0.3


class Wire(ABC):
    """A wire that outlives its senders. on_open: called when a sender has connected and must be
    greeted. The first one gets what was sent before."""

    closed = False
    on_open: Callable[[], None] = staticmethod(lambda: None)

    def __init__(self) -> None:
        self._connected = False
        self._connected_at = 0.0  # when the sender connected
        self._welcomed = False  # the sender has got its banner
        self._early: bytes | None = b""  # kept for the first sender; None after it was sent
        self._is_deaf = False  # the sender did not read in time

    @abstractmethod
    def _take(self, limit: int) -> bytes | None:
        """Return received bytes; None if no sender is connected."""

    @abstractmethod
    def _put(self, data: bytes) -> int:
        """Send bytes; returns how many were accepted. BlockingIOError if none can be."""

    @abstractmethod
    def _wait_to_put(self, seconds: float) -> None:
        """Wait until bytes can be sent, at most for that time."""

    @abstractmethod
    def _wait_to_take(self, seconds: float) -> None:
        """Wait until bytes have arrived, at most for that time."""

    def _note_disconnect(self) -> None:
        """Note that the sender has disconnected."""
        self._connected = self._welcomed = self._is_deaf = False

    def read(self, limit: int) -> bytes:
        """Return the bytes received from the sender."""
        data = self._take(limit)
        if data is None:
            if self._connected:
                self._note_disconnect()
            return b""
        if not self._connected:  # a new sender
            self._connected = True
            self._connected_at = time.monotonic()
        if not self._welcomed and (data or time.monotonic() >= self._connected_at + _WELCOME_S):
            self._welcome()
        return data

    def _welcome(self) -> None:
        """Send a new sender what was kept for it, or have the machine greet it."""
        self._welcomed = True
        early, self._early = self._early, None
        if early is None:
            self.on_open()
        else:
            self._send(early)

    def write(self, data: bytes) -> None:
        """Send bytes. Before the first sender they are kept for it, the last _KEPT of them. Later,
        without a sender or to one that does not read, they are lost."""
        if self._early is not None:
            self._early = (self._early + data)[-_KEPT:]
        elif self._connected:
            self._send(data)

    def wait(self, seconds: float) -> None:
        """Wait until bytes arrive; without a sender, for the time given."""
        if self._connected:
            self._wait_to_take(seconds)
        else:
            time.sleep(seconds)

    def _send(self, data: bytes) -> None:
        """Send bytes; those that the sender does not accept in time are lost."""
        deadline = time.monotonic() + (0 if self._is_deaf else _DEAF_S)  # no second wait
        while data:
            try:
                data = data[self._put(data) :]
                self._is_deaf = False
            except BlockingIOError:
                self._wait_to_put(max(0.0, deadline - time.monotonic()))
                if time.monotonic() >= deadline:
                    self._is_deaf = True
                    return
            except OSError:  # the sender has disconnected
                return
