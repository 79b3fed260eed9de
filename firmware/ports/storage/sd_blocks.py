"""Blocks of an SD card over SPI, each with its checksum.

MicroPython's driver for the RP2040 checks none, and close to a spindle a bit that is read wrong
means another path. Here the card is set to send checksums, and damaged blocks are read again.
Commands and answers are those of the SD Association's Physical Layer Simplified Specification,
chapter 7.
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

_BLOCK = const(512)  # bytes
_BLOCK_LOG2 = const(9)
_BEGIN_HZ = const(400_000)  # of the bus while the card starts
_HZ = const(12_000_000)

# Numbers of commands: CMD0 and so on.
_GO_IDLE = const(0)
_INTERFACE = const(8)
_READ_CSD = const(9)
_STATUS = const(13)
_BLOCK_LENGTH = const(16)
_READ = const(17)
_WRITE = const(24)
_BEGIN = const(41)  # ACMD41, sent after _APPLICATION
_APPLICATION = const(55)
_CHECKSUMS = const(59)

_VOLTAGE = const(0x1AA)  # 2.7 to 3.6 V, and a pattern that the card returns
_LARGE = const(0x40000000)  # HCS: we support cards of more than 2 GB
_IDLE = const(1)  # a command's answer: good, the card is not started yet; 0: good
_START = const(0xFE)  # the token before a block
_ACCEPTED = const(5)  # the answer to a block
_HIGH = const(0xFF)  # the level of an idle line
_COMMAND = const(0x40)  # the first byte of a command, with its number
_NO_ANSWER = const(0x80)  # an answer's byte is below
_DATA_STATUS = const(0x1F)  # the bits of the answer to a block

_ANSWER_BYTES = const(9)  # a command's answer is one of so many bytes after it
_TRIES = const(3)
# The specification's longest times for a card to start, to read, and to write.
_BEGIN_MS = const(1000)
_READ_MS = const(100)
_BUSY_MS = const(500)

_COUNT = const(4)  # ioctl: number of blocks
_SIZE = const(5)  # ioctl: bytes of a block


@micropython.viper
def _sum7(command: ptr8, count: int) -> int:
    """Return a command's checksum (CRC-7) as it is sent: in bits 7 to 1, bit 0 is 1."""
    crc = 0
    for i in range(count):
        crc ^= command[i]
        for _ in range(8):
            crc <<= 1
            if crc & 0x100:
                crc ^= 0x112  # x^7 + x^3 + 1, shifted left by 1
    return crc | 1


@micropython.viper
def _sum16(block: ptr8, count: int) -> int:
    """Return a block's checksum (CRC-16 CCITT: x^16 + x^12 + x^5 + 1, from 0).

    Eight bits at once: `bits` is what the polynomial adds for a byte, at x^12, x^5 and 1.
    """
    crc = 0
    for i in range(count):
        bits = crc >> 8 ^ block[i]
        bits ^= bits >> 4
        crc = (crc << 8 ^ bits << 12 ^ bits << 5 ^ bits) & 0xFFFF
    return crc


class SdBlocks:
    """The block device of a file system, from begin() to end(). pins: clock, to the card, from the
    card, select; shared: memory shared with the supervisor: shared[TURNED] = 1 says that the loop
    is alive. is_faulty: a read or write failed: all later ones fail, too. _since: ticks_ms() at
    the start of the transfer. _count: number of blocks, 0 before begin() and after end(). _shift:
    from a block's number to its address."""

    def __init__(self, pins: "tuple[int, ...]", shared: "array[int]") -> None:
        clock, to_card, from_card, select = pins
        self._shared = shared
        self._select = Pin(select, Pin.OUT, value=1)
        into = Pin(from_card, Pin.IN, Pin.PULL_UP)  # high without a card
        self._bus = SPI(clock >> 3 & 1, sck=Pin(clock), mosi=Pin(to_card), miso=into)
        self._byte = bytearray(1)
        self._command = bytearray(6)
        self._sum = bytearray(2)
        self._since = 0
        self._shift = 0
        self._count = 0
        self.is_faulty = False

    def begin(self) -> None:
        """Start the card that is in the holder now. OSError if there is none, or it does not
        answer in time."""
        self._set_speed(_BEGIN_HZ)
        self._wake()
        self._set_speed(_HZ)

    def _set_speed(self, hz: int) -> None:
        """Set the clock of the bus."""
        self._bus.init(baudrate=hz)

    def end(self) -> None:
        """Become a device with no blocks, without errors. A file left open still accesses it when
        it is collected, and a fault there would be printed to the sender."""
        self._count = 0

    def is_there(self) -> bool:
        """Return whether the card is the one that begin() started, and works: a card inserted
        since then is not started, and answers with another status than 0."""
        try:
            return not self.is_faulty and self._status() == 0
        except OSError:
            return False

    # The methods that MicroPython calls return 0 or -EIO. An exception would pass by the file
    # system, which would then go on with half of its state.

    def readblocks(self, number: int, into: "bytearray | memoryview") -> int:
        """Read blocks, from `number` on, into a buffer of whole blocks."""
        return self._each(self._read_block, number, into)

    def writeblocks(self, number: int, data: "bytes | bytearray | memoryview") -> int:
        """Write whole blocks, from `number` on."""
        return self._each(self._write_block, number, data)

    def ioctl(self, what: int, _argument: int) -> int:
        """Return the number of blocks or the size of one; other requests need no action."""
        if what == _COUNT:
            return self._count
        return _BLOCK if what == _SIZE else 0

    def _each(
        self,
        do: "Callable[[int, memoryview], None]",
        number: int,
        data: "bytes | bytearray | memoryview",
    ) -> int:
        """Call do(address, block) for each block of data, whose numbers count from `number` on.
        Return 0, or -EIO after a fault."""
        if not self._count:  # after end()
            return 0
        if self.is_faulty:
            return -errno.EIO
        view = memoryview(data)
        try:
            for start in range(0, len(view), _BLOCK):
                do(number << self._shift, view[start : start + _BLOCK])
                number += 1
        except OSError:
            self.is_faulty = True
            return -errno.EIO
        return 0

    # The card's protocol

    def _wake(self) -> None:
        """Initialise the card as the specification says, and read its size from its CSD.

        OSError if there is no card, it does not answer in time, or not as an SD card does.
        """
        self._bus.read(10, _HIGH)  # not selected: the card needs 74 clocks
        self._reset()
        answer = bytearray(4)
        # Only cards of version 2 know CMD8.
        is_version_2 = self._order(_INTERFACE, _VOLTAGE, answer) == _IDLE
        if is_version_2 and answer[3] != _VOLTAGE & 0xFF:
            raise OSError(errno.ENODEV)
        if self._order(_CHECKSUMS, 1) != _IDLE:
            raise OSError(errno.EIO)
        since = time.ticks_ms()
        while True:
            self._order(_APPLICATION, 0)
            if self._order(_BEGIN, _LARGE if is_version_2 else 0) == 0:
                break
            self._since = since  # _order() has restarted it
            self._check_time(_BEGIN_MS)
        about = bytearray(16)
        self._read(_READ_CSD, 0, about)
        self._count = _blocks(about)
        # Addresses: with CSD version 2 numbers of blocks, with version 1 bytes.
        self._shift = 0 if about[0] >> 6 else _BLOCK_LOG2
        self._order(_BLOCK_LENGTH, _BLOCK)

    def _reset(self) -> None:
        """Reset the card, whatever its state: in the middle of a block it does not react to the
        first command."""
        for _ in range(_TRIES):
            try:
                if self._order(_GO_IDLE, 0) == _IDLE:
                    return
            except OSError as fault:
                if fault.args[0] != errno.ENODEV:
                    raise
        raise OSError(errno.ENODEV)

    def _status(self) -> int:
        """Return the card's status, 0 if it is good: its two bytes, combined by or."""
        answer = bytearray(1)
        return self._order(_STATUS, 0, answer) | answer[0]

    def _order(self, command: int, argument: int, more: "bytearray | None" = None) -> int:
        """Select the card, send a command without data and return its answer, a byte of bits, 0 or
        _IDLE if it is good. more: filled with the bytes that follow. OSError without an answer."""
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
        """Read a block at a card's address. OSError if that fails."""
        self._read(_READ, address, into)

    def _read(self, command: int, argument: int, into: "bytearray | memoryview") -> None:
        """Send a command and read the block that it returns, at most _TRIES times. OSError if its
        checksum was wrong each time."""
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
        """Write a block at a card's address, at most _TRIES times. OSError if that fails."""
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
        """Send a command to the selected card; return its answer, a byte of bits. argument: 32
        bits. OSError (ENODEV) without an answer."""
        self._wait(_READ_MS)
        data = self._command
        data[0] = _COMMAND | command
        for i in range(1, 5):  # the argument, its highest byte first
            data[i] = argument >> (32 - 8 * i) & 0xFF
        data[5] = _sum7(data, 5)
        self._bus.write(data)
        for _ in range(_ANSWER_BYTES):
            answer = self._next()
            if answer < _NO_ANSWER:
                return answer
        raise OSError(errno.ENODEV)

    def _take(self, into: "bytearray | memoryview") -> bool:
        """Receive a block into a buffer; False if its checksum is wrong or the card answers with
        an error. OSError if it does not come in time."""
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
        """Send a block, and wait until it is written; False if the card reports that it was
        damaged."""
        checksum = _sum16(block, len(block))
        self._sum[0], self._sum[1] = checksum >> 8, checksum & 0xFF
        self._next()  # the card needs a byte in between
        self._byte[0] = _START
        self._bus.write(self._byte)
        self._bus.write(block)
        self._bus.write(self._sum)
        answer = self._next() & _DATA_STATUS
        self._since = time.ticks_ms()
        self._wait(_BUSY_MS)
        return answer == _ACCEPTED

    def _wait(self, limit_ms: int) -> None:
        """Wait while the card is busy. OSError after limit_ms."""
        while self._next() != _HIGH:
            self._check_time(limit_ms)

    def _next(self) -> int:
        """Return the next byte from the card; _HIGH if it sends none."""
        self._bus.readinto(self._byte, _HIGH)
        return self._byte[0]

    def _release(self) -> None:
        """End a transfer: deselect the card. The supervisor sees that the loop is alive."""
        self._select(1)
        self._next()  # the card releases the line at the next clock
        self._shared[TURNED] = 1

    def _check_time(self, limit_ms: int) -> None:
        """Raise OSError if the transfer has taken longer than limit_ms."""
        self._shared[TURNED] = 1
        if time.ticks_diff(time.ticks_ms(), self._since) > limit_ms:
            raise OSError(errno.ETIMEDOUT)


def _blocks(about: bytearray) -> int:
    """Return the number of blocks, from the card's CSD register (version 1 or 2)."""
    is_version_2 = about[0] >> 6
    if is_version_2:
        c_size = (about[7] & 0x3F) << 16 | about[8] << 8 | about[9]
        return c_size + 1 << 10  # C_SIZE is in units of 512 kB, which are 1024 blocks
    c_size = (about[6] & 3) << 10 | about[7] << 2 | about[8] >> 6
    factor_log2 = ((about[9] & 3) << 1 | about[10] >> 7) + 2  # C_SIZE_MULT
    length_log2 = about[5] & 15  # READ_BL_LEN: bytes of a block
    return c_size + 1 << factor_log2 + length_log2 - _BLOCK_LOG2
