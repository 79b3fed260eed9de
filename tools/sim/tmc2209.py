"""TMC2209 motor drivers on a wire, as the firmware sees them: datagrams in, datagrams out.

Written from the data sheet, independently of the firmware's code. The motors are not affected: the
simulator has no motor current.
"""

import machine

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

GCONF, GSTAT, IFCNT, NODECONF, IOIN = 0x00, 0x01, 0x02, 0x03, 0x06
IHOLD_IRUN, TPOWERDOWN, TPWMTHRS, TCOOLTHRS = 0x10, 0x11, 0x13, 0x14
SGTHRS, CHOPCONF, DRV_STATUS = 0x40, 0x6C, 0x6F
# Registers: initial values, readable ones, and writable ones.
_BEGIN = {
    GCONF: 0x101,
    GSTAT: 1,
    IOIN: 0x21 << 24,
    CHOPCONF: 0x10000053,
    DRV_STATUS: 0x80000000,
}
_READABLE = (GCONF, GSTAT, IFCNT, IOIN, CHOPCONF, DRV_STATUS)
_THRESHOLDS = (TPWMTHRS, TCOOLTHRS, SGTHRS)
_WRITABLE = (GCONF, GSTAT, NODECONF, IHOLD_IRUN, TPOWERDOWN, CHOPCONF) + _THRESHOLDS
# A datagram: sync, address, register with the write flag, four bytes of data unless it is a read
# request, CRC. The address of the master, in answers, is 255.
_READ_BYTES, _WRITE_BYTES = 4, 8  # length of a request
_SYNC, _SYNC_BITS, _MASTER = 5, 0xF, 0xFF
_WRITE = 0x80  # flag in the byte of the register


def crc(data: bytes) -> int:
    """Return the CRC: the remainder by x^8 + x^2 + x + 1 of all bits, the lowest of each byte
    first. By long division, as in the definition."""
    bits = [byte >> i & 1 for byte in data for i in range(8)] + [0] * 8
    for i in range(len(bits) - 8):
        if bits[i]:  # subtract the polynomial, by its powers of x
            for power in (8, 2, 1, 0):
                bits[i + 8 - power] ^= 1
    value = 0
    for bit in bits[-8:]:
        value = value * 2 + bit
    return value


class Driver:
    """One driver. has_supply: the motor supply is on. stuck: flags of GSTAT that return after
    being cleared."""

    def __init__(self, address: int) -> None:
        self.address = address
        self.registers: "dict[int, int]" = {}  # by address
        self.stuck = 0
        self.switch_on()

    def switch_on(self) -> None:
        """Switch the supply on."""
        self.has_supply = True
        self.registers = dict(_BEGIN)
        self._writes = 0  # datagrams that were accepted, for IFCNT

    def take(self, data: bytes) -> bytes:
        """Process a datagram to this address; returns the answer of a read request, else b"". An
        invalid one is ignored, as by the chip."""
        register, is_write = data[2] & ~_WRITE, data[2] & _WRITE
        if not self.has_supply or data[0] & _SYNC_BITS != _SYNC or crc(data[:-1]) != data[-1]:
            return b""
        if not is_write:
            if len(data) != _READ_BYTES or register not in _READABLE:
                return b""
            value = self._writes & 0xFF if register == IFCNT else self.registers.get(register, 0)
            answer = bytes((_SYNC, _MASTER, register)) + value.to_bytes(4, "big")
            return answer + bytes((crc(answer),))
        if len(data) == _WRITE_BYTES and register in _WRITABLE:
            self._writes += 1
            value = int.from_bytes(data[3:7], "big")
            if register == GSTAT:  # a bit written as 1 is cleared
                value = self.registers[GSTAT] & ~value | self.stuck
            self.registers[register] = value
        return b""


class DriverBus:
    """All drivers of a machine, one per motor. spoil: changes an answer, for tests. is_broken:
    nothing comes back on the wire, not even the echo."""

    def __init__(self, addresses: "Sequence[int]", is_idle: "Callable[[], bool]") -> None:
        self.drivers = [Driver(address) for address in addresses]
        self.spoil: "Callable[[bytes], bytes] | None" = None
        self.is_broken = False
        self.datagrams = 0  # number of all
        self.in_motion = 0  # number of datagrams while motors turned
        self._is_idle = is_idle

    def attach(self, pins: "Sequence[int]") -> None:
        """Connect to these pins, TX and RX; () if the board has no such wire."""
        if len(pins) == 2:
            machine.UART.at[pins[0], pins[1]] = self.exchange

    def exchange(self, data: bytes) -> bytes:
        """Return what comes back: the echo of the data, followed by the answer."""
        self.datagrams += 1
        if not self._is_idle():
            self.in_motion += 1
        if self.is_broken:
            return b""
        answer = b""
        for driver in self.drivers:
            if len(data) > 2 and data[1] == driver.address:  # byte 1 of a datagram
                answer = driver.take(data)
        if answer and self.spoil:
            answer = self.spoil(answer)
        return data + answer
