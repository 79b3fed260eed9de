"""Two motors on an axis, and a gantry that squares itself: MOTORS = "XYZY" in the board file.

The first motors move one axis each, in order. Each further motor moves with the axis of its
letter. If both motors of an axis have a limit switch, homing runs both and stops each at its own
switch. $17n then moves one of them further off its switch. If only the first has one, they home
together. Setting numbers are grblHAL's. The alarm for a switch not found in time is Grbl's.
"""

from base import errors
from base.axes import LETTERS, X, Y
from base.settings import FLOAT, INT, Settings
from control.homing_probing import HomingProbing
from control.inputs import Inputs
from micropython import const
from motion.kinematics import Kinematics

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

    from base.settings import Row, Rows
    from interfaces import Options

    from extras.api import Cnc

    Pairs = tuple[tuple[int, int], ...]  # an axis, also its first motor, and its second motor

_INVERT: "Rows" = (
    # Second motor direction invert. One bit per axis, in addition to $3, which inverts both
    # motors.
    (8, "ganged_dir_invert", INT, 0, "mask"),
)
_SQUARING: "Rows" = (
    # Squaring fail length. One motor may search for its switch alone over this share of the travel
    # of the perpendicular axis.
    (347, "racking_percent", FLOAT, 5.0, "percent"),
    # Squaring fail distance, least. Minimum of the distance of $347.
    (348, "racking_least_mm", FLOAT, 2.5, "millimeters"),
    # Squaring fail distance, most. Maximum of the distance of $347.
    (349, "racking_most_mm", FLOAT, 25.0, "millimeters"),
)
# For each axis that squares itself, the row with its number.
_OFFSETS: "Rows" = (
    # X squaring offset. The second motor moves this much further from its switch than the first;
    # negative: the first motor does.
    (170, "square_x_mm", FLOAT, 0.0, "millimeters"),
    # Y squaring offset. As $170.
    (171, "square_y_mm", FLOAT, 0.0, "millimeters"),
    # Z squaring offset. As $170.
    (172, "square_z_mm", FLOAT, 0.0, "millimeters"),
    # A squaring offset. As $170.
    (173, "square_a_mm", FLOAT, 0.0, "millimeters"),
    # B squaring offset. As $170.
    (174, "square_b_mm", FLOAT, 0.0, "millimeters"),
    # C squaring offset. As $170.
    (175, "square_c_mm", FLOAT, 0.0, "millimeters"),
)
_MOST_OFFSET_MM = const(10)
_MOTORS_OF_AN_AXIS = const(2)
_FEWEST_AXES = const(3)
_INVERT_SETTINGS = (2, 3)  # numbers of $2 and $3, step and direction invert


class GangedSettings(Settings):
    """Settings whose $2 and $3 have a bit per axis; engines get a bit per motor."""

    pairs: "Pairs" = ()

    def _announce(self, number: int) -> None:
        """Announce a change, as Settings._announce(), with the inverts of motors for engines."""
        # Bits of axes become bits of motors, in place. A second conversion changes nothing.
        self.step_invert = self._motor_mask(self.step_invert, flipped=0)
        flipped: int = self.ganged_dir_invert  # type: ignore[attr-defined]
        self.dir_invert = self._motor_mask(self.dir_invert, flipped=flipped)
        super()._announce(number)

    def _motor_mask(self, inverted: int, flipped: int) -> int:
        """Return a mask of motors to invert. inverted: mask whose bits of axes count, its others
        do not; flipped: mask of axes whose second motor is inverted against the first."""
        inverted &= (1 << self._axes) - 1
        motors = inverted  # the first motors have the numbers of their axes
        for axis, motor in self.pairs:
            motors |= ((inverted ^ flipped) >> axis & 1) << motor
        return motors

    def _shown(self, number: int, row: "Row") -> float:
        """Return a setting's value for $$, as Settings._shown(), of masks only the axes' bits."""
        amount = super()._shown(number, row)
        return int(amount) & (1 << self._axes) - 1 if number in _INVERT_SETTINGS else amount


class GangedInputs(Inputs):
    """Inputs with more than one limit switch on an axis."""

    pairs: "Pairs" = ()

    def active(self) -> int:
        """Return Inputs.active(), a mask: bit 0 is the probe, bit i + 1 axis i, which is set if
        any of its switches is closed."""
        closed = super().active()
        limits = self.limits()
        for axis, motor in self.pairs:
            if limits >> motor & 1:
                closed |= 2 << axis  # bit 0 is the probe
        return closed

    def add_second_switches(self, pairs: "Pairs") -> None:
        """Use the limit switches of these pairs' second motors, too."""
        self.pairs = pairs
        for _, motor in pairs:
            self._all |= 1 << motor


class GangedHoming(HomingProbing):
    """Homing that squares a gantry. pairs: of each squared axis, its number, which is also its
    first motor's, and its second motor.

    The steps of a pair's motors differ by how far the axis is racked. Only homing makes them
    differ, also homing that fails; they stay so until homing succeeds or the board restarts.
    _racked: of each pair, the steps by which the first motor has gone further than the second
    until the start of the present phase; _difference() is what the phase adds.
    """

    pairs: "Pairs" = ()

    def connect_pairs(self, pairs: "Pairs") -> None:
        """Set the pairs whose motors have a switch each."""
        self.pairs = pairs
        self._racked = [0 for _ in pairs]

    def home(self, axes: int) -> bool:
        """Home the axes (a mask; 0: all), as HomingProbing.home(). Refuse, by an alarm, if a
        switch of a squared axis is closed already.

        The distance that its motor has gone beyond the switch is unknown then.
        """
        closed = self._inputs.limits()
        for axis, motor in self.pairs:
            is_requested = axes == 0 or axes >> axis & 1
            if is_requested and (closed >> axis | closed >> motor) & 1:
                self._voice.message("%s: move off the closed limit switch first" % LETTERS[axis])
                self._motor_control.reset()
                self._state.alarm = errors.ALARM_HARD_LIMIT
                return False
        return super().home(axes)

    def find_switches(self, axes: int) -> None:
        """Home these axes (a mask), as HomingProbing.find_switches(), with their second motors."""
        for axis, motor in self.pairs:
            if axes >> axis & 1:
                axes |= 1 << motor
        super().find_switches(axes)

    def home_phase(self, axes: int, approach: bool, travel: float, rate: float) -> None:
        """Run a phase of homing, as HomingProbing.home_phase(). axes: a mask, with second motors.
        approach: False for a pull-off. travel: mm; rate: mm/min.

        Before a pull-off both switches must still be closed. A motor that stopped without its
        switch closed would leave the axis racked.
        """
        closed = self._inputs.limits()
        for i, (axis, motor) in enumerate(self.pairs):
            if axes >> axis & 1:
                self._racked[i] += self._difference(axis, motor)
                # closed has a bit per motor; the axis' number is also that of its first motor.
                both_closed = closed >> axis & closed >> motor & 1
                if not approach and not both_closed:
                    self._state.alarm = errors.ALARM_HOMING_FAIL_APPROACH
                    self._motor_control.reset()
                    self._canon.service()  # raises Abort
        super().home_phase(axes, approach, travel, rate)

    def _difference(self, axis: int, motor: int) -> int:
        """Return by how many steps the first motor of an axis has gone further than the second."""
        self._engine.position(self._steps)
        return self._steps[axis] - self._steps[motor]

    def _failed(self, approach: bool, axes: int) -> bool:
        """Return whether a phase has failed, as HomingProbing._failed(), and set the alarm.

        An approach also fails if one motor has searched too far alone.
        """
        failed = super()._failed(approach, axes)
        if failed or not approach:  # a pull-off has no search
            return failed
        for i, (axis, motor) in enumerate(self.pairs):
            if axes >> axis & 1:
                racked = abs(self._racked[i] + self._difference(axis, motor))
                if racked > self._most_racking_mm(axis) * self._planner.steps_per_mm[axis]:
                    self._state.alarm = errors.ALARM_HOMING_FAIL_DUAL_APPROACH
        return self._state.alarm != 0

    def _most_racking_mm(self, axis: int) -> float:
        """Return how far, in mm, one motor may search for its switch alone."""
        settings: "Any" = self._settings
        width = settings.max_travel[Y if axis == X else X]  # across the gantry, mm
        most: float = max(width * settings.racking_percent / 100, settings.racking_least_mm)
        most = min(most, settings.racking_most_mm)
        return most + abs(self._offset_mm(axis))  # between both switches, if the axis is square

    def _offset_mm(self, axis: int) -> float:
        """Return the squaring offset of an axis: $170 to $175, in mm."""
        offset: float = getattr(self._settings, _OFFSETS[axis][1])
        return offset

    def _set_origin(self, axes: int) -> None:
        """Square these axes (a mask), then set their positions as HomingProbing._set_origin().

        Both motors get the steps of a pull-off by the offset, but one is locked until its end:
        the first for a positive offset, else the second.
        """
        for i, (axis, motor) in enumerate(self.pairs):
            if axes >> axis & 1:
                offset = self._offset_mm(axis)
                both_motors = 1 << axis | 1 << motor
                if offset:
                    self._engine.lock(1 << (axis if offset > 0 else motor))
                    rate = self._settings.homing_feed
                    # Not self.home_phase(), which requires closed switches.
                    super().home_phase(both_motors, approach=False, travel=abs(offset), rate=rate)
                self._racked[i] = 0
        super()._set_origin(axes)


def count_axes(letters: str, motors: int) -> int:
    """Return the number of axes of so many motors with these letters. ValueError if wrong."""
    axes = len(set(letters))  # a second motor repeats its axis' letter
    if len(letters) != motors:
        raise ValueError("MOTORS has %d letters, and STEP %d pins" % (len(letters), motors))
    if axes < _FEWEST_AXES or letters[:axes] != LETTERS[:axes]:
        axes = max(axes, _FEWEST_AXES)
        raise ValueError("MOTORS: %s first, then second motors: XYZY" % LETTERS[:axes])
    for letter in letters:
        if letters.count(letter) > _MOTORS_OF_AN_AXIS:
            raise ValueError("MOTORS: %s has more than two" % letter)
    return axes


def prepare(options: "Options", board: "ModuleType") -> None:
    """Assign motors to axes. ValueError if the board file is wrong.

    moves: per motor the mask of its axes; those of COREXY or MOVES have more than one. alone: the
    mask of motors that stop at a switch of their own, while the axis' other motor goes on.
    """
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
        if moves[axis] != 1 << axis:  # it moves other axes, too
            raise ValueError("MOTORS: %s shares its motor, and has no second" % letters[motor])
        moves.append(1 << axis)
        if len(limits) > motor and limits[motor] is not None:
            if limits[axis] is None:
                raise ValueError("LIMIT: %s has its second switch only" % letters[motor])
            alone |= 1 << axis | 1 << motor
    for number, _, _, _, _ in _OFFSETS:
        if not abs(options.defaults.get(number, 0.0)) <= _MOST_OFFSET_MM:
            raise ValueError("DEFAULTS: $%d may be at most %d mm" % (number, _MOST_OFFSET_MM))
    options.kinematics = Kinematics(axes, moves, alone)
    options.settings, options.inputs, options.homing_probing = (
        GangedSettings,
        GangedInputs,
        GangedHoming,
    )


def install(cnc: "Cnc") -> None:
    """Let second motors follow the settings, and square the axes with two switches."""
    machine: "Any" = cnc.machine
    settings, planner = machine.settings, machine.planner
    kinematics, axes = planner.kinematics, planner.axes
    pairs: "Pairs" = ()
    for motor in range(axes, planner.motors):  # the second motors
        first_motor = kinematics.moves.index(kinematics.moves[motor])
        pairs += ((first_motor, motor),)
    squared = tuple([(axis, motor) for axis, motor in pairs if kinematics.alone >> motor & 1])
    settings.pairs = pairs
    machine.inputs.add_second_switches(squared)
    machine.homing_probing.connect_pairs(squared)
    cnc.add_settings(_INVERT)
    if squared:
        rows = tuple([_OFFSETS[axis] for axis, _ in squared])
        settings.signed.update({row[0]: _MOST_OFFSET_MM for row in rows})
        cnc.add_settings(_SQUARING + rows)
