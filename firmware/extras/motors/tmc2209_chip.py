"""One TMC2209: registers and datagrams of Trinamic's data sheet, revision 1.09.

A read datagram is 5, the address, a register and a checksum. A write datagram has four more bytes
before the checksum, most significant first. A driver counts the writes that it has accepted.
Reading that counter (IFCNT) is the only acknowledgement.
"""

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from interfaces import DriverWire

_SYNC = const(5)
_MASTER = const(0xFF)  # the address of an answer
_WRITE = const(0x80)  # added to the register
_ANSWER_BYTES = const(8)
_CHECKSUM_AT = const(7)  # in an answer, and in a write datagram
_VALUE_AT = const(3)
_POLYNOMIAL = const(7)
_TRIES = const(3)

# Registers.
_GCONF = const(0x00)
_GSTAT = const(0x01)
_IFCNT = const(0x02)
_NODECONF = const(0x03)
_IOIN = const(0x06)
_IHOLD_IRUN = const(0x10)
_TCOOLTHRS = const(0x14)
_SGTHRS = const(0x40)
_CHOPCONF = const(0x6C)
_DRV_STATUS = const(0x6F)

# GCONF. The first one also has steps filtered.
_SERIAL = const(0x1C0)  # current and microsteps are set over the serial line, not by pins
_EN_SPREADCYCLE = const(4)
# GSTAT: its bits stay set until ones are written to them.
_WAS_RESET = const(1)
_DRIVER_FAULT = const(2)
_LOW_VOLTAGE = const(4)
_ALL_FLAGS = const(7)  # of GSTAT: writing ones clears them
# NODECONF: several drivers on a wire need at least 2 * 8.
_SEND_DELAY = const(0x200)  # an answer is delayed by 3 * 8 bit times
_HOLD_DELAY = const(8)  # in 2^18 clocks: time of each step from run to hold current
# CHOPCONF.
_OFF_TIME_MASK = const(0xF)  # of CHOPCONF; 0 there: the driver is off
_DEFAULT_OFF_TIME = const(3)
_LOW_VOLTAGE_RANGE = const(1 << 17)  # lower full-scale voltage at the sense resistors
_MRES_AT = const(24)  # bit of CHOPCONF where MRES begins: 0 for 256 microsteps, 1 for 128, ...
_INTERPOLATED = const(1 << 28)  # in CHOPCONF: the chip makes 256 microsteps of them
_SMOOTHEST_LOG2 = const(8)  # 256 microsteps
# DRV_STATUS.
_WARM = const(1)
_FAULTS = ((2, "too hot"), (0xC, "short circuit to ground"), (0x30, "short circuit to supply"))
_SCALE_AT = const(16)  # bit of DRV_STATUS where the present current in 1/32, less 1, begins
_SCALES = const(32)  # current goes from 1/32 to 32/32
_FULL_V = const(0.325)  # full-scale voltage at the sense resistors
_LOW_V = const(0.18)  # the lower one, with _LOW_VOLTAGE_RANGE
_WIRES_OHM = const(0.02)  # the resistance of their wiring
_PEAK = const(1.4142136)  # of an RMS value: sqrt(2)
_CLOCK_HZ = const(12000000)
_MOST_CLOCKS = const(0xFFFFF)  # the highest value of TCOOLTHRS


def checksum(data: "bytes | bytearray") -> int:
    """Return the CRC-8 of the bytes, lowest bit first."""
    crc = 0
    for byte in data:
        for i in range(8):
            differs = crc >> 7 ^ byte >> i & 1
            crc = crc << 1 & 0xFF
            if differs:
                crc ^= _POLYNOMIAL
    return crc


def full_scale_ma(sense_ohm: float, volts: float = _FULL_V) -> float:
    """Return the highest current (RMS, mA) with these sense resistors (ohm). volts: the full-scale
    voltage at them."""
    return volts / (sense_ohm + _WIRES_OHM) / _PEAK * 1000


def is_resolution(microsteps: float) -> bool:
    """Return whether a full step can be divided into so many microsteps."""
    return microsteps in [1 << i for i in range(_SMOOTHEST_LOG2 + 1)]


class Silence(Exception):
    """A driver does not answer, or answers wrongly. The text says more."""


class Chip:
    """A driver at an address of the wire. sense_ohm: its sense resistors, in ohm. _gstat and
    _drv_status: these registers as they were read last. _writes: what the driver's counter of
    accepted writes must be. _spread_bit: the bit of GCONF for spreadCycle, or 0."""

    def __init__(self, wire: "DriverWire", address: int, sense_ohm: float) -> None:
        self._wire = wire
        self._address = address
        self._sense_ohm = sense_ohm
        self._spread_bit = self._writes = self._gstat = self._drv_status = 0

    # Datagrams

    def _read(self, register: int, tries: int = _TRIES) -> int:
        """Return a register's 32 bits. Raises Silence if no try gets a valid answer."""
        request = bytearray((_SYNC, self._address, register, 0))
        request[3] = checksum(request[:3])  # of the bytes before it
        begins_with = bytes((_SYNC, _MASTER, register))  # an answer, before its value
        why = ""
        for _ in range(tries):
            answer = self._wire.exchange(request, _ANSWER_BYTES)
            if answer is None:
                why = "no echo: its serial wire is cut"
            elif len(answer) < _ANSWER_BYTES:
                why = "no answer: is the motors' supply on?"
            elif checksum(answer[:_CHECKSUM_AT]) == answer[_CHECKSUM_AT] and (
                answer[:_VALUE_AT] == begins_with
            ):
                return int.from_bytes(answer[_VALUE_AT:_CHECKSUM_AT], "big")
            else:
                why = "a corrupted answer"
        raise Silence(why)

    def _write(self, register: int, value: int) -> None:
        """Write a register's 32 bits. There is no answer: _check_writes() checks that it has
        arrived."""
        request = bytearray((_SYNC, self._address, register | _WRITE, 0, 0, 0, 0, 0))
        for i in range(4):  # the value's bytes, the lowest one last
            request[_CHECKSUM_AT - 1 - i] = value >> 8 * i & 0xFF
        request[_CHECKSUM_AT] = checksum(request[:_CHECKSUM_AT])
        self._wire.exchange(request, 0)
        self._writes += 1

    def _begin_writes(self) -> None:
        """Begin a series of writes: read the driver's counter of them."""
        self._writes = self._read(_IFCNT)

    def _check_writes(self) -> None:
        """Raise Silence if the driver has not accepted all writes."""
        if self._read(_IFCNT) != self._writes & 0xFF:  # the counter has 8 bits
            raise Silence("it missed a setting sent to it")

    # Functions

    def set_up(self, milliamps: float, hold_percent: float, microsteps: int, spread: bool) -> None:
        """Write the configuration and clear old faults. Raises Silence.

        milliamps: RMS. hold_percent: current while the motor stands. spread: use spreadCycle. The
        chopper's times keep the chip's defaults. run, hold: currents in 1/32 of the full scale,
        which has a lower range for small currents.
        """
        in_low_range = milliamps <= full_scale_ma(self._sense_ohm, _LOW_V)
        full_ma = full_scale_ma(self._sense_ohm, _LOW_V if in_low_range else _FULL_V)
        run = min(max(int(_SCALES * milliamps / full_ma + 0.5), 1), _SCALES)
        hold = max(int(run * hold_percent / 100 + 0.5), 1)
        microsteps_log2 = 0
        while 1 << microsteps_log2 < microsteps:
            microsteps_log2 += 1
        chopper = self._read(_CHOPCONF) & ~(_LOW_VOLTAGE_RANGE | 0xF << _MRES_AT)
        chopper |= (_SMOOTHEST_LOG2 - microsteps_log2) << _MRES_AT | _INTERPOLATED
        if in_low_range:
            chopper |= _LOW_VOLTAGE_RANGE
        if not chopper & _OFF_TIME_MASK:
            chopper |= _DEFAULT_OFF_TIME
        self._spread_bit = _EN_SPREADCYCLE if spread else 0
        self._begin_writes()
        self._write(_NODECONF, _SEND_DELAY)
        self._write(_GCONF, _SERIAL | self._spread_bit)
        self._write(_IHOLD_IRUN, _HOLD_DELAY << 16 | (run - 1) << 8 | hold - 1)
        self._write(_TCOOLTHRS, 0)  # no stall is reported until homing asks for it
        self._write(_SGTHRS, 0)
        self._write(_CHOPCONF, chopper)
        self._write(_GSTAT, _ALL_FLAGS)
        self._check_writes()
        if self._read(_CHOPCONF) != chopper:
            raise Silence("it did not accept its microsteps")

    def set_stall_threshold(self, threshold: int, steps_per_s: float, microsteps: int) -> None:
        """Let DIAG report a stalled motor, at more than half of that step rate. Raises Silence.

        threshold: 0 to 255; higher is more sensitive, 0 switches it off. microsteps: those of
        steps_per_s, per full step.
        """
        longest_clocks = 0
        if threshold:
            # TCOOLTHRS counts clocks per 1/256 step; twice as long is half of the rate.
            clocks = 2 * _CLOCK_HZ * microsteps / (256 * max(steps_per_s, 1.0))
            longest_clocks = min(int(clocks), _MOST_CLOCKS)
        self._begin_writes()
        if self._spread_bit:  # StallGuard does not work with spreadCycle
            self._write(_GCONF, _SERIAL)
        self._write(_TCOOLTHRS, longest_clocks)
        self._write(_SGTHRS, threshold)
        self._check_writes()

    def read_status(self, tries: int = _TRIES) -> None:
        """Read the status registers for the methods below. Raises Silence."""
        self._gstat = self._read(_GSTAT, tries)
        self._drv_status = self._read(_DRV_STATUS)

    def has_lost_supply(self) -> bool:
        """Return whether its supply has failed since it was configured."""
        return bool(self._gstat & _WAS_RESET)

    def is_warm(self) -> bool:
        """Return whether it is near its temperature limit."""
        return bool(self._drv_status & _WARM)

    def fault(self) -> str:
        """Return the fault that the status read last shows, as text, or ""."""
        for mask, words in _FAULTS:
            if self._drv_status & mask:
                return words
        if self._gstat & _LOW_VOLTAGE:
            return "its supply voltage is too low"
        return "it has switched itself off" if self._gstat & _DRIVER_FAULT else ""

    def status_text(self) -> str:
        """Return its status as text, for a report. Raises Silence."""
        chopper = self._read(_CHOPCONF)
        self.read_status()
        return "version:%d|microsteps:%d|mode:%s|scale:%d/32|state:%s" % (
            self._read(_IOIN) >> 24,
            1 << _SMOOTHEST_LOG2 - (chopper >> _MRES_AT & 0xF),
            "spreadCycle" if self._read(_GCONF) & _EN_SPREADCYCLE else "stealthChop",
            (self._drv_status >> _SCALE_AT & 31) + 1,
            self.fault() or ("warm" if self.is_warm() else "good"),
        )
