"""Blocks of an SD card, over SPI, each with its checksum.

MicroPython's driver for the RP2040 looks at none, and beside a spindle a bit that is read wrong is
another path: here the card is asked for them, and what came damaged is read again. Commands and
answers are those of the SD Association's Physical Layer Simplified Specification, chapter 7.
"""

import errno
import time

import micropython
from machine import SPI, Pin
from micropython import const

from ports.link_memory import TURNED

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable

_BLOCK = const(512)
_BLOCK_LOG2 = const(9)
_BEGIN_HZ = const(400_000)
_HZ = const(12_000_000)

_GO_IDLE = const(0)
_INTERFACE = const(8)
_READ_CSD = const(9)
_STATUS = const(13)
_BLOCK_LENGTH = const(16)
_READ = const(17)
_WRITE = const(24)
_BEGIN = const(41)  # behind _APPLICATION
_APPLICATION = const(55)
_CHECKSUMS = const(59)

_VOLTAGE = const(0x1AA)  # 2.7 to 3.6 V, and a pattern that comes back
_LARGE = const(0x40000000)  # we know cards of more than 2 GB
_IDLE = const(1)
_START = const(0xFE)  # of a block
_ACCEPTED = const(5)
_HIGH = const(0xFF)  # the line at rest

_ANSWER_BYTES = const(9)
_TRIES = const(3)
# The specification's longest times, of a card that begins, reads and writes.
_BEGIN_MS = const(1000)
_READ_MS = const(100)
_BUSY_MS = const(500)

_COUNT = const(4)  # of blocks
_SIZE = const(5)  # of one


@micropython.viper
def _sum7(command: ptr8, count: int) -> int:
    """A command's checksum (CRC-7), as it is sent."""
    crc = 0
    for at in range(count):
        crc ^= command[at]
        for _ in range(8):
            crc <<= 1
            if crc & 0x100:
                crc ^= 0x112
    return crc | 1


@micropython.viper
def _sum16(block: ptr8, count: int) -> int:
    """A block's (CRC-16, CCITT)."""
    crc = 0
    for at in range(count):
        x = crc >> 8 ^ block[at]
        x ^= x >> 4
        crc = (crc << 8 ^ x << 12 ^ x << 5 ^ x) & 0xFFFF
    return crc


class SdBlocks:
    """What a file system is made on, from begin() to end(). pins: clock, to the card, from the
    card, select; shared: with the supervisor, which hears of each block."""

    def __init__(self, pins: "tuple[int, ...]", shared: "array[int]") -> None:
        clock, to_card, from_card, select = pins
        self._shared = shared
        self._select = Pin(select, Pin.OUT, value=1)
        into = Pin(from_card, Pin.IN, Pin.PULL_UP)  # without a card it is high
        self._bus = SPI(clock >> 3 & 1, sck=Pin(clock), mosi=Pin(to_card), miso=into)
        self._byte = bytearray(1)
        self._command = bytearray(6)
        self._sum = bytearray(2)
        self._since = 0
        self._shift = 0  # from a block's number to its address
        self._count = 0
        self.is_faulty = False  # something could not be read or written: all else cannot be either

    def begin(self) -> None:
        """Wake the card that is in the holder now. OSError where there is none, or it does not
        answer in time."""
        self._set_speed(_BEGIN_HZ)
        self._wake()
        self._set_speed(_HZ)

    def _set_speed(self, hz: int) -> None:
        self._bus.init(baudrate=hz)

    def end(self) -> None:
        """Have no blocks any more, and say nothing of it. Who still asks is a file left open, as
        it is collected, and a fault there would be written to the sender."""
        self._count = 0

    def is_there(self) -> bool:
        """The card is the one that has been begun with, and well: a new one does not answer so."""
        try:
            return not self.is_faulty and self._status() == 0
        except OSError:
            return False

    # As MicroPython calls them: 0, or -EIO. Raised, a fault would pass by the file system, which
    # would go on with half of what it knows.

    def readblocks(self, number: int, into: "bytearray | memoryview") -> int:
        """Fill what is given with blocks, from one on."""
        return self._each(self._read_block, number, into)

    def writeblocks(self, number: int, data: "bytes | bytearray | memoryview") -> int:
        """Write whole blocks."""
        return self._each(self._write_block, number, data)

    def ioctl(self, what: int, _argument: int) -> int:
        """How many blocks there are, and how long they are; all else is done anyway."""
        if what == _COUNT:
            return self._count
        return _BLOCK if what == _SIZE else 0

    def _each(
        self,
        do: "Callable[[int, memoryview], None]",
        number: int,
        data: "bytes | bytearray | memoryview",
    ) -> int:
        if not self._count:
            return 0
        if self.is_faulty:
            return -errno.EIO
        view = memoryview(data)
        try:
            for at in range(0, len(view), _BLOCK):
                do(number << self._shift, view[at : at + _BLOCK])
                number += 1
        except OSError:
            self.is_faulty = True
            return -errno.EIO
        return 0

    # The card's own words

    def _wake(self) -> None:
        self._bus.read(10, _HIGH)  # unselected: it wants 74 clocks
        self._reset()
        answer = bytearray(4)
        is_new = self._order(_INTERFACE, _VOLTAGE, answer) == _IDLE
        if is_new and answer[3] != _VOLTAGE & 0xFF:
            raise OSError(errno.ENODEV)
        if self._order(_CHECKSUMS, 1) != _IDLE:
            raise OSError(errno.EIO)
        since = time.ticks_ms()
        while True:
            self._order(_APPLICATION, 0)
            if self._order(_BEGIN, _LARGE if is_new else 0) == 0:
                break
            self._since = since
            self._check_time(_BEGIN_MS)
        about = bytearray(16)
        self._read(_READ_CSD, 0, about)
        self._count = _blocks(about)
        self._shift = 0 if about[0] >> 6 else _BLOCK_LOG2
        self._order(_BLOCK_LENGTH, _BLOCK)

    def _reset(self) -> None:
        """Whatever it has been at: in the middle of a block it does not hear the first order."""
        for _ in range(_TRIES):
            try:
                if self._order(_GO_IDLE, 0) == _IDLE:
                    return
            except OSError as fault:
                if fault.args[0] != errno.ENODEV:
                    raise
        raise OSError(errno.ENODEV)

    def _status(self) -> int:
        """0: all is well."""
        answer = bytearray(1)
        return self._order(_STATUS, 0, answer) | answer[0]

    def _order(self, command: int, argument: int, more: "bytearray | None" = None) -> int:
        """Send a command without data; more: filled with what follows the answer, a byte."""
        self._since = time.ticks_ms()
        self._select(0)
        try:
            answer = self._ask(command, argument)
            if more:
                self._bus.readinto(more, _HIGH)
            return answer
        finally:
            self._release()

    def _read_block(self, address: int, into: memoryview) -> None:
        self._read(_READ, address, into)

    def _read(self, command: int, argument: int, into: "bytearray | memoryview") -> None:
        """What a command brings."""
        self._since = time.ticks_ms()
        for _ in range(_TRIES):
            self._select(0)
            try:
                if self._ask(command, argument) == 0 and self._take(into):
                    return
            finally:
                self._release()
        raise OSError(errno.EIO)

    def _write_block(self, address: int, block: memoryview) -> None:
        for _ in range(_TRIES):
            self._since = time.ticks_ms()
            self._select(0)
            try:
                is_written = self._ask(_WRITE, address) == 0 and self._give(block)
            finally:
                self._release()
            if is_written and self._status() == 0:
                return
        raise OSError(errno.EIO)

    def _ask(self, command: int, argument: int) -> int:
        """Send a command to the card, which is selected; its answer, a byte of bits."""
        self._wait(_READ_MS)
        words = self._command
        words[0] = 0x40 | command
        for at in range(1, 5):
            words[at] = argument >> (32 - 8 * at) & 0xFF
        words[5] = _sum7(words, 5)
        self._bus.write(words)
        for _ in range(_ANSWER_BYTES):
            answer = self._next()
            if answer < 0x80:
                return answer
        raise OSError(errno.ENODEV)

    def _take(self, into: "bytearray | memoryview") -> bool:
        """A block the card sends; False where its checksum is another, or it has none."""
        token = self._next()
        while token == _HIGH:
            self._check_time(_READ_MS)
            token = self._next()
        if token != _START:
            return False
        self._bus.readinto(into, _HIGH)
        self._bus.readinto(self._sum, _HIGH)
        return _sum16(into, len(into)) == self._sum[0] << 8 | self._sum[1]

    def _give(self, block: memoryview) -> bool:
        """Send it a block; False where it has not come as it was sent."""
        checksum = _sum16(block, len(block))
        self._sum[0], self._sum[1] = checksum >> 8, checksum & 0xFF
        self._next()  # it wants a byte in between
        self._byte[0] = _START
        self._bus.write(self._byte)
        self._bus.write(block)
        self._bus.write(self._sum)
        answer = self._next() & 0x1F
        self._since = time.ticks_ms()
        self._wait(_BUSY_MS)
        return answer == _ACCEPTED

    def _wait(self, limit_ms: int) -> None:
        """While it is busy."""
        while self._next() != _HIGH:
            self._check_time(limit_ms)

    def _next(self) -> int:
        self._bus.readinto(self._byte, _HIGH)
        return self._byte[0]

    def _release(self) -> None:
        self._select(1)
        self._next()  # it lets go of the line at a clock
        self._shared[TURNED] = 1

    def _check_time(self, limit_ms: int) -> None:
        """OSError where what is done takes longer."""
        self._shared[TURNED] = 1
        if time.ticks_diff(time.ticks_ms(), self._since) > limit_ms:
            raise OSError(errno.ETIMEDOUT)


def _blocks(about: bytearray) -> int:
    """How many, by what the card tells of itself (CSD, of either version)."""
    if about[0] >> 6:
        return ((about[7] & 0x3F) << 16 | about[8] << 8 | about[9]) + 1 << 10
    size = (about[6] & 3) << 10 | about[7] << 2 | about[8] >> 6
    factor_log2 = ((about[9] & 3) << 1 | about[10] >> 7) + 2
    return size + 1 << factor_log2 + (about[5] & 15) - _BLOCK_LOG2
