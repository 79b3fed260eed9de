# mypy: disable-error-code=arg-type
"""Escape: the way back to MicroPython's prompt, heard among the bytes that a sender sends.

Only while the machine is at rest: Ctrl-C three times in a row, or Ctrl-C and Ctrl-A as mpremote
sends them. KeyboardInterrupt leaves listen() then.
"""

import io
import os

import micropython
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

_CTRL_A = const(1)
CTRL_C = const(3)
_CR = const(13)
_PATIENCE = const(3)  # times Ctrl-C


@micropython.viper
def _follow(buf: ptr8, count: int, interrupts: int) -> int:
    """How many times in a row there was Ctrl-C; -1 - i where byte i asks for the prompt."""
    for i in range(count):
        byte = buf[i]
        if byte == CTRL_C:
            interrupts += 1
        elif byte == _CTRL_A and interrupts:
            interrupts = _PATIENCE
        elif byte != _CR:
            interrupts = 0
        if interrupts >= _PATIENCE:
            return -1 - i
    return interrupts


class Escape:
    """close: called before the prompt is left alone with the line."""

    def __init__(self, close: "Callable[[], None]") -> None:
        self._close = close
        self._interrupts = 0
        # Whether the prompt may be had now.
        self.at_rest: "Callable[[], bool]" = lambda: True

    def listen(self, buf: bytearray, count: int) -> None:
        """So much has arrived. Raises KeyboardInterrupt where the prompt is asked for."""
        found = _follow(buf, count, self._interrupts)
        self._interrupts = max(found, 0)
        if found < 0 and self.at_rest():
            at = -1 - found
            if buf[at] == CTRL_C:
                at += 1  # or it would interrupt what is to come
            self._close()
            if at < count:
                push(bytes(buf[at:count]))  # the prompt reads on where we stop
            raise KeyboardInterrupt


class _Pusher(io.IOBase):
    """A stream with bytes for MicroPython to read, as if they had arrived."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def readinto(self, buf: bytearray) -> "int | None":
        if self._at == len(self._data):
            return None
        buf[0] = self._data[self._at]
        self._at += 1
        return 1

    def write(self, data: bytes) -> int:
        return len(data)

    def ioctl(self, request: int, argument: int) -> int:
        return 0


def push(data: bytes) -> None:
    """Put bytes behind those that have arrived."""
    before = os.dupterm(_Pusher(data))
    os.dupterm_notify(None)
    os.dupterm(before)
