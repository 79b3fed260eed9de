"""Connect a board at its port; threads read and write, so that no browser delays them.

After unplugging, opening the port is retried once a second without limit.
"""

import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

from ..device.connection import BAUD, SendError, broke, open_port

_READ_S = 0.05
_AGAIN_S = 1.0
_READ_BYTES = 4096
_WRITE_BYTES = 256
# Time limit for the last bytes when the link is closed; a feed hold among them must be sent.
_CLOSING_S = 1.0


class Source(Protocol):
    """A place where a board can be opened."""

    name: str

    def open(self) -> Any:
        """Open a port with pyserial's interface. Raises SendError if it cannot be opened."""

    def close(self) -> None:
        """Close the source; it is not opened again."""


class SerialSource:
    """A serial port. where: returns its name, or raises SendError."""

    name = ""

    def __init__(self, where: Callable[[], str], baud: int = BAUD) -> None:
        self._where = where
        self._baud = baud

    def open(self) -> Any:
        """Open the port that exists now; its name may differ after plugging in again."""
        self.name = self._where()
        return open_port(self.name, self._baud, _READ_S)

    def close(self) -> None:
        """Do nothing; the source holds no resources."""


class BoardLink:
    """Pass bytes to and from one board.

    heard receives the bytes from the board. changed is called when the link breaks and when it is
    restored. log receives a sentence. All three are called from threads.
    """

    def __init__(
        self,
        source: Source,
        heard: Callable[[bytes], None],
        changed: Callable[[], None],
        log: Callable[[str], None],
    ) -> None:
        self._source = source
        self._heard, self._changed, self._log = heard, changed, log
        self._port: Any = None  # None: no board is connected
        self._closing = threading.Event()
        self._queues_changed = threading.Condition()  # and the lock of all that follows
        self._urgent = bytearray()  # realtime bytes to write, before all lines
        self._lines: deque[bytes] = deque()
        self._is_writing = False  # bytes taken from these two are being written
        self._last_reason = ""  # the last logged reason why the port could not be opened
        self._threads = [
            threading.Thread(target=work, name=f"board link, {work.__name__}", daemon=True)
            for work in (self._read_loop, self._write_loop)
        ]

    @property
    def name(self) -> str:
        """Return the name of the port, or `sim`."""
        return self._source.name

    @property
    def is_open(self) -> bool:
        """Return whether a board is connected."""
        return self._port is not None

    def start(self) -> None:
        """Open the port for the first time and start the threads. Raises SendError."""
        self._port = self._source.open()
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Send the remaining bytes within 1 s and close the port."""
        with self._queues_changed:
            self._queues_changed.wait_for(self._is_empty, _CLOSING_S)
            self._closing.set()
            self._queues_changed.notify_all()
        for thread in self._threads:
            if thread.is_alive():
                thread.join()
        if self._port is not None:
            self._port.close()
            self._port = None
        self._source.close()

    # To the board

    def write_line(self, line: bytes) -> None:
        """Queue a whole line; it is lost if no board is connected."""
        with self._queues_changed:
            if self._port is not None:
                self._lines.append(line)
                self._queues_changed.notify_all()

    def write_now(self, byte: bytes) -> None:
        """Queue a realtime byte before all waiting lines; it is lost if no board is connected."""
        with self._queues_changed:
            if self._port is not None:
                self._urgent += byte
                self._queues_changed.notify_all()

    def forget_lines(self) -> None:
        """Drop the lines that are not sent yet."""
        with self._queues_changed:
            self._lines.clear()

    def waiting(self) -> int:
        """Return the number of lines that are not sent yet."""
        return len(self._lines)

    def _is_empty(self) -> bool:
        """Return whether nothing waits to be written, or nothing can be."""
        idle = not (self._urgent or self._lines or self._is_writing)
        return idle or self._port is None

    def _write_loop(self) -> None:
        """Write what is queued until the link is closed. This is a thread."""
        while True:
            with self._queues_changed:
                self._is_writing = False
                self._queues_changed.notify_all()  # close() waits for this
                self._queues_changed.wait_for(
                    lambda: self._urgent or self._lines or self._closing.is_set()
                )
                if self._closing.is_set():
                    return
                data, port = self._next(), self._port
                self._is_writing = True
            if port is None:  # lost meanwhile, and the data with it
                continue
            try:
                port.write(data)
            except (OSError, TypeError, ValueError):  # the last two: the port was closed
                self._lose(port)

    def _next(self) -> bytes:
        """Take the bytes to write next from the queues: all urgent ones, or some whole lines."""
        if self._urgent:
            data = bytes(self._urgent)
            self._urgent.clear()
            return data
        data = self._lines.popleft()
        while self._lines and len(data) + len(self._lines[0]) <= _WRITE_BYTES:
            data += self._lines.popleft()
        return data

    # From the board

    def _read_loop(self) -> None:
        """Read until the link is closed; open the port again while there is none. This is a
        thread."""
        while not self._closing.is_set():
            port = self._port
            if port is None:
                self._open_again()
                continue
            try:
                data = _read(port)
            except (OSError, TypeError, ValueError):  # the last two: the port was closed
                self._lose(port)
                continue
            if data:
                self._heard(data)

    def _open_again(self) -> None:
        """After a pause, try once to open the port; log each new reason for a failure once."""
        self._closing.wait(_AGAIN_S)
        if self._closing.is_set():
            return
        try:
            port = self._source.open()
        except SendError as error:
            if str(error) != self._last_reason:
                self._last_reason = str(error)
                self._log(f"{self._last_reason}; trying again")
            return
        with self._queues_changed:
            self._port, self._last_reason = port, ""
        self._log(f"{self.name} is there again")
        self._changed()

    def _lose(self, port: Any) -> None:
        """Drop the failed port and all bytes that wait for it; either thread may call it first."""
        with self._queues_changed:
            if self._port is not port:  # the other thread was first
                return
            self._port = None
            self._lines.clear()
            self._urgent.clear()
        port.close()
        self._log(f"{self.name}: {broke(self.name)}; trying again")
        self._changed()


def _read(port: Any) -> bytes:
    """Return the available bytes; wait up to 0.05 s for the first."""
    data = bytes(port.read(1))  # waits
    try:
        while data and len(data) < _READ_BYTES and (more := port.in_waiting):
            data += port.read(more)
    except (OSError, TypeError, ValueError):  # the port failed or was closed
        if not data:
            raise
    return data  # after a fault too: the next call meets it again, and raises
