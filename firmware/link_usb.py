# mypy: disable-error-code=arg-type
"""The sender on the board's USB, which MicroPython calls stdin and stdout.

MicroPython collects what has arrived in a ring of 512 bytes, and hands it out byte by byte at
13 us each, or in pieces whose length one has to know. So the ring is looked for in memory, tried
out, and read where it lies; where it is not found the plain way is taken. USB makes the sender
wait when the ring is full: nothing is ever lost.

A hard timer looks at the ring too: Ctrl-X acts also while the main loop is busy, and a sender
that opens the port is seen, for the welcome. What MicroPython writes while no port is open waits
for the first one that is.

Back to the REPL, only while the machine is at rest: Ctrl-C three times in a row, or Ctrl-C and
Ctrl-A as mpremote sends them; KeyboardInterrupt leaves read_into() then.
"""

import array
import binascii
import io
import os
import select
import sys
import time

import machine
import micropython
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

# MicroPython looks for files of these names at every import, for 5 ms each, unless they are known.
for _module in (array, binascii, io, machine, os, select, time):
    sys.modules[_module.__name__] = _module

_CTRL_A = const(1)
_CTRL_C = const(3)
_CR = const(13)
_CTRL_X = const(24)
_PATIENCE = const(3)  # times Ctrl-C

# A host that does not read for so long is taken for absent, and is not waited for any more.
_DEAF_MS = const(250)

_LOOK_MS = const(5)

# What a link remembers: where the ring is,
_RING = const(0)
_TAKING = const(1)  # whether the main loop is taking bytes out of it,
_PORT = const(2)  # what the sender has done with the port,
_NEVER = const(0)
_OPEN = const(1)
_CLOSED = const(2)
_OPENED = const(3)  # and whether it has opened it once more.

# The last request of the host, in the memory of RP2040's and RP2350's USB: requests that tell
# of the port being open or not (its DTR), and that the cable has been plugged in.
_SETUP = const(0x50100000)
_SET_LINE_STATE = const(0x2221)
_SET_CONFIGURATION = const(0x0900)

# MicroPython's struct ringbuf_t: address, size : 16, iget : 16, iput : 16.
_RING_BYTES = const(512)
_MEMORY = const(0x20000000)
_MEMORY_WORDS = const(0x10000)
_TRIALS = (b"Where is the ring?", b"Here?")


@micropython.viper
def _find(memory: ptr32, start: int, trial: ptr8, length: int) -> int:
    """Index, from start on, of a word that may begin a ring that ends with the trial; or -1."""
    i = start
    while i < _MEMORY_WORDS - 3:
        at = memory[i] - _MEMORY
        sizes = memory[i + 1]
        if at > 0 and at < 4 * _MEMORY_WORDS and sizes & 0xFFFF == _RING_BYTES:
            get = (sizes >> 16) & 0xFFFF
            put = memory[i + 2] & 0xFFFF
            if get < _RING_BYTES and put < _RING_BYTES and (put - get) & 511 >= length:
                data = ptr8(memory[i])
                same = 0
                while same < length and data[(get + same) & 511] == trial[same]:
                    same += 1
                if same == length:
                    return i
        i += 1
    return -1


@micropython.viper
def _take(at: ptr32, buf: ptr8, room: int) -> int:
    """Move up to `room` bytes that the ring holds into buf. Returns how many."""
    at[_TAKING] = 1
    shorts = ptr16(at[_RING])
    data = ptr8(ptr32(at[_RING])[0])
    get = shorts[3]
    put = shorts[4]
    count = 0
    while get != put and count < room:
        buf[count] = data[get]
        get += 1
        if get == _RING_BYTES:
            get = 0
        count += 1
    shorts[3] = get
    at[_TAKING] = 0
    return count


@micropython.viper
def _look(at: ptr32) -> int:
    """Interrupt: drop all that has arrived up to a Ctrl-X. Returns whether there was one."""
    shorts = ptr16(at[_RING])
    data = ptr8(ptr32(at[_RING])[0])
    get = shorts[3]
    put = shorts[4]
    request = ptr32(_SETUP)[0]
    is_open = request & 0xFFFF == _SET_LINE_STATE and request & 0x10000
    is_closed = request & 0x1FFFF == _SET_LINE_STATE or request & 0xFFFF == _SET_CONFIGURATION
    if at[_PORT] == _OPEN:
        if is_closed:
            at[_PORT] = _CLOSED
    elif is_open or get != put:
        at[_OPENED] = at[_PORT] == _CLOSED
        at[_PORT] = _OPEN
    found = 0
    if at[_TAKING] == 0:
        while get != put:
            get = (get + 1) & (_RING_BYTES - 1)
            if data[(get - 1) & (_RING_BYTES - 1)] == _CTRL_X:
                shorts[3] = get
                found = 1
    return found


@micropython.viper
def _control_bytes(buf: ptr8, count: int) -> int:
    """Whether there is a Ctrl-C or a Ctrl-A."""
    for i in range(count):
        if buf[i] == _CTRL_C or buf[i] == _CTRL_A:
            return 1
    return 0


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


def _push(data: bytes) -> None:
    """Put bytes behind those that have arrived."""
    before = os.dupterm(_Pusher(data))
    os.dupterm_notify(None)
    os.dupterm(before)


class UsbLink:
    """A Link. feed: called at every turn of the main loop, for a watchdog."""

    def __init__(self) -> None:
        micropython.kbd_intr(-1)  # Ctrl-C is a byte like others
        self.feed: "Callable[[], None] | None" = None
        self._in: "Any" = sys.stdin.buffer
        self._out: "Any" = sys.stdout.buffer
        self._arrived: "Any" = select.poll()
        self._arrived.register(sys.stdin, select.POLLIN)
        self._sendable: "Any" = select.poll()
        self._sendable.register(sys.stdout, select.POLLOUT)
        self._deaf = False
        self._interrupts = 0
        self._byte = bytearray(1)
        self._early = bytearray()
        self._at_rest: "Callable[[], bool]" = lambda: True
        self._timer: "machine.Timer | None" = None
        self._at = array.array("i", (0, 0, _NEVER, 0))
        if sys.platform == "rp2":
            self._at[_RING] = self._find_ring()

    def attach(
        self,
        at_rest: "Callable[[], bool]",
        on_reset: "Callable[[], None]",
        on_open: "Callable[[], None]",
    ) -> None:
        """Say when the REPL may be asked for, who hears of Ctrl-X, in a hard interrupt, while
        the main loop does not listen, and who greets a sender that opens the port anew."""
        self._at_rest = at_rest
        self._on_reset = on_reset
        self._on_open = on_open
        if self._at[_RING]:
            self._timer = machine.Timer()
            self._timer.init(period=_LOOK_MS, callback=self._look, hard=True)

    @micropython.native
    def _look(self, _timer: object) -> None:
        if _look(self._at):
            self._on_reset()

    def _find_ring(self) -> int:
        """Address of MicroPython's ring, or 0."""
        while self._waiting():
            self._in.readinto(self._byte)
            self._early.append(self._byte[0])
        try:
            _push(_TRIALS[0])
        except (AttributeError, OSError):
            return 0
        index = _find(_MEMORY, 0, _TRIALS[0], len(_TRIALS[0]))
        while index >= 0:
            ring = _MEMORY + 4 * index
            at = array.array("i", (ring, 0))
            trial = bytearray(len(_TRIALS[0]))
            _take(at, trial, len(trial))
            _push(_TRIALS[1])
            if _find(_MEMORY, index, _TRIALS[1], len(_TRIALS[1])) == index:
                _take(at, trial, len(trial))
                return ring
            index = _find(_MEMORY, index + 1, _TRIALS[0], len(_TRIALS[0]))
        self._drop_trials()
        return 0

    def _drop_trials(self) -> None:
        for trial in _TRIALS:
            while self._waiting() and self._in.readinto(self._byte):
                self._early.append(self._byte[0])
            self._early = bytearray(bytes(self._early).replace(trial, b""))

    def read_into(self, buf: bytearray) -> int:
        """Move what has arrived into buf; return how many bytes."""
        if self.feed:
            self.feed()
        at = self._at
        if self._early:
            count = min(len(buf), len(self._early))
            buf[:count] = self._early[:count]
            self._early = self._early[count:]
        elif at[_RING]:
            count = _take(at, buf, len(buf))
            if count == 0 and self._waiting():  # asking also fills the ring
                count = _take(at, buf, len(buf))
            if at[_OPENED]:
                at[_OPENED] = 0
                self._on_open()
        else:
            count = self._read_plainly(buf)
        if count and _control_bytes(buf, count):
            self._look_for_escape(buf, count)
        return count

    def _waiting(self) -> bool:
        for _ in self._arrived.ipoll(0):
            return True
        return False

    def _read_plainly(self, buf: bytearray) -> int:
        count = 0
        while count < len(buf) and self._waiting():
            self._in.readinto(self._byte)
            buf[count] = self._byte[0]
            count += 1
        return count

    def _look_for_escape(self, buf: bytearray, count: int) -> None:
        """Raise KeyboardInterrupt where the REPL is asked for, and may be."""
        for i in range(count):
            byte = buf[i]
            if byte == _CTRL_C:
                self._interrupts += 1
            elif byte == _CTRL_A and self._interrupts:
                self._interrupts = _PATIENCE
            elif byte != _CR:
                self._interrupts = 0
            if self._interrupts >= _PATIENCE:
                self._interrupts = 0
                if self._at_rest():
                    self.close()
                    _push(bytes(buf[i:count]))  # the REPL reads on where we stop
                    raise KeyboardInterrupt

    def write(self, data: "bytes | bytearray | memoryview") -> None:
        """Send. A host that does not read is waited for once, then goes without."""
        if self._deaf and not self._sendable.poll(0):
            return
        since = time.ticks_ms()
        self._out.write(data)
        self._deaf = time.ticks_diff(time.ticks_ms(), since) >= _DEAF_MS

    def close(self) -> None:
        """Ctrl-C interrupts again."""
        if self._timer:
            self._timer.deinit()
        micropython.kbd_intr(_CTRL_C)
