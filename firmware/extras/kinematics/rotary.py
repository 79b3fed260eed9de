"""Rotary axes: ROTARY = "A" in the board file. Their unit is degrees where Grbl's is mm.

As in NIST RS274NGC, the feed rate is that of X, Y and Z, and the rotary axes move in the same
time. If only rotary axes move, it is in degrees per minute. Rotary numbers are never in inches.
Travel 0 ($133 for A) makes an axis endless: far from 0, whole turns are subtracted from its
position. A rotary axis without a limit switch keeps its position in homing.
"""

import math
from array import array

import micropython
from base import state as st
from base.axes import LETTERS, Z
from control.canon import BELOW, SHUT, Canon
from control.modes import INCHES
from language.block_layout import LENGTHS
from micropython import const
from motion import arcs, layout, minifloat
from motion.arc_geometry import ONE_AXIS, OTHER_AXIS, RADIUS
from motion.planner import Planner

from extras.kinematics.rotary_kernel import stretch

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType
    from typing import Any

    from interfaces import Options
    from language.block import Block
    from motion.arc_geometry import Arc
    from motion.planner import Move

    from extras.api import Cnc

_FIRST_ROTARY = const(3)  # X, Y and Z are never rotary
_TURN = 360.0  # degrees
_FAR = 1e9  # degrees: beyond every machine, and a whole number for int()
_FINITE = 3e38  # near the largest number in single precision; infinity cannot be frozen
_EXACT_STEPS = 16777216.0  # single precision is exact up to it; beyond, an axis is unwound
_PER_INCH = minifloat.real(1 / 25.4)
# Lines without a programmed feed rate, or with one that applies to all axes.
ITS_OWN_RATE = const(layout.RAPID_MOTION | layout.SYSTEM_MOTION | layout.INVERSE_TIME)


class RotaryPlanner(Planner):
    """A planner whose feed rates are those of the linear axes.

    Blocks are those of any Planner: their rates and accelerations are along the path of all axes.

    linear: mask of linear axes. arc_factor: of the arc requested, its length with rotary axes per
    length without them, a real. _rate_factor: factor of rate(): arc_factor while an arc is
    planned, else minifloat.ONE. block: the interpreter's. synced: the plan has been cleared.
    """

    linear = 0
    synced = False
    arc_factor = minifloat.ONE
    block: "Block"

    _rate_factor = minifloat.ONE

    @micropython.native
    def plan_line(
        self, target: "array[float]", flags: int, line: int, power: int, rate: int
    ) -> int:
        """Plan a line, as Planner.plan(). rate: along the linear axes, a real, mm/s.

        Planner.plan() needs the rate along the path of all axes. That path is longer than its
        linear part by the factor of stretch(), and so the rate is higher by it. The rate of a line
        of rotary axes only is in degrees; with G20 it was multiplied by 25.4, which is undone.
        """
        if not flags & ITS_OWN_RATE:
            factor = stretch(target, self.table, self.ring, self.flow, self.linear)
            if factor == 0:  # no linear axis moves: rate is in degrees/s
                factor = _PER_INCH if self.block.ints[INCHES] else minifloat.ONE
            rate = minifloat.mul(rate, factor)
        return self.plan(target, flags, line, power, rate)

    def sync_motors(self, motors: "array[int]") -> None:
        """Synchronise with the motors, as Planner.sync_motors()."""
        super().sync_motors(motors)
        self.synced = True

    def chords(self, course: "array[int]", move: "Move", power: int, moves: bool) -> int:
        """Plan an arc's chords, as Planner.chords(). rate() multiplies its result by arc_factor
        meanwhile."""
        if not move.flags & ITS_OWN_RATE:
            self._rate_factor = self.arc_factor
        result = super().chords(course, move, power, moves)
        self._rate_factor = minifloat.ONE
        return result

    def rate(self, feed: float) -> int:
        """Return a feed rate in mm/min as a real in mm/s, as Planner.rate(). On an arc the result
        is along the path of all axes; on a line plan_line() converts it."""
        return minifloat.mul(super().rate(feed), self._rate_factor)


class RotaryCanon(Canon):
    """Canon of a machine with rotary axes. axes: their numbers. coords: the offsets. unwound: by
    axis, the degrees that have been subtracted since power-up."""

    axes: "tuple[int, ...]" = ()
    planner: "RotaryPlanner"
    engine: "Any"
    modes: "Any"
    coords: "Any"
    unwound: "dict[int, float]"

    def configure(self) -> None:
        """Apply settings, as Canon.configure(). Endless axes have no limit of travel."""
        super().configure()
        for axis in self.endless():
            # Bits of SHUT: axis i may not go above 0 (bit i), or not below (bit i + BELOW).
            self.travel[SHUT] &= ~(1 << axis | 1 << axis + BELOW)
            self.limit(axis, _EXACT_STEPS / self.planner.steps_per_mm[axis])  # of lines, degrees
            arcs.limit(self.course, axis, -arcs.FARTHEST, arcs.FARTHEST)  # of arcs, steps

    def endless(self) -> "list[int]":
        """Return the endless axes: rotary axes whose travel setting is 0."""
        return [axis for axis in self.axes if not self._settings.max_travel[axis]]

    def outside(self, target: "array[float]") -> bool:
        """Return Canon.outside(), which checks a jog. Endless axes may go as far as any axis:
        _plan_line() unwinds them."""
        for axis in self.endless():
            self.limit(axis, self.planner.reach_mm(axis))
        is_outside = super().outside(target)
        for axis in self.endless():
            self.limit(axis, _EXACT_STEPS / self.planner.steps_per_mm[axis])
        return is_outside

    def _plan_line(self, target: "array[float]", move: "Move") -> None:
        """Plan a line, as Canon._plan_line(). Unwind endless axes first. A jog that is cancelled
        while it waits for that is dropped."""
        planner = self.planner
        planner.synced = False  # True again once a jog is cancelled
        self._unwind(target)
        if not (self._is_jog and planner.synced):
            super()._plan_line(target, move)

    def _unwind(self, target: "array[float]") -> None:
        """Subtract whole turns from endless axes whose target is beyond _EXACT_STEPS. target: mm
        or degrees per axis, changed in place.

        Target, parser position and G92 change together, so the program's numbers stay valid. The
        motors' position can only be changed while idle, so this waits for the end of motion. A
        line that is itself longer than _EXACT_STEPS is allowed, up to the limit of any axis.
        """
        planner, state = self.planner, self._state
        for axis in self.endless():
            farthest = _EXACT_STEPS / planner.steps_per_mm[axis]  # exact position, degrees
            if not abs(target[axis]) > farthest:
                continue
            degrees = self._whole_turns(axis, target)
            if degrees and state.run != st.CHECK:  # in check mode only the numbers change
                while not planner.empty() or self._motor_control.moving:
                    self.auto_start()  # else planned lines would not be executed yet
                    self.service()
                if self._is_jog and planner.synced:
                    return
                degrees = self._whole_turns(axis, target)  # a hold may have ended the motion
                self._subtract(axis, degrees)
            if degrees:
                target[axis] -= degrees
                self.modes.position[axis] -= degrees
                g92 = array("f", self.coords.g92)
                g92[axis] -= degrees
                self.coords.set_g92(g92)
                self.unwound[axis] = self.unwound.get(axis, 0.0) + degrees
                state.wco_countdown = 0  # the next status report has the offsets
                state.invalidate_lines()
            # Allow this line's target, which may still be beyond, as far as any axis may go.
            allowed = min(abs(target[axis]), planner.reach_mm(axis))
            self.limit(axis, max(allowed, farthest))

    def _whole_turns(self, axis: int, target: "array[float]") -> float:
        """Return the whole turns to subtract from an axis, in degrees: those in the position at
        the end of all planned blocks; in check mode, which plans none, those in the target."""
        if self._state.run == st.CHECK:
            return int(target[axis] / _TURN) * _TURN if abs(target[axis]) < _FAR else 0.0
        steps = self.planner.position[axis] - arcs.PLACE_BIAS
        return int(steps / self.planner.steps_per_mm[axis] / _TURN) * _TURN

    def _subtract(self, axis: int, degrees: float) -> None:
        """Subtract degrees from an axis' position, rounded to steps. Call it while idle."""
        planner, engine = self.planner, self.engine
        motors = array("i", bytes(4 * planner.motors))
        engine.position(motors)
        steps = degrees * planner.steps_per_mm[axis]  # rounded by // 1, also if negative
        position = planner.axis_steps(motors, axis) - int((steps + 0.5) // 1)
        if planner.kinematics:
            planner.kinematics.set_axis(motors, axis, position)
        else:
            motors[axis] = position
        engine.set_position(motors)
        planner.sync_motors(motors)
        planner.synced = False

    def arc(self, start: "array[float]", target: "array[float]", arc: "Arc", move: "Move") -> None:
        """Request an arc, as Canon.arc(). The time of G93 applies to all axes.

        arc_factor becomes the length of the path of all axes per length of the linear ones.
        """
        self._unwind(target)
        inverse_time = move.flags & layout.INVERSE_TIME
        super().arc(start, target, arc, move)
        move.flags |= inverse_time  # Canon.arc() has cleared it; no factor applies to that rate
        linear_sqr = rotary_sqr = 0.0
        plane = arc.plane[ONE_AXIS], arc.plane[OTHER_AXIS]
        for i in range(len(start)):
            if i in self.axes:  # a rotary one
                rotary_sqr += (target[i] - start[i]) ** 2
            elif i not in plane:
                linear_sqr += (target[i] - start[i]) ** 2
        linear_sqr += (arc.numbers[RADIUS] * arc.sweep(start, target)) ** 2  # the circle's length
        self.planner.arc_factor = minifloat.ONE
        if 0 < linear_sqr < _FINITE:  # nor NaN, of an arc with an infinite radius
            self.planner.arc_factor = minifloat.real(math.sqrt(1 + rotary_sqr / linear_sqr))


def mask_of(letters: str, axes: int) -> int:
    """Return the mask of the axes with these letters, of a machine with so many axes. ValueError
    if one cannot be a rotary axis."""
    mask = 0
    for letter in letters:
        axis = LETTERS[:axes].find(letter)
        if axis < _FIRST_ROTARY or mask >> axis & 1:
            raise ValueError("ROTARY: %s is no rotary axis here, or named twice" % letter)
        mask |= 1 << axis
    return mask


_found: "dict[str, int]" = {}  # prepare() stores here what install() needs: masks of axes


def prepare(options: "Options", board: "ModuleType") -> None:
    """Select planner and canon, and find rotary axes, and those of them without a limit switch.
    ValueError if the board file is wrong."""
    option = board.__dict__.get
    _found["rotary"] = rotary = mask_of(option("ROTARY", ""), options.axes)
    limits: "tuple[int | None, ...]" = option("LIMIT", ())
    for axis in range(min(len(limits), options.axes)):
        if limits[axis] is not None:
            rotary &= ~(1 << axis)
    _found["without_switch"] = rotary  # those that are left
    options.planner, options.canon = RotaryPlanner, RotaryCanon


def install(cnc: "Cnc") -> None:
    """Hook rotary axes into homing, planning, units and reports."""
    machine: "Any" = cnc.machine
    planner, canon, block = machine.planner, machine.canon, machine.interpreter.block
    all_axes = (1 << planner.axes) - 1
    rotary = _found["rotary"]
    planner.linear = all_axes & ~rotary
    planner.block = block
    canon.engine, canon.modes, canon.coords = machine.engine, machine.modes, machine.coords
    canon.unwound = {}
    canon.axes = tuple([axis for axis in range(planner.axes) if rotary >> axis & 1])
    # A mask of axes whose numbers are lengths: inches with G20.
    machine.interpreter.machine[LENGTHS] &= ~rotary
    planner.move_hook = planner.plan_line
    _hook_homing(machine, all_axes & ~_found["without_switch"])
    machine.report.turning = rotary  # degrees stay degrees when reports are in inches


def _hook_homing(machine: "Any", axes_in_cycle: int) -> None:
    """Hook into $H: rotary axes without a switch are left out.

    axes_in_cycle: mask of those that $H includes. An endless axis, whose travel setting is 0, gets
    one turn of travel during homing, so its search ends after one and a half turns.
    """
    hooks, settings, canon = machine.state.hooks, machine.settings, machine.canon
    previous: "Callable[[int], bool]" = hooks.home

    def home(axes: int) -> bool:
        """Home the axes, a mask; 0: all that $H includes. Returns whether that succeeded."""
        if axes == 0:  # $H in Grbl's own order: Z, then all others together
            in_turn: bool = machine.homing_probing.home_in_turn(
                home, [1 << Z, axes_in_cycle & ~(1 << Z)]
            )
            return in_turn
        endless = [axis for axis in canon.endless() if axes >> axis & 1]
        for axis in endless:
            settings.max_travel[axis] = _TURN
        try:
            return previous(axes)
        finally:
            for axis in endless:
                settings.max_travel[axis] = 0.0

    hooks.home = home
