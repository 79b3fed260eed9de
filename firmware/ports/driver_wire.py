"""The wire to motor drivers with a serial port: one for all drivers, each with its own address.

Both directions share one wire: the bytes sent come back, before the answer.
"""

from machine import UART
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

# An ESP32's UART 0 is the sender's; an RP2040's UARTs have pins of their own.
_UARTS = (1, 0)  # numbers of UARTs, in the order in which they are tried
_BAUD = const(115200)
_PATIENCE_MS = const(3)  # twelve bytes take 1.1 ms, and a driver waits 0.2 ms at most
_BUFFER = const(32)  # bytes, more than a request and its answer


def of_board(board: "ModuleType") -> "DriverWire":
    """Return the wire of a board file that names TMC_UART: TX and RX. ValueError if they are not
    the pins of one UART."""
    pins: "tuple[int, ...]" = board.__dict__.get("TMC_UART", ())
    if len(pins) != 2:
        raise ValueError("TMC_UART needs two pins: TX and RX")
    for number in _UARTS:
        try:
            return DriverWire(_make_uart(number, pins[0], pins[1]))
        except ValueError:
            pass
    raise ValueError("TMC_UART: %d and %d are not TX and RX of one UART" % pins)


def _make_uart(number: int, tx: int, rx: int) -> "Any":
    """Return UART `number` on these pins. ValueError if it cannot use them."""
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
    """The wire. uart: a machine.UART. Main loop only, while idle: an exchange takes 2 ms, or 4 if
    no driver answers."""

    def __init__(self, uart: "Any") -> None:
        self._uart = uart
        self._in = bytearray(_BUFFER)

    def exchange(self, request: "bytes | bytearray", answer_bytes: int) -> "bytes | None":
        """Send a request and return the answer of answer_bytes, which is short or empty if the
        driver did not answer in time. None if not even the request came back: the wire is
        broken."""
        uart, length = self._uart, len(request)
        while uart.any():  # drop what came late
            uart.readinto(self._in)
        uart.write(request)
        echo_and_answer = memoryview(self._in)[: length + answer_bytes]
        count: int = uart.readinto(echo_and_answer) or 0
        # The buffer may still have the same request from last time, so the count is checked, too.
        if count < length or bytes(echo_and_answer[:length]) != bytes(request):
            return None
        return bytes(echo_and_answer[length:count])
