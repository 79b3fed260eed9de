"""A simulated punch that needs time, and a pulse engine that checks its law.

The law: no step is made unless the punch is completely up, from the first step of a segment to its
last; and it goes down only at standstill. A violation raises BrokenLaw.
"""

from array import array

from motion.layout import ROW_AXES, ROW_STRIDE

from .engine import SimEngine, step_tick
from .port import SimPort

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

    from .seams import Clock

_STROKE_MS = 40  # of a board file that says nothing, as in boardfile/options.py
# Positions of the punch, and the bits of its sensors.
UP, DOWN = 0.0, 1.0
SENSOR_DOWN, SENSOR_UP = 1, 2


class BrokenLaw(Exception):
    """The machine would have been damaged."""


class PunchPort(SimPort):
    """SimPort with a punch, which keeps its position while neither actuator is on, or both are.

    wiring: mask of inverted wiring, counted as $30 to $33 from bit 0. dead: mask of sensors that
    never see it. lowest: it goes no further down than that. stuck: it does not move at all. holes:
    where it was down, in steps of the motors. on_hole: called when it is down.
    """

    def __init__(self, rig: "Clock", board: "ModuleType") -> None:
        super().__init__(rig, board)
        self.wiring = 0
        self.dead = 0
        self.lowest = DOWN
        self.stuck = False
        self.holes: "list[tuple[int, ...]]" = []
        self.on_hole: "Callable[[], None] | None" = None
        stroke_ms = getattr(board, "PUNCH_STROKE_MS", _STROKE_MS)
        self._stroke_ticks = rig.ms(stroke_ms) - rig.now
        self._place = UP
        self._since = rig.now  # time of that position
        self._speed = 0  # 1: down, -1: up
        # It is or was up between these ticks; None: until now.
        self._up_from = rig.now
        self._up_until: "int | None" = None
        self._has_rest = False  # the outputs at rest are known
        engine = rig.engine
        if isinstance(engine, PunchEngine):
            engine.watch = self.check

    # The pins of an extra

    def add_pins(self, outputs: "tuple[int, ...]", inputs: "tuple[int, ...]") -> None:
        assert (len(outputs), len(inputs)) == (2, 2), "a punch has two actuators and two sensors"

    def drive(self, levels: int) -> None:
        self._drive(levels & 1, levels >> 1)
        if self._killed:
            self.safe()

    def safe(self) -> None:
        super().safe()
        if self._has_rest:
            self._drive(self._rest & 1, self._rest >> 1)

    def _drive(self, down: int, up: int) -> None:
        """Set both actuators by the levels of their outputs. BrokenLaw if the punch would go down
        during motion."""
        down ^= self.wiring & 1
        up ^= self.wiring >> 1 & 1
        self.place()
        speed = down - up
        if speed > 0 and speed != self._speed and not self._rig.engine.idle():
            raise BrokenLaw("the punch goes down while the machine moves")
        self._speed = speed

    def rest(self, levels: int) -> None:
        self._rest = levels
        self._has_rest = True

    def sense(self) -> int:
        place = self.place()
        sensors = SENSOR_DOWN if place == DOWN else SENSOR_UP if place == UP else 0
        return sensors & ~self.dead ^ self.wiring >> 2

    def watch_pins(self, on_change: "Callable[[], None]") -> None:
        self._on_change = on_change

    # Interface for the simulator

    def place(self) -> float:
        """Return its position now, UP to DOWN."""
        was, since = self._place, self._since
        self._since = self._rig.now
        stroke = 0.0 if self.stuck else self._speed * (self._since - since) / self._stroke_ticks
        if stroke > 0:
            self._place = max(was, min(was + stroke, self.lowest))
        elif stroke < 0:
            self._place = max(was + stroke, UP)
        if was == UP < self._place:
            self._up_until = since
        if was < DOWN == self._place:
            self._note_hole()
        if was > UP == self._place:
            self._up_from = since + int(was * self._stroke_ticks)
            self._up_until = None
        return self._place

    def _note_hole(self) -> None:
        """Note the motors' positions, and report the hole."""
        steps = self._rig.scratch
        self._rig.engine.physical(steps)
        self.holes.append(tuple(steps))
        if self.on_hole:
            self.on_hole()

    def fall(self) -> None:
        """Let it drop half way by itself, at once."""
        if self.place() == UP:
            self._up_until = self._rig.now
        self._place = (UP + DOWN) / 2
        if self._on_change:
            self._on_change()

    def check(self, first: int, last: int) -> None:
        """Check steps that were made from one tick to the other."""
        self.place()
        if first < self._up_from or (self._up_until is not None and last > self._up_until):
            raise BrokenLaw("the machine moves while the punch is down")

    def power_off(self) -> None:
        super().power_off()
        self.place()
        self._on_change = None
        self._speed = 0


class PunchEngine(SimEngine):
    """SimEngine that checks every step made. watch: PunchPort.check."""

    watch: "Callable[[int, int], None] | None" = None

    def _finish(self, ticks: int) -> None:
        """End a segment, and check its first and last step of each motor."""
        super()._finish(ticks)
        row: "array[int]" = self._queue[self._head]
        for i in range(self._axes):
            base = ROW_AXES + ROW_STRIDE * i
            count = row[base]
            if count and self.watch:
                first, last = step_tick(row, base, 0), step_tick(row, base, count - 1)
                self.watch(self._start + first, self._start + last)
