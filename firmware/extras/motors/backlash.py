"""Backlash: BACKLASH = True in the board file, and $160, $161, $162 in mm for X, Y, Z.

When an axis reverses, its motor first takes up the slack. It moves alone, from standstill to
standstill, at the axis' own rate and acceleration. Positions are those of the axis, as the program
means them: the extra move is in no report, and the motor's position differs by the slack that it
has taken up. The slack that remains in the positive direction is known to the step, also after a
reset. Homing takes it up in the direction of the pull-off. Numbers are grblHAL's.
"""

from array import array

from base import errors
from base import state as st
from base.errors import GrblError
from base.float32 import copy, vector
from base.settings import AXIS
from control.canon import Canon
from language.block_layout import MOVE
from micropython import const
from motion import arcs, layout
from motion import planner as plan
from motion.kinematics import Kinematics
from motion.plan_kernel import plan_block
from motion.planner import Planner
from motion.steps import to_steps

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType
    from typing import Any

    from base.settings import Rows
    from interfaces import Options
    from motion.planner import Move

    from extras.api import Cnc

_SETTINGS: "Rows" = (
    # Backlash, one value per axis. When the axis reverses, its motor turns by this much before the
    # axis moves; 0: off.
    (160, "backlash_mm", AXIS, 0.0, "millimeters"),
)
_FIRST_SETTING = const(160)
_MOST_MM = const(5)
_UNKNOWN = const(-1)  # the axis' position within its slack is unknown
EXCLUDED = (
    "BACKLASH",
    "COREXY",
    "MOVES",
    "KINEMATICS",
    "ROTARY",
    "JERK",
    "CLUSTERS",
    "PARKING",
    "POWER_FAIL_UP_MM",
)


class BacklashKinematics(Kinematics):
    """Kinematics in which motors differ from their axis' position by its slack, in steps.

    slack: per axis, the steps that its motor has made to take up slack. standing: mask of axes
    that stand still while their motors take up slack; standing_at: the steps where they stand.
    """

    def __init__(self, axes: int, moves: "list[int]", alone: int) -> None:
        super().__init__(axes, moves, alone)
        self.slack = array("i", bytes(4 * axes))
        self.standing = 0
        self.standing_at = array("i", bytes(4 * axes))

    def motor_of(self, motors: "array[int]", axis: int) -> int:
        """Return the steps of an axis' motor, slack included."""
        return super().axis_steps(motors, axis)

    def axis_steps(self, motors: "array[int]", axis: int) -> int:
        """Return the position of the axis, as Kinematics.axis_steps()."""
        if self.standing >> axis & 1:
            return self.standing_at[axis]
        return self.motor_of(motors, axis) - self.slack[axis]

    def set_axis(self, motors: "array[int]", axis: int, steps: int) -> None:
        """Set the position of axis and motor, as Kinematics.set_axis(). The slack becomes 0."""
        self.slack[axis] = 0
        super().set_axis(motors, axis, steps)


class BacklashPlanner(Planner):
    """A planner that can move motors while their axes stand, to take up slack. synced: the plan
    has been cleared."""

    kinematics: "BacklashKinematics"
    synced = False

    def sync_motors(self, motors: "array[int]") -> None:
        """Synchronise with the motors, as Planner.sync_motors()."""
        super().sync_motors(motors)
        self.synced = True

    def take_up(self, steps: "array[int]", move: "Move", power: int) -> bool:
        """Plan a system move, as a rapid, of the motor of each axis i by steps[i], with a sign.
        Return whether any of them moves.

        move: the program's, whose line number, spindle and coolant are used. power: of the
        spindle.
        """
        table, axes = self.table, self.axes
        # The table's TARGET of each axis, then its POSITION, in steps. Both are restored at the
        # end, because for the program the axes have not moved.
        targets = memoryview(table)[layout.LIMITS + layout.TARGET * axes :]
        saved = array("i", targets[: 2 * axes])
        for i in range(axes):
            position = targets[axes + i]
            targets[i] = position + steps[i]
        # PLACED: the target is in the table, and plan_block() does not read its first argument.
        flags = layout.SYSTEM_MOTION | layout.RAPID_MOTION | layout.NO_FEED_OVERRIDE
        flags |= layout.PLACED | move.flags & plan.ACCESSORY_MASK
        line = move.line_number
        planned = plan_block(self.speeds, table, self.ring, self.flow, flags, line, power, 0)
        self.speeds[self.flow[layout.ROWS]] = move.spindle_rpm  # that of the system's own block
        copy(saved, targets, 2 * axes)
        return bool(planned)


class BacklashCanon(Canon):
    """Canon of a machine with backlash.

    whole_slack: for each axis, its slack in motor steps. ahead: the part of it that its motor
    turns before the axis moves in the positive direction, or _UNKNOWN; before the negative
    direction it is the rest. _steps_to_turn: steps that each motor has to turn next, with a sign.
    """

    planner: "BacklashPlanner"
    engine: "Any"
    active = False  # some axis has slack to take up

    def __init__(self, *parts: "Any") -> None:
        super().__init__(*parts)
        axes = self.planner.axes
        self.whole_slack = array("i", bytes(4 * axes))
        self.ahead = array("i", (_UNKNOWN for _ in range(axes)))
        self._steps_to_turn = array("i", bytes(4 * axes))
        self._signs = array("i", bytes(4 * axes))  # directions of the next line: 1, -1 or 0
        # Motor steps before and after slack is taken up.
        self._before = array("i", bytes(4 * self.planner.motors))
        self._after = array("i", bytes(4 * self.planner.motors))

    def configure(self) -> None:
        """Apply the settings, as Canon.configure(), and $160 and the others."""
        super().configure()
        settings: "Any" = self._settings
        self.active = False
        for i in range(self.planner.axes):
            steps = int(settings.backlash_mm[i] * self.planner.steps_per_mm[i] + 0.5)
            if steps:
                self.active = True
            if not self.whole_slack[i]:
                self.ahead[i] = _UNKNOWN  # without slack it was not counted
            elif self.ahead[i] >= self.whole_slack[i]:
                self.ahead[i] = steps  # the motor is still at the negative end of the slack
            elif self.ahead[i] > steps:
                self.ahead[i] = _UNKNOWN  # more is ahead than the new value allows
            self.whole_slack[i] = steps

    def pulled_off(self, axis: int, upwards: bool) -> None:
        """Note that homing has pulled the axis off in that direction, which took up its slack."""
        self.ahead[axis] = 0 if upwards else self.whole_slack[axis]

    def _plan_line(self, target: "array[float]", move: "Move") -> None:
        """Take up slack if an axis reverses, then plan as Canon._plan_line()."""
        state = self._state
        if self.active and state.run != st.CHECK:
            # A program's target outside the travel is left to Canon._plan_line(), which raises
            # the alarm; a jog's has been checked.
            is_jog = state.run == st.JOG or self._is_jog
            if is_jog or not self.outside(target):
                to_steps(target, self.planner.table)  # into TARGET
                if not self._take_up(move):
                    return  # the jog has been cancelled
        super()._plan_line(target, move)

    def _plan_chords(self) -> None:
        """Plan all chords of the arc as Canon._plan_chords(), but one by one, because axes reverse
        within an arc: slack is taken up before a chord."""
        state, move, course, planner = self._state, self._move, self.course, self.planner
        if not self.active or state.run == st.CHECK:
            super()._plan_chords()
            return
        table, ring, flow, rate = planner.table, planner.ring, planner.flow, planner.rate
        self.service()  # reads the link, and raises Abort after a reset
        while course[arcs.CHORDS_LEFT]:
            if arcs.next_chord(course, table):
                self.stop_with_alarm(errors.ALARM_SOFT_LIMIT)  # raises Abort
            # next_chord() has put the chord's end into TARGET; it is restored after the waits.
            targets = memoryview(table)[layout.LIMITS + layout.TARGET * planner.axes :]
            chord_end = array("i", targets[: planner.axes])
            self._take_up(move)
            self.wait_for_room()
            copy(chord_end, targets, planner.axes)
            power, head = self.power_of(move), flow[layout.HEAD]
            # PLACED: the target is in the table; plan_block() does not read its first argument.
            flags, feed = move.flags | layout.PLACED, rate(move.feed)
            if plan_block(course, table, ring, flow, flags, move.line_number, power, feed):
                planner.speeds[head] = move.spindle_rpm
            else:
                self.apply_zero_length(move)
            course[arcs.CHORDS_LEFT] -= 1
            if course[arcs.CHORDS_LEFT] & arcs.EIGHT_MASK == 0:  # each eighth one
                self.service()

    def _take_up(self, move: "Move") -> bool:
        """Take up the slack that is in the way of the line to TARGET in the planner's table.

        First wait until all motion has ended, because axes must stand still. Return False if a jog
        has been cancelled meanwhile, else True. move: the line's.
        """
        planner = self.planner
        if not self._note_directions():
            return True
        planner.synced = False  # True again once a jog is cancelled, or after a reset
        # A jog cannot follow a program's motion before its state has ended, too.
        under_way = st.HOLD | st.RUN if self._is_jog else st.HOLD
        while not planner.empty() or self._motor_control.moving or self._state.run & under_way:
            self.auto_start()
            self.service()
        # More than once if a hold has ended the move early.
        while self._compute_steps() and not (self._is_jog and planner.synced):
            self._move_motors(move)
        return not (self._is_jog and planner.synced)

    def _note_directions(self) -> bool:
        """Note the direction of each axis on the way from POSITION to TARGET in the planner's
        table. Return whether one of them has slack to take up.

        An axis whose slack is unknown is assumed to have it taken up in this direction.
        """
        table, axes = self.planner.table, self.planner.axes
        target_at = layout.LIMITS + layout.TARGET * axes  # indexes in the table
        position_at = target_at + axes
        for i in range(axes):
            way = table[target_at + i] - table[position_at + i]
            self._signs[i] = sign = (way > 0) - (way < 0)
            if sign and self.ahead[i] == _UNKNOWN:
                self.ahead[i] = 0 if sign > 0 else self.whole_slack[i]
        return self._compute_steps()

    def _compute_steps(self) -> bool:
        """Compute how many steps each axis' motor has to turn in the direction _signs, into
        _steps_to_turn. Return whether any has to.

        In the positive direction that is `ahead`, in the negative one the rest of the slack.
        """
        has_slack = False
        for i in range(self.planner.axes):
            sign = self._signs[i]
            steps = 0
            if sign and self.ahead[i] != _UNKNOWN:
                steps = self.ahead[i] if sign > 0 else self.ahead[i] - self.whole_slack[i]
            self._steps_to_turn[i] = steps
            has_slack = has_slack or steps != 0
        return has_slack

    def _move_motors(self, move: "Move") -> None:
        """Turn the motors by _steps_to_turn while the axes stand, and count the steps made.

        Hold and reset work meanwhile, so the steps may be fewer than requested. move: the line's,
        for its line number, spindle and coolant.
        """
        planner, motor_control = self.planner, self._motor_control
        kinematics = planner.kinematics
        axes = range(planner.axes)
        power = 0
        if self._spindle.laser:  # dark, because it stands still: also after a hold of this move
            self._state.spindle[st.RPM] = 0.0
        else:
            power = self.power_of(move)
        self.engine.position(self._before)
        for i in axes:  # reported meanwhile for the axes of the mask `standing`
            kinematics.standing_at[i] = kinematics.axis_steps(self._before, i)
        planner.take_up(self._steps_to_turn, move, power)
        kinematics.standing = sum([1 << i for i in axes if self._steps_to_turn[i]])
        try:
            motor_control.start(st.JOG if self._is_jog else st.RUN)
            self.service()  # raises Abort if an extra has refused the start
            while motor_control.moving or self._state.run == st.HOLD:  # a hold ends a little later
                self.service()
        finally:
            self.engine.position(self._after)
            for i in axes:
                made = kinematics.motor_of(self._after, i)
                made -= kinematics.motor_of(self._before, i)
                if self._steps_to_turn[i]:
                    self.ahead[i] -= made
                    kinematics.slack[i] += made
            kinematics.standing = 0
        planner.clear()  # ends the system move, and drops what a hold has left of it


def prepare(options: "Options", board: "ModuleType") -> None:
    """Select planner, canon and kinematics. ValueError if a default is out of range."""
    for i in range(options.axes):
        if not 0 <= options.defaults.get(_FIRST_SETTING + i, 0.0) <= _MOST_MM:
            raise ValueError("DEFAULTS: $%d may be at most %d mm" % (_FIRST_SETTING + i, _MOST_MM))
    # moves=(): each motor moves one axis.
    selected: "Any" = options.kinematics or Kinematics(options.axes, moves=())
    options.kinematics = BacklashKinematics(options.axes, selected.moves, selected.alone)
    options.planner, options.canon = BacklashPlanner, BacklashCanon


def _check(mm: float) -> None:
    """Refuse a slack that is too large, by GrblError."""
    if not mm <= _MOST_MM:
        raise GrblError(errors.INVALID_STATEMENT)


def install(cnc: "Cnc") -> None:
    """Add $160 and the others, and hooks of homing and probing.

    Once an axis has slack ($160 or another above 0), lines that move are no longer executed by the
    kernels alone but by BacklashCanon, which may add a move.
    """
    machine: "Any" = cnc.machine
    canon, interpreter = machine.canon, machine.interpreter
    canon.engine = machine.engine  # it counts the steps made while slack is taken up
    cnc.add_settings(_SETTINGS)
    for i in range(machine.planner.axes):
        cnc.check_setting(_FIRST_SETTING + i, _check)

    def watch() -> None:
        """Have lines that move executed by the interpreter, if an axis has slack."""
        if canon.active:
            interpreter.watch(MOVE)

    machine.settings.on_change(watch)
    watch()
    _hook_homing(machine)
    _hook_probing(machine)


def _hook_homing(machine: "Any") -> None:
    """Hook into homing: its pull-off takes up the slack in the direction of the pull-off."""
    canon, hooks, settings = machine.canon, machine.state.hooks, machine.settings
    previous: "Callable[[int], None]" = hooks.find_switches

    def find(axes: int) -> None:
        """Search the switches of the axes, a mask. Until then the side of their slack is not
        known."""
        for i in range(machine.planner.axes):
            if axes >> i & 1:
                canon.ahead[i] = _UNKNOWN
        previous(axes)
        for i in range(machine.planner.axes):
            if axes >> i & 1:
                # With its bit of $23 the switch is at the negative end: the pull-off goes up.
                canon.pulled_off(i, bool(settings.homing_dir_invert >> i & 1))

    hooks.find_switches = find


def _hook_probing(machine: "Any") -> None:
    """Hook into probing: store the contact position, because slack taken up later changes it."""
    state, axes = machine.state, machine.planner.axes
    hooks = state.hooks
    contact = vector(axes)  # mm
    previous_probe, previous_forget = hooks.probe, hooks.forget
    previous_position: "Callable[[], array[float]]" = hooks.probed_at

    def probe(target: "array[float]", move: "Move", away: bool, alarms: bool) -> bool:
        """Probe, as HomingProbing.probe(), and store the contact position, unless nothing moved:
        in check mode, or because the probe was triggered before."""
        reached: bool = previous_probe(target, move, away, alarms)
        if state.run != st.CHECK and state.alarm != errors.ALARM_PROBE_FAIL_INITIAL:
            copy(previous_position(), contact, axes)
        return reached

    def forget() -> None:
        """Forget the contact position, also the one stored here."""
        previous_forget()
        for i in range(axes):
            contact[i] = 0.0

    hooks.probe, hooks.forget, hooks.probed_at = probe, forget, lambda: contact
