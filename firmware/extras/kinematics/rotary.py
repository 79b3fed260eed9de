"""Rotary axes: ROTARY = "A" in the board file. Where Grbl says mm, theirs are degrees.

As NIST RS274NGC has them: a feed rate is that of X, Y and Z, in whose time the others come to
their places; where only rotary axes move it is degrees per minute. No number of theirs is ever in
inches. Travel 0 ($133 for A) means that the axis turns for ever: far from 0 its whole turns are
taken off its place. One without a limit switch stays where it is when the machine is homed.
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

_FIRST = const(3)  # X, Y and Z are no rotary axes
_TURN = 360.0
# Up to here single precision knows each step; beyond, an endless axis is unwound.
_EXACT = 16777216.0
_PER_INCH = minifloat.real(1 / 25.4)
# A line of these has no feed rate of its program's, or one that is of all its axes.
_ITS_OWN_RATE = const(layout.RAPID_MOTION | layout.SYSTEM_MOTION | layout.INVERSE_TIME)


class RotaryPlanner(Planner):
    """A planner whose feed rates are those of the linear axes. What it plans knows of no
    difference: rates and accelerations are along the way of all axes."""

    linear = 0  # mask of axes
    on_arc = minifloat.ONE  # how many times as long as its arc a helix is
    block: "Block"

    _times = minifloat.ONE

    @micropython.native
    def turn(self, target: "array[float]", flags: int, line: int, power: int, rate: int) -> int:
        """As Planner.plan()."""
        if not flags & _ITS_OWN_RATE:
            times = stretch(target, self.table, self.ring, self.flow, self.linear)
            if times == 0:
                times = _PER_INCH if self.block.ints[INCHES] else minifloat.ONE
            rate = minifloat.mul(rate, times)
        return self.plan(target, flags, line, power, rate)

    def chords(self, course: "array[int]", move: "Move", power: int, moves: bool) -> int:
        """As Planner.chords()."""
        if not move.flags & _ITS_OWN_RATE:
            self._times = self.on_arc
        found = super().chords(course, move, power, moves)
        self._times = minifloat.ONE
        return found

    def rate(self, feed: float) -> int:
        """As Planner.rate(), along the way of all axes."""
        return minifloat.mul(super().rate(feed), self._times)


class RotaryCanon(Canon):
    """Functions of a machine with rotary axes."""

    axes: "tuple[int, ...]" = ()
    planner: "RotaryPlanner"
    engine: "Any"
    modes: "Any"
    coords: "Any"

    def configure(self) -> None:
        """As Canon.configure(); axes without an end to their travel."""
        super().configure()
        for axis in self.endless():
            self.travel[SHUT] &= ~(1 << axis | 1 << axis + BELOW)
            self.limit(axis, _EXACT / self.planner.steps_per_mm[axis])
            arcs.limit(self.course, axis, -arcs.FARTHEST, arcs.FARTHEST)

    def endless(self) -> "list[int]":
        """Axes that turn for ever."""
        return [axis for axis in self.axes if not self._settings.max_travel[axis]]

    def outside(self, target: "array[float]") -> bool:
        """As Canon.outside(), which a jog asks; an endless axis is unwound."""
        self._unwind(target)
        return super().outside(target)

    def _plan_line(self, target: "array[float]", move: "Move") -> None:
        """As Canon._plan_line(); an endless axis is unwound."""
        self._unwind(target)
        super()._plan_line(target, move)

    def _unwind(self, target: "array[float]") -> None:
        """Take whole turns off the place of an endless axis that is to go further from 0 than
        single precision knows each step. Target, parser and G92 change with it, so the numbers of
        the program go on. A line that is longer than that itself goes as far as any axis may."""
        planner, state = self.planner, self._state
        for axis in self.endless():
            exact = _EXACT / planner.steps_per_mm[axis]
            if not abs(target[axis]) > exact:
                continue
            turned = self._turned(axis, target)
            if turned and state.run != st.CHECK:
                while not planner.empty() or self._motor_control.moving:
                    self.auto_start()
                    self.service()
                turned = self._turned(axis, target)
                self._take_off(axis, turned)
            if turned:
                target[axis] -= turned
                self.modes.position[axis] -= turned
                g92 = array("f", self.coords.g92)
                g92[axis] -= turned
                self.coords.set_g92(g92)
                state.wco_countdown = 0
                state.invalidate_lines()
            far = min(abs(target[axis]), planner.reach_mm(axis))
            self.limit(axis, max(far, exact))

    def _turned(self, axis: int, target: "array[float]") -> float:
        """The whole turns of an axis, in degrees: those planned; in check mode all of them."""
        if self._state.run == st.CHECK:
            return int(target[axis] / _TURN) * _TURN
        steps = self.planner.position[axis] - arcs.FAR
        return int(steps / self.planner.steps_per_mm[axis] / _TURN) * _TURN

    def _take_off(self, axis: int, degrees: float) -> None:
        """The present place of an axis, at rest, is less by so much, to the step."""
        planner, engine = self.planner, self.engine
        motors = array("i", bytes(4 * planner.motors))
        engine.position(motors)
        steps = degrees * planner.steps_per_mm[axis]
        place = planner.axis_steps(motors, axis) - int((steps + 0.5) // 1)
        if planner.kinematics:
            planner.kinematics.set_axis(motors, axis, place)
        else:
            motors[axis] = place
        engine.set_position(motors)
        planner.sync_motors(motors)

    def arc(self, start: "array[float]", target: "array[float]", arc: "Arc", move: "Move") -> None:
        """As Canon.arc(); but the time of G93 is kept to."""
        self._unwind(target)
        timed = move.flags & layout.INVERSE_TIME
        super().arc(start, target, arc, move)
        move.flags |= timed
        way = turns = 0.0
        plane = arc.plane[ONE_AXIS], arc.plane[OTHER_AXIS]
        for i in range(len(start)):
            if i in self.axes:
                turns += (target[i] - start[i]) ** 2
            elif i not in plane:
                way += (target[i] - start[i]) ** 2
        way += (arc.numbers[RADIUS] * arc.sweep(start, target)) ** 2
        self.planner.on_arc = minifloat.real(math.sqrt(1 + turns / way)) if way else minifloat.ONE


def mask_of(letters: str, axes: int) -> int:
    """The axes (a mask) that these letters are. ValueError where one cannot be."""
    mask = 0
    for letter in letters:
        axis = LETTERS[:axes].find(letter)
        if axis < _FIRST or mask >> axis & 1:
            raise ValueError("ROTARY: %s is none of A, B, C here, or there twice" % letter)
        mask |= 1 << axis
    return mask


_found: "dict[str, int]" = {}


def prepare(options: "Options", board: "ModuleType") -> None:
    """What a machine with rotary axes is made of. ValueError where they cannot be."""
    option = board.__dict__.get
    _found["rotary"] = rotary = mask_of(option("ROTARY", ""), options.axes)
    limits: "tuple[int | None, ...]" = option("LIMIT", ())
    for axis in range(min(len(limits), options.axes)):
        if limits[axis] is not None:
            rotary &= ~(1 << axis)
    _found["without_switch"] = rotary
    options.planner, options.canon = RotaryPlanner, RotaryCanon


def install(cnc: "Cnc") -> None:
    """Have the rotary axes homed, read and shown as such."""
    machine: "Any" = cnc.machine
    planner, canon, block = machine.planner, machine.canon, machine.interpreter.block
    everything = (1 << planner.axes) - 1
    rotary = _found["rotary"]
    planner.linear = everything & ~rotary
    planner.block = block
    canon.engine, canon.modes, canon.coords = machine.engine, machine.modes, machine.coords
    canon.axes = tuple([axis for axis in range(planner.axes) if rotary >> axis & 1])
    machine.interpreter.machine[LENGTHS] &= ~rotary
    planner.move_hook = planner.turn
    _home(machine, everything & ~_found["without_switch"])
    machine.report.turning = rotary  # degrees stay degrees where reports are in inches


def _home(machine: "Any", homed: int) -> None:
    """$H leaves axes without a switch alone. The switch of one without an end is searched for as
    long as it takes to turn one and a half times: it has travel meanwhile."""
    hooks, settings, canon = machine.state.hooks, machine.settings, machine.canon
    usual: "Callable[[int], bool]" = hooks.home

    def home(axes: int) -> bool:
        if axes == 0:
            return home(1 << Z) and home(homed & ~(1 << Z))
        endless = [axis for axis in canon.endless() if axes >> axis & 1]
        for axis in endless:
            settings.max_travel[axis] = _TURN
        try:
            return usual(axes)
        finally:
            for axis in endless:
                settings.max_travel[axis] = 0.0

    hooks.home = home
