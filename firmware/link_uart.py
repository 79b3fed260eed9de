"""The sender on the board's own serial port: stdin and stdout, which are UART 0 or native USB.

MicroPython keeps 260 bytes that have arrived; a UART drops what comes on top of that and says
nothing, so a board file that uses this tells senders of 128. Native USB lets the sender wait.
"""

import select
import sys

import micropython
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import Any

# What a UART's own memory takes without waiting; soft interrupts come in between.
_PIECE = const(64)


class UartLink:
    """A Link."""

    def __init__(self) -> None:
        micropython.kbd_intr(-1)  # Ctrl-C is a byte like others
        self._in: "Any" = sys.stdin.buffer
        self._out: "Any" = sys.stdout.buffer
        self._byte = bytearray(1)
        self._poll = select.poll()
        self._poll.register(sys.stdin, select.POLLIN)

    def read_into(self, buf: bytearray) -> int:
        """Move what has arrived into buf; return how many bytes."""
        count = 0
        while count < len(buf) and self._poll.poll(0):
            if not self._in.readinto(self._byte):
                break
            buf[count] = self._byte[0]
            count += 1
        return count

    def write(self, data: "bytes | bytearray | memoryview") -> None:
        """Send; waits where the line is slower than we are."""
        if len(data) <= _PIECE:
            self._out.write(data)
            return
        whole = memoryview(data)
        for at in range(0, len(whole), _PIECE):
            self._out.write(whole[at : at + _PIECE])
