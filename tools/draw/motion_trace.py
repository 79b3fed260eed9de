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
    block is the index of the segment's block in the columns of blocks: line, rapid, and per mm of
    its path the steps of each motor and the share, in mm, of each axis. Block 0 is a standstill.
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
        """Return an axis' acceleration in mm/s2 for each segment, without sign, as a mean over
        MEAN_S. Only changes of the speed along the path count, not those of direction."""
        time_s = np.frombuffer(self.time_s)
        change = np.abs(np.diff(_view(self.speed_mm_s), prepend=np.float32(0)))
        axis_share = _view(self.share[axis])[_view(self.block)]
        # The sum of the axis' changes of speed, up to the end of each segment, from time 0 on.
        sums = np.append(0.0, np.cumsum(change * axis_share, dtype=float))
        times = np.append(0.0, time_s)
        middle = time_s - self.seconds / 2
        after, before = (np.interp(middle + s, times, sums) for s in (MEAN_S / 2, -MEAN_S / 2))
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
        self._start_tick = 0  # the tick of time 0
        self._blocks: dict[int, int] = {}  # block of the trace, by its place in the planner's ring
        # Speed at the end and block of each segment that waits in the engine, by its row's id().
        self._plans: dict[int, tuple[float, int]] = {}
        self._port = rig.port
        # Block 0, a standstill.
        self._add_block(line=0, rapid=False, per_mm=[0.0 for _ in self._motors])

    def start_clock(self) -> None:
        """Start the clock at the beginning of the program; segments before, of settings and
        commands, are removed."""
        super().start_clock()
        self.motion.forget()
        self._start_tick = self._rig.now
        self._add_standing(0.0, self._to_mm(self._motor_steps))

    def _attach(self) -> None:
        """Attach to the machine, as Paced._attach(), also to the generator of segments: the engine
        calls _next_segment() instead of it."""
        super()._attach()
        from motion.minifloat import value

        self._to_float = value
        self._segments = self._rig.controller.segments
        hooks = self._rig.controller.state.hooks
        self._firmware_next = replace_method(hooks, "next_segment", self._next_segment)

    def _note(self, row: int) -> None:
        """Note a block that was planned in this row of the planner's ring."""
        super()._note(row)
        layout, ring = self._layout, self._planner.ring
        at = row * self._planner.flow[layout.ROW_SIZE]  # its place in the ring
        length = self._to_float(ring[at + layout.LENGTH]) or 1.0
        steps = ring[at + layout.STEPS : at + layout.STEPS + len(self._motors)]
        backwards, flags = ring[at + layout.DIRS], ring[at + layout.FLAGS]  # masks
        per_mm = [
            (-count if backwards >> i & 1 else count) / length for i, count in enumerate(steps)
        ]
        self._blocks[at] = len(self.motion.line)
        rapid = bool(flags & (layout.RAPID_MOTION | layout.SYSTEM_MOTION))
        self._add_block(self._rig.link.now_at(), rapid, per_mm)

    def _add_block(self, line: int, rapid: bool, per_mm: Sequence[float]) -> None:
        """Add a block. per_mm: steps of each motor per mm of its path, negative if backwards."""
        motion = self.motion
        motion.line.append(line)
        motion.rapid.append(rapid)
        for column, steps in zip(motion.steps_per_mm, per_mm, strict=True):
            column.append(abs(steps))
        for column, mm in zip(motion.share, self._to_mm(per_mm), strict=True):
            column.append(abs(mm))

    def _next_segment(self, row: "array[int]") -> int:
        """Replace the generator of segments: let it fill the row, and note the speed at the end of
        the segment, and its block. Return 0 if there is no segment."""
        has_segment = int(self._firmware_next(row))
        if has_segment:
            place = self._planner.flow[self._layout.BLOCK_AT]
            speed = self._to_float(self._segments.rate())
            self._plans[id(row)] = speed, self._blocks.get(place, 0)
        return has_segment

    def _moved(self, start: int, row: "array[int]", at: Sequence[float]) -> None:
        """Add a segment that begins at `start`, in ticks, and ends at this position, in mm. Called
        after it was executed."""
        if not self.motion.time_s:  # the first one, without start_clock()
            self._start_tick = start
            self._add_standing(0.0, [0.0 for _ in self._axes])
        hz = self._rig.engine.tick_hz
        speed, block = self._plans.get(id(row), (0.0, 0))
        begin = (start - self._start_tick) / hz
        motion = self.motion
        if len(motion) and begin - motion.time_s[-1] > _REST_S:  # a standstill before it
            place = [column[-1] for column in motion.place]
            self._add_standing(motion.time_s[-1], place)
            self._add_standing(begin, place)
        self._add(begin + row[self._layout.ROW_TICKS] / hz, speed, block, at)

    def _add_standing(self, time_s: float, at: Sequence[float]) -> None:
        """Add a row of a standstill: time, position in mm."""
        self._add(time_s, 0.0, 0, at)

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

    settings: lines sent before it. check: run it in check mode ($C), without motion. progress:
    called with the number of lines done. For a long program, segments are up to _COARSE times as
    long; steps, path and time are the same.
    """
    commands = (*settings, *(["$C"] if check else []))
    coarse = _COARSE if len(lines) > _MANY_LINES else 1
    return watch_program(lines, MotionTrace, board, commands, progress, coarse, around)
