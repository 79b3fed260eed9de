"""An SD card as seen from the bus: bytes in, bytes out, by the rules of its SPI mode.

Written from the SD Association's Physical Layer Simplified Specification, chapter 7, not from our
driver. It requires right checksums, once enabled, and the right order of commands.
"""

from collections import deque
from collections.abc import Callable

BLOCK = 512

_IDLE, _ILLEGAL, _BAD_SUM, _BAD_ADDRESS = 1, 4, 8, 0x20
_START, _ACCEPTED, _REFUSED = 0xFE, 0xE5, 0xEB
_HIGH = 0xFF
_CLOCKS = 74
_BUSY = 20  # busy bytes after a block written
_DELAY = 8  # bytes until a block comes


def sum7(data: bytes) -> int:
    """Return CRC-7 by long division, followed by a 1."""
    rest = int.from_bytes(data, "big") << 7
    for bit in reversed(range(7, rest.bit_length())):
        if rest >> bit & 1:
            rest ^= 0x89 << bit - 7
    return rest << 1 | 1


def sum16(data: bytes) -> int:
    """Return CRC-16 (CCITT) by long division."""
    rest = int.from_bytes(data, "big") << 16
    for bit in reversed(range(16, rest.bit_length())):
        if rest >> bit & 1:
            rest ^= 0x11021 << bit - 16
    return rest


class SdCard:
    """A card. is_large: addresses count blocks. damage: returns a block as it arrives at the
    reader, or
    None if it never comes; refuse: number of blocks to refuse as damaged when written;
    has_no_sums: it
    does not support checksums."""

    def __init__(self, image: bytearray, is_large: bool = True) -> None:
        self.image = image
        self.is_large = is_large
        self.is_in = True
        self.damage: Callable[[bytes], bytes | None] = lambda block: block
        self.refuse = 0
        self.has_no_sums = False
        self.busy = _BUSY
        self.read = self.written = 0  # blocks
        self.select(False)
        self.power_off()

    def power_off(self) -> None:
        """Reset the state, as after removal or insertion."""
        self._clocks = 0
        self._is_awake = self._is_spi = self._has_sums = self._is_application = False
        self._begins = 3  # it answers busy so often before it is ready
        self._out: deque[int] = deque()
        self._in = bytearray()
        self._writes: int | None = None
        self._has_waited = False

    def select(self, is_selected: bool) -> None:
        """Set its select line; this ends its output."""
        self._is_selected = is_selected
        self._in, self._out = bytearray(), deque()
        self._writes = None

    def exchange(self, byte: int) -> int:
        """Exchange a byte: one in, one out."""
        if not self.is_in:
            return _HIGH
        if not self._is_selected:
            self._clocks += 8
            return _HIGH
        if self._clocks < _CLOCKS:
            return _HIGH
        if self._out:
            return self._out.popleft()
        if self._writes is not None:
            self._receive(byte)
        elif self._in or byte >> 6 == 1:
            self._in.append(byte)
            if len(self._in) == 6:
                command, self._in = bytes(self._in), bytearray()
                self._out.append(_HIGH)
                self._out.extend(self._answer(command))
        return _HIGH

    def _answer(self, command: bytes) -> bytes:
        number, argument = command[0] & 0x3F, int.from_bytes(command[1:5], "big")
        is_application, self._is_application = self._is_application, False
        wants_sum = self._has_sums or number in (0, 8)
        idle = 0 if self._is_awake else _IDLE
        if wants_sum and sum7(command[:5]) != command[5]:
            return bytes([idle | _BAD_SUM])
        if number == 0:
            self._is_spi, self._is_awake, self._has_sums = True, False, False
            return bytes([_IDLE])
        if not self._is_spi:
            return b""
        if number == 8 and self.is_large:
            return bytes([idle]) + command[1:5]
        if number == 59 and self.has_no_sums:
            return bytes([idle | _ILLEGAL])
        if number == 59:
            self._has_sums = bool(argument & 1)
            return bytes([idle])
        if number == 55:
            self._is_application = True
            return bytes([idle])
        if number == 41 and is_application:
            self._begins -= 1
            self._is_awake = self._begins <= 0 and (not self.is_large or bool(argument >> 30))
            return bytes([0 if self._is_awake else _IDLE])
        if not self._is_awake:
            return bytes([_IDLE | _ILLEGAL])
        return self._answer_awake(number, argument)

    def _answer_awake(self, number: int, argument: int) -> bytes:
        if number == 9:
            return b"\0" + self._block(self.about())
        if number == 13:
            return b"\0\0"
        if number == 16:
            return b"\0" if argument == BLOCK else bytes([_ILLEGAL])
        if number not in (17, 24):
            return bytes([_ILLEGAL])
        at = argument * BLOCK if self.is_large else argument
        if at % BLOCK or at >= len(self.image):
            return bytes([_BAD_ADDRESS])
        if number == 24:
            self._writes, self._has_waited = at, False
            return b"\0"
        self.read += 1
        return b"\0" + self._block(bytes(self.image[at : at + BLOCK]))

    def _block(self, data: bytes) -> bytes:
        came = self.damage(data)
        if came is None:
            return b""
        return bytes([_HIGH] * _DELAY + [_START]) + came + sum16(data).to_bytes(2, "big")

    def _receive(self, byte: int) -> None:
        """Receive a block, after at least one byte of delay."""
        has_waited, self._has_waited = self._has_waited, True
        if not self._in and (byte != _START or not has_waited):
            return
        self._in.append(byte)
        if len(self._in) < 1 + BLOCK + 2:
            return
        at, self._writes = self._writes, None
        assert at is not None
        data, checksum = bytes(self._in[1:-2]), int.from_bytes(self._in[-2:], "big")
        self._in = bytearray()
        if self.refuse or (self._has_sums and sum16(data) != checksum):
            self.refuse -= 1
            self._out.append(_REFUSED)
            return
        self.image[at : at + BLOCK] = data
        self.written += 1
        self._out.extend(bytes([_ACCEPTED] + [0] * self.busy))

    def about(self) -> bytes:
        """Return its CSD register."""
        count = len(self.image) // BLOCK
        csd = bytearray(16)
        if self.is_large:
            assert count % 1024 == 0
            csd[0] = 0x40
            csd[5] = 9
            csd[7:10] = (count // 1024 - 1).to_bytes(3, "big")
        else:
            # Blocks of 512 bytes, and a factor of 4: (size + 1) * 4 of them.
            size = count // 4 - 1
            csd[5] = 9
            csd[6], csd[7], csd[8] = size >> 10, size >> 2 & 0xFF, (size & 3) << 6
        csd[15] = sum7(bytes(csd[:15]))
        return bytes(csd)
