"""Settings: declared once, in _TABLE; everything else is derived from its rows.

A setting is an attribute here, in the units of its row. The store holds the lines that a user
would type. It also keeps lines that this firmware does not know, so that an older firmware does
not lose the settings of a newer one. Code that derives a value from a setting subscribes with
on_change(). Settings must not change during motion.
"""

from array import array

from micropython import const

from base import errors
from base.errors import GrblError
from base.float32 import f32, truncate

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    from interfaces import Store

    Row = tuple[int, str, int, float, str]
    Rows = tuple[Row, ...]

INT = const(0)  # whole, 0 to 255: larger numbers wrap
BOOL = const(1)  # 0 or 1
WHOLE = const(2)  # a float, shown without decimals
FLOAT = const(3)
AXIS = const(4)  # a float per axis: number + axis

ALL = const(-1)  # in place of a number: all settings

_FILE = "settings"  # name in the store

_TABLE: "Rows" = (
    # number, attribute, kind, default, unit. The comment above a row is its documentation.
    #
    # Step pulse time. Length of one step pulse; the driver's data sheet gives the minimum. No
    # less than 3.
    (0, "step_pulse_us", INT, 10, "microseconds"),
    # Step idle delay. Motors are released this long after a motion; 255 keeps them on for ever.
    (1, "idle_lock_ms", INT, 25, "milliseconds"),
    # Step pulse invert. One bit per axis: X = 1, Y = 2, Z = 4.
    (2, "step_invert", INT, 0, "mask"),
    # Step direction invert. One bit per axis.
    (3, "dir_invert", INT, 0, "mask"),
    # Invert step enable pin. Off: low enables the drivers.
    (4, "enable_invert", BOOL, 0, "boolean"),
    # Invert limit pins. Off: switches pull their pins to ground when hit.
    (5, "limit_invert", BOOL, 0, "boolean"),
    # Invert probe pin. Off: the probe pulls its pin to ground on contact.
    (6, "probe_invert", BOOL, 0, "boolean"),
    # Status report options. 1: machine position rather than work position; 2: buffer state.
    (10, "report_mask", INT, 1, "mask"),
    # Junction deviation. How far the speed computation rounds a corner; more makes corners faster.
    (11, "junction_deviation_mm", FLOAT, 0.010, "millimeters"),
    # Arc tolerance. How far the chords of an arc may be off the arc.
    (12, "arc_tolerance_mm", FLOAT, 0.002, "millimeters"),
    # Report in inches. Positions and rates in reports, not in settings.
    (13, "report_inches", BOOL, 0, "boolean"),
    # Soft limits. Refuse motion outside the travel of $130-$132. Needs homing.
    (20, "soft_limits", BOOL, 0, "boolean"),
    # Hard limits. Stop at once and alarm when a limit switch changes.
    (21, "hard_limits", BOOL, 0, "boolean"),
    # Homing cycle. $H is available, and the machine starts locked until homed.
    (22, "homing", BOOL, 0, "boolean"),
    # Homing direction invert. One bit per axis; set: the switch is at the negative end.
    (23, "homing_dir_invert", INT, 0, "mask"),
    # Homing locate feed rate. The slow approach that sets the position.
    (24, "homing_feed", FLOAT, 25.0, "mm/min"),
    # Homing search seek rate. The fast approach that finds the switch.
    (25, "homing_seek", FLOAT, 500.0, "mm/min"),
    # Homing switch debounce delay. Pause between the moves of homing.
    (26, "homing_debounce_ms", INT, 250, "milliseconds"),
    # Homing switch pull-off distance. Move back from the switch, far enough to open it.
    (27, "homing_pull_off_mm", FLOAT, 1.0, "millimeters"),
    # Maximum spindle speed. The speed at full power.
    (30, "max_rpm", WHOLE, 1000.0, "RPM"),
    # Minimum spindle speed. The speed at the lowest power.
    (31, "min_rpm", WHOLE, 0.0, "RPM"),
    # Laser mode. S changes without stopping; M4 power follows the speed; G0 is dark.
    (32, "laser_mode", BOOL, 0, "boolean"),
    # Steps per millimetre, one value per axis.
    (100, "steps_per_mm", AXIS, 250.0, "step/mm"),
    # Maximum rate, one value per axis.
    (110, "max_rate", AXIS, 500.0, "mm/min"),
    # Acceleration, one value per axis.
    (120, "acceleration", AXIS, 10.0, "mm/sec^2"),
    # Maximum travel, one value per axis, from the homing switch.
    (130, "max_travel", AXIS, 200.0, "millimeters"),
)
_SHORTEST_PULSE_US = const(3)  # $0, unless the board's drivers accept less
_BEYOND = float("3.5e38")  # above single precision; a literal could not be frozen

# Stored internally in mm/min2, as Grbl does in single precision, and shown in the row's unit.
_ACCELERATION = const(120)  # the first number of that row
_PER_SECOND_SQR = 3600.0  # mm/min2 in 1 mm/s2


class Settings:
    """All settings. They are read from the store and written to it.

    axes: how many there are. defaults: the board's, by number; they replace those of the rows.
    """

    step_pulse_us: int
    idle_lock_ms: int
    step_invert: int
    dir_invert: int
    enable_invert: int
    limit_invert: int
    probe_invert: int
    report_mask: int
    junction_deviation_mm: float
    arc_tolerance_mm: float
    report_inches: int
    soft_limits: int
    hard_limits: int
    homing: int
    homing_dir_invert: int
    homing_feed: float
    homing_seek: float
    homing_debounce_ms: int
    homing_pull_off_mm: float
    max_rpm: float
    min_rpm: float
    laser_mode: int
    steps_per_mm: "array[float]"
    max_rate: "array[float]"
    acceleration: "array[float]"  # mm/min2
    max_travel: "array[float]"

    def __init__(
        self,
        store: "Store",
        axes: int,
        defaults: "dict[int, float]",
    ) -> None:
        # Set by a board: a limit of step rates ($100-$112; 0: none), and the shortest pulse ($0).
        self.max_step_hz = 0
        self.step_pulse_min_us = _SHORTEST_PULSE_US
        # An extra may replace the rows, or the name of the file.
        self.rows: "Rows" = _TABLE
        self.file = _FILE
        self.checks: "tuple[Callable[[int, float], object], ...]" = ()  # called before set()
        self.signed: "dict[int, float]" = {}  # numbers that may be negative: largest magnitude
        self._store = store
        self._axes = axes
        self._board_defaults = defaults
        self._unknown: "list[str]" = []  # stored lines of another firmware or board
        self._callbacks: "list[Callable[[], None]]" = []
        self.changed = ALL  # what has changed, for subscribers: a number, or ALL
        self.is_new = False  # the store has never held settings, which is still to be reported

    # Subscribers

    def on_change(self, callback: "Callable[[], None]") -> None:
        """Subscribe a callback to every change; `changed` is the setting's number, or ALL."""
        self._callbacks.append(callback)

    def _announce(self, number: int) -> None:
        """Call the subscribers after a change of the setting `number`, or of ALL."""
        self.changed = number
        for callback in self._callbacks:
            callback()

    # Storage

    def load(self) -> bool:
        """Read the stored settings. If they are damaged, or none were ever stored, restore the
        defaults. Returns False if they were damaged."""
        lines = self._store.load(self.file)
        if not lines:  # None: they are damaged; an empty list: none were ever stored
            self.restore()
            self.is_new = lines is not None
            return self.is_new
        self._set_defaults()
        self._unknown = []
        try:
            for line in lines:
                self._read(line)
        except ValueError:
            self.restore()
            return False
        self._announce(ALL)
        return True

    def _read(self, line: str) -> None:
        """Apply a line ($100=250). Raises ValueError if save() cannot have written it. A line for
        a number that this firmware does not have is stored again by save()."""
        number, _, amount = line.partition("=")
        key, value = int(number[1:]), float(amount)
        if not abs(value) < _BEYOND:
            raise ValueError(line)
        try:
            row, axis = self.row(key)
        except GrblError:
            self._unknown.append(line)  # from another firmware or board
        else:
            if self._fault(key, value):
                raise ValueError(line)
            if key == 0:  # the step pulse: the board's drivers may be others now
                value = max(value, self.step_pulse_min_us)
            self._store_value(row, axis, value)

    def save(self) -> None:
        """Store all settings as lines ($100=250), and the lines that this firmware does not
        know."""
        lines = [
            "$%d=%.9g" % (number, self._shown(number, row)) for number, row in self._numbers()
        ]
        self._store.save(self.file, lines + self._unknown)

    def restore(self) -> None:
        """Restore and store the defaults ($RST=$)."""
        self._set_defaults()
        self._announce(ALL)
        self.save()

    def set(self, number: int, amount: float) -> None:
        """Execute $number=amount. Raises GrblError if it is refused; nothing has changed then."""
        for check in self.checks:
            check(number, amount)
        self._assign(number, amount)
        self._announce(number)
        self.save()

    def each(self) -> "list[tuple[int, float, int]]":
        """Return (number, value, decimals) of every setting in the order of $$."""
        return [
            (number, self._shown(number, row), self._decimals(row))
            for number, row in self._numbers()
        ]

    def _numbers(self) -> "list[tuple[int, Row]]":
        """Return (number, row) of every setting; a row of AXIS has a number per axis."""
        numbers = []
        for row in self.rows:
            first, _, kind, _, _ = row
            for axis in range(self._axes if kind == AXIS else 1):
                numbers.append((first + axis, row))
        return numbers

    def _decimals(self, row: "Row") -> int:
        """Return how many decimals $$ shows of a row's settings."""
        _, _, kind, _, _ = row
        return 3 if kind > WHOLE else 0

    def _shown(self, number: int, row: "Row") -> float:
        """Return the value of the setting `number` in the unit of its row."""
        first, attribute, kind, _, _ = row
        amount: float = getattr(self, attribute)
        if kind == AXIS:  # then the attribute is an array
            amount = getattr(self, attribute)[number - first]
            if first == _ACCELERATION:
                amount = f32(amount / _PER_SECOND_SQR)
        return amount

    def _set_defaults(self) -> None:
        """Set every setting to the board's default, or else to that of its row."""
        for row in self.rows:
            first, attribute, kind, default, _ = row
            if kind == AXIS:
                setattr(self, attribute, array("f", (0.0 for _ in range(self._axes))))
            for axis in range(self._axes if kind == AXIS else 1):
                self._store_value(row, axis, self._board_defaults.get(first + axis, default))

    def _store_value(self, row: "Row", axis: int, amount: float) -> None:
        """Set the attribute of a row, converted to its kind. axis: 0 unless the kind is AXIS."""
        first, attribute, kind, _, _ = row
        if kind == AXIS:
            if first == _ACCELERATION:
                amount = amount * _PER_SECOND_SQR
            getattr(self, attribute)[axis] = amount
        elif kind == INT:
            setattr(self, attribute, truncate(amount) & 255)  # larger numbers wrap
        elif kind == BOOL:
            setattr(self, attribute, 1 if truncate(amount) & 255 else 0)
        else:
            setattr(self, attribute, f32(amount))

    def row(self, number: int) -> "tuple[Row, int]":
        """Return the row of a number, and its axis. Raises GrblError if there is no such row."""
        for row in self.rows:
            first, _, kind, _, _ = row
            axis = number - first
            if axis == 0 or (kind == AXIS and 0 < axis < self._axes):
                return row, axis
        raise GrblError(errors.INVALID_STATEMENT)

    def _fault(self, number: int, amount: float) -> int:
        """Return Grbl's error number if the sign or size of the amount is wrong, or 0."""
        if number not in self.signed:
            return 0 if amount >= 0 else errors.NEGATIVE_VALUE
        return 0 if abs(amount) <= self.signed[number] else errors.INVALID_STATEMENT

    def _assign(self, number: int, amount: float) -> None:
        """Check a setting's new value and set the attribute. Raises GrblError if the number does
        not exist or the value is refused; nothing has changed then."""
        fault = self._fault(number, amount)
        if fault:
            raise GrblError(fault)
        row, axis = self.row(number)
        check = _CHECKS.get(row[0])  # by the first number of a row; raises GrblError
        if check:
            check(self, axis, amount)
        self._store_value(row, axis, amount)

    # Checks of one setting each, which may involve others, before it gets the value `amount`. They
    # raise GrblError. A board's step rate is limited in Hz; rates are in mm/min, resolutions in
    # steps/mm. & 255: whole numbers wrap there, as they are stored.

    def _check_pulse(self, axis: int, amount: float) -> None:
        """Refuse a step pulse that is too short, by GrblError."""
        if truncate(amount) & 255 < self.step_pulse_min_us:
            raise GrblError(errors.SETTING_STEP_PULSE_MIN)

    def _check_soft_limits(self, axis: int, amount: float) -> None:
        """Refuse soft limits without homing, by GrblError."""
        if truncate(amount) & 255 and not self.homing:
            raise GrblError(errors.SOFT_LIMIT_ERROR)

    def _check_homing(self, axis: int, amount: float) -> None:
        """Switch soft limits off if homing is switched off, because they need it."""
        if not truncate(amount) & 255:
            self.soft_limits = 0

    def _check_resolution(self, axis: int, amount: float) -> None:
        """Refuse steps/mm that need, at the axis' rate, more steps/s than the board makes."""
        if self.max_step_hz and amount * self.max_rate[axis] > self.max_step_hz * 60.0:
            raise GrblError(errors.MAX_STEP_RATE_EXCEEDED)

    def _check_rate(self, axis: int, amount: float) -> None:
        """Refuse a rate that needs more steps/s than the board makes, by GrblError."""
        if self.max_step_hz and amount * self.steps_per_mm[axis] > self.max_step_hz * 60.0:
            raise GrblError(errors.MAX_STEP_RATE_EXCEEDED)


_CHECKS = {
    0: Settings._check_pulse,
    20: Settings._check_soft_limits,
    22: Settings._check_homing,
    100: Settings._check_resolution,
    110: Settings._check_rate,
}
