"""Two motors on an axis, and a gantry that squares itself: MOTORS = "XYZY" in the board file.

The first motors move an axis each, in order; each of those behind goes along with the axis that
its letter says. Where both motors of an axis have a limit switch, homing runs both and stops each
at its own; how far apart they are then is $17n. Where only the first has one, they home as one.
Numbers of settings are grblHAL's, that of the alarm for a switch not found in time is Grbl's.
"""

from base import errors
from base.axes import LETTERS, X, Y
from base.errors import GrblError
from base.settings import FLOAT, INT, Settings
from control.inputs import Inputs
from control.seek import Seek
from micropython import const
from motion.kinematics import Kinematics

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

    from base.settings import Rows
    from interfaces import Options

    from extras.api import Cnc

    Pairs = tuple[tuple[int, int], ...]  # an axis, which is its first motor's number, and a motor

_INVERT: "Rows" = (  # attribute-names: column 1
    # Second motor direction invert. One bit per axis; on top of $3, which turns both of them.
    (8, "ganged_dir_invert", INT, 0, "mask"),
)
_SQUARING: "Rows" = (  # attribute-names: column 1
    # Squaring fail length. One motor may look for its switch alone for so much of the travel of
    # the axis across.
    (347, "racking_percent", FLOAT, 5.0, "percent"),
    # Squaring fail distance, least. However short that is.
    (348, "racking_least_mm", FLOAT, 2.5, "millimeters"),
    # Squaring fail distance, most. However long that is.
    (349, "racking_most_mm", FLOAT, 25.0, "millimeters"),
)
# Of each axis that squares itself, the row of its number.
_OFFSETS: "Rows" = (  # attribute-names: column 1
    # X squaring offset. The second motor goes so much further away from its switch than the first;
    # negative: the first.
    (170, "square_x_mm", FLOAT, 0.0, "millimeters"),
    # Y squaring offset.
    (171, "square_y_mm", FLOAT, 0.0, "millimeters"),
    # Z squaring offset.
    (172, "square_z_mm", FLOAT, 0.0, "millimeters"),
    # A squaring offset.
    (173, "square_a_mm", FLOAT, 0.0, "millimeters"),
)
_MOST_OFFSET_MM = const(10)
_MOTORS_OF_AN_AXIS = const(2)


class GangedSettings(Settings):
    """Settings, of which the squaring offsets may be negative."""

    def _read(self, line: str) -> None:
        number, _, amount = line.partition("=-")
        if amount and self._is_offset(int(number[1:])):
            self._assign(int(number[1:]), -float(amount))
        else:
            super()._read(line)

    def _assign(self, number: int, amount: float) -> None:
        if not self._is_offset(number):
            super()._assign(number, amount)
            return
        if not abs(amount) <= _MOST_OFFSET_MM:
            raise GrblError(errors.INVALID_STATEMENT)
        row, axis = self.row(number)
        self._store_value(row, axis, amount)

    def _is_offset(self, number: int) -> bool:
        return any(row[0] == number for row in self.rows if row in _OFFSETS)


class GangedInputs(Inputs):
    """Inputs, of which several may be an axis' limit switches."""

    pairs: "Pairs" = ()

    def closed(self) -> int:
        """As Inputs.closed(): an axis' bit is set where one of its switches is closed."""
        found = super().closed()
        limits = self.limits()
        for axis, motor in self.pairs:
            if limits >> motor & 1:
                found |= 2 << axis  # behind the probe
        return found

    def add(self, pairs: "Pairs") -> None:
        """The second motors of these have a switch, too."""
        self.pairs = pairs
        for _, motor in pairs:
            self._all |= 1 << motor


class GangedSeek(Seek):
    """Homing that squares."""

    pairs: "Pairs" = ()

    def home(self, axes: int) -> bool:
        """As Seek.home(). Refused where a switch of an axis that squares is closed: nobody knows
        how far."""
        closed = self._inputs.limits()
        for axis, motor in self.pairs:
            if (axes == 0 or axes >> axis & 1) and (closed >> axis | closed >> motor) & 1:
                self._voice.message("%s: move off the closed limit switch first" % LETTERS[axis])
                self._drive.reset()
                self._state.alarm = errors.ALARM_HARD_LIMIT
                return False
        return super().home(axes)

    def _home(self, axes: int) -> None:
        for axis, motor in self.pairs:
            if axes >> axis & 1:
                axes |= 1 << motor
        super()._home(axes)

    def _failed(self, approach: bool, axes: int) -> bool:
        if super()._failed(approach, axes) or not approach:
            return self._state.alarm != 0
        made = self._steps
        self._engine.position(made)
        for axis, motor in self.pairs:
            resolution = self._planner.steps_per_mm[axis]
            racked = abs(made[axis] - made[motor])
            if axes >> axis & 1 and racked > self._most_mm(axis) * resolution:
                self._state.alarm = errors.ALARM_HOMING_FAIL_DUAL_APPROACH
        return self._state.alarm != 0

    def _most_mm(self, axis: int) -> float:
        """How far one motor may look for its switch alone."""
        settings = self._settings
        across = settings.max_travel[Y if axis == X else X]
        most = across * settings.racking_percent / 100  # type: ignore[attr-defined]
        most = max(most, settings.racking_least_mm)  # type: ignore[attr-defined]
        return min(most, settings.racking_most_mm)  # type: ignore[attr-defined, no-any-return]

    def _set_origin(self, axes: int) -> None:
        settings = self._settings
        for axis, motor in self.pairs:
            if axes >> axis & 1:
                offset: float = getattr(settings, _OFFSETS[axis][1])
                if offset:
                    self._engine.lock(1 << (axis if offset > 0 else motor))
                    self._home_phase(
                        1 << axis | 1 << motor, False, abs(offset), settings.homing_feed
                    )
        super()._set_origin(axes)


def count_axes(letters: str, motors: int) -> int:
    """How many axes there are, of so many motors with these letters. ValueError where that cannot
    be."""
    axes = len(set(letters))
    if len(letters) != motors:
        raise ValueError("MOTORS has %d letters, and STEP %d pins" % (len(letters), motors))
    if letters[:axes] != LETTERS[:axes]:
        raise ValueError("MOTORS: %s first, then second motors: XYZY" % LETTERS[:axes])
    for letter in letters:
        if letters.count(letter) > _MOTORS_OF_AN_AXIS:
            raise ValueError("MOTORS: %s has more than two" % letter)
    return axes


def prepare(options: "Options", board: "ModuleType") -> None:
    """Which motor goes with which axis. ValueError where that cannot be."""
    option = board.__dict__.get
    letters: str = option("MOTORS", "")
    limits: "tuple[int | None, ...]" = option("LIMIT", ())
    options.axes = axes = count_axes(letters, len(option("STEP", ())))
    moves = [1 << axis for axis in range(axes)]
    if options.kinematics:
        moves = list(options.kinematics.moves)[:axes]
    alone = 0
    for motor in range(axes, len(letters)):
        axis = LETTERS.index(letters[motor])
        if moves[axis] != 1 << axis:
            raise ValueError("MOTORS: %s of a CoreXY has no second motor" % letters[motor])
        moves.append(1 << axis)
        if len(limits) > motor and limits[motor] is not None:
            if limits[axis] is None:
                raise ValueError("LIMIT: %s has its second switch only" % letters[motor])
            alone |= 1 << axis | 1 << motor
    options.kinematics = Kinematics(axes, moves, alone)
    options.settings, options.inputs, options.seek = GangedSettings, GangedInputs, GangedSeek


def install(cnc: "Cnc") -> None:
    """Have the second motors turn as the settings say, and square the axes that can be."""
    machine: "Any" = cnc.machine
    settings, engine, planner = machine.settings, machine.engine, machine.planner
    kinematics, axes = planner.kinematics, planner.axes
    pairs: "Pairs" = ()
    for motor in range(axes, planner.motors):
        pairs += ((kinematics.moves.index(kinematics.moves[motor]), motor),)
    squared = tuple([pair for pair in pairs if kinematics.alone >> pair[1] & 1])
    machine.inputs.add(squared)
    machine.seek.pairs = squared
    cnc.add_settings(_INVERT)
    if squared:
        cnc.add_settings(_SQUARING)
        cnc.add_settings(tuple([_OFFSETS[axis] for axis, _ in squared]))

    def configure() -> None:
        """The motors' pins, once more, for $2 and $3 are of axes."""
        mask = (1 << axes) - 1
        step, direction = settings.step_invert & mask, settings.dir_invert & mask
        turned = direction ^ settings.ganged_dir_invert
        for axis, motor in pairs:
            step |= (step >> axis & 1) << motor
            direction |= (turned >> axis & 1) << motor
        engine.configure(settings.step_pulse_us, step, direction)

    settings.on_change(configure)
