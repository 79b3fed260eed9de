"""The sender on the ESP32's own serial port: stdin and stdout, which are UART 0 or native USB.

MicroPython keeps 260 bytes that have arrived; a UART drops more than that without notice, so a
board file that uses this link advertises 128 to senders. Native USB makes the sender wait. On a
chip with native USB, output goes to UART 0 as well, and no faster than there.
"""

import array
import select
import sys

import micropython
from micropython import const

from ports.escape import CTRL_C, Escape
from ports.link_memory import AWAY_MS, DISCARD_PIECES, LOOP_HAS_READ, STOP_CAUSE, WRITE_MS

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

# Soft interrupts run between pieces.
_PIECE = const(64)  # bytes that a UART's buffer takes without waiting


class UartLink:
    """A Link. shared: memory shared with the supervisor, by the indices of link_memory.py.
    poll_reset is None: Ctrl-X can be found only by reading. check_supervisor: the supervisor's,
    called in the main loop, which raises. on_poll: called at each read."""

    poll_reset = None
    is_slow = False  # Ctrl-X is read as soon as this chip's MicroPython can

    def __init__(self) -> None:
        micropython.kbd_intr(-1)  # Ctrl-C is an ordinary byte
        self.check_supervisor: "Callable[[], None]" = lambda: None
        self.on_poll: "Callable[[], None]" = lambda: None
        self.shared = array.array("i", (0, 0, 0))  # LOOP_HAS_READ, STOP_CAUSE, AWAY_MS
        self._in: "Any" = sys.stdin.buffer
        self._out: "Any" = sys.stdout.buffer
        self._byte = bytearray(1)
        self._input_poll: "Any" = select.poll()
        self._input_poll.register(sys.stdin, select.POLLIN)
        self._escape = Escape(self.close)

    def attach(self, at_rest: "Callable[[], bool]", on_open: "Callable[[], None]") -> None:
        """Set when the REPL may be requested: at_rest() returns that. on_open is not used, because
        this link cannot see a sender open the port."""
        self._escape.at_rest = at_rest

    def read_into(self, buf: bytearray) -> int:
        """Move the bytes received into buf; return how many."""
        self.shared[LOOP_HAS_READ] = 1  # for the supervisor: the loop is alive
        if self.shared[STOP_CAUSE]:
            self.check_supervisor()
        self.on_poll()
        count = 0
        while count < len(buf) and self._can_read():
            if not self._in.readinto(self._byte):
                break
            buf[count] = self._byte[0]
            count += 1
        if count:
            self._escape.listen(buf, count)
        return count

    def discard(self) -> None:
        """Drop the bytes received. MicroPython keeps less than 1 kB; more may follow."""
        piece = bytearray(_PIECE)
        for _ in range(DISCARD_PIECES):
            self.read_into(piece)

    def _can_read(self) -> bool:
        """Return whether a byte can be read without waiting."""
        for _ in self._input_poll.ipoll(0):
            return True
        return False

    def write(self, data: "bytes | bytearray | memoryview") -> None:
        """Send; wait if the line is slower than the output."""
        if len(data) <= _PIECE:
            self._send(data)
            return
        whole = memoryview(data)
        for start in range(0, len(whole), _PIECE):
            self._send(whole[start : start + _PIECE])

    def _send(self, piece: "bytes | bytearray | memoryview") -> None:
        """Write a piece; the supervisor allows the wait that this may take."""
        self.shared[AWAY_MS] = -WRITE_MS
        self._out.write(piece)
        self.shared[AWAY_MS] = 0

    def close(self) -> None:
        """Let Ctrl-C interrupt again."""
        micropython.kbd_intr(CTRL_C)
