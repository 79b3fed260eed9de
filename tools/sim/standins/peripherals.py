"""Further parts of a board's `machine`, for the user's own Python. Nothing is connected to them.

Writes succeed; reads return nothing, or zeros. The firmware uses none of them.
"""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any


class _Inert:
    """Accepts any parameters, and does nothing."""

    def __init__(self, *_: "Any", **__: "Any") -> None:
        pass

    def init(self, *_: "Any", **__: "Any") -> None:
        pass

    def deinit(self) -> None:
        pass


class UART(_Inert):
    """A serial port. There is no answer, unless the simulated machine has a device at its pins."""

    INV_TX, INV_RX, RTS, CTS, IRQ_RXIDLE = 1, 2, 2, 1, 64
    # Devices by their pins TX and RX: called with the written bytes, return the bytes received.
    at: "dict[tuple[Any, Any], Callable[[bytes], bytes]]" = {}

    def __init__(self, *_: "Any", **words: "Any") -> None:
        self._answer = self.at.get((words.get("tx"), words.get("rx")))
        self._arrived = b""

    def any(self) -> int:
        return len(self._arrived)

    def read(self, count: int = -1, /) -> "bytes | None":
        """Return so many received bytes, -1: all; None if there are none."""
        end = len(self._arrived) if count < 0 else count
        data, self._arrived = self._arrived[:end], self._arrived[end:]
        return data or None

    def readline(self) -> "bytes | None":
        length = self._arrived.find(b"\n") + 1  # 0: no whole line
        return self.read(length or -1)

    def readinto(self, buf: "bytearray | memoryview", count: int = -1, /) -> "int | None":
        data = self.read(len(buf) if count < 0 else count) or b""
        buf[: len(data)] = data
        return len(data) or None

    def write(self, data: "bytes | bytearray | memoryview | str", /) -> int:
        sent = data.encode() if isinstance(data, str) else bytes(data)
        if self._answer:
            self._arrived += self._answer(sent)
        return len(sent)

    def flush(self) -> None:
        pass

    def txdone(self) -> bool:
        return True

    def sendbreak(self) -> None:
        pass

    def irq(self, *_: "Any", **__: "Any") -> None:
        pass


class I2C(_Inert):
    """A bus whose addresses accept all data, and read as zeros; a scan finds none."""

    def scan(self) -> "list[int]":
        return []

    def readfrom(self, addr: int, nbytes: int, stop: bool = True, /) -> bytes:
        return bytes(nbytes)

    def readfrom_into(self, addr: int, buf: bytearray, stop: bool = True, /) -> None:
        buf[:] = bytes(len(buf))

    def writeto(self, addr: int, buf: bytes, stop: bool = True, /) -> int:
        return len(buf)

    def writevto(self, addr: int, vector: "Any", stop: bool = True, /) -> int:
        return sum(map(len, vector))

    def readfrom_mem(self, addr: int, memaddr: int, nbytes: int, *, addrsize: int = 8) -> bytes:
        return bytes(nbytes)

    def readfrom_mem_into(
        self, addr: int, memaddr: int, buf: bytearray, *, addrsize: int = 8
    ) -> None:
        buf[:] = bytes(len(buf))

    def writeto_mem(self, addr: int, memaddr: int, buf: bytes, *, addrsize: int = 8) -> None:
        pass


class SoftI2C(I2C):
    """The same on any pins."""


class SPI(_Inert):
    """A bus that reads as zeros."""

    MSB, LSB = 0, 1

    def read(self, nbytes: int, write: int = 0, /) -> bytes:
        return bytes(nbytes)

    def readinto(self, buf: "bytearray | memoryview", write: int = 0, /) -> None:
        buf[:] = bytes(len(buf))

    def write(self, buf: "bytes | bytearray | memoryview", /) -> None:
        pass

    def write_readinto(self, write_buf: bytes, read_buf: bytearray, /) -> None:
        read_buf[:] = bytes(len(read_buf))


class SoftSPI(SPI):
    """The same on any pins."""


class ADC(_Inert):
    """An analog input at 0 V."""

    ATTN_0DB, ATTN_2_5DB, ATTN_6DB, ATTN_11DB = range(4)
    CORE_TEMP = 4

    def read_u16(self) -> int:
        return 0

    def read_uv(self) -> int:
        return 0

    def read(self) -> int:
        return 0


class RTC(_Inert):
    """A clock that has not been set."""

    def datetime(self, when: "Any" = None, /) -> "Any":
        return None if when else (2021, 1, 1, 4, 0, 0, 0, 0)


def unique_id() -> bytes:
    return bytes(8)


def reset_cause() -> int:
    return 1  # PWRON_RESET
