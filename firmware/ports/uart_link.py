"""The sender on the ESP32's own serial port: stdin and stdout, which are UART 0 or native USB.

MicroPython keeps 260 bytes that have arrived; a UART drops what comes on top of that and says
nothing, so a board file that uses this tells senders of 128. Native USB lets the sender wait.
Where there is native USB, what we say goes out on UART 0 as well, and no faster than there.
"""

import array
import select
import sys

import micropython
from micropython import const

from ports.escape import CTRL_C, Escape
from ports.link_memory import AWAY, PIECES, STOPPED, TURNED, WRITE_MS

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

# What a UART's own memory takes without waiting; soft interrupts come in between.
_PIECE = const(64)


class UartLink:
    """A Link. For the supervisor: shared is what they share; there is nothing to look at but by
    reading; check_supervisor is its own, called in the main loop, and raises. on_poll: called in
    every turn."""

    poll_reset = None
    is_slow = False  # Ctrl-X is heard as soon as the chip's MicroPython lets anyone hear it

    def __init__(self) -> None:
        micropython.kbd_intr(-1)  # Ctrl-C is a byte like others
        self.check_supervisor: "Callable[[], None]" = lambda: None
        self.on_poll: "Callable[[], None]" = lambda: None
        self.shared = array.array("i", (0, 0, 0))
        self._in: "Any" = sys.stdin.buffer
        self._out: "Any" = sys.stdout.buffer
        self._byte = bytearray(1)
        self._arrived: "Any" = select.poll()
        self._arrived.register(sys.stdin, select.POLLIN)
        self._escape = Escape(self.close)

    def attach(self, at_rest: "Callable[[], bool]", on_open: "Callable[[], None]") -> None:
        """Say when the REPL may be asked for. That a sender opens the port nobody hears of."""
        self._escape.at_rest = at_rest

    def read_into(self, buf: bytearray) -> int:
        """Move what has arrived into buf; return how many bytes."""
        self.shared[TURNED] = 1
        if self.shared[STOPPED]:
            self.check_supervisor()
        self.on_poll()
        count = 0
        while count < len(buf) and self._waiting():
            if not self._in.readinto(self._byte):
                break
            buf[count] = self._byte[0]
            count += 1
        if count:
            self._escape.listen(buf, count)
        return count

    def discard(self) -> None:
        """Drop what has arrived. MicroPython keeps less than 1 kB; more may follow."""
        piece = bytearray(_PIECE)
        for _ in range(PIECES):
            self.read_into(piece)

    def _waiting(self) -> bool:
        for _ in self._arrived.ipoll(0):
            return True
        return False

    def write(self, data: "bytes | bytearray | memoryview") -> None:
        """Send; waits where the line is slower than we are."""
        if len(data) <= _PIECE:
            self._send(data)
            return
        whole = memoryview(data)
        for at in range(0, len(whole), _PIECE):
            self._send(whole[at : at + _PIECE])

    def _send(self, piece: "bytes | bytearray | memoryview") -> None:
        self.shared[AWAY] = -WRITE_MS
        self._out.write(piece)
        self.shared[AWAY] = 0

    def close(self) -> None:
        """Ctrl-C interrupts again."""
        micropython.kbd_intr(CTRL_C)
