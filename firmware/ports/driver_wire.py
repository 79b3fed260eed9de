"""The wire to motor drivers that have a serial port, all on one, each by its address.

Both directions are one wire: what is sent comes back, in front of the answer.
"""

from machine import UART
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

# An ESP32's UART 0 is the sender's; an RP2040's have pins of their own.
_UARTS = (1, 0)
_BAUD = const(115200)
_PATIENCE_MS = const(3)  # twelve bytes take 1.1, and a driver waits 0.2 at the most
_BUFFER = const(32)


def of_board(board: "ModuleType") -> "DriverWire":
    """That of a board file that names TMC_UART: TX and RX. ValueError where no UART has them."""
    pins: "tuple[int, ...]" = board.__dict__.get("TMC_UART", ())
    if len(pins) != 2:
        raise ValueError("TMC_UART wants two pins: TX and RX")
    for number in _UARTS:
        try:
            return DriverWire(_make_uart(number, pins[0], pins[1]))
        except ValueError:
            pass
    raise ValueError("TMC_UART: %d and %d are not TX and RX of one UART" % pins)


def _make_uart(number: int, tx: int, rx: int) -> "Any":
    return UART(
        number,
        _BAUD,
        tx=tx,
        rx=rx,
        txbuf=_BUFFER,
        rxbuf=_BUFFER,
        timeout=_PATIENCE_MS,
        timeout_char=_PATIENCE_MS,
    )


class DriverWire:
    """The wire. Main loop only, and at rest: an exchange takes 2 ms, or 4 where nobody answers."""

    def __init__(self, uart: "Any") -> None:
        self._uart = uart
        self._in = bytearray(_BUFFER)

    def exchange(self, request: "bytes | bytearray", answer_bytes: int) -> "bytes | None":
        """Send, and return the answer: fewer bytes, or none, where it has not come. None where not
        even what was sent has come back: the wire is broken."""
        uart, sent = self._uart, len(request)
        while uart.any():
            uart.readinto(self._in)
        uart.write(request)
        whole = memoryview(self._in)[: sent + answer_bytes]
        count: int = uart.readinto(whole) or 0
        if bytes(whole[:sent]) != bytes(request):
            return None
        return bytes(whole[sent:count])
