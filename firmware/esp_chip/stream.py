"""Stream: machine.I2S as a ring of DMA buffers that plays for ever, filled without waiting.

Buffers are numbered from the moment the stream is opened; the hardware's clock is the
processor's, so that the clock says which one is being played. Not one byte goes in but whole
buffers: a rest would be played a whole round later. Where nothing has been written, zeros come.
"""

import select
import time

import machine
from micropython import const

from esp_chip.frames import FRAMES

_PORT = const(0)
BYTES = const(1024)  # of a buffer


class Stream:
    """pins: BCK, WS and DATA. rate_hz: frames per second. buffers: how many DMA has."""

    def __init__(self, pins: "tuple[int, int, int]", rate_hz: int, buffers: int) -> None:
        if FRAMES * 1_000_000 % rate_hz:
            raise ValueError("256 frames do not last whole microseconds")
        self.buffers = buffers
        self.buffer_us = FRAMES * 1_000_000 // rate_hz
        self._pins = pins
        self._rate_hz = rate_hz

    def open(self) -> int:
        """Begin with zeros. Returns when, in us.

        Buffer number `buffers`, a whole round away, is the first that can be written.
        """
        bck, ws, data = self._pins
        self._i2s = machine.I2S(
            _PORT,
            sck=machine.Pin(bck),
            ws=machine.Pin(ws),
            sd=machine.Pin(data),
            mode=machine.I2S.TX,
            bits=32,
            format=machine.I2S.MONO,  # the same word in both halves of a frame
            rate=self._rate_hz,
            ibuf=BYTES * self.buffers,
        )
        began = time.ticks_us()
        # Once it has been polled, write() takes what fits and does not wait.
        poller = select.poll()
        poller.register(self._i2s, select.POLLOUT)
        poller.poll(0)
        poller.unregister(self._i2s)
        return began

    def write(self, buffer: "bytearray | memoryview") -> bool:
        """Hand over a buffer; False where DMA has no room for it yet."""
        return bool(self._i2s.write(buffer))

    def close(self) -> None:
        """Stop at once. The outputs keep the levels they have."""
        self._i2s.deinit()
