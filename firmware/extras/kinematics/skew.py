"""Skew: SKEW = True in the board file, and $780, $781, $782 in mm per m.

It is for axes that are not at right angles to each other. Positions are those of a square machine,
in programs, reports, offsets, soft limits and probe results. Motors move to the corresponding
place; a motor also compensates the axes that lean towards its own. A straight line stays straight
and is one block; an arc's chords are such lines. The inverse is exact to the step, so the position
is known wherever motion has stopped. Homing moves motors, each alone to its own switch. At home,
positions of axes and motors are the same.
"""

import math
from array import array

import micropython
from base.axes import Y, Z
from base.float32 import f32
from base.settings import FLOAT
from micropython import const
from motion import layout
from motion.arcs import PLACE_BIAS
from motion.kinematics import Kinematics
from motion.planner import Planner
from motion.steps import to_steps

from extras.kinematics import skew_kernel as kernel

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType
    from typing import Any

    from base.settings import Rows
    from interfaces import AxisLimits, Options
    from motion.planner import Move

    from extras.api import Cnc

_SETTINGS: "Rows" = (
    # XY skew. Travel of the tool along X while the motor of Y moves it 1 m in +Y; negative: in -X.
    (780, "skew_xy", FLOAT, 0.0, "mm/m"),
    # XZ skew. Travel of the tool along X while the motor of Z moves it 1 m in +Z.
    (781, "skew_xz", FLOAT, 0.0, "mm/m"),
    # YZ skew. Travel of the tool along Y while the motor of Z moves it 1 m in +Z.
    (782, "skew_yz", FLOAT, 0.0, "mm/m"),
)
_NUMBERS = (780, 781, 782)
_MOST_MM_PER_M = const(100)  # the largest skew
_PER_M = 1000.0
_FACTOR_BITS = const(28)
EXCLUDED = ("SKEW", "KINEMATICS", "ROTARY", "BACKLASH", "JERK", "CLUSTERS")


class SkewKinematics(Kinematics):
    """Kinematics in which motors differ from their axes by the skew.

    skew: the table of skew_kernel.py. homing: while it is True, an axis' position is that of its
    motor. active: some factor is not 0.
    """

    def __init__(self, axes: int, moves: "list[int]", alone: int) -> None:
        super().__init__(axes, moves, alone)
        self.skew = array("i", (PLACE_BIAS for _ in range(kernel.LENGTH)))
        self.homing = False
        self.set_factors([0.0, 0.0, 0.0])

    def motor_of(self, motors: "array[int]", axis: int) -> int:
        """Return the steps of an axis' motor, or of all motors that move it."""
        return super().axis_steps(motors, axis)

    def axis_steps(self, motors: "array[int]", axis: int) -> int:
        """Return the position of an axis in steps, as Kinematics.axis_steps(): its motor's, plus
        what the motors of Y and Z add to it. Z and further axes have their motor's position."""
        steps = self.motor_of(motors, axis)
        if axis >= Z or self.homing or not self.active:
            return steps
        z = self.motor_of(motors, Z) - self._home_steps(Z)
        if axis == Y:
            return steps + kernel.back_y(z, self.skew)
        y = self.motor_of(motors, Y) - self._home_steps(Y)
        return steps + kernel.back_x(y, z, self.skew)

    def _home_steps(self, axis: int) -> int:
        """Return the steps at which an axis' motor was homed; the skew is counted from there."""
        return self.skew[kernel.HOMED + axis] - PLACE_BIAS

    def note_homed(self, motors: "array[int]", axis: int) -> None:
        """Note that this axis' motor has been homed here: its skew is counted from here."""
        self.skew[kernel.HOMED + axis] = PLACE_BIAS + self.motor_of(motors, axis)

    def set_factors(self, factors: "list[float]") -> bool:
        """Set the factors XY, XZ, YZ, in steps of the axis that is moved per step of the motor
        that moves it. Return whether they have changed.

        Each factor gets as many fraction bits as leave it 28 significant ones, within the limits
        of the kernel. It is stored as factor + PLACE_BIAS, then its number of fraction bits.
        """
        skew, before = self.skew, bytes(self.skew)
        self.active = False
        for i in range(len(factors)):  # XY, XZ, YZ: two integers each in skew
            _, exponent = math.frexp(factors[i])  # the factor is less than 2**exponent
            bits = min(max(_FACTOR_BITS - exponent, kernel.FEWEST_BITS), kernel.MOST_BITS)
            # // rounds down also for negative numbers; int() alone would truncate.
            factor = int((factors[i] * 2.0**bits + 0.5) // 1)
            skew[2 * i], skew[2 * i + 1] = PLACE_BIAS + factor, bits
            self.active |= factor != 0
        return bytes(skew) != before


class SkewPlanner(Planner):
    """A planner whose TARGET and POSITION are those of motors."""

    kinematics: "SkewKinematics"
    is_new = False  # the skew has changed, so positions must be read again

    def configure(
        self, settings: "AxisLimits", tick_hz: int, segment_log2: int, step_hz: int
    ) -> None:
        """Apply settings, as Planner.configure(), and $780 to $782."""
        super().configure(settings, tick_hz, segment_log2, step_hz)
        values: "Any" = settings
        x, y, z = self.steps_per_mm[:3]
        # Each setting in mm per m, steps per mm of the axis that is moved, and of the one that
        # moves it.
        shears = (values.skew_xy, x, y), (values.skew_xz, x, z), (values.skew_yz, y, z)
        # From mm per m to steps per step. f32 rounds as a board's single precision does.
        factors = [f32(f32(f32(mm * moved) / moving) / _PER_M) for mm, moved, moving in shears]
        self.is_new |= self.kinematics.set_factors(factors)

    def reach_mm(self, axis: int) -> float:
        """Return half of Planner.reach_mm(): motors make up to a fifth more steps than axes."""
        return super().reach_mm(axis) / 2

    @micropython.native
    def plan_skewed(
        self, target: "array[float]", flags: int, line: int, power: int, rate: int
    ) -> int:
        """Plan a line, as Planner.plan(), to the positions of motors that correspond to target.
        They are put into TARGET of the table; with PLACED plan() reads that instead of target."""
        kinematics = self.kinematics
        if kinematics.active and not kinematics.homing:
            to_steps(target, self.table)
            kernel.to_motors(self.table, kinematics.skew)
            flags |= layout.PLACED
        return self.plan(target, flags, line, power, rate)

    def chords(self, course: "array[int]", move: "Move", power: int, moves: bool) -> int:
        """Plan an arc's chords, as Planner.chords(), to positions of motors."""
        if not moves or not self.kinematics.active:  # moves is False in check mode
            return super().chords(course, move, power, moves)
        arc_index = self.flow[layout.ROWS] + 1  # where the kernel reads the speed of all chords
        self.speeds[arc_index] = move.spindle_rpm
        return kernel.follow_arc(
            course,
            self.table,
            self.ring,
            self.flow,
            self.speeds,
            move.flags | layout.PLACED,
            move.line_number,
            power,
            self.rate(move.feed),
            self.kinematics.skew,
        )

    def sync_motors(self, motors: "array[int]") -> None:
        """Set the position from which the next block is planned, as Planner.sync_motors(): here it
        is the motors' own."""
        for i in range(self.axes):
            self.position[i] = PLACE_BIAS + self.kinematics.motor_of(motors, i)


def prepare(options: "Options", board: "ModuleType") -> None:
    """Select kinematics and planner. ValueError if a default is out of range."""
    for number in _NUMBERS:
        if not abs(options.defaults.get(number, 0.0)) <= _MOST_MM_PER_M:
            raise ValueError("DEFAULTS: $%d may be at most %d mm/m" % (number, _MOST_MM_PER_M))
    # moves=(): each motor moves one axis.
    selected: "Any" = options.kinematics or Kinematics(options.axes, moves=())
    options.kinematics = SkewKinematics(options.axes, selected.moves, selected.alone)
    options.planner = SkewPlanner


def install(cnc: "Cnc") -> None:
    """Add the settings, and hook into lines and homing."""
    machine: "Any" = cnc.machine
    cnc.add_settings(_SETTINGS)
    machine.settings.signed.update(dict.fromkeys(_NUMBERS, _MOST_MM_PER_M))
    _hook_homing(machine)
    planner = machine.planner
    planner.move_hook = planner.plan_skewed

    def resync() -> None:
        """If a setting has changed the skew, compute positions again from those of the motors."""
        if planner.is_new:
            planner.is_new = False
            machine.resync()

    machine.settings.on_change(resync)


def _hook_homing(machine: "Any") -> None:
    """Hook into homing, which moves each motor alone, instead of axes with their skew."""
    hooks, engine, kinematics = machine.state.hooks, machine.engine, machine.planner.kinematics
    previous: "Callable[[int], None]" = hooks.find_switches
    motors = array("i", (0 for _ in range(machine.planner.motors)))

    def find(axes: int) -> None:
        """Search the switches of the axes, a mask, and store the motors' positions after it, where
        the skew is 0."""
        kinematics.homing = True
        try:
            previous(axes)
        finally:
            kinematics.homing = False
        engine.position(motors)
        for i in range(Z + 1):
            if axes >> i & 1:
                kinematics.note_homed(motors, i)

    hooks.find_switches = find
