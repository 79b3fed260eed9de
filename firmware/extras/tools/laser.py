# mypy: disable-error-code=arg-type
"""The laser: PWM frequency, and power changed by the engine during motion.

$33 is the frequency of the PWM that sets the power, with grblHAL's number and meaning. PWM_HZ in
the board file is its default. A spindle's controller needs a certain frequency. A laser engraves a
raster better with more pulses per dot.

On engines that support it, hardware changes the power at the step where the change belongs, and no
interrupt sets it. move_power() writes the changes of each segment, as motion/beam_layout.py
defines them.
"""

from array import array

import micropython
from base.errors import INVALID_STATEMENT, GrblError
from base.float32 import truncate
from base.settings import ALL, WHOLE
from control.spindle import Spindle
from micropython import const
from motion import beam_layout as bm
from motion.beam_layout import BOTH, COUNT, FULL, FULL_LOG2, GAP, LEVEL, LEVELS_MASK, SINCE
from motion.layout import (
    KEEP_POWER,
    MOTOR_COUNT,
    ROW_AXES,
    ROW_POWER,
    ROW_STRIDE,
    ROW_TICKS,
)

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

    from base.settings import Rows
    from base.state import State
    from interfaces import BeamEngine, NextSegment, Options, Port
    from motion.planner import Planner

    from extras.api import Cnc

_SETTINGS: "Rows" = (
    # Spindle PWM frequency. Pulses per second of the output that sets the power: 10 to 100000.
    (33, "pwm_hz", WHOLE, 5000.0, "Hz"),
)
_PWM_HZ = const(33)  # number of that setting
# Every chip's PWM can do this range, with nearly a thousand steps of power or more.
_LOWEST_HZ = const(10)
_HIGHEST_HZ = const(100_000)
_MOST_WITH_RADIO = const(4)  # motors, on an RP2040 that uses its radio
_EARLIEST_TICK = const(8)  # of a segment: an engine cannot change the power before
_MOST_SINCE = const(0x100000)  # ticks: limit of beam[SINCE], so that it cannot overflow


@micropython.viper
def emit(beam: ptr32, levels: ptr32, power: int) -> int:
    """Append a change of power (PWM steps) to the ring of levels. Returns 0.

    beam: the beam's state: beam[COUNT] changes so far, beam[LEVEL] the last power. level = power *
    beam[FULL] / 2**FULL_LOG2; beam_layout.full() keeps the product within 31 bits. The
    factor beam[BOTH] puts it into the engine's format: 0x10001 for a register with it twice.
    """
    levels[beam[COUNT] & LEVELS_MASK] = ((power * beam[FULL]) >> FULL_LOG2) * beam[BOTH]
    beam[COUNT] += 1
    beam[LEVEL] = power
    return 0


@micropython.viper
def place_changes(
    table: ptr32, row: ptr32, beam: ptr32, number: int, first: int, last: int
) -> int:
    """Write into a segment's row when its `number` changes of power come: evenly from tick `first`
    to tick `last` of the segment. Returns 0. emit() writes their levels. In the row the beam
    follows the motors and has three integers, as they do: number, first tick and last tick.

    Both are delayed where the hardware would not be ready: it needs _EARLIEST_TICK ticks from the
    start of the segment, and beam[GAP] ticks from one change to the next. beam[SINCE]: ticks from
    the last change to the end of the segment before, and afterwards of this one. table: the
    planner's.
    """
    base = ROW_AXES + ROW_STRIDE * table[MOTOR_COUNT]  # index of the beam's integers in row
    row[base] = number
    since = beam[SINCE] + row[ROW_TICKS]  # without a change
    if number:
        earliest_first = beam[GAP] - beam[SINCE]
        if earliest_first < _EARLIEST_TICK:
            earliest_first = _EARLIEST_TICK
        if first < earliest_first:
            first = earliest_first
        earliest_last = first + (number - 1) * beam[GAP]
        if last < earliest_last:
            last = earliest_last
        row[base + 1] = first
        row[base + 2] = last
        since = row[ROW_TICKS] - last
    beam[SINCE] = since if since < _MOST_SINCE else _MOST_SINCE
    return 0


@micropython.viper
def move_power(table: ptr32, row: ptr32, beam: ptr32, levels: ptr32) -> int:
    """Move the power of a segment just made to the beam: a change at its start, or none if it is
    the last power. Returns 0.

    row[ROW_POWER], the power that an interrupt would set, becomes KEEP_POWER: it sets none. beam,
    levels: see emit(); table: the planner's.
    """
    changes = 0  # how many: 1, at tick 0 or as soon as the hardware is ready
    if row[ROW_POWER] != beam[LEVEL]:
        emit(beam, levels, row[ROW_POWER])
        changes = 1
    place_changes(table, row, beam, changes, 0, 0)
    row[ROW_POWER] = KEEP_POWER
    return 0


class Laser(Spindle):
    """A spindle whose power the engine changes during motion. _engine: None if it cannot. _beam:
    see beam_layout.py; _beam[bm.LEVEL] is the power of the last change, UNKNOWN (negative) while
    idle. _reversed: M4; laser: $32 is on."""

    def __init__(self, port: "Port", state: "State", enable_by_direction: bool) -> None:
        super().__init__(port, state, enable_by_direction)
        self._beam = array("i", (bm.UNKNOWN for _ in range(bm.LENGTH)))
        self._engine: "Any" = None

    def connect(
        self, engine: "BeamEngine", planner: "Planner", next_segment: "NextSegment"
    ) -> None:
        """Connect the engine, which sets the power during motion, and the planner. next_segment:
        Segments.next() or its replacement, which fills a segment's row."""
        self._next_segment = next_segment
        self._engine = engine
        self._beam = engine.beam
        self._levels = engine.levels
        self._table = planner.table

    @micropython.viper
    def next(self, row: object) -> int:
        """Fill the next segment's row, as segments.Segments.next(), with its changes of power.

        Return 1, or 0 if nothing is left to move. Called in the engine's interrupt.
        """
        if int(self._next_segment(row)) == 0:
            return 0
        move_power(ptr32(self._table), ptr32(row), ptr32(self._beam), ptr32(self._levels))
        return 1

    def set_power(self, power: int) -> None:
        """Set PWM directly (PWM steps): while idle, or per segment with an engine that cannot.
        Safe in an interrupt."""
        self._power = power
        self._port.spindle(power != 0, power)

    def on_motion_end(self) -> None:
        """Set the output to the power that the engine has set last, when motion has ended.
        Interrupt. With M4 (dynamic power) the laser is off while idle."""
        beam = self._beam
        if self._reversed and self.laser:
            self.set_power(0)
        elif beam[bm.LEVEL] >= 0:  # not UNKNOWN: the engine has set a power
            self.set_power(beam[bm.LEVEL])
        beam[bm.LEVEL] = bm.UNKNOWN  # the next motion sends its first power in any case

    def stop(self) -> None:
        """Switch off at once, also if the engine has queued changes. Safe in an interrupt."""
        if self._engine:
            self._engine.put_out()
        super().stop()

    def direction(self) -> int:
        """Return OFF, CW or CCW. Without an enable pin, the power set last says whether it is
        on."""
        if self._beam[bm.LEVEL] >= 0:  # during motion the engine has set it
            self._power = self._beam[bm.LEVEL]
        return super().direction()


def prepare(options: "Options", board: "ModuleType") -> None:
    """Check the board file before the machine is created. ValueError if it is wrong."""
    option = board.__dict__.get
    hz: int = option("PWM_HZ", 5000)
    if not _LOWEST_HZ <= hz <= _HIGHEST_HZ:
        raise ValueError("TOOL = laser: PWM_HZ is %d to %d" % (_LOWEST_HZ, _HIGHEST_HZ))
    if option("SPINDLE_ON", None) is not None:
        raise ValueError("TOOL = laser: remove SPINDLE_ON, it lags the beam")
    # With five motors the PIO programs of beam and radio do not fit together into PIO 1 of an
    # RP2040.
    if option("ENGINE", "") == "pio" and option("MPY_ARCH", "") == "armv6m":
        if len(option("STEP", ())) > _MOST_WITH_RADIO and option("LINK", "usb") == "wifi":
            raise ValueError('TOOL = laser: LINK = "wifi" allows 4 motors at most')
    options.defaults = dict(options.defaults)
    options.defaults.setdefault(_PWM_HZ, hz)
    options.spindle = Laser


def install(cnc: "Cnc") -> None:
    """Add the setting and the changes of power. ValueError without a PWM pin."""
    machine = cnc.machine
    pwm = machine.port.pwm
    if not pwm:
        raise ValueError("TOOL = laser: the board file names no pin for SPINDLE_PWM")
    settings: "Any" = machine.settings
    engine: "Any" = machine.engine
    laser: "Any" = machine.spindle
    has_beam = hasattr(engine, "beam")  # else the engine cannot change power within motion
    if has_beam:
        hooks = machine.state.hooks
        laser.connect(engine, machine.planner, hooks.next_segment)
        hooks.next_segment = laser.next

    def configure() -> None:
        """Set the output's frequency, and the beam's scale, from the settings."""
        if settings.changed in (_PWM_HZ, ALL):  # the number of the changed setting, or ALL
            hz = truncate(settings.pwm_hz)  # an integer
            pwm.freq(min(max(hz, _LOWEST_HZ), _HIGHEST_HZ))
            if has_beam:
                engine.scale(machine.port.pwm_max)  # the power that is 100 %

    cnc.add_settings(_SETTINGS)
    cnc.check_setting(_PWM_HZ, _check)
    settings.on_change(configure)


def _check(hz: float) -> None:
    """Refuse a frequency outside the range, by GrblError."""
    if not _LOWEST_HZ <= hz <= _HIGHEST_HZ:
        raise GrblError(INVALID_STATEMENT)
