"""One TMC2209, by its registers and datagrams as Trinamic's data sheet has them (rev. 1.09).

A datagram to a driver is a 5, its address, a register and a checksum; with four bytes in between,
most significant first, it writes. A driver that has taken a write counts it, and says so when it
is asked: nothing else is an acknowledgement.
"""

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from interfaces import DriverWire

_SYNC = const(5)
_MASTER = const(0xFF)  # the address of an answer
_WRITE = const(0x80)  # beside a register
_ANSWER_BYTES = const(8)
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

# GCONF: the serial line instead of the pins says current and microsteps; steps are filtered.
_SERIAL = const(0x1C0)
_SPREAD = const(4)
# GSTAT, whose bits stay until ones are written to them.
_RESET = const(1)
_DRIVER_FAULT = const(2)
_LOW_VOLTAGE = const(4)
_ALL_FLAGS = const(7)
# NODECONF: an answer waits for 3 times 8 bits; several on a wire want 2 at least.
_SEND_DELAY = const(0x200)
_HOLD_DELAY = const(8)  # 2^18 clocks each, by which current goes down to that of holding
# CHOPCONF.
_OFF_TIME = const(0xF)  # 0: the driver is off
_USUAL_OFF_TIME = const(3)
_SENSITIVE = const(1 << 17)  # the lower voltage at the sense resistors
_STEPS_AT = const(24)
_INTERPOLATED = const(1 << 28)
_SMOOTHEST_LOG2 = const(8)  # 256 microsteps
# DRV_STATUS.
_WARM = const(1)
_FAULTS = ((2, "too hot"), (0xC, "short circuit to ground"), (0x30, "short circuit to supply"))
_SCALE_AT = const(16)
_SCALES = const(32)  # current goes from 1/32 to 32/32
# Voltages at the sense resistors at full scale, with their wires' own resistance, and sqrt(2).
_FULL_V = const(0.325)
_LOW_V = const(0.18)
_WIRES_OHM = const(0.02)
_PEAK = const(1.4142136)
_CLOCK_HZ = const(12000000)
_LONGEST_STEP = const(0xFFFFF)


def checksum(data: "bytes | bytearray") -> int:
    """Over all its bytes, whose lowest bits come first."""
    crc = 0
    for byte in data:
        for i in range(8):
            high = crc >> 7 ^ byte >> i & 1
            crc = crc << 1 & 0xFF
            if high:
                crc ^= _POLYNOMIAL
    return crc


def full_scale_ma(sense_ohm: float, volts: float = _FULL_V) -> float:
    """The highest current, in mA as a motor's maker says it (RMS), with these resistors."""
    return volts / (sense_ohm + _WIRES_OHM) / _PEAK * 1000


def is_resolution(microsteps: float) -> bool:
    """Whether a full step can be divided into so many."""
    return microsteps in [1 << i for i in range(_SMOOTHEST_LOG2 + 1)]


class Silence(Exception):
    """It does not answer, or not as it should; the text says what is known."""


class Chip:
    """A driver at an address of the wire. sense_ohm: its sense resistors."""

    def __init__(self, wire: "DriverWire", address: int, sense_ohm: float) -> None:
        self._wire = wire
        self._address = address
        self._sense_ohm = sense_ohm
        self._spread = 0
        self._writes = 0
        self._flags = 0
        self._status = 0

    # Datagrams

    def _read(self, register: int, tries: int = _TRIES) -> int:
        request = bytearray((_SYNC, self._address, register, 0))
        request[3] = checksum(request[:3])
        why = ""
        for _ in range(tries):
            answer = self._wire.exchange(request, _ANSWER_BYTES)
            if answer is None:
                why = "the wire is broken"
            elif len(answer) < _ANSWER_BYTES:
                why = "no answer: is the motors' supply on?"
            elif checksum(answer[:7]) != answer[7] or answer[:3] != bytes(
                (_SYNC, _MASTER, register)
            ):
                why = "a spoilt answer"
            else:
                return int.from_bytes(answer[3:7], "big")
        raise Silence(why)

    def _write(self, register: int, value: int) -> None:
        request = bytearray((_SYNC, self._address, register | _WRITE, 0, 0, 0, 0, 0))
        for i in range(4):
            request[6 - i] = value >> 8 * i & 0xFF
        request[7] = checksum(request[:7])
        self._wire.exchange(request, 0)
        self._writes += 1

    def _begin(self) -> None:
        self._writes = self._read(_IFCNT)

    def _end(self) -> None:
        """Silence where it has not taken all that was written."""
        if self._read(_IFCNT) != self._writes & 0xFF:
            raise Silence("a setting did not arrive")

    # What it can do

    def set_up(self, milliamps: float, hold_percent: float, microsteps: int, spread: bool) -> None:
        """Say all it has to know, and forget what has been. Its chopper's times stay as its maker
        has set them. Raises Silence."""
        sensitive = milliamps <= full_scale_ma(self._sense_ohm, _LOW_V)
        full = full_scale_ma(self._sense_ohm, _LOW_V if sensitive else _FULL_V)
        run = min(max(int(_SCALES * milliamps / full + 0.5), 1), _SCALES)
        hold = max(int(run * hold_percent / 100 + 0.5), 1)
        log2 = 0
        while 1 << log2 < microsteps:
            log2 += 1
        chopper = self._read(_CHOPCONF) & ~(_SENSITIVE | 0xF << _STEPS_AT)
        chopper |= (_SMOOTHEST_LOG2 - log2) << _STEPS_AT | _INTERPOLATED
        if sensitive:
            chopper |= _SENSITIVE
        if not chopper & _OFF_TIME:
            chopper |= _USUAL_OFF_TIME
        self._spread = _SPREAD if spread else 0
        self._begin()
        self._write(_NODECONF, _SEND_DELAY)
        self._write(_GCONF, _SERIAL | self._spread)
        self._write(_IHOLD_IRUN, _HOLD_DELAY << 16 | (run - 1) << 8 | hold - 1)
        self._write(_TCOOLTHRS, 0)
        self._write(_SGTHRS, 0)
        self._write(_CHOPCONF, chopper)
        self._write(_GSTAT, _ALL_FLAGS)
        self._end()
        if self._read(_CHOPCONF) != chopper:
            raise Silence("it has other microsteps than it was told")

    def feel(self, threshold: int, steps_per_s: float, microsteps: int) -> None:
        """Say by DIAG when the motor is stopped, above half of that rate, more readily the higher
        the threshold is; 0: no more. Raises Silence."""
        slowest = 0
        if threshold:
            clocks = 2 * _CLOCK_HZ * microsteps / (256 * max(steps_per_s, 1.0))
            slowest = min(int(clocks), _LONGEST_STEP)
        self._begin()
        if self._spread:  # it feels nothing with that
            self._write(_GCONF, _SERIAL)
        self._write(_TCOOLTHRS, slowest)
        self._write(_SGTHRS, threshold)
        self._end()

    def read_status(self, tries: int = _TRIES) -> None:
        """Ask it how it is: what follows is of that moment. Raises Silence."""
        self._flags = self._read(_GSTAT, tries)
        self._status = self._read(_DRV_STATUS)

    def has_begun_anew(self) -> bool:
        """Its supply has failed since it was set up."""
        return bool(self._flags & _RESET)

    def is_warm(self) -> bool:
        """It is about to be too hot."""
        return bool(self._status & _WARM)

    def fault(self) -> str:
        """What is wrong with it; "" where nothing is."""
        for mask, words in _FAULTS:
            if self._status & mask:
                return words
        if self._flags & _LOW_VOLTAGE:
            return "its supply is too low"
        return "it has switched itself off" if self._flags & _DRIVER_FAULT else ""

    def status_text(self) -> str:
        """What it says of itself, for a report. Raises Silence."""
        chopper = self._read(_CHOPCONF)
        self.read_status()
        return "version:%d|microsteps:%d|mode:%s|scale:%d/32|state:%s" % (
            self._read(_IOIN) >> 24,
            1 << _SMOOTHEST_LOG2 - (chopper >> _STEPS_AT & 0xF),
            "spreadCycle" if self._read(_GCONF) & _SPREAD else "stealthChop",
            (self._status >> _SCALE_AT & 31) + 1,
            self.fault() or ("warm" if self.is_warm() else "good"),
        )
