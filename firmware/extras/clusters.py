"""Clusters of a laser's powers, S0:0:875:0: one line, one block, up to 16 dots of equal length.

A line with a cluster holds what lines that only move hold: G1, axes, F, S and N, with $32 on. To
the rest of the machine it is one with its last S, and its block is one like others; the powers of
its dots lie beside the planner's ring, for motion/beam.py.
"""

from array import array

import micropython
from base.errors import GCODE_UNSUPPORTED_COMMAND, GrblError
from control import spindle as sp
from control.modes import SPINDLE
from language import clusters as words
from micropython import const
from motion.beam import MOST, ROOM, ROW
from motion.layout import DYNAMIC, FLAGS, HEAD, ROW_SIZE, ROWS, TAIL

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType
    from typing import Any

    from interfaces import Options
    from motion.planner import Move
    from talk.controller import Controller

    from extras.api import Cnc

_LINE_LENGTH = const(160)


class Clusters:
    """What stands around a machine's lines, and around its planner."""

    def __init__(self, machine: "Controller") -> None:
        self._machine = machine
        flow = machine.planner.flow
        blocks = flow[ROWS] + 1
        self.powers = array("i", (0 for _ in range(ROOM * blocks)))
        # S of each dot: an override of the spindle weighs it anew.
        self._speeds = array("f", (0.0 for _ in range(MOST * blocks)))
        self._values = array("f", (0.0 for _ in range(MOST)))
        self._text = bytearray(_LINE_LENGTH + 1)
        self._waiting = 0  # dots of a line that is on its long way to the planner
        fast, planner = machine.interpreter.fast, machine.planner
        self._usual_execute = machine.interpreter.execute
        self._usual_line, self._usual_clear = planner.line, planner.clear
        self._usual_each_power = planner.each_power
        fast.follow = self._make_follow(fast.follow)
        machine.interpreter.execute = self.execute  # type: ignore[method-assign]
        planner.line = self.line  # type: ignore[method-assign]
        planner.clear = self.clear  # type: ignore[method-assign]
        planner.each_power = self.each_power  # type: ignore[method-assign]

    # Lines

    def _make_follow(
        self, usual: "Callable[[bytearray, int], int]"
    ) -> "Callable[[bytearray, int], int]":
        """The shortest way: see language/fast_path.py. What it needs is at hand."""
        machine = self._machine

        @micropython.native
        def follow(
            line: bytearray,
            length: int,
            usual: "Callable[[bytearray, int], int]" = usual,
            text: bytearray = self._text,
            values: "array[float]" = self._values,
            scale: "array[float]" = machine.state.spindle,
            powers: "array[int]" = self.powers,
            speeds: "array[float]" = self._speeds,
            flow: "array[int]" = machine.planner.flow,
            modal: "array[int]" = machine.modes.modal,
        ) -> int:
            found = words.gather(line, length, text, values)
            if found == 0:
                return usual(line, length)
            turning = modal[SPINDLE]
            if found < 0 or not turning:
                return 0
            head = flow[HEAD]
            flags = turning | DYNAMIC if turning == sp.CCW else turning
            words.store(values, found >> 8, scale, flags, powers, speeds, head)
            planned = usual(text, found & 255)
            if flow[HEAD] == head:
                powers[ROOM * head] = 0
            return planned

        return follow

    def execute(self, line: bytearray, length: int) -> None:
        """The long way, for lines that say something new besides."""
        found = words.gather(line, length, self._text, self._values)
        if found == 0:
            self._usual_execute(line, length)
            return
        if found < 0:
            raise GrblError(-found)
        interpreter = self._machine.interpreter
        if not interpreter.fast.execute(self._text, found & 255):
            raise GrblError(GCODE_UNSUPPORTED_COMMAND)
        self._waiting = found >> 8
        try:
            self._machine.canon.finish()
        finally:
            self._waiting = 0
        interpreter.fast.tell()

    # The planner

    def _put(self, count: int, block: int) -> None:
        """A block that is going to be planned has these dots; it has none without M3 and M4."""
        machine = self._machine
        flags = machine.modes.modal[SPINDLE]
        if not flags:
            count = 0
        elif flags == sp.CCW:
            flags |= DYNAMIC
        scale = machine.state.spindle
        words.store(self._values, count, scale, flags, self.powers, self._speeds, block)

    def _weigh(self, power: "Any", flags: int, block: int) -> None:
        for i in range(self.powers[ROOM * block]):
            self.powers[ROOM * block + 1 + i] = power(flags, self._speeds[MOST * block + i])

    def line(self, target: "array[float]", move: "Move", power: int) -> bool:
        """As motion.planner.Planner.line()."""
        flow = self._machine.planner.flow
        head = flow[HEAD]
        if self._waiting:
            self._put(self._waiting, head)
        planned = self._usual_line(target, move, power)
        if flow[HEAD] == head:
            self.powers[ROOM * head] = 0
        return planned

    def each_power(self, power: "Any") -> None:
        """As motion.planner.Planner.each_power()."""
        self._usual_each_power(power)
        planner = self._machine.planner
        flow = planner.flow
        at = flow[TAIL]
        while at != flow[HEAD]:
            self._weigh(power, planner.ring[at * flow[ROW_SIZE] + FLAGS], at)
            at = (at + 1) % flow[ROWS]

    def clear(self) -> None:
        """As motion.planner.Planner.clear()."""
        self._usual_clear()
        for i in range(0, len(self.powers), ROOM):
            self.powers[i] = 0


def prepare(options: "Options", board: "ModuleType") -> None:
    """Before the machine is made. Raises ValueError where the board cannot play them."""
    option = board.__dict__.get
    if option("TOOL", "spindle") != "laser":
        raise ValueError('CLUSTERS wants TOOL = "laser"')
    if option("ENGINE", "") in ("rmt", "i2s"):
        raise ValueError("CLUSTERS wants a Pico: others have no machine for a beam")
    options.line_length = _LINE_LENGTH


def install(cnc: "Cnc") -> None:
    """Around the lines, the planner, and the laser's segments."""
    machine = cnc.machine
    clusters = Clusters(machine)
    engine: "Any" = machine.engine
    laser: "Any" = machine.spindle
    engine.beam[ROW] = ROOM
    laser.burn(clusters.powers)
