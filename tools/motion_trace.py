"""What a machine does from segment to segment: place, speed, acceleration, step rate."""

from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from . import machine
from .recorder import Recorder, replace_method
from .run import Result, watch_program

if TYPE_CHECKING:
    from .sim.rig import Rig

LETTERS = "XYZABC"
# Between two segments so far apart the machine has stood still.
_REST_S = 1e-6


def _column() -> "array[float]":
    return array("d")


@dataclass
class Motion:
    """Columns of equal length, a row per segment; at rest, a row at each end of it.

    speed is that at the end of the segment, along the path. Per axis: acceleration and step
    rate, without sign, as the settings limit them.
    """

    time_s: "array[float]" = field(default_factory=_column)
    seconds: "array[float]" = field(default_factory=_column)
    place: "list[array[float]]" = field(default_factory=lambda: [_column() for _ in range(3)])
    speed_mm_s: "array[float]" = field(default_factory=_column)
    acceleration: "list[array[float]]" = field(default_factory=list)  # mm/s2
    step_hz: "list[array[float]]" = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.time_s)


class MotionTrace(Recorder):
    """A Recorder that also knows how fast the firmware meant each segment to be.

    Speeds come from the segments' maker and not from the steps: at 250 steps/mm, the steps of
    10 ms tell an acceleration to no better than 40 mm/s2.
    """

    def __init__(self, rig: "Rig") -> None:
        super().__init__(rig)
        self.motion = Motion(
            acceleration=[_column() for _ in self._axes], step_hz=[_column() for _ in self._axes]
        )
        self._begun_at = 0
        self._plans: dict[int, tuple[float, list[float]]] = {}  # by the row they are for

    def start_clock(self) -> None:
        """The work begins now; what was before is forgotten."""
        super().start_clock()
        self._begun_at = self._rig.now
        self._add(0.0, 0.0, 0.0, [0.0 for _ in self._axes])

    def _attach(self) -> None:
        super()._attach()
        from reals import value

        self._value = value
        self._segments = self._rig.controller.segments
        self._next = replace_method(self._segments, "next", self._noted)

    def _noted(self, row: "array[int]") -> int:
        """Stand in for Segments.next: note the speed of what it makes, and of which block."""
        made = int(self._next(row))
        if made:
            kernels = self._kernels
            at = self._planner.flow[kernels.AT]
            ring = self._planner.ring
            length = self._value(ring[at + kernels.LENGTH]) or 1.0
            steps = ring[at + kernels.STEPS : at + kernels.STEPS + len(self._axes)]
            dirs = ring[at + kernels.DIRS]
            per_mm = [(-n if dirs >> i & 1 else n) / length for i, n in enumerate(steps)]
            self._plans[id(row)] = (self._segments.rate_mm_min() / 60, per_mm)
        return made

    def _segment(self, start: int, row: "array[int]") -> None:
        super()._segment(start, row)
        hz = self._rig.engine.tick_hz
        ticks = row[self._kernels.ROW_TICKS]
        speed, per_mm = self._plans.get(id(row), (0.0, [0.0 for _ in self._axes]))
        begin = (start - self._begun_at) / hz
        motion = self.motion
        if len(motion) and begin - motion.time_s[-1] > _REST_S:
            self._rest_until(begin)
        self._add(begin + ticks / hz, ticks / hz, speed, per_mm)

    def _rest_until(self, time_s: float) -> None:
        still = [0.0 for _ in self._axes]
        last = self.motion.time_s[-1]
        self._add(last, 0.0, 0.0, still)
        self._add(time_s, time_s - last, 0.0, still)

    def _add(self, time_s: float, seconds: float, speed: float, per_mm: Sequence[float]) -> None:
        motion = self.motion
        before = motion.speed_mm_s[-1] if len(motion) else 0.0
        change = abs(speed - before) / seconds if seconds else 0.0
        motion.time_s.append(time_s)
        motion.seconds.append(seconds)
        motion.speed_mm_s.append(speed)
        for column, mm in zip(motion.place, self._to_mm(self._place), strict=False):
            column.append(mm)
        share = self._shares(per_mm)
        for i in self._axes:
            motion.acceleration[i].append(change * share[i])
            motion.step_hz[i].append(speed * abs(per_mm[i]))

    def _shares(self, per_mm: Any) -> list[float]:
        """How much of a millimetre is each axis's, from the steps of its motors."""
        return [abs(mm) for mm in self._to_mm(per_mm)]


def trace_program(
    lines: Sequence[bytes],
    *,
    board: str = machine.DEFAULT_BOARD,
    settings: Sequence[str] = (),
    progress: Callable[[int], None] | None = None,
) -> tuple[Result, Motion]:
    """Run a program as run.run_program does, and follow every segment."""
    result, trace = watch_program(lines, MotionTrace, board, settings, progress)
    return result, trace.motion
