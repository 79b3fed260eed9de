"""The ESP32's stdin and stdout, with the parts of `sys`, `select` and `os` that access them.

MicroPython buffers at most 259 bytes received on a UART. Here further bytes raise an exception
instead of being lost. In virtual time; runs under CPython and MicroPython. What is not modelled
raises an exception.
"""

from esp_clock import clock

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

_RING = 259  # bytes
_LOOP_US = 400  # duration of a turn of the firmware's main loop
_BYTE_US = 87  # at 115200 baud


class _Namespace:
    """Stands in for a module, or an object in it."""

    def __init__(self, **names: object) -> None:
        for name, value in names.items():
            setattr(self, name, value)


class Wire:
    """The wire. on_read: called when there is nothing to read; on_write: called with each text
    written."""

    def __init__(self) -> None:
        self.on_read: "Callable[[], object]" = lambda: None
        self.on_write: "Callable[[str], object]" = lambda text: None
        self._ring = bytearray()
        self._second: "Any" = None  # the second terminal: os.dupterm

    # Interface for the sender

    def arrive(self, data: bytes) -> None:
        """Deliver the sender's bytes."""
        if len(self._ring) + len(data) > _RING:
            raise OSError("MicroPython drops what does not fit into its ring")
        self._ring += data

    def left(self) -> bytes:
        """Return the bytes that have not been read."""
        return bytes(self._ring)

    # The modules

    def sys(self) -> "Any":
        stdin = _Namespace(buffer=_Namespace(readinto=self._read))
        stdout = _Namespace(buffer=_Namespace(write=self._write))
        return _Namespace(stdin=stdin, stdout=stdout, platform="esp32", modules={})

    def select(self) -> "Any":
        return _Namespace(poll=lambda: self, POLLIN=1)

    def os(self) -> "Any":
        return _Namespace(dupterm=self._dupterm, dupterm_notify=self._notify)

    # select.poll()

    def register(self, stream: object, events: int) -> None:
        if events != 1:  # POLLIN
            raise NotImplementedError("only what our link uses is modelled")

    def ipoll(self, timeout: int) -> "list[int]":
        """Return one entry if there are bytes. Else the time of a turn of the main loop passes,
        in which bytes may arrive."""
        if timeout:
            raise NotImplementedError("only what our link uses is modelled")
        if not self._ring:
            clock.advance(clock.us + _LOOP_US)
            self.on_read()
        return [1] if self._ring else []

    # Streams

    def _read(self, buf: bytearray) -> int:
        """Fill the buffer; returns its length."""
        if len(buf) > len(self._ring):
            raise OSError("this would wait for ever")
        count = len(buf)
        buf[:] = self._ring[:count]
        self._ring = self._ring[count:]
        return count

    def _write(self, data: "bytes | bytearray | memoryview") -> int:
        """Send the text, which takes time; returns its length."""
        clock.advance(clock.us + len(data) * _BYTE_US)
        self.on_write(bytes(data).decode())
        return len(data)

    def _dupterm(self, stream: "Any") -> "Any":
        before, self._second = self._second, stream
        return before

    def _notify(self, _: object) -> None:
        """Read the second terminal until it is empty; its bytes are input as those of the wire."""
        byte = bytearray(1)
        while self._second and self._second.readinto(byte):
            self.arrive(bytes(byte))
