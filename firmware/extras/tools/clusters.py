# mypy: disable-error-code=arg-type
"""Clusters of a laser's powers, S0:0:875:0: one line, one block, up to 16 dots of equal length.

A line with a cluster holds what lines that only move hold: G1, axes, F, S and N, with $32 on. To
the rest of the machine it is one with its last S, and its block is one like others; the powers of
its dots lie beside the planner's ring, for motion/beam.py.
"""

from array import array

import micropython
from control.spindle import ASKED, weigh
from language.words import DOTS, FIRST_DOT
from micropython import const
from motion.beam import MOST, ROOM, ROW
from motion.layout import FLAGS, HEAD, ROW_SIZE, ROWS, SYSTEM_MOTION, TAIL
from motion.planner import SPINDLE_MASK

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

    from interfaces import Options
    from talk.controller import Controller

    from extras.api import Cnc

_LINE_LENGTH = const(160)


@micropython.viper
def store(
    values: ptr32,
    count: int,
    scale: ptr32,
    flags: int,
    clusters: ptr32,
    speeds: ptr32,
    block: int,
) -> int:
    """Powers, and what they are made of, go where a block's are looked for. scale and flags: as
    weigh() wants them."""
    at = ROOM * block
    last = -1
    power = 0
    for i in range(count):
        if values[i] != last:
            last = values[i]
            scale[ASKED] = last
            power = int(weigh(scale, flags))
        clusters[at + 1 + i] = power
        speeds[MOST * block + i] = last
    clusters[at] = count
    return 0


class Clusters:
    """What stands around a machine's planner."""

    def __init__(self, machine: "Controller") -> None:
        self._machine = machine
        flow = machine.planner.flow
        blocks = flow[ROWS] + 1
        self.powers = array("i", (0 for _ in range(ROOM * blocks)))
        # S of each dot: an override of the spindle weighs it anew.
        self._speeds = array("f", (0.0 for _ in range(MOST * blocks)))
        self._dots = machine.interpreter.block.dots
        self._values = memoryview(self._dots)[FIRST_DOT:]
        planner = machine.planner
        self._usual_plan, planner.move_hook = planner.move_hook or planner.plan, self.plan
        hooks = machine.state.hooks
        hooks.cleared += (self._clear,)
        hooks.powered += (self._each_power,)

    # The planner

    def _weigh(self, power: "Any", flags: int, block: int) -> None:
        for i in range(self.powers[ROOM * block]):
            self.powers[ROOM * block + 1 + i] = power(flags, self._speeds[MOST * block + i])

    @micropython.native
    def plan(self, target: "array[float]", flags: int, line: int, power: int, rate: int) -> int:
        """As motion.planner.Planner.plan(); without M3 and M4 there are no dots."""
        machine = self._machine
        head = machine.planner.flow[HEAD]
        if not flags & SYSTEM_MOTION:
            count = self._dots[DOTS] if flags & SPINDLE_MASK else 0
            scale = machine.state.spindle
            store(self._values, count, scale, flags, self.powers, self._speeds, head)
        planned = self._usual_plan(target, flags, line, power, rate)
        if machine.planner.flow[HEAD] == head:
            self.powers[ROOM * head] = 0
        return planned

    def _each_power(self, power: "Any") -> None:
        """Weigh the dots of every block anew."""
        planner = self._machine.planner
        flow = planner.flow
        at = flow[TAIL]
        while at != flow[HEAD]:
            self._weigh(power, planner.ring[at * flow[ROW_SIZE] + FLAGS], at)
            at = (at + 1) % flow[ROWS]

    def _clear(self) -> None:
        """Nothing is planned."""
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
    options.dots = MOST


def install(cnc: "Cnc") -> None:
    """Around the lines, the planner, and the laser's segments."""
    machine = cnc.machine
    clusters = Clusters(machine)
    engine: "Any" = machine.engine
    laser: "Any" = machine.spindle
    engine.beam[ROW] = ROOM
    laser.burn(clusters.powers)
