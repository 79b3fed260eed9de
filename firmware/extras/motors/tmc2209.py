"""TMC2209 motor drivers over their serial line: TMC2209 = (0, 2, 1) in the board file.

Current, microsteps and more are settings, with grblHAL's numbers. Drivers are configured after
each power-up of their supply, and are polled while the machine is idle. A hot, damaged or silent
driver causes an alarm, and no motor moves before all drivers are configured. With $339 StallGuard
detects the end of an axis, and DIAG replaces its limit switch. There is no traffic on the serial
line while anything moves.
"""

import math

from base import errors
from base import state as st
from base.axes import LETTERS
from base.errors import GrblError
from base.settings import AXIS, INT
from micropython import const
from motion.layout import REVERSE

from extras.motors import tmc2209_chip
from extras.motors.tmc2209_chip import Chip, Silence

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

    from base.settings import Rows
    from interfaces import Options

    from extras.api import Cnc

PINS = ("TMC_UART",)

_CURRENT = const(140)  # first numbers of settings, one per axis
_MICROSTEPS = const(150)
_SEEK = const(200)
_HOLD = const(210)
_LOCATE = const(220)
_NUMBERS_PER_ROW = const(6)  # of settings, because there may be six axes
_SETTINGS: "Rows" = (
    # Motor current, one value per axis. RMS; it holds for both motors of an axis.
    (140, "driver_ma", AXIS, 500.0, "milliampere"),
    # Microsteps, one value per axis. 1, 2, 4 and so on up to 256; $100-$105 count them.
    (150, "driver_microsteps", AXIS, 16.0, "steps"),
    # StallGuard threshold of homing's search, one value per axis, 0 to 255. Higher is more
    # sensitive.
    (200, "driver_stall_seek", AXIS, 0.0, "threshold"),
    # Hold current, one value per axis. Percent of $140-$145 while the motor stands still.
    (210, "driver_hold", AXIS, 50.0, "percent"),
    # StallGuard threshold of homing's slow approach, one value per axis. As $200.
    (220, "driver_stall_locate", AXIS, 0.0, "threshold"),
    # Motor drivers that are set up. One bit per axis; the others are configured by their pins.
    (338, "driver_axes", INT, 63, "mask"),
    # Axes that home without switches, by StallGuard. One bit per axis.
    (339, "driver_homing", INT, 0, "mask"),
    # Axes whose drivers use spreadCycle: more torque at high rates, but noise. One bit per axis.
    (810, "driver_spread", INT, 0, "mask"),
)
_ROWS = (_CURRENT, _MICROSTEPS, _SEEK, _HOLD, _LOCATE)  # first numbers of rows of settings
_HIGHEST_ADDRESS = const(3)
_MOST_THRESHOLD = const(255)
_PERCENT = const(100)
_POLL_MS = const(100)  # from the poll of one driver to that of the next
_SECONDS_PER_MIN = const(60)
_ROUNDING = const(1.001)  # a rate so little above $24 is that rate, rounded

_board: "dict[str, Any]" = {}  # prepare() stores here what install() needs


def prepare(options: "Options", board: "ModuleType") -> None:
    """Assign drivers to motors: TMC2209 has an address per motor, in the order of STEP. ValueError
    if the board file is wrong, or if its DEFAULTS are nothing a driver can do."""
    addresses: "tuple[int, ...]" = board.__dict__["TMC2209"]
    motors = len(board.__dict__.get("STEP", ()))
    if len(addresses) != motors:
        raise ValueError(
            "TMC2209 has %d addresses, but STEP has %d pins" % (len(addresses), motors)
        )
    for address in addresses:
        if not 0 <= address <= _HIGHEST_ADDRESS or addresses.count(address) > 1:
            raise ValueError("TMC2209: addresses must be 0 to 3, each only once")
    _board["addresses"] = addresses
    _board["wire"] = options.driver_wire
    _board["ohm"] = ohm = board.__dict__.get("TMC_SENSE_MOHM", 110) / 1000
    for number, amount in options.defaults.items():
        if not _can_be(number, amount, tmc2209_chip.full_scale_ma(ohm)):
            raise ValueError("DEFAULTS: $%d=%g is beyond what a driver can do" % (number, amount))
    _board["letters"] = board.__dict__.get("MOTORS", "")


def _can_be(number: int, amount: float, most_ma: float) -> bool:
    """Return whether the setting $number may have that value (amount). most_ma: the drivers'
    highest current, mA. Settings that are not a driver's may have any."""
    base = number // 10 * 10  # the last digit is the axis
    if base not in _ROWS or number - base >= _NUMBERS_PER_ROW:
        return True  # not a driver's
    if base == _CURRENT:
        return 0 < amount <= most_ma
    if base == _MICROSTEPS:
        return tmc2209_chip.is_resolution(amount)
    if base == _HOLD:
        return amount <= _PERCENT
    return amount <= _MOST_THRESHOLD  # StallGuard's, of _SEEK or _LOCATE


def install(cnc: "Cnc") -> None:
    """Create the drivers, and add their settings, the command $TMC, and hooks: drivers are polled
    between lines, checked before motion, and prepared for homing."""
    machine: "Any" = cnc.machine
    wire, ohm = _board["wire"], _board["ohm"]
    chips = [Chip(wire, address, ohm) for address in _board["addresses"]]
    drivers = Drivers(cnc, chips, _names(_board["letters"], len(chips)), ohm)
    cnc.add_settings(_SETTINGS)
    drivers.check_settings()
    machine.settings.on_change(drivers.configure)
    cnc.add_command(b"TMC", drivers.report)
    cnc.before_lines(drivers.poll_drivers)
    cnc.before_motion(drivers.may_start)
    drivers.hook_homing()


def _names(letters: str, motors: int) -> "list[str]":
    """Return the names of motors: the axis letter, Y2 for a second motor."""
    names: "list[str]" = []
    for letter in letters or LETTERS[:motors]:
        names.append(letter + "2" if letter in names else letter)
    return names


class Drivers:
    """All drivers. Masks are of motors, except those of settings, which are of axes.

    chips, names: per motor. sense_ohm: the drivers' sense resistors. Masks of motors whose drivers
    are to be configured ($338): _wanted; are configured: _ready; have answered, so silence is a
    fault: _responsive; have been reported as warm or faulty already: _reported.
    """

    def __init__(
        self, cnc: "Cnc", chips: "list[Chip]", names: "list[str]", sense_ohm: float
    ) -> None:
        machine = cnc.machine
        self._cnc = cnc
        self._machine = machine
        self._state = machine.state
        self._settings: "Any" = machine.settings
        self._planner = machine.planner
        self._motor_control = machine.motor_control
        self._port = machine.port
        self._chips = chips
        self._names = names
        self._axes = [LETTERS.index(name[0]) for name in names]
        self._most_ma = tmc2209_chip.full_scale_ma(sense_ohm)
        self._wanted = self._ready = self._responsive = self._reported = 0
        self._next = 0  # the motor whose driver is polled next
        self._polled_ms = self._port.ticks_ms()  # time of the last poll

    # Settings

    def check_settings(self) -> None:
        """Register a range check of the drivers' settings: a value that _can_be() denies is
        refused with GrblError before it is stored."""

        def check(number: int, amount: float) -> None:
            if not _can_be(number, amount, self._most_ma):
                raise GrblError(errors.INVALID_STATEMENT)

        self._settings.checks += (check,)

    def configure(self) -> None:
        """Note that settings have changed: all drivers must be configured again."""
        self._ready = 0
        self._wanted = 0
        for motor, axis in enumerate(self._axes):
            self._wanted |= (self._settings.driver_axes >> axis & 1) << motor

    def _set_up(self, motor: int) -> None:
        """Write the settings into a motor's driver. Raises Silence if it does not answer."""
        settings, axis = self._settings, self._axes[motor]
        self._chips[motor].set_up(
            settings.driver_ma[axis],
            settings.driver_hold[axis],
            int(settings.driver_microsteps[axis]),
            bool(settings.driver_spread >> axis & 1),
        )

    # Polling

    def poll_drivers(self) -> None:
        """Check the next driver, if the machine is idle and _POLL_MS have passed since the last
        one. A fault raises an alarm if the driver has worked before; otherwise it is reported
        once."""
        if self._port.elapsed_ms(self._polled_ms) < _POLL_MS or not self._machine.at_rest():
            return
        self._polled_ms = self._port.ticks_ms()
        motor = self._next
        self._next = (motor + 1) % len(self._chips)
        if self._wanted >> motor & 1:
            why = self._check_driver(motor)
            if why and self._responsive >> motor & 1:  # it has worked before
                self._responsive &= ~(1 << motor)  # only one alarm
                self._note_fault(motor, why)
                if self._state.run != st.ALARM:
                    self._machine.canon.stop_with_alarm(errors.ALARM_DRIVER)  # raises Abort
            elif why and not self._reported >> motor & 1:
                self._note_fault(motor, why)

    def _check_driver(self, motor: int) -> str:
        """Check a driver, and configure it if needed. Return its fault, or ""."""
        chip, mask = self._chips[motor], 1 << motor
        try:
            if self._responsive & mask:
                chip.read_status()
                if chip.has_lost_supply():
                    return "its supply has failed"
            else:
                chip.read_status(1)  # one try, because a driver without supply never answers
            if not self._ready & mask:
                self._set_up(motor)
                chip.read_status()
        except Silence as fault:
            return str(fault)
        why = chip.fault()
        if not why:
            self._note_healthy(motor)
        return why

    def _note_healthy(self, motor: int) -> None:
        """Note that a driver is configured and has no fault. Report once that it is warm."""
        mask, is_warm = 1 << motor, self._chips[motor].is_warm()
        self._ready |= mask
        self._responsive |= mask
        if is_warm and not self._reported & mask:
            self._report(motor, "warm")
        if is_warm:
            self._reported |= mask
        else:
            self._reported &= ~mask

    def _report(self, motor: int, what: str) -> None:
        """Send a message about a motor's driver."""
        self._cnc.message("Motor driver %s: %s" % (self._names[motor], what))

    def _note_fault(self, motor: int, why: str) -> None:
        """Report the fault (why) of a motor's driver, which must then be configured again."""
        self._ready &= ~(1 << motor)
        self._reported |= 1 << motor
        self._report(motor, why)

    def may_start(self) -> bool:
        """Check before motion that all drivers are configured. If not, raise an alarm."""
        for motor in range(len(self._chips)):
            if (self._wanted & ~self._ready) >> motor & 1:
                why = self._check_driver(motor)
                if why:
                    self._note_fault(motor, why)
                    self._motor_control.reset()
                    self._state.alarm = errors.ALARM_DRIVER
                    return False
        return True

    # Homing without switches

    def hook_homing(self) -> None:
        """Hook into homing and each of its phases: drivers get StallGuard's thresholds for it."""
        hooks = self._state.hooks
        previous_home, previous_phase = hooks.home, hooks.home_phase

        def home(axes: int) -> bool:
            """Home the axes (a mask; 0: all) if the drivers are configured. Those that have used
            StallGuard are configured again afterwards. Returns whether homing succeeded."""
            if not self.may_start():
                return False
            try:
                return previous_home(axes)
            finally:
                self._end_homing()

        def phase(axes: int, approach: bool, travel: float, rate: float) -> None:
            """Set thresholds, then run a phase of homing: see HomingProbing.home_phase()."""
            self._set_thresholds(axes, approach, rate)
            previous_phase(axes, approach, travel, rate)

        hooks.home, hooks.home_phase = home, phase

    def _sensing_motors(self, axes: int) -> "list[int]":
        """Return the numbers of the motors that detect the end of one of these axes (a mask): axes
        of $339, and drivers that are configured."""
        axes &= self._settings.driver_homing
        kinematics = self._planner.kinematics
        motors = []
        for motor in range(len(self._chips)):
            # The axes that it moves: bit i, or bit i + REVERSE if backwards.
            moves = kinematics.moves[motor] if kinematics else 1 << motor
            if (moves | moves >> REVERSE) & axes and self._ready >> motor & 1:
                motors.append(motor)
        return motors

    def _set_thresholds(self, axes: int, approach: bool, rate: float) -> None:
        """Set the StallGuard thresholds of a homing phase. axes: mask of those that move.

        rate: along the path of all of them, mm/min; if that is above $24 per axis, it is the
        search, else the slow approach. approach: False in a pull-off, which has no threshold.
        """
        settings = self._settings
        count = sum([axes >> i & 1 for i in range(self._planner.axes)])
        axis_rate = rate / math.sqrt(count)  # all move at the same rate
        is_search = axis_rate > settings.homing_feed * _ROUNDING
        thresholds = settings.driver_stall_seek if is_search else settings.driver_stall_locate
        for motor in self._sensing_motors(axes):
            axis = self._axes[motor]
            threshold = int(thresholds[axis]) if approach else 0
            try:
                self._chips[motor].set_stall_threshold(
                    threshold,
                    axis_rate / _SECONDS_PER_MIN * settings.steps_per_mm[axis],
                    int(settings.driver_microsteps[axis]),
                )
            except Silence as fault:
                self._note_fault(motor, str(fault))
                self._motor_control.reset()
                self._state.alarm = errors.ALARM_DRIVER
                self._cnc.service()  # raises Abort

    def _end_homing(self) -> None:
        """Have the drivers that StallGuard has used configured again, after homing has ended or
        was aborted."""
        for motor in self._sensing_motors((1 << self._planner.axes) - 1):
            self._ready &= ~(1 << motor)

    # The report

    def report(self, words: bytes) -> None:
        """Answer $TMC with the status of each driver."""
        if words:
            raise GrblError(errors.INVALID_STATEMENT)
        for motor, chip in enumerate(self._chips):
            try:
                text = chip.status_text()
            except Silence as fault:
                text = "state:%s" % fault
            self._cnc.write_line(b"[TMC:%s|%s]" % (self._names[motor].encode(), text.encode()))
