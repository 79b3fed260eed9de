# mypy: disable-error-code=arg-type
"""Escape: the way to MicroPython's prompt, found among the bytes that a sender sends.

Only while the machine is idle: Ctrl-C three times in a row, or Ctrl-C and Ctrl-A as mpremote sends
them. listen() then raises KeyboardInterrupt.
"""

import io
import os

import micropython
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

_CTRL_A = const(1)  # characters
CTRL_C = const(3)
_CR = const(13)
_ENOUGH = const(3)  # so many Ctrl-C in a row request the prompt


@micropython.viper
def _count_interrupts(buf: ptr8, count: int, interrupts: int) -> int:
    """Return how many times in a row Ctrl-C was received; -1 - i if byte i requests the prompt.

    buf: `count` bytes; interrupts: the result for the bytes before. A CR does not end a row:
    mpremote sends it first.
    """
    for i in range(count):
        byte = buf[i]
        if byte == CTRL_C:
            interrupts += 1
        elif byte == _CTRL_A and interrupts:
            interrupts = _ENOUGH
        elif byte != _CR:
            interrupts = 0
        if interrupts >= _ENOUGH:
            return -1 - i
    return interrupts


class Escape:
    """Detect a request for the prompt. close: called before the prompt takes over the line;
    at_rest: returns whether the prompt is allowed now. _interrupts: Ctrl-C in a row so far."""

    def __init__(self, close: "Callable[[], None]") -> None:
        self._close = close
        self._interrupts = 0
        self.at_rest: "Callable[[], bool]" = lambda: True

    def listen(self, buf: bytearray, count: int) -> None:
        """Check the first `count` bytes of buf. Raises KeyboardInterrupt if they request the
        prompt and that is allowed now. The prompt then reads what follows the Ctrl-C, also a
        Ctrl-A (raw REPL)."""
        result = _count_interrupts(buf, count, self._interrupts)  # -1 - i: byte i requests it
        self._interrupts = max(result, 0)
        if result < 0 and self.at_rest():
            next_byte = -1 - result
            if buf[next_byte] == CTRL_C:
                next_byte += 1  # or it would interrupt the code that follows
            self._close()
            if next_byte < count:
                push(bytes(buf[next_byte:count]))
            raise KeyboardInterrupt


class _Pusher(io.IOBase):
    """A stream from which MicroPython reads bytes (data) as if they had been received. _index: of
    the next one."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._index = 0

    def readinto(self, buf: bytearray) -> "int | None":
        """Put the next byte into buf, and return 1; None after the last one."""
        if self._index == len(self._data):
            return None
        buf[0] = self._data[self._index]
        self._index += 1
        return 1

    def write(self, data: bytes) -> int:
        """Discard output."""
        return len(data)

    def ioctl(self, request: int, argument: int) -> int:
        """Do nothing: MicroPython requires the method."""
        return 0


def push(data: bytes) -> None:
    """Append bytes to those received, as if they came from outside. dupterm_notify() makes
    MicroPython read all of them."""
    previous = os.dupterm(_Pusher(data))
    os.dupterm_notify(None)
    os.dupterm(previous)
