"""Stream: machine.I2S as an endless ring of DMA buffers, filled without waiting.

Buffers are numbered from the opening of the stream. The hardware's clock is the processor's, so
the time says which buffer is being played. Only whole buffers are written: the rest of one would
be played a whole round later. Where nothing was written, zeros are played.
"""

import select
import time

import machine
from micropython import const

from esp_chip.frames import FRAMES

_PORT = const(0)  # number of the I2S peripheral
BYTES = const(1024)  # per buffer


class Stream:
    """The stream of bits. pins: numbers of BCK, WS and DATA. rate_hz: frames per second. buffers:
    how many DMA has. buffer_us: how long one lasts."""

    def __init__(self, pins: "tuple[int, int, int]", rate_hz: int, buffers: int) -> None:
        if FRAMES * 1_000_000 % rate_hz:
            raise ValueError("I2S_RATE_HZ: 256 frames must last a whole number of microseconds")
        self.buffers = buffers
        self.buffer_us = FRAMES * 1_000_000 // rate_hz
        self._pins = pins
        self._rate_hz = rate_hz

    def open(self) -> int:
        """Open the stream, which plays zeros. Returns its start, in us.

        Buffer number `buffers`, a whole round later, is the first that can be written.
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
        # After a poll, whatever its result, write() accepts what fits and does not wait.
        poller = select.poll()
        poller.register(self._i2s, select.POLLOUT)
        poller.poll(0)
        poller.unregister(self._i2s)
        return began

    def write(self, buffer: "bytearray | memoryview") -> bool:
        """Hand over a whole buffer of BYTES. Returns False if DMA has no space for it yet."""
        return bool(self._i2s.write(buffer))

    def close(self) -> None:
        """Stop at once. The outputs keep their levels."""
        self._i2s.deinit()
