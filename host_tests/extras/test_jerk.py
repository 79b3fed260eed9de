"""Test the limit of jerk: acceleration changes over a time, and all other laws hold.

The laws are those of laws.py: limits of rate and acceleration, junction speeds, even steps,
pulses. line() plans a target in mm at a feed in mm/min, and feed 0 is a rapid. pull(n) generates n
segments of motion. check() executes the rest, and checks all laws.
Machine is the whole simulated machine; its play(lines, events) also sends real-time bytes at their
ms.
"""

from array import array
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate
from math import cos, inf, radians, sin, tau
from types import ModuleType
from typing import Any

import pytest
from extras.motors import jerk_layout
from extras.motors.jerk import Jerk
from hypothesis import given
from hypothesis import strategies as st
from laws import (
    SEGMENT_LOG2,
    TICK_HZ,
    Bench,
    Block,
    Limits,
    Watch,
    check_pulses,
    check_segments,
    real,
    some,
)
from micropython_runner import needs_micropython, run_micropython
from motion import layout
from motion.kinematics import COREXY
from motion.layout import DYNAMIC
from motion.planner import Move
from rig_bench import Machine
from test_laws import (
    actions,
    any_limits,
    blocks,
    check_position,
    circle,
    events,
    fast,
    harmless,
    jogs,
    machines,
    plunges,
    reversals,
    single_steps,
    slow,
    staircase,
    zigzag,
)
from ugrbl.boardfile.files import load_board
from ugrbl.paths import FIRMWARE
from ugrbl.sim.engine import Switch

# Many cases: the first ring runs a sample of them.
pytestmark = pytest.mark.sampled(2)

# Accelerations have 14 bits, steps are rounded as in largest_jerk(), and braking to a place may be
# harder by a sixteenth (segment_kernel.brake).
JERK_SLACK = 1.15
# As in laws.py.
_END_PART = 1 / 20  # part of a step before the end, where braking may be harder


class JerkBench(Bench):
    """Planner and segments with limited jerk in mm/s3, one value per axis; 0 is no limit."""

    def __init__(
        self,
        limits: Limits,
        jerk: Sequence[float],
        blocks: int = 16,
        tick_hz: int = TICK_HZ,
        segment_log2: int = SEGMENT_LOG2,
    ) -> None:
        """blocks: of the planner. segment_log2: a segment has 2**segment_log2 ticks."""
        super().__init__(limits, blocks, tick_hz, segment_log2)
        self.jerk = tuple(jerk)
        hooks = self.state.hooks
        # The watch records the segments of its _next, first unfiltered ones. Jerk() replaces the
        # function in the hook by one that filters its segments: then the watch records those.
        hooks.next_segment = self.watch._next
        self.smoother = Jerk(self.planner, self.state)
        self.watch._next = hooks.next_segment
        # A segment lasts 2**SEGMENT_LOG2 ticks; the filter averages over a number of segments.
        self.slot_s = (1 << self.planner.table[layout.SEGMENT_LOG2]) / tick_hz
        self.smoother.limit(list(limits.acceleration), list(jerk), self.slot_s)

    def finish(self) -> None:
        """Execute all planned motion."""
        self.planner.catch_up()
        super().finish()

    @property
    def slots(self) -> int:
        """Return the number of segments over which speed is averaged."""
        return self.smoother._line[jerk_layout.FILTER_TAPS]

    @property
    def time_s(self) -> float:
        """Return the time over which speed is averaged, in s."""
        return self.slots * self.slot_s

    def check(self) -> None:
        """Check all laws; if jerk is limited, also that it stays within its limit."""
        super().check()
        if self.slots:
            assert largest_jerk(self) <= JERK_SLACK


class Course:
    """The machine's distance on its path in mm, by time in s."""

    def __init__(self, watch: Watch) -> None:
        """watch: the record of a motion in pieces, each with its time, distance and speeds."""
        self._pieces = watch.pieces
        self._times = [0.0, *accumulate(piece.time for piece in watch.pieces)]
        self._distances_mm = [0.0, *accumulate(piece.distance for piece in watch.pieces)]
        self.end = self._times[-1]
        # The blocks in the order of motion, each once.
        self.all = list(dict.fromkeys(piece.block for piece in watch.pieces))

    def at(self, time: float) -> float:
        """Return the distance in mm at a time in s."""
        if time >= self.end:
            return self._distances_mm[-1]
        if time <= 0:
            return 0.0
        i = bisect_right(self._times, time) - 1
        piece, since_s = self._pieces[i], time - self._times[i]
        # A piece has constant acceleration: its mean speed is that of begin and end.
        begin_speed = 2 * piece.mean - piece.speed
        return (
            self._distances_mm[i]
            + begin_speed * since_s
            + (piece.speed - begin_speed) * since_s**2 / 2 / piece.time
        )

    def blocks(self, begin: float, end: float) -> "list[Block]":
        """Return the block of each piece between these times in s."""
        first = max(bisect_right(self._times, begin) - 1, 0)
        last = bisect_right(self._times, end)
        return [piece.block for piece in self._pieces[first:last]]


def allowed(block: Block, jerk: Sequence[float]) -> float:
    """Return the allowed jerk along a block, mm/s3; an axis with 0 has no limit."""
    return block.limits.along(block.unit, [j or inf for j in jerk])


def largest_jerk(bench: "JerkBench") -> float:
    """Return the largest jerk on the path, as a ratio to the jerk that the axes allow.

    Jerk is the third difference of distance over windows of time. They are long enough that an
    error of a tenth of a step changes the result by at most a tenth: the coefficients 1, 3, 3 and
    1 add up to 8. The end of braking, within _END_PART of a step, may be harder: that change of
    speed is subtracted.
    """
    course = Course(bench.watch)
    step_windows_s = [
        (8 * block.step / allowed(block, bench.jerk)) ** (1 / 3) for block in course.all
    ]
    window_s = max([2 * bench.slot_s, *step_windows_s])
    largest = 0.0
    time = -3 * window_s
    while time < course.end:
        a, b, c, d = (course.at(time + i * window_s) for i in range(4))
        if blocks := course.blocks(time, time + 3 * window_s):
            jerk_mm_s3 = abs(d - 3 * c + 3 * b - a) / window_s**3
            jerk_mm_s3 -= (
                max(block.braked(_END_PART) for block in blocks) / bench.time_s / window_s
            )
            largest = max(
                largest, jerk_mm_s3 / max(allowed(block, bench.jerk) for block in blocks)
            )
        time += window_s / 4
    return largest


programs = pytest.mark.parametrize(
    "program", [zigzag, staircase, reversals, plunges, slow, single_steps]
)
jerks = pytest.mark.parametrize("jerk", [(2000.0,) * 3, (30_000.0, 30_000.0, 4000.0)])


@programs
@jerks
@pytest.mark.parametrize("limits", [Limits(), fast], ids=["factory", "fast"])
def test_examples_keep_every_law(program, limits: Limits, jerk) -> None:
    bench = JerkBench(limits, jerk)
    program(bench)
    bench.check()


@programs
def test_corexy_keeps_every_law_of_its_motors(program) -> None:
    bench = JerkBench(replace(fast, moves=COREXY), jerk=(20_000.0,) * 3)
    program(bench)
    bench.check()


@pytest.mark.parametrize("chords", [24, 300])
def test_circle_of_chords_keeps_every_law(chords: int) -> None:
    bench = JerkBench(fast, jerk=(20_000.0,) * 3)
    circle(bench, radius=4.0, chords=chords, feed=2400)
    bench.check()


@pytest.mark.parametrize("segment_log2", [12, 14, 17])
def test_coarse_ticks_and_short_segments_keep_every_law(segment_log2: int) -> None:
    bench = JerkBench(fast, jerk=(20_000.0,) * 3, tick_hz=1_000_000, segment_log2=segment_log2)
    zigzag(bench)
    bench.check()


@pytest.mark.parametrize("after", [1, 7, 20, 33, 40, 61, 90])
def test_hold_at_any_moment_keeps_every_law(after: int) -> None:
    """fast and 20,000: the limits of speed and acceleration, and of jerk in mm/s3."""
    bench = JerkBench(fast, jerk=(20_000.0,) * 3)
    zigzag(bench)
    bench.pull(after)  # this number of segments
    bench.hold()
    bench.check()


@pytest.mark.parametrize("after", [1, 7, 20, 33, 40])
def test_hold_released_before_the_stop_keeps_every_law(after: int) -> None:
    """The machine brakes for a hold, and speeds up again before it has stopped."""
    bench = JerkBench(fast, jerk=(20_000.0,) * 3)
    zigzag(bench)
    bench.pull(40)  # segments: in full motion
    bench.segments.hold(True)
    bench.pull(after)  # fewer segments than braking takes
    bench.segments.hold(False)
    bench.check()


@pytest.mark.parametrize("feed", [10, 200])
@pytest.mark.parametrize("after", [1, 7, 20, 40])
def test_override_at_any_moment_keeps_every_law(feed: int, after: int) -> None:
    """The feed override changes in motion, and once more after as many segments."""
    bench = JerkBench(fast, jerk=(20_000.0,) * 3)
    zigzag(bench)
    bench.pull(after)  # this number of segments
    bench.override(feed)  # feed in %
    bench.pull(after)
    bench.override(100)
    bench.check()


@pytest.mark.parametrize("after", [1, 3, 10, 30, 55, 80])
def test_clearing_in_motion_leaves_nothing_in_the_filter(after: int) -> None:
    """A reset and a probe's contact clear the planner in motion.

    A program that follows must make the same segments as on a new bench.
    """
    bench = JerkBench(fast, jerk=(20_000.0,) * 3)
    bench.line((3, 1, 0), 2000)
    bench.line((3, 4, 0), 2000)
    bench.pull(after)  # this number of segments
    bench.planner.clear()
    assert not bench.pull()  # no segment is left
    fresh = JerkBench(fast, jerk=(20_000.0,) * 3)
    for each in (bench, fresh):
        each.planner.sync_motors(array("i", (0, 0, 0)))
        made_before = len(each.watch.made)
        # A new row for finish() to fill: nothing of the old motion is left in it.
        each._row = array("i", [0] * layout.row_length(motors=3))
        zigzag(each)
        each.finish()
        each.rows = [segment.row for segment in each.watch.made[made_before:]]
    assert bench.rows == fresh.rows


@some(10)
@given(
    any_limits(3),
    st.tuples(*[st.sampled_from([0.0, 100.0, 2000.0, 50_000.0, 1e6])] * 3),
    st.lists(actions(3), min_size=5, max_size=30),
)
def test_random_programs_keep_every_law(limits: Limits, jerk, program) -> None:
    """A program is a list of the bench's methods with arguments. Its lines are relative."""
    bench = JerkBench(limits, jerk)
    target_mm = (0.0, 0.0, 0.0)
    for name, *arguments in program:
        if name == "line":
            target_mm = tuple(a + b for a, b in zip(target_mm, arguments[0], strict=True))
            arguments[0] = target_mm
        getattr(bench, name)(*arguments)
    bench.check()


@pytest.mark.parametrize("segments_before", [9, 40, 77])
def test_parking_moves_between_two_halves_of_a_block(segments_before: int) -> None:
    """A hold stops a block in its middle.

    Two moves of the system (parking) follow, then the rest of the block.
    """
    steps_per_mm, jerk_mm_s3 = 250, 20_000.0  # steps_per_mm is that of `fast`
    is_executed = 2  # value of flow[SYSTEM]: see layout.py
    bench = JerkBench(fast, jerk=(jerk_mm_s3,) * 3)
    zigzag(bench)
    bench.pull(segments_before)
    bench.segments.hold(True)
    bench.finish()
    made = bench.watch.made
    motors = array("i", [sum(s.axis(i)[0] for s in made) for i in range(3)])  # in steps
    move = Move()
    move.flags = layout.SYSTEM_MOTION | layout.RAPID_MOTION
    bench.segments.begin_system()
    bench.segments.hold(False)
    for place_mm in ((1.0, 2.0, 3.0), (0.0, 0.0, 0.0)):
        assert bench.planner.system_line(array("f", place_mm), move, power=0, start=motors)
        bench.finish()
        assert bench.planner.flow[layout.SYSTEM] == is_executed
        motors[:] = array("i", [round(steps_per_mm * mm) for mm in place_mm])
    bench.segments.end_system()
    bench.check()


@pytest.mark.parametrize("per_mm", [5.0, 26.667, 250.0, 20_000.0, 300_000.0])
@pytest.mark.parametrize("feed", [1, 30])
def test_slow_motion_and_any_resolution_keep_every_law(per_mm: float, feed: int) -> None:
    """From 5 steps/mm to 300,000 steps/mm, at 1 or 30 mm/min."""
    # Steps/mm, mm/min, mm/s2, and a jerk of 2000 mm/s3.
    bench = JerkBench(Limits((per_mm,) * 3, (300.0,) * 3, (50.0,) * 3), (2000.0,) * 3)
    length_mm = max(0.02, 3 / per_mm)  # at least three steps
    bench.line((length_mm, 0, 0), feed)
    bench.line((2 * length_mm, length_mm / 3, 0), feed)
    bench.check()


def test_line_too_long_for_the_filter_is_entered_and_left_at_rest() -> None:
    """The line of 19,900 mm lasts too long for averaging: its entry speed and exit speed are 0."""
    bench = JerkBench(Limits((1.0,) * 3, (600_000.0,) * 3, (5000.0,) * 3), (100_000.0,) * 3)
    for x_mm in (100.0, 20_000.0, 20_200.0):
        bench.line((x_mm, 0, 0), 0)
    queue = bench.watch.queue()
    assert [row[layout.ENTRY_SQR] for _, row in queue] == [0, 0, 0]
    bench.finish()
    assert sum(segment.axis(0)[0] for segment in bench.watch.made) == 20_200  # 1 step/mm


_ROWS = """
from array import array

from base.state import State
from extras.motors.jerk import Jerk
from motion import layout
from motion.planner import Move, Planner
from motion.segments import Segments


class Settings:
    steps_per_mm = array("f", [250.0, 80.0, 4000.0])
    max_rate = array("f", [3000.0, 5000.0, 500.0])
    acceleration = array("f", [360000.0, 3600000.0, 36000.0])
    junction_deviation_mm = 0.01


state = State()
planner = Planner(3, 16, None, state)
planner.configure(Settings, 13107200, 17, 90909)
segments = Segments(planner)
state.hooks.next_segment = segments.next
jerk = Jerk(planner, state)
jerk.limit([100.0, 1000.0, 10.0], [2000.0, 20000.0, 500.0], 0.01)
planner.override()
row = array("i", [0] * layout.row_length(3))
move = Move()
seen = 0
for i in range(40):
    target = array("f", [0.7 * (i % 5), 0.11 * i, -0.01 * (i // 9)])
    move.feed = 900.0 if i % 7 else 200.0
    planner.line(target, move, 0)
    while planner.full() or (i == 39 and not planner.empty()):
        segments.hold(seen % 97 > 80)
        jerk.next(row)
        for number in row:
            seen = (seen * 31 + number) & 0xFFFFFF
print(seen)
"""


@needs_micropython
def test_both_pythons_make_the_same_rows(capsys: pytest.CaptureFixture[str]) -> None:
    """_ROWS plans 40 lines with limited jerk, and prints a checksum of all rows of steps."""
    exec(_ROWS, {})
    assert run_micropython(_ROWS, paths=[FIRMWARE]) == capsys.readouterr().out


# Cost in time


def duration(limits: Limits, jerk: float, program) -> "tuple[float, JerkBench]":
    """Return the time of a program in s, and its bench; jerk in mm/s3, 0: no limit."""
    bench = JerkBench(limits, jerk=(jerk,) * 3)
    program(bench)
    bench.finish()
    last_segment = bench.watch.made[-1]
    return (last_segment.start + last_segment.ticks) / TICK_HZ, bench


@pytest.mark.parametrize("jerk", [5000.0, 20_000.0, 100_000.0])
def test_each_stop_takes_longer_by_the_filters_time_and_at_most_a_segment(jerk) -> None:
    """Six rapids, to and fro, stop six times.

    Each stop costs bench.time_s, over which speed is averaged; slot_s is a segment.
    """

    def stops(bench: Bench) -> None:
        for i in range(6):  # six rapids, to and fro
            bench.line((20.0 * ((i + 1) % 2), 0, 0))

    limits = Limits((250.0,) * 3, (6000.0,) * 3, (1000.0,) * 3)
    unlimited_s, _ = duration(limits, 0, stops)
    limited_s, bench = duration(limits, jerk, stops)
    # The acceleration of 1000 mm/s2 is reached, on average of the filter, at half of the jerk.
    assert bench.time_s == pytest.approx(2 * 1000 / jerk, abs=bench.slot_s)
    assert 0 <= (limited_s - unlimited_s) / 6 - bench.time_s <= bench.slot_s * 1.01


def test_curve_of_short_lines_takes_longer_only_at_its_ends() -> None:
    """A circle of 600 lines does not stop within: only its ends cost the time of the filter."""

    def curve(bench: Bench) -> None:
        circle(bench, radius=20.0, chords=600, feed=2400)

    limits = Limits((250.0,) * 3, (6000.0,) * 3, (1000.0,) * 3)
    unlimited_s, _ = duration(limits, 0, curve)
    limited_s, bench = duration(limits, 40_000.0, curve)
    assert limited_s - unlimited_s <= bench.time_s + bench.slot_s * 1.01


def polygon(length: float, lines: int) -> Any:
    """Return a program: a circle of this number of lines of this length, in mm."""

    def program(bench: Bench) -> None:
        radius = length * lines / tau
        for k in range(1, lines + 1):
            angle = tau * k / lines
            bench.line((radius * cos(angle) - radius, radius * sin(angle), 0), 6000)

    return program


def folded(length: float, degrees: float) -> Any:
    """Return a program: a zigzag of forty lines of this length in mm, with these corners."""

    def program(bench: Bench) -> None:
        half_angle = radians(degrees / 2)
        for k in range(1, 41):
            bench.line((k * length * cos(half_angle), length * sin(half_angle) * (k % 2), 0), 6000)

    return program


def rounded(bench: Bench) -> None:
    """Plan twelve lines of 5 mm at right angles, and ten of 0.02 mm round each corner."""
    x = y = 0.0
    for k in range(12):
        for n in range(11):
            direction = tau / 4 * (k + n / 10)
            length_mm = 0.02 if n < 10 else 5.0
            x, y = x + length_mm * cos(direction), y + length_mm * sin(direction)
            bench.line((x, y, 0), 6000)


@pytest.mark.sampled(20)
@pytest.mark.parametrize(
    ("program", "most"),
    [
        pytest.param(polygon(0.015, 900), 1.3, id="900 lines of 0.015 mm"),
        pytest.param(polygon(0.05, 900), 1.2, id="900 lines of 0.05 mm"),
        pytest.param(polygon(0.2, 600), 1.12, id="600 lines of 0.2 mm"),
        pytest.param(folded(0.1, 30), 1.8, id="zigzag of 0.1 mm"),
        pytest.param(folded(1.0, 30), 1.75, id="zigzag of 1 mm"),
        pytest.param(folded(1.0, 90), 2.9, id="zigzag of 1 mm, right angles"),
        pytest.param(folded(5.0, 45), 1.7, id="zigzag of 5 mm"),
        pytest.param(rounded, 2.9, id="rounded corners"),
    ],
)
def test_short_lines_take_little_longer(program: Any, most: float) -> None:
    """The limit of jerk costs at most this factor of time.

    A filter that has to stop at each corner would cost 51, 2.7, 1.1, 22, 4.4, 3.6, 2.1 and 4.7, in
    the order of the cases.
    """
    limits = Limits((80.0,) * 3, (6000.0,) * 3, (1000.0,) * 3)
    durations_ticks = []
    for jerk in (0.0, 20_000.0):
        bench = JerkBench(limits, jerk=(jerk,) * 3, blocks=64)
        program(bench)
        bench.check()
        last_segment = bench.watch.made[-1]
        durations_ticks.append(last_segment.start + last_segment.ticks)
    assert durations_ticks[1] <= most * durations_ticks[0]


def test_acceleration_is_reduced_if_the_filter_would_be_too_long() -> None:
    """1000 mm/s2 at a jerk of 100 mm/s3 would need a filter of 20 s."""
    limits = Limits((250.0,) * 3, (6000.0,) * 3, (1000.0,) * 3)
    bench = JerkBench(limits, jerk=(100.0,) * 3)
    bench.line((20, 0, 0))
    bench.check()
    assert bench.slots == 64  # the most; of 0.01 s each
    row = bench.planner.ring[: bench.planner.flow[layout.ROW_SIZE]]  # the only planned line
    # Jerk times the filter's 0.64 s, by two: the average of a ramp.
    assert real(row[layout.ACCEL]) == pytest.approx(100.0 * 0.64 / 2, rel=1e-3)


@pytest.mark.parametrize("blocks", [3, 64])
def test_short_and_long_rings_keep_every_law(blocks: int) -> None:
    bench = JerkBench(fast, jerk=(20_000.0,) * 3, blocks=blocks)
    circle(bench, radius=4.0, chords=300, feed=2400)
    bench.check()


def test_power_follows_the_speed_of_the_segments() -> None:
    """Dynamic power (M4) is proportional to speed, here to that after the filter."""
    bench = JerkBench(fast, jerk=(20_000.0,) * 3)
    bench.planner.table[layout.POWER_MAX] = 1000
    # 2400 mm/min are 40 mm/s.
    bench.line((6.0, 2.0, 0.0), 2400, DYNAMIC)
    bench.planner.ring[layout.POWER] = 1000 << 6  # of the first row; in 1/64 of a level
    bench.finish()
    pieces = [piece for piece in bench.watch.pieces if piece.segment]
    assert max(piece.segment.row[layout.ROW_POWER] for piece in pieces) == 1000
    for piece in pieces:
        assert piece.segment.row[layout.ROW_POWER] == pytest.approx(piece.speed / 40 * 1000, abs=2)


@pytest.mark.parametrize("unfilled_ticks", range(0, 200, 7))
def test_unused_rest_of_a_slot_does_not_lengthen_the_next(unfilled_ticks: int) -> None:
    """The end of motion may leave a few ticks of a segment unfilled (here set by hand).

    Added to the next segment, they would be time that no ramp includes.
    """
    bench = JerkBench(fast, jerk=(20_000.0,) * 3)
    bench.line((3, 1, 0), 2000)
    bench.line((6, 1, 0), 2000)
    bench.pull(9)  # segments: in motion
    bench.segments.hold(True)
    bench.finish()
    bench.smoother._line[layout.TIME_TO_FILL] = unfilled_ticks
    bench.segments.hold(False)
    bench.check()


# The whole machine


def board(**words: Any) -> ModuleType:
    """Return the simulator's board with the module for limited jerk, and other options."""
    module = ModuleType("board")
    vars(module).update({**vars(load_board("sim_jerk")), **words})
    return module


LIMITED = {800: 20_000.0, 801: 20_000.0, 802: 5000.0}  # jerk in mm/s3 of X, Y and Z


def played(machine: Machine, lines: "list[str]", bytes_: "list[tuple[int, str]]") -> Any:
    """Return the step rows that a machine has made of a program, and its output."""
    machine.play(lines, bytes_)
    return machine.rows, machine.received


JOB = [
    "G21G91F2000",
    "G1X5Y1",
    "G1X.1",
    "G1X.1Y.02",
    "G2X3I1.5F900",
    "G0Z-2",
    "G1X-8F3000",
    "$J=X1F500",
]
# At ms: a hold and its end, feed override +10 % and -10 %, a report.
EVENTS = [(150, "!"), (500, "~"), (600, "\x91"), (900, "?"), (1200, "\x92")]


def test_board_with_the_limit_off_moves_like_one_without_the_module() -> None:
    """JOB has lines, an arc and a jog.

    EVENTS are a hold, its end, a report, and feed overrides.
    """
    # Rates in mm/min and accelerations in mm/s2 of X and Y. $800 to $802 (jerk) are 0.
    settings = {110: 3000.0, 111: 3000.0, 120: 200.0, 121: 200.0}
    assert played(Machine(settings, board()), JOB, EVENTS) == played(
        Machine(settings), JOB, EVENTS
    )


def test_removed_limit_leaves_no_effect() -> None:
    """Moves with a limit that is set back to 0 do not change the steps of the lines after it."""
    lines = [*JOB, "G1X5Y1", "G4P0"]
    plain, limited = Machine(board=board()), Machine(board=board())
    plain.play(["$800=0", *lines])
    limited.play(["$800=9000", "G91G1X.1F300", "G1X-.1", "$800=0", *lines])
    plain_rows = [row for _, row in plain.rows]
    assert [row for _, row in limited.rows][-len(plain_rows) :] == plain_rows


def test_long_ring_is_streamed_to_its_last_line() -> None:
    """A planner with 64 blocks receives 200 short lines, a hold and its end."""
    lines = [f"G1X{0.05 * (1 + i % 2):.2f}Y0.05F900" for i in range(200)]
    machine = Machine(LIMITED, board(PLANNER_BLOCKS=64))
    machine.play(["G21G91", *lines], [(700, "?"), (900, "!"), (1500, "~")])  # events in ms
    check_segments(machine.watch)
    check_pulses(machine.watch, machine.rows)
    check_position(machine)


def test_limit_is_a_stored_setting_per_axis() -> None:
    """$800 to $802 are the jerk of X, Y and Z in mm/s3. A negative value is refused."""
    machine = Machine(board=board())
    machine.play(["$800=9000", "$802=1500.5", "$801=-1", "$$"])
    listed = [line for line in machine.received if line.startswith("$80")]
    assert listed == ["$800=9000.000", "$801=0.000", "$802=1500.500"]
    assert "error:4" in machine.received  # Grbl's answer to a negative value


@some(4)
@given(machines, st.lists(blocks, min_size=4, max_size=16), events(harmless))
def test_no_step_is_lost_by_holds_and_overrides(settings_, lines, bytes_) -> None:
    """Settings, lines and real-time bytes without resets are random, with the jerk of LIMITED."""
    machine = Machine({**settings_, **LIMITED}, board())
    machine.play(["G21G91F500", *lines], bytes_)
    check_segments(machine.watch)
    check_pulses(machine.watch, machine.rows)
    check_position(machine)


@some(4)
@given(
    machines, st.lists(blocks, min_size=2, max_size=12), events(st.sampled_from("!~?\x18\x84\x91"))
)
def test_position_is_right_after_resets_and_doors(settings_, lines, bytes_) -> None:
    """Settings, lines and real-time bytes are random. Reports agree with the motors."""
    machine = Machine({**settings_, **LIMITED}, board(SAFETY_DOOR=True))
    machine.play(["G21G91F500", *lines], bytes_)
    check_position(machine)


@some(4)
@given(machines, st.lists(jogs, min_size=2, max_size=6), events(st.sampled_from("\x85!?~")))
def test_position_is_right_after_jog_cancels(settings_, lines, bytes_) -> None:
    """Settings, lines and real-time bytes are random. Reports agree with the motors."""
    machine = Machine({**settings_, **LIMITED}, board())
    machine.play(lines, bytes_)
    check_segments(machine.watch)
    check_position(machine)


def test_homing_ends_at_the_same_place_as_without_the_limit() -> None:
    """Homing, motion and homing again, without and with a limit of jerk."""
    positions = []
    for limited in ({}, LIMITED):
        # $22 to $27: homing enabled, its rates, debounce in ms, pull-off in mm.
        settings = {22: 1, 24: 150.0, 25: 1200.0, 26: 5, 27: 0.5, 110: 3000.0, 120: 200.0}
        machine = Machine({**settings, **limited}, board())
        for axis, pin in enumerate(("limit_x", "limit_y", "limit_z")):
            # Each switch closes at 500, 700 or 900 steps.
            machine.rig.engine.switches.append(
                Switch(pin, axis, above=True, steps=500 + 200 * axis)
            )
        # After motion, homing must find the same positions again.
        machine.play(["$H", "G91G1X-2Y-1F800", "$H", "G1X-1F500"])
        positions.append((machine.reported(), machine.physical()))
    assert positions[0] == positions[1]


def test_probe_stops_later_by_the_lag_and_the_next_line_is_complete() -> None:
    """Averaged speed lags by at most the time of the filter, so a probe stops after a longer way.

    It reports the same point of contact.
    """
    feed_mm_s = 10.0
    positions_steps = []
    for limited in ({}, LIMITED):
        machine = Machine({110: 3000.0, 120: 200.0, **limited}, board())
        machine.rig.engine.switches.append(Switch("probe", axis=0, above=True, steps=700))
        machine.play(["G91", "G38.2X10F600", "G1X2F900", "G1Y1"])
        assert "[PRB:2.800,0.000,0.000:1]" in machine.received  # 700 steps at 250 steps/mm
        check_position(machine)
        positions_steps.append(machine.physical())
    later_mm = (positions_steps[1][0] - positions_steps[0][0]) / 250
    # The filter lasts 2 * acceleration / jerk; a segment of 0.01 s may be added.
    assert 0 < later_mm <= feed_mm_s * (2 * 200 / LIMITED[800] + 0.01)
    assert positions_steps[1][1] == positions_steps[0][1] == 250  # 1 mm of Y
