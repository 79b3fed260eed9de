"""Laws of motion for any moves, and the benches that supply moves.

A Watch records every planned block and every segment of planner and segments; the checks use only
these records. A Bench drives planner and segments alone, by their own functions; a whole rig is
driven by its script. Everything here is in plain floats, independent of the kernels' integers.
"""

from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise
from math import inf, sqrt
from types import SimpleNamespace
from typing import Any

from base.float32 import vector
from base.state import State
from hypothesis import settings
from motion import layout, minifloat
from motion.kinematics import Kinematics
from motion.layout import ROOT_SCALE, ROW_AXES, ROW_DIRS, ROW_STRIDE, ROW_TICKS
from motion.planner import Move, Planner
from motion.segments import Segments
from ugrbl.sim.engine import step_tick

TICK_HZ = 13_107_200
SEGMENT_LOG2 = 17

RATE_SLACK = 1.005
ACCELERATION_SLACK = 1.08
JUNCTION_SLACK = 1.1
PROMISE_SLACK = 1.005
# Error of a corner's angle from unit vectors of 14 bits, in radians.
_ANGLE = 2e-4
# Grbl calls a corner straight below this angle.
_STRAIGHT = 0.0015
SETUP_US = 3
# With a jerk limit: a corner within this many steps of a straight line may be the step grid's.
_GRID = 1.5
# Segments of constant speed after which its steps are even.
_SETTLED = 8
# Precision of braking as a fraction of a step: in the middle of a block, and at its end.
STEP_PART = 1 / 400
_END_PART = 1 / 20


@dataclass
class Limits:
    """The user's settings in mm and seconds, per axis; and the engine's highest rate."""

    steps_per_mm: tuple[float, ...] = (250.0, 250.0, 250.0)
    rate: tuple[float, ...] = (500.0, 500.0, 500.0)  # mm/min
    acceleration: tuple[float, ...] = (10.0, 10.0, 10.0)
    deviation: float = 0.01
    step_hz: int = 90_909
    moves: Sequence[int] = ()  # axes of the first motors; empty: each motor moves its own axis

    @classmethod
    def of(cls, settings: Any, step_hz: int) -> "Limits":
        """Return the limits in a machine's settings."""
        return cls(
            tuple(settings.steps_per_mm),
            tuple(settings.max_rate),
            tuple(a / 3600 for a in settings.acceleration),
            settings.junction_deviation_mm,
            step_hz,
        )

    def settings(self) -> SimpleNamespace:
        """Return settings for planner.configure()."""
        return SimpleNamespace(
            steps_per_mm=array("f", self.steps_per_mm),
            max_rate=array("f", self.rate),
            acceleration=array("f", [a * 3600 for a in self.acceleration]),
            junction_deviation_mm=self.deviation,
        )

    def speed(self, axis: int) -> float:
        """Return the highest speed of an axis, mm/s."""
        return min(self.rate[axis] / 60, self.step_hz / self.steps_per_mm[axis])

    def along(self, unit: Sequence[float], what: Sequence[float]) -> float:
        """Return the largest value along a direction that no axis' limit forbids."""
        return min((w / abs(u) for u, w in zip(unit, what, strict=True) if u), default=inf)


@dataclass(eq=False)
class Block:
    """A planned block in mm and seconds. motors: signed steps; unit: its direction."""

    motors: tuple[int, ...]
    unit: tuple[float, ...]
    length: float
    limits: Limits

    @property
    def events(self) -> int:
        return max(abs(n) for n in self.motors)

    @property
    def step(self) -> float:
        """Return the distance between steps of its longest axis, mm."""
        return self.length / self.events

    def braked(self, part: float) -> float:
        """Return the change in speed from braking within a fraction of a step."""
        return sqrt(2 * self.acceleration * self.step * part)

    @property
    def speed(self) -> float:
        """Return the speed that its axes allow."""
        limits = self.limits
        return limits.along(self.unit, [limits.speed(i) for i in range(len(self.unit))])

    @property
    def acceleration(self) -> float:
        """Return the acceleration that its axes allow."""
        return self.limits.along(self.unit, self.limits.acceleration)

    def bend(self, after: "Block") -> float:
        """Return the corner's distance from the straight line, in steps; infinite for a
        reversal."""
        a, b = self.motors, after.motors
        inner = sum(x * y for x, y in zip(a, b, strict=True))
        if inner < 0:
            return inf
        squares = sum(x * x for x in a), sum(y * y for y in b)
        cross = max(squares[0] * squares[1] - inner * inner, 0)
        return sqrt(cross / (squares[0] + squares[1] + 2 * inner))

    def junction(self, after: "Block", lean: int = 1) -> float:
        """Return the highest speed into the following block by junction deviation, in floats.

        lean: 1 for the largest result within the error of 14-bit unit vectors, -1 for the
        smallest.
        """
        delta = [b - a for a, b in zip(self.unit, after.unit, strict=True)]
        change = sqrt(sum(d * d for d in delta))  # 2 sin(half the angle of deflection)
        unsure = [max(abs(d) - lean * _ANGLE, 0.0) for d in delta]
        change = min(max(change - lean * _ANGLE, 0.0), 2.0)
        if change < _STRAIGHT and lean > 0:
            return inf
        accel = self.limits.along(unsure, self.limits.acceleration) * change
        cosine = sqrt(1 - change * change / 4)  # sin(theta / 2) of Grbl's angle
        return sqrt(accel * self.limits.deviation * cosine / (1 - cosine))


@dataclass(eq=False)
class Segment:
    """A row as it was handed out. start: in ticks, without pauses between segments."""

    block: Block
    start: int
    row: "array[int]"
    ends_block: bool

    @property
    def ticks(self) -> int:
        return self.row[ROW_TICKS]

    def axis(self, i: int) -> "tuple[int, int, int]":
        """Return steps, tick of the first, tick of the last."""
        at = ROW_AXES + ROW_STRIDE * i
        return self.row[at], self.row[at + 1], self.row[at + 2]


@dataclass(eq=False)
class Piece:
    """The profile during a segment, to a fraction of a step, in mm and seconds."""

    block: Block
    distance: float
    time: float
    speed: float  # at its end
    ends_block: bool
    from_rest: bool
    segment: "Segment | None"
    unit: float  # resolution of its distance in mm with a jerk limit; else 0
    promise: float  # at a block's end: the highest speed planned there; else infinite

    @property
    def mean(self) -> float:
        return self.distance / self.time

    def change(self, hz: int) -> float:
        """Return how much its mean speed may differ from the speed at either end."""
        return self.block.acceleration * self.time / 2 + self.grain(hz)

    def grain(self, hz: int) -> float:
        """Return the error of its mean: ticks, 2**-18 of a step, braking within a fraction of a
        step."""
        told = self.block.step * 4 / 2**18 + self.unit * 2
        ticks = (self.distance * 2 / self.time / hz + told) / self.time
        return ticks + self.block.braked(STEP_PART)


def real(r: int) -> float:
    """Return the value of a minifloat."""
    return (r % 32768) * 2.0 ** (r // 32768 - 64)


def pack(x: float) -> int:
    """Return the minifloat below x."""
    return minifloat.real(x)


class Watch:
    """Record blocks as they are planned and segments as they are made."""

    def __init__(self, planner: Planner, segments: Segments, limits: Limits, tick_hz: int) -> None:
        self.limits = limits
        self.tick_hz = tick_hz
        self.planned: list[Block] = []
        self.made: list[Segment] = []
        self.pieces: list[Piece] = []
        self.rests: set[int] = set()  # numbers of segments after which a hold came to rest
        self.planner = planner
        self._block_of_row: dict[int, Block] = {}
        self._plan = planner.move_hook or planner.plan
        self._chords, self._override = planner.chords, planner.override
        self._slowed: set[Block] = set()
        self._next = segments.next
        planner.move_hook = self.plan
        planner.chords = self.chords  # type: ignore[method-assign]
        planner.override = self.override  # type: ignore[method-assign]
        segments.next = self.next

    def plan(self, target: Any, flags: int, *asked: int) -> int:
        """Replace Planner.move_hook."""
        flow = self.planner.flow
        at = flow[layout.ROWS if flags & layout.SYSTEM_MOTION else layout.HEAD]
        planned = self._plan(target, flags, *asked)
        if planned:
            self._keep(at)
            check_plan(self)
        return planned

    def chords(self, *asked: Any) -> int:
        """Replace Planner.chords."""
        at = self.planner.flow[layout.HEAD]
        found = self._chords(*asked)
        while at != self.planner.flow[layout.HEAD]:
            self._keep(at)
            at = (at + 1) % self.planner.flow[layout.ROWS]
        check_plan(self)
        return found

    def override(self) -> None:
        """Replace Planner.override. It may come too late to brake for lowered limits."""
        self._override()
        flow = self.planner.flow
        if flow[layout.LOADED]:
            self._slowed.add(self._block_of_row[flow[layout.BLOCK_AT] // self._row_size])
        elif (
            flow[layout.JOIN_SPEED] and flow[layout.TAIL] != flow[layout.HEAD]
        ):  # between two blocks
            self._slowed.add(self._block_of_row[flow[layout.TAIL]])

    @property
    def _row_size(self) -> int:
        return self.planner.flow[layout.ROW_SIZE]

    def _keep(self, at: int) -> None:
        block = self._block(at)
        self._block_of_row[at] = block
        self.planned.append(block)

    def row(self, at: int) -> "array[int]":
        """Return a row of the ring."""
        size = self.planner.flow[layout.ROW_SIZE]
        return self.planner.ring[at * size : (at + 1) * size]

    def _block(self, at: int) -> Block:
        row = self.row(at)
        axes = range(self.planner.axes)
        steps = [row[layout.STEPS + i] for i in axes]
        motors = tuple(-n if row[layout.DIRS] >> i & 1 else n for i, n in enumerate(steps))
        # CoreXY: as in Grbl, length and limits are the motors'.
        mm = [n / r for n, r in zip(motors, self.limits.steps_per_mm, strict=True)]
        length = sqrt(sum(x * x for x in mm))
        return Block(motors, tuple(x / length for x in mm), length, self.limits)

    def queue(self) -> "list[tuple[Block, array[int]]]":
        """Return each queued block with its row of the ring, the one being executed first."""
        flow = self.planner.flow
        at = flow[layout.TAIL]
        found = []
        while at != flow[layout.HEAD]:
            found.append((self._block_of_row[at], self.row(at)))
            at = (at + 1) % flow[layout.ROWS]
        return found

    def promise(self, row: "array[int]", column: int) -> float:
        """Return a scaled squared speed of a row in mm/s."""
        return sqrt(row[column] / real(self.planner.table[layout.SQR_SCALE]))

    def top(self) -> float:
        """Return the highest speed that the planner can represent."""
        return sqrt(2**30 / real(self.planner.table[layout.SQR_SCALE])) * 0.999

    def next(self, row: "array[int]") -> int:
        """Replace Segments.next."""
        flow = self.planner.flow
        loaded = flow[layout.LOADED]
        speed = layout.ROW_SPEED if flow[layout.SLICES] else layout.END_SPEED
        at_rest = flow[speed if loaded else layout.JOIN_SPEED] == 0
        left = self._left() if loaded else 0
        spare = flow[layout.SPARE_TICKS] if loaded else 0
        row[ROW_TICKS] = 0
        found = self._next(row)
        at = flow[layout.BLOCK_AT] // flow[layout.ROW_SIZE]
        block = self._block_of_row.get(at)
        if block is None:
            return found
        ended = not flow[layout.LOADED]
        segment = None
        if found:
            start = self.made[-1].start + self.made[-1].ticks if self.made else 0
            segment = Segment(block, start, row[:], ended)
            self.made.append(segment)
        time = row[ROW_TICKS] + flow[layout.SPARE_TICKS] - spare
        if row[ROW_TICKS] and time:
            distance = ((left or block.events << 18) - self._left()) / 2**18
            distance *= block.length / block.events
            speed = flow[layout.ROW_SPEED] / real(self.row(at)[layout.FACTOR])
            unit = 2**-16 if self.planner.table[layout.JUNCTION_DERATE] else 0.0
            seconds = time / self.tick_hz
            promise = self._promised(block, speed) if ended else inf
            piece = Piece(block, distance, seconds, speed, ended, at_rest, segment, unit, promise)
            self.pieces.append(piece)
        return found

    def _promised(self, block: Block, speed: float) -> float:
        """Return the highest planned speed at the end of the block just finished."""
        flow, table = self.planner.flow, self.planner.table
        at = flow[layout.TAIL]
        if flow[layout.SYSTEM] or at == flow[layout.HEAD]:
            return 0.0
        promise = self.promise(self.row(at), layout.ENTRY_SQR)
        if table[layout.JUNCTION_DERATE]:  # the average exceeds its plan by this
            promise += (
                block.acceleration * real(table[layout.JUNCTION_DERATE]) * real(table[ROOT_SCALE])
            )
        if block in self._slowed:
            if speed > promise:
                self._slowed.add(self._block_of_row[at])
            return inf
        return promise

    def _left(self) -> int:
        """Return the remaining distance of the profile, in 2**-18 steps of the longest axis."""
        flow = self.planner.flow
        return (
            (flow[layout.STEPS_LEFT] << 18)
            + flow[layout.FRACTION_LEFT]
            + flow[layout.PLANNED_DISTANCE]
        )


class Bench:
    """Planner and segments without the rest of the machine."""

    def __init__(
        self,
        limits: "Limits | None" = None,
        blocks: int = 16,
        tick_hz: int = TICK_HZ,
        segment_log2: int = SEGMENT_LOG2,
    ) -> None:
        self.limits = limits = limits or Limits()
        axes = len(limits.rate)
        self.state = State()
        kinematics = Kinematics(axes, limits.moves) if limits.moves else None
        self.planner = Planner(axes, blocks, kinematics, self.state)
        self.planner.configure(limits.settings(), tick_hz, segment_log2, limits.step_hz)  # type: ignore[arg-type]
        self.planner.override()
        self.segments = Segments(self.planner)
        self.watch = Watch(self.planner, self.segments, limits, tick_hz)
        self._row = array("i", [0] * layout.row_length(self.planner.motors))
        self._target = vector(axes)
        self._move = Move()

    def line(self, target: Sequence[float], feed: float = 0, flags: int = 0) -> bool:
        """Plan a line to a position in mm; feed 0 is a rapid. Makes space first."""
        while self.planner.full():
            if not self.pull():
                raise AssertionError("a full planner, and nothing moves")
        self._target[:] = array("f", target)
        self._move.clear()
        self._move.feed = feed
        self._move.flags = flags | (0 if feed else 1)
        return self.planner.line(self._target, self._move, 0)

    def pull(self, count: int = 1) -> bool:
        """Make segments as the engine would request them."""
        return all(self.segments.next(self._row) for _ in range(count))

    def override(self, feed: int, rapid: int = 100) -> None:
        """Set the overrides."""
        self.state.feed_override = feed
        self.state.rapid_override = rapid
        self.planner.override()
        check_plan(self.watch)

    def hold(self) -> None:
        """Hold, come to rest, resume."""
        self.segments.hold(True)
        self.finish()
        self.watch.rests.add(len(self.watch.made))
        self.segments.hold(False)

    def finish(self) -> None:
        """Execute everything planned."""
        most = 1_000_000
        while self.segments.next(self._row):
            most -= 1
            assert most, "motion does not end"

    def check(self) -> None:
        """Execute everything planned, and check all laws."""
        self.finish()
        assert self.planner.empty()
        check_segments(self.watch)
        check_even(self.watch)
        check_pulses(self.watch, [(segment.start, segment.row) for segment in self.watch.made])


def check_plan(watch: Watch) -> None:
    """Check that every planned entry speed can be kept: reached within limits, and braked from."""
    queue = watch.queue()
    speeds = [watch.promise(row, layout.ENTRY_SQR) for _, row in queue]
    for i, (block, row) in enumerate(queue):
        if i == 0:
            continue  # being executed, or about to be, from rest
        entry = speeds[i]
        leave = speeds[i + 1] if i + 1 < len(queue) else 0.0
        way = 2 * block.acceleration * block.length
        assert entry**2 <= (leave**2 + way) * PROMISE_SLACK + _least(watch), "cannot brake"
        before, row_before = queue[i - 1]
        nominals = [real(row[layout.NOMINAL]), real(row_before[layout.NOMINAL])]
        assert entry <= min(nominals) * PROMISE_SLACK + _least(watch), "faster than nominal"
        corner = before.junction(block)
        assert entry <= corner * JUNCTION_SLACK + _least(watch), "corner too fast"
        if watch.planner.table[layout.JUNCTION_DERATE]:
            continue  # with a jerk limit corners are slower
        slower = before.junction(block, -1) / JUNCTION_SLACK
        junction = watch.promise(row, layout.JUNCTION_SQR)
        assert junction >= min(slower, watch.top()) - _least(watch), "corner too slow"


def _least(watch: Watch) -> float:
    """Return the error of a scaled square, in mm/s (or in its square, where that is less)."""
    return sqrt(2 / real(watch.planner.table[layout.SQR_SCALE]))


def check_segments(watch: Watch) -> None:
    """Check the speed along the path: from rest to rest, no jump, within every axis' limits."""
    _check_rows(watch)
    hz = watch.tick_hz
    pieces = watch.pieces
    for piece in pieces:
        assert piece.mean <= piece.block.speed * RATE_SLACK + piece.grain(hz), "rate of an axis"
        planned = piece.promise * RATE_SLACK + _least(watch)
        assert piece.speed <= planned + piece.block.braked(_END_PART), "braked too late"
    for before, after in pairwise(pieces):
        if after.from_rest:
            _check_rest(before, hz)
            _check_rest(after, hz)
            continue
        change = before.change(hz) + after.change(hz)
        assert abs(after.mean - before.mean) <= change * ACCELERATION_SLACK, "acceleration"
        # With a jerk limit: a corner of the step grid is no corner.
        limited = watch.planner.table[layout.JUNCTION_DERATE]
        if before.ends_block and not (limited and before.block.bend(after.block) < _GRID):
            corner = before.block.junction(after.block) * JUNCTION_SLACK + _least(watch)
            assert before.speed <= corner + before.block.braked(_END_PART), "corner taken too fast"
    if pieces:
        _check_rest(pieces[0], hz)
        _check_rest(pieces[-1], hz)


def _check_rest(piece: Piece, hz: int) -> None:
    change = piece.change(hz) * ACCELERATION_SLACK + piece.block.braked(_END_PART)
    assert piece.mean <= change, "not from rest, or not to rest"


def _check_rows(watch: Watch) -> None:
    """Check that rows are in order, and that a block makes exactly its planned steps."""
    made: dict[Block, list[int]] = {}
    for segment in watch.made:
        sums = made.setdefault(segment.block, [0] * len(segment.block.motors))
        assert segment.ticks > 0
        for i in range(len(segment.block.motors)):
            count, first, last = segment.axis(i)
            assert count >= 0
            sums[i] += count
            if count:
                assert 0 <= first <= last <= segment.ticks
                assert count == 1 or first < last
                planned = segment.block.motors[i]
                assert (segment.row[ROW_DIRS] >> i & 1) == (planned < 0), "wrong direction"
        if segment.ends_block:
            planned = [abs(n) for n in segment.block.motors]
            assert sums == planned, "steps made are not those planned"


Rows = Sequence["tuple[int, array[int]]"]


def pulses(rows: Rows, axis: int) -> "Iterator[tuple[int, int]]":
    """Yield (tick, direction) of every pulse of a motor."""
    base = ROW_AXES + ROW_STRIDE * axis
    for start, row in rows:
        sign = -1 if row[ROW_DIRS] >> axis & 1 else 1
        for k in range(row[base]):
            yield start + step_tick(row, base, k), sign


@dataclass
class Train:
    """The pulses of one motor."""

    ticks: list[int] = field(default_factory=list)
    net: int = 0
    total: int = 0


def check_pulses(watch: Watch, rows: Rows, pulse_us: float = 10) -> None:
    """Check that pulses are those planned, within the axis' rate, and far enough apart."""
    limits = watch.limits
    hz = watch.tick_hz
    for i in range(watch.planner.axes):
        train = list(pulses(rows, i))
        ticks = [tick for tick, _ in train]
        assert ticks == sorted(ticks)
        planned = [block.motors[i] for block in watch.planned]
        assert sum(sign for _, sign in train) == sum(planned), "net steps"
        assert len(train) == sum(map(abs, planned)), "pulses"
        check_spacing(train, hz, pulse_us)
        _check_density(ticks, limits.speed(i) * limits.steps_per_mm[i] / hz)


def check_spacing(train: "list[tuple[int, int]]", hz: int, pulse_us: float) -> None:
    """Check that a pulse ends before the next, and that a new direction is set early enough."""
    pulse = pulse_us * hz / 1_000_000
    setup = SETUP_US * hz / 1_000_000
    for (before, was), (tick, sign) in pairwise(train):
        assert tick - before >= pulse, "a step within the last one's pulse"
        assert sign == was or tick - before >= pulse + setup, "a step too soon after a reversal"


def _check_density(ticks: "list[int]", rate: float) -> None:
    """Check that every time window has at most two steps more than the axis' rate explains."""
    rate *= RATE_SLACK
    # Steps as a queue that the rate empties: it never holds more than three.
    waiting = 0.0
    before = 0
    for tick in ticks:
        waiting = max(waiting - (tick - before) * rate, 0.0) + 1
        before = tick
        assert waiting <= 3 + 1e-6, "steps faster than the axis may go"


def off_line(trains: "Sequence[Sequence[float]]") -> float:
    """Return the largest distance of a line's steps from the line, in steps: rounding makes 0.5.

    trains: when each motor steps, in order. When a motor makes step k of n (from 0), the line is
    at
    (k + 1/2) / n of its length; motors with fewer steps are there too, within half a step.
    """
    worst = 0.0
    for b, a in combinations(sorted((train for train in trains if train), key=len), 2):
        for k, time in enumerate(a):
            due = (k + 0.5) / len(a) * len(b)
            made = bisect_left(b, time), bisect_right(b, time)
            worst = max(worst, min(abs(due - n) for n in made))
    return worst


def uneven(ticks: Sequence[int]) -> float:
    """Return the largest deviation of intervals from their mean: in ticks, or in 1 % of the
    mean."""
    intervals = [b - a for a, b in pairwise(ticks)]
    mean = (ticks[-1] - ticks[0]) / len(intervals)
    return max(abs(n - mean) for n in intervals) / max(1.0, 0.01 * mean)


def check_even(watch: Watch) -> None:
    """Check that at constant speed every motor's steps are even, also between segments."""
    pieces = iter(watch.pieces)
    stretch: list[Segment] = []
    steady = None
    for at, segment in enumerate(watch.made):
        piece = next(p for p in pieces if p.segment is segment)
        same = steady and steady.block is piece.block and near(piece.mean, steady.speed, 1e-4)
        if not same or at in watch.rests:
            _check_stretch(stretch)
            stretch = []
        stretch.append(segment)
        steady = piece if near(piece.mean, piece.speed, 1e-4) else None
        if not steady:
            stretch = []
    _check_stretch(stretch)


def _check_stretch(stretch: "list[Segment]") -> None:
    # A fraction of a step is carried over from the ramp, and disappears after some segments.
    rows = [(segment.start, segment.row) for segment in stretch[_SETTLED:]]
    for i in range(len(stretch[0].block.motors) if stretch else 0):
        ticks = [tick for tick, _ in pulses(rows, i)]
        if len(ticks) > 2:
            assert uneven(ticks) <= 1, "uneven steps at a constant speed"


def some(count: int) -> settings:
    """Return settings for `count` examples in the second ring, a quarter in the first, forty times
    as
    many in a thorough run."""
    return settings(max_examples=max(1, count * settings.default.max_examples // 50))


def near(got: float, expected: float, part: float) -> bool:
    """Return whether they differ by at most this fraction."""
    return abs(got - expected) <= part * abs(expected)
