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
UP, DOWN = 0.0, 1.0  # positions of the punch: completely up, completely down
SENSOR_DOWN, SENSOR_UP = 1, 2  # bits of its sensors


class BrokenLaw(Exception):
    """The machine would have been damaged."""


class PunchPort(SimPort):
    """SimPort with a punch, which keeps its position while neither actuator is on, or both are.

    wiring: mask of inverted wiring: bit 0 the actuator down, 1 the actuator up, 2 the sensor down,
    3 the sensor up. dead: mask of sensors that never see it. lowest: it goes no further down than
    that. stuck: it does not move at all. holes: where it was down, in steps of the motors.
    on_hole: called when it is down.
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
        self._position = UP
        self._position_tick = rig.now  # time at which it was there
        self._direction = 0  # 1: moves down, -1: up, 0: neither
        # The ticks between which it was completely up last; None: it still is.
        self._up_from = rig.now
        self._up_until: "int | None" = None
        self._has_safe_levels = False  # rest() has set those of safe()
        engine = rig.engine
        if isinstance(engine, PunchEngine):
            engine.watch = self.check

    # The pins of an extra

    def add_pins(self, outputs: "tuple[int, ...]", inputs: "tuple[int, ...]") -> None:
        assert (len(outputs), len(inputs)) == (2, 2), "a punch has two actuators and two sensors"

    def drive(self, levels: int) -> None:
        self._set_actuators(levels & 1, levels >> 1)
        if self._killed:
            self.safe()

    def safe(self) -> None:
        super().safe()
        if self._has_safe_levels:
            self._set_actuators(self._safe_outputs & 1, self._safe_outputs >> 1)

    def _set_actuators(self, down: int, up: int) -> None:
        """Set both actuators by the levels of their outputs. BrokenLaw if the punch would go down
        during motion."""
        down ^= self.wiring & 1
        up ^= self.wiring >> 1 & 1
        self.place()  # moves it up to now, in the direction so far
        direction = down - up
        begins_to_go_down = direction > 0 and direction != self._direction
        if begins_to_go_down and not self._rig.engine.idle():
            raise BrokenLaw("the punch goes down while the machine moves")
        self._direction = direction

    def rest(self, levels: int) -> None:
        self._safe_outputs = levels
        self._has_safe_levels = True

    def sense(self) -> int:
        """Return the levels of both sensors, a mask of SENSOR_DOWN and SENSOR_UP."""
        place = self.place()
        sensors = SENSOR_DOWN if place == DOWN else SENSOR_UP if place == UP else 0
        inverted = self.wiring >> 2
        return (sensors & ~self.dead) ^ inverted

    def watch_pins(self, on_change: "Callable[[], None]") -> None:
        self._on_change = on_change

    # Interface for the simulator

    def place(self) -> float:
        """Return its position now, UP to DOWN. Calculate it from the time since the last call, and
        note when it has left or reached UP and DOWN."""
        before, since = self._position, self._position_tick
        self._position_tick = self._rig.now
        elapsed = self._position_tick - since
        stroke = 0.0 if self.stuck else self._direction * elapsed / self._stroke_ticks
        if stroke > 0:
            self._position = max(before, min(before + stroke, self.lowest))
        elif stroke < 0:
            self._position = max(before + stroke, UP)
        if before == UP < self._position:
            self._up_until = since
        if before < DOWN == self._position:
            self._note_hole()
        if before > UP == self._position:
            self._up_from = since + int(before * self._stroke_ticks)  # it may have been before now
            self._up_until = None
        return self._position

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
        self._position = (UP + DOWN) / 2
        if self._on_change:
            self._on_change()

    def check(self, first: int, last: int) -> None:
        """Check steps that were made from one tick to the other. BrokenLaw if the punch was not up
        all the time between."""
        self.place()  # updates the ticks that follow
        if first < self._up_from or (self._up_until is not None and last > self._up_until):
            raise BrokenLaw("the machine moves while the punch is down")

    def power_off(self) -> None:
        super().power_off()
        self.place()
        self._on_change = None
        self._direction = 0


class PunchEngine(SimEngine):
    """SimEngine that checks every step made. watch: PunchPort.check."""

    watch: "Callable[[int, int], None] | None" = None

    def _finish(self, ticks: int) -> None:
        """End a segment after `ticks`, and check its first and last step of each motor."""
        super()._finish(ticks)  # the row then has only the steps made
        row: "array[int]" = self._queue[self._head]
        for i in range(self._axes):
            base = ROW_AXES + ROW_STRIDE * i
            count = row[base]
            if count and self.watch:
                first, last = step_tick(row, base, 0), step_tick(row, base, count - 1)
                self.watch(self._start + first, self._start + last)
