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

from ports.link_memory import LOOP_HAS_READ

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable

_BLOCK = const(512)  # bytes
_BLOCK_LOG2 = const(9)
_BEGIN_HZ = const(400_000)  # of the bus while the card starts
_HZ = const(12_000_000)

# Numbers of commands: CMD0 and so on.
_GO_IDLE = const(0)  # CMD0: reset
_INTERFACE = const(8)  # CMD8: offers a voltage
_READ_CSD = const(9)  # CMD9: the card's data, a block of 16 bytes
_STATUS = const(13)  # CMD13
_BLOCK_LENGTH = const(16)  # CMD16
_READ = const(17)  # CMD17: one block
_WRITE = const(24)  # CMD24: one block
_START_CARD = const(41)  # ACMD41, sent after _APPLICATION
_APPLICATION = const(55)  # CMD55: the next command is an ACMD
_CHECKSUMS = const(59)  # CMD59: argument 1 switches them on

_VOLTAGE = const(0x1AA)  # 2.7 to 3.6 V, and a pattern that the card returns
_LARGE = const(0x40000000)  # HCS: we support cards of more than 2 GB
_NOT_STARTED = const(1)  # a command's answer: good, the card is not started yet; 0: good
_START_TOKEN = const(0xFE)  # the byte before a block
_ACCEPTED = const(5)  # the answer to a block that has arrived whole
_IDLE_LINE = const(0xFF)  # byte read while the card sends nothing; a busy card sends 0
_COMMAND_BYTE = const(0x40)  # the first byte of a command, to which its number is added
_NO_ANSWER = const(0x80)  # a byte from here on is no answer yet
_DATA_STATUS = const(0x1F)  # the bits of the answer to a block

_ANSWER_BYTES = const(9)  # a command's answer is one of so many bytes after it
_TRIES = const(3)  # of each transfer
_BEGIN_MS = const(1000)  # the specification's longest time for a card to start,
_READ_MS = const(100)  # to read,
_BUSY_MS = const(500)  # and to write

_ASK_COUNT = const(4)  # request of ioctl(): number of blocks
_ASK_SIZE = const(5)  # request of ioctl(): bytes of a block


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
    card, select; shared: memory shared with the supervisor: shared[LOOP_HAS_READ] = 1 says that
    the loop is alive. is_faulty: a read or write failed: all later ones fail, too. _since_ms:
    ticks_ms() at the start of the transfer. _count: number of blocks, 0 before begin() and after
    end(). _shift: from a block's number to its address, in bits to the left."""

    def __init__(self, pins: "tuple[int, ...]", shared: "array[int]") -> None:
        clock, to_card, from_card, select = pins
        self._shared = shared
        self._select = Pin(select, Pin.OUT, value=1)
        into = Pin(from_card, Pin.IN, Pin.PULL_UP)  # high without a card
        unit = clock >> 3 & 1  # RP2040 and RP2350: SPI 0 or 1 has this pin
        self._bus = SPI(unit, sck=Pin(clock), mosi=Pin(to_card), miso=into)
        self._byte = bytearray(1)
        self._command = bytearray(6)
        self._sum = bytearray(2)
        self._since_ms = 0
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
        return self._for_each(self._read_block, number, into)

    def writeblocks(self, number: int, data: "bytes | bytearray | memoryview") -> int:
        """Write whole blocks, from `number` on."""
        return self._for_each(self._write_block, number, data)

    def ioctl(self, what: int, _argument: int) -> int:
        """Return the number of blocks or the size of one; other requests need no action."""
        if what == _ASK_COUNT:
            return self._count
        return _BLOCK if what == _ASK_SIZE else 0

    def _for_each(
        self,
        do: "Callable[[int, memoryview], None]",
        number: int,
        data: "bytes | bytearray | memoryview",
    ) -> int:
        """Call do(address, block) for each block of data, whose numbers count from `number` on.
        Return 0, or -EIO after a fault."""
        if not self._count:  # after end(): no blocks, but no error
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
        self._bus.read(10, _IDLE_LINE)  # not selected: the card needs 74 clocks
        self._reset()
        answer = bytearray(4)
        # Only cards of version 2 know CMD8.
        is_version_2 = self._send_command(_INTERFACE, _VOLTAGE, answer) == _NOT_STARTED
        if is_version_2 and answer[3] != _VOLTAGE & 0xFF:
            raise OSError(errno.ENODEV)
        if self._send_command(_CHECKSUMS, 1) != _NOT_STARTED:
            raise OSError(errno.EIO)
        since = time.ticks_ms()
        while True:
            self._send_command(_APPLICATION, 0)
            if self._send_command(_START_CARD, _LARGE if is_version_2 else 0) == 0:
                break
            self._since_ms = since  # _send_command() has restarted the time
            self._check_time(_BEGIN_MS)
        csd = bytearray(16)
        self._read(_READ_CSD, 0, csd)
        self._count = _count_blocks(csd)
        # Addresses: with CSD version 2 numbers of blocks, with version 1 bytes.
        self._shift = 0 if csd[0] >> 6 else _BLOCK_LOG2
        self._send_command(_BLOCK_LENGTH, _BLOCK)

    def _reset(self) -> None:
        """Reset the card, whatever its state: in the middle of a block it does not react to the
        first command."""
        for _ in range(_TRIES):
            try:
                if self._send_command(_GO_IDLE, 0) == _NOT_STARTED:
                    return
            except OSError as fault:
                if fault.args[0] != errno.ENODEV:
                    raise
        raise OSError(errno.ENODEV)

    def _status(self) -> int:
        """Return the card's status, 0 if it is good: its two bytes, combined by or."""
        answer = bytearray(1)
        return self._send_command(_STATUS, 0, answer) | answer[0]

    def _send_command(self, command: int, argument: int, more: "bytearray | None" = None) -> int:
        """Select the card, send a command without data and return its answer, a byte of bits, 0 or
        _NOT_STARTED if it is good. more: filled with the bytes that follow the answer. OSError
        without an answer."""
        self._since_ms = time.ticks_ms()
        self._select(0)
        try:
            answer = self._send_selected(command, argument)
            if more:
                self._bus.readinto(more, _IDLE_LINE)
            return answer
        finally:
            self._release()

    def _read_block(self, address: int, into: memoryview) -> None:
        """Read a block at a card's address. OSError if that fails."""
        self._read(_READ, address, into)

    def _read(self, command: int, argument: int, into: "bytearray | memoryview") -> None:
        """Send a command and read the block that it returns, at most _TRIES times. OSError if none
        was whole, or at once if the card does not answer in time."""
        self._since_ms = time.ticks_ms()
        for _ in range(_TRIES):
            self._select(0)
            try:
                if self._send_selected(command, argument) == 0 and self._receive_block(into):
                    return
            finally:
                self._release()
        raise OSError(errno.EIO)

    def _write_block(self, address: int, block: memoryview) -> None:
        """Write a block at a card's address, at most _TRIES times. OSError if all fail, or at once
        if the card does not answer in time."""
        for _ in range(_TRIES):
            self._since_ms = time.ticks_ms()
            self._select(0)
            try:
                is_written = self._send_selected(_WRITE, address) == 0 and self._send_block(block)
            finally:
                self._release()
            if is_written and self._status() == 0:
                return
        raise OSError(errno.EIO)

    def _send_selected(self, command: int, argument: int) -> int:
        """Send a command to the selected card; return its answer, a byte of bits. argument: 32
        bits. OSError (ENODEV) without an answer."""
        self._wait(_READ_MS)
        data = self._command
        data[0] = _COMMAND_BYTE | command
        for i in range(1, 5):  # the argument, its highest byte first
            data[i] = argument >> (32 - 8 * i) & 0xFF
        data[5] = _sum7(data, 5)
        self._bus.write(data)
        for _ in range(_ANSWER_BYTES):
            answer = self._next()
            if answer < _NO_ANSWER:
                return answer
        raise OSError(errno.ENODEV)

    def _receive_block(self, into: "bytearray | memoryview") -> bool:
        """Receive a block into a buffer; False if its checksum is wrong or the card answers with
        an error. OSError if it does not come in time."""
        token = self._next()
        while token == _IDLE_LINE:
            self._check_time(_READ_MS)
            token = self._next()
        if token != _START_TOKEN:
            return False
        self._bus.readinto(into, _IDLE_LINE)
        self._bus.readinto(self._sum, _IDLE_LINE)
        return _sum16(into, len(into)) == self._sum[0] << 8 | self._sum[1]

    def _send_block(self, block: memoryview) -> bool:
        """Send a block, and wait until it is written; False if the card reports that it was
        damaged."""
        checksum = _sum16(block, len(block))
        self._sum[0], self._sum[1] = checksum >> 8, checksum & 0xFF
        self._next()  # the card needs a byte in between
        self._byte[0] = _START_TOKEN
        self._bus.write(self._byte)
        self._bus.write(block)
        self._bus.write(self._sum)
        answer = self._next() & _DATA_STATUS
        self._since_ms = time.ticks_ms()
        self._wait(_BUSY_MS)
        return answer == _ACCEPTED

    def _wait(self, limit_ms: int) -> None:
        """Wait while the card is busy. OSError after limit_ms."""
        while self._next() != _IDLE_LINE:
            self._check_time(limit_ms)

    def _next(self) -> int:
        """Return the next byte from the card; _IDLE_LINE if it sends none."""
        self._bus.readinto(self._byte, _IDLE_LINE)
        return self._byte[0]

    def _release(self) -> None:
        """End a transfer: deselect the card. The supervisor sees that the loop is alive."""
        self._select(1)
        self._next()  # the card releases the line at the next clock
        self._shared[LOOP_HAS_READ] = 1

    def _check_time(self, limit_ms: int) -> None:
        """Raise OSError if the transfer has taken longer than limit_ms."""
        self._shared[LOOP_HAS_READ] = 1
        if time.ticks_diff(time.ticks_ms(), self._since_ms) > limit_ms:
            raise OSError(errno.ETIMEDOUT)


def _count_blocks(csd: bytearray) -> int:
    """Return the number of blocks, from the card's CSD register (version 1 or 2)."""
    is_version_2 = csd[0] >> 6
    if is_version_2:
        c_size = (csd[7] & 0x3F) << 16 | csd[8] << 8 | csd[9]
        return c_size + 1 << 10  # C_SIZE is in units of 512 kB, which are 1024 blocks
    c_size = (csd[6] & 3) << 10 | csd[7] << 2 | csd[8] >> 6
    factor_log2 = ((csd[9] & 3) << 1 | csd[10] >> 7) + 2  # C_SIZE_MULT
    length_log2 = csd[5] & 15  # READ_BL_LEN: bytes of a block
    return c_size + 1 << factor_log2 + length_log2 - _BLOCK_LOG2
