"""What wires to one sender at a time have in common: who is there, who listens, the welcome."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable

# A sender that has not taken a byte for so long does not listen: what follows is lost on it.
_DEAF_S = 0.5
# What is kept for the first sender to come: the banner.
_KEPT = 1024
# An Arduino is silent for longer after it has been opened, and a sender that says nothing of
# itself may count on it: the Universal G-Code Sender begins twice where it is greeted before it
# has noted that it has begun.
_WELCOME_S = 0.3


class Wire(ABC):
    """A wire that outlives its senders. on_open: called when one has come that is to be greeted;
    the first hears what was said before."""

    closed = False
    on_open: Callable[[], None] = staticmethod(lambda: None)

    def __init__(self) -> None:
        self._connected = False
        self._since = 0.0
        self._welcomed = False
        self._early: bytes | None = b""  # kept for the first; None once it has been told
        self._deaf = False

    @abstractmethod
    def _take(self, limit: int) -> bytes | None:
        """What has come; None where nobody is there."""

    @abstractmethod
    def _put(self, data: bytes) -> int:
        """Send; returns how many bytes have gone. BlockingIOError where none can."""

    @abstractmethod
    def _wait_to_put(self, seconds: float) -> None:
        """Until some can, so long at the most."""

    @abstractmethod
    def _wait_to_take(self, seconds: float) -> None:
        """Until something has come, so long at the most."""

    def _left(self) -> None:
        """The sender has gone."""
        self._connected = self._welcomed = self._deaf = False

    def read(self, limit: int) -> bytes:
        """What has come from the sender."""
        data = self._take(limit)
        if data is None:
            if self._connected:
                self._left()
            return b""
        if not self._connected:
            self._connected = True
            self._since = time.monotonic()
        if not self._welcomed and (data or time.monotonic() >= self._since + _WELCOME_S):
            self._welcome()
        return data

    def _welcome(self) -> None:
        self._welcomed = True
        early, self._early = self._early, None
        if early is None:
            self.on_open()
        else:
            self._send(early)

    def write(self, data: bytes) -> None:
        """Send; without a sender, or to one that does not read, the bytes are lost."""
        if self._early is not None:
            self._early = (self._early + data)[-_KEPT:]
        elif self._connected:
            self._send(data)

    def wait(self, seconds: float) -> None:
        """Sleep until bytes come; with nobody there, for the time given."""
        if self._connected:
            self._wait_to_take(seconds)
        else:
            time.sleep(seconds)

    def _send(self, data: bytes) -> None:
        until = time.monotonic() + (0 if self._deaf else _DEAF_S)
        while data:
            try:
                data = data[self._put(data) :]
                self._deaf = False
            except BlockingIOError:
                self._wait_to_put(max(0.0, until - time.monotonic()))
                if time.monotonic() >= until:
                    self._deaf = True
                    return
            except OSError:
                return
