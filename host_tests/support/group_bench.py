"""A group of axes on the simulator's engine, whose plans and pulses the laws of motion judge."""

from laws import Limits, Watch, check_pulses, check_segments
from ugrbl.sim.engine import SimEngine
from ugrbl.sim.group_hardware import SimHardware
from ugrbl_motion import Axis, Group, Output

RESOLUTION = (80.0, 200.0, 17.5)
SPEED = (100.0, 60.0, 300.0)
ACCELERATION = (500.0, 2000.0, 800.0)
NAMES = "xyz"
CORNER = 0.02


class GroupBench:
    """A group x, y, z with an output, and a watch of the laws."""

    def __init__(self, queue: int = 16, outputs: int = 1) -> None:
        self.hardware = SimHardware()
        self.axes = [
            Axis(2 + i, 5 + i, RESOLUTION[i], SPEED[i], ACCELERATION[i]) for i in range(len(NAMES))
        ]
        parts: "dict[str, Axis | Output]" = dict(zip(NAMES, self.axes, strict=True))
        parts |= {f"out{i}": Output(15 + i) for i in range(outputs)}
        self.group = Group(corner=CORNER, queue=queue, hardware=self.hardware, **parts)
        self.engine: SimEngine = self.hardware.sim
        lines = self.group._lines
        # The laws are in the planner's unit, of which the finest axis has one to two steps.
        scale = lines._scale
        limits = Limits(
            tuple(r / scale for r in RESOLUTION),
            tuple(v * scale * 60 for v in SPEED),
            tuple(a * scale for a in ACCELERATION),
            CORNER * scale,
            self.engine.max_step_hz(3),
        )
        self.watch = Watch(lines._planner, lines._segments, limits, self.engine.tick_hz)
        self.engine.attach(self.watch.next, lines._on_row, lines._on_rest)

    @property
    def steps(self) -> "list[int]":
        """Return the steps at the pins."""
        return list(self.hardware.steps())

    def run(self, seconds: float) -> None:
        """Let time pass."""
        self.hardware.pass_s(seconds)

    def check(self) -> None:
        """Execute everything that is queued, and check the laws."""
        self.group.wait()
        assert self.steps == [self.group.end(i) for i in range(len(NAMES))]
        check_segments(self.watch)
        check_pulses(self.watch, self.hardware.made, 3)
