"""The machine's motion by segment: position, speed, acceleration, step rate, power.

Also the line of the program for each segment. A long job has millions of segments, so all data is
in arrays.
"""

from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..run import machine
from ..run.pace import Paced
from ..run.program import Result, watch_program
from ..run.recorder import replace_method

if TYPE_CHECKING:
    from ..sim.rig import Rig

LETTERS = "XYZABC"
# A longer time between two segments means that the machine has stood still.
_REST_S = 1e-6

# Segments end with a step, but their speeds are those of whole milliseconds, so acceleration is a
# mean over this time.
MEAN_S = 0.03

# For a program with so many lines, segments of 40 ms instead of Grbl's 10 are enough.
_MANY_LINES = 50_000
_COARSE = 4

Column = NDArray[np.float64] | NDArray[np.float32]


def _column(kind: str) -> "array[float]":
    return array(kind)


@dataclass
class Motion:
    """Columns of equal length, a row per segment; a standstill has a row at each end.

    speed is that at the end of the segment, along the path; power is the tool's, from 0 to 1.
    Acceleration and step rate are per axis and computed on demand, without sign, as the settings
    limit them.
    """

    time_s: "array[float]" = field(default_factory=lambda: _column("d"))
    place: "list[array[float]]" = field(default_factory=lambda: [_column("f") for _ in range(3)])
    speed_mm_s: "array[float]" = field(default_factory=lambda: _column("f"))
    power: "array[float]" = field(default_factory=lambda: _column("f"))
    block: "array[int]" = field(default_factory=lambda: array("i"))
    # A row per block of the planner; block 0 is standstill.
    line: "array[int]" = field(default_factory=lambda: array("i"))
    rapid: "array[int]" = field(default_factory=lambda: array("b"))
    steps_per_mm: "list[array[float]]" = field(default_factory=list)  # per mm of path, by motor
    share: "list[array[float]]" = field(default_factory=list)  # of a mm of path, by axis

    def __len__(self) -> int:
        return len(self.time_s)

    def forget(self) -> None:
        """Remove all segments, but keep the blocks."""
        for column in (self.time_s, self.speed_mm_s, self.power, *self.place):
            del column[:]
        del self.block[:]

    @property
    def seconds(self) -> Column:
        """Return how long each segment took."""
        return np.diff(np.frombuffer(self.time_s), prepend=self.time_s[:1])

    @property
    def lines(self) -> NDArray[np.int32]:
        """Return the line of the program for each segment; 0 at standstill."""
        return np.asarray(_view(self.line)[_view(self.block)], np.int32)

    @property
    def rapids(self) -> NDArray[np.bool_]:
        """Return which segments belong to rapids."""
        return np.asarray(_view(self.rapid)[_view(self.block)], bool)

    @property
    def points(self) -> NDArray[np.float32]:
        """Return X, Y and Z in mm."""
        return np.column_stack([_view(column) for column in self.place])

    def axes(self) -> range:
        """Return the numbers of all axes."""
        return range(len(self.share))

    def acceleration(self, axis: int) -> Column:
        """Return the acceleration in mm/s2, along the path, as a mean over MEAN_S."""
        time_s = np.frombuffer(self.time_s)
        change = np.abs(np.diff(_view(self.speed_mm_s), prepend=np.float32(0)))
        changed = np.cumsum(change * _view(self.share[axis])[_view(self.block)], dtype=float)
        ends = np.append(0.0, time_s), np.append(0.0, changed)
        middle = time_s - self.seconds / 2
        # The change of speed up to half of MEAN_S after, and before, the middle of each segment.
        after, before = (np.interp(middle + s, *ends) for s in (MEAN_S / 2, -MEAN_S / 2))
        return np.asarray((after - before) / MEAN_S)

    def step_hz(self, motor: int) -> Column:
        """Return the steps per second."""
        per_mm = _view(self.steps_per_mm[motor])[_view(self.block)]
        return np.asarray(per_mm * _view(self.speed_mm_s))


def _view(column: "array[float] | array[int]") -> "NDArray[np.float32]":
    """Return the array as a numpy array, not copied."""
    return np.frombuffer(column, column.typecode)


class MotionTrace(Paced):
    """A Recorder that also records the firmware's planned speed of each segment.

    Speeds come from the segment generator and not from the steps: at 250 steps/mm, the steps of 10
    ms determine an acceleration only to 40 mm/s2.
    """

    def __init__(self, rig: "Rig") -> None:
        super().__init__(rig)
        per_motor = [_column("f") for _ in self._motors]
        per_axis = [_column("f") for _ in self._axes]
        self.motion = Motion(steps_per_mm=per_motor, share=per_axis)
        self._begun_at = 0
        self._blocks: dict[int, int] = {}  # block of the trace, by the row of the planner's ring
        self._plans: dict[int, tuple[float, int]] = {}  # speed and block, by the segment's row
        self._port = rig.port
        self._add_block(0, False, [0.0 for _ in self._motors])

    def start_clock(self) -> None:
        """Start the clock at the beginning of the program; earlier segments are removed."""
        super().start_clock()
        self.motion.forget()
        self._begun_at = self._rig.now
        self._add(0.0, 0.0, 0, self._to_mm(self._place))

    def _attach(self) -> None:
        """Attach to the machine, as Paced._attach(), also to the generator of segments."""
        super()._attach()
        from motion.minifloat import value

        self._value = value
        self._segments = self._rig.controller.segments
        hooks = self._rig.controller.state.hooks
        self._next = replace_method(hooks, "next_segment", self._noted)

    def _note(self, row: int) -> None:
        """Note a block that was planned in this row of the planner's ring."""
        super()._note(row)
        layout, ring = self._layout, self._planner.ring
        at = row * self._planner.flow[layout.ROW_SIZE]
        length = self._value(ring[at + layout.LENGTH]) or 1.0
        steps = ring[at + layout.STEPS : at + layout.STEPS + len(self._motors)]
        dirs, flags = ring[at + layout.DIRS], ring[at + layout.FLAGS]
        per_mm = [(-count if dirs >> i & 1 else count) / length for i, count in enumerate(steps)]
        self._blocks[at] = len(self.motion.line)
        rapid = bool(flags & (layout.RAPID_MOTION | layout.SYSTEM_MOTION))
        self._add_block(self._rig.link.now_at(), rapid, per_mm)

    def _add_block(self, line: int, rapid: bool, per_mm: Sequence[float]) -> None:
        """Add a block. per_mm: steps of each motor per mm of its path, negative if backwards."""
        motion = self.motion
        motion.line.append(line)
        motion.rapid.append(rapid)
        for steps, mm in zip(motion.steps_per_mm, per_mm, strict=True):
            steps.append(abs(mm))
        for share, mm in zip(motion.share, self._to_mm(per_mm), strict=True):
            share.append(abs(mm))

    def _noted(self, row: "array[int]") -> int:
        """Replace Segments.next: note the speed of the segment, and its block. Return its result,
        0 if there is no segment."""
        has_segment = int(self._next(row))
        if has_segment:
            block = self._planner.flow[self._layout.BLOCK_AT]
            self._plans[id(row)] = (self._value(self._segments.rate()), self._blocks.get(block, 0))
        return has_segment

    def _moved(self, start: int, row: "array[int]", at: Sequence[float]) -> None:
        """Add a segment that begins at `start`, in ticks, and ends at this position, in mm."""
        if not self.motion.time_s:
            self._begun_at = start
            self._add(0.0, 0.0, 0, [0.0 for _ in self._axes])
        hz = self._rig.engine.tick_hz
        speed, block = self._plans.get(id(row), (0.0, 0))
        begin = (start - self._begun_at) / hz
        motion = self.motion
        if len(motion) and begin - motion.time_s[-1] > _REST_S:
            last = [column[-1] for column in motion.place]
            self._add(motion.time_s[-1], 0.0, 0, last)
            self._add(begin, 0.0, 0, last)
        self._add(begin + row[self._layout.ROW_TICKS] / hz, speed, block, at)

    def _add(self, time_s: float, speed: float, block: int, at: Sequence[float]) -> None:
        """Add a row: time, speed in mm/s, block, position in mm; power as it is now."""
        motion, port = self.motion, self._port
        motion.time_s.append(time_s)
        motion.speed_mm_s.append(speed)
        motion.power.append(port.spindle_pwm / port.pwm_max if port.spindle_on else 0.0)
        motion.block.append(block)
        for column, mm in zip(motion.place, at, strict=False):
            column.append(mm)


def trace_program(
    lines: Sequence[bytes],
    *,
    board: str = machine.DEFAULT_BOARD,
    settings: Sequence[str] = (),
    check: bool = False,
    progress: Callable[[int], None] | None = None,
    around: machine.Around = machine.NOTHING,
) -> tuple[Result, MotionTrace]:
    """Run a program as run.run_program does, and trace every segment.

    For a long one, segments are longer where the lines are long; steps, path and time are the
    same.
    """
    commands = (*settings, *(["$C"] if check else []))
    coarse = _COARSE if len(lines) > _MANY_LINES else 1
    return watch_program(lines, MotionTrace, board, commands, progress, coarse, around)
