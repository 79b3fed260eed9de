"""Arcs: chords end on the arc, however many there are, and the link is served meanwhile."""

from array import array
from collections.abc import Iterator
from math import atan2, cos, hypot, pi, sin
from typing import NamedTuple

import pytest
from base import state as run
from base.float32 import f32, vector
from boot import wiring
from hypothesis import example, given
from hypothesis import strategies as st
from laws import some
from motion import arcs, layout
from motion.arc_geometry import CENTRE_0, CENTRE_1, RADIUS, Arc
from ugrbl.run import machine
from ugrbl.run.program import ProgramLink

# How far a position may be off, in addition to half a step: a fraction of the radius (an angle in
# single precision leaves that open over a circle); a fraction of the distance from 0 (rounding to
# single precision); and some units of the course.
_OF_RADIUS = 6e-7
_OF_DISTANCE = 2.0**-24
_UNITS = 16 * 2.0**-29

PLANES = ((0, 1), (2, 0), (1, 2))  # the axes of G17, G18, G19

tolerances = st.sampled_from([0.002, 0.00005, 0.1])
planes = st.sampled_from(PLANES)


class ArcCase(NamedTuple):
    """An arc in doubles. sweep: in radians; shift: travel of the axes outside the plane, in mm."""

    radius: float
    begin: float
    sweep: float
    centre: "tuple[float, float]" = (0.0, 0.0)
    shift: "tuple[float, ...]" = (0.0,)
    plane: "tuple[int, int]" = PLANES[0]
    clockwise: bool = False
    steps: "tuple[float, float]" = (1.0, 1.0)  # steps/mm of the other axes, relative to those of X


class Course:
    """The course of an arc: its computed positions, and the exact ones."""

    def __init__(self, case: ArcCase, tolerance: float) -> None:
        """Divide the arc into chords as the firmware does. tolerance: of chords, in mm."""
        self.axes = 2 + len(case.shift)
        reach_mm = 2 * max(map(abs, (*case.centre, *case.shift, case.radius))) + case.radius
        # steps/mm of X: high, but positions stay within the range of a course
        steps = min(1e6 / reach_mm, 1e7)
        self._steps_per_mm = array("f", [steps] * self.axes)
        for i, times in enumerate(case.steps, 1):
            self._steps_per_mm[i] *= times
        self._start, self._target = vector(self.axes), vector(self.axes)
        self._arc = arc = Arc()
        arc.plane[:] = array("i", (*case.plane, case.clockwise))
        self._centre = self._lay_ends(case)
        for i, number in zip((CENTRE_0, CENTRE_1, RADIUS), (*self._centre, hypot(*self._centre))):
            arc.numbers[i] = number
        self._course = array("i", [0] * arcs.course_length(self.axes))
        for i in range(self.axes):
            arcs.limit(self._course, i, -arcs.FARTHEST, arcs.FARTHEST)
        arcs.stray(self._course, tolerance)
        self.chords = arc.lay(self._start, self._target, self._steps_per_mm, self._course)
        self.chords_before_last = self._course[arcs.CHORDS_LEFT]

    def _lay_ends(self, case: ArcCase) -> "tuple[float, float]":
        """Set start and target in mm; return the centre relative to the start."""
        first, second = case.plane
        sweep = -case.sweep if case.clockwise else case.sweep
        for ends, angle in ((self._start, case.begin), (self._target, case.begin + sweep)):
            ends[first] = case.centre[0] + case.radius * cos(angle)
            ends[second] = case.centre[1] + case.radius * sin(angle)
        if case.sweep > 2 * pi - 1e-3:  # a full circle: exactly the same position
            self._target[:] = self._start
        for i, shift in zip(self.others(), case.shift, strict=True):
            self._target[i] = self._start[i] + shift
        centre, start = case.centre, self._start
        return f32(centre[0] - start[first]), f32(centre[1] - start[second])

    def others(self) -> "list[int]":
        """Return the axes that are not in the plane."""
        return [i for i in range(self.axes) if i not in self._arc.plane[:2]]

    def computed(self) -> "Iterator[list[float]]":
        """Yield where chords end, except the last, in mm."""
        table = array("i", [0] * layout.table_length(self.axes, self.axes))
        table[layout.AXES] = self.axes
        for _ in range(self.chords_before_last):
            assert arcs.next_chord(self._course, table) == 0
            steps = table[layout.LIMITS + layout.TARGET * self.axes :][: self.axes]
            per_mm = self._steps_per_mm
            yield [(n - arcs.PLACE_BIAS) / r for n, r in zip(steps, per_mm, strict=True)]

    def exact(self) -> "Iterator[list[float]]":
        """Yield the same in doubles, each computed from the beginning of the arc."""
        start, target = self._start, self._target
        first, second, clockwise = self._arc.plane
        x, y = -self._centre[0], -self._centre[1]
        to_x = target[first] - start[first] + x
        to_y = target[second] - start[second] + y
        sweep = atan2(x * to_y - y * to_x, x * to_x + y * to_y)
        if clockwise:  # below 5e-7 radians, the firmware makes it a full circle
            sweep -= 2 * pi if sweep >= -5e-7 else 0
        else:
            sweep += 2 * pi if sweep <= 5e-7 else 0
        for k in range(1, self.chords):
            part = k / self.chords
            angle = part * sweep
            place = [s + part * (t - s) for s, t in zip(start, target, strict=True)]
            place[first] = start[first] - x + x * cos(angle) - y * sin(angle)
            place[second] = start[second] - y + x * sin(angle) + y * cos(angle)
            yield place

    def check(self) -> None:
        """Check that each position is within the tolerances at the top of the module."""
        # In mm, more than any coordinate of the arc.
        reach = 5 * self._arc.numbers[RADIUS] + sum(map(abs, [*self._start, *self._target]))
        allowed = (
            _OF_RADIUS * self._arc.numbers[RADIUS] + _OF_DISTANCE * reach + _UNITS * (1 + reach)
        )
        allowed_mm = [
            allowed + 0.5 / steps for steps in self._steps_per_mm
        ]  # half a step of rounding
        for computed, exact in zip(self.computed(), self.exact(), strict=True):
            assert all(
                abs(m - e) <= a for m, e, a in zip(computed, exact, allowed_mm, strict=True)
            )


# Where chords end


@pytest.mark.parametrize("plane", PLANES)
@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("radius", [0.01, 0.3, 7.0, 150.0, 1000.0])
def test_chords_of_a_circle_end_on_it(
    radius: float, clockwise: bool, plane: "tuple[int, int]"
) -> None:
    """A helix of one turn, about a centre away from 0."""
    case = ArcCase(
        radius,
        begin=0.7,
        sweep=2 * pi,
        centre=(-3.0, 2.0 * radius),
        shift=(12.3,),
        plane=plane,
        clockwise=clockwise,
    )
    course = Course(case, tolerance=0.002)
    assert course.chords >= 3 and course.chords_before_last == course.chords - 1
    course.check()


@pytest.mark.parametrize("clockwise", [False, True])
def test_the_error_does_not_grow_with_the_number_of_chords(clockwise: bool) -> None:
    case = ArcCase(radius=400.0, begin=2.0, sweep=2 * pi, clockwise=clockwise)
    course = Course(case, tolerance=1e-6)  # mm
    assert course.chords > 44_000
    course.check()


arc_cases = st.builds(
    ArcCase,
    st.floats(-2, 3).map(lambda power: 10.0**power),
    st.floats(0, 2 * pi),
    st.floats(0.01, 6.28),
    st.tuples(st.floats(-500, 500), st.floats(-500, 500)),
    st.tuples(st.floats(-50, 50), st.floats(-1, 1)),
    planes,
    st.booleans(),
    st.tuples(st.floats(0.01, 100), st.floats(0.01, 100)),
)


@some(60)
@given(arc_cases, tolerances)
@example(ArcCase(0.00201, 0.0, 2 * pi), 0.002)
@example(ArcCase(0.00101, 0.3, 5.99), 0.002)
def test_positions_on_any_arc_match_doubles(case: ArcCase, tolerance: float) -> None:
    Course(case, tolerance).check()


@pytest.mark.parametrize("far_mm", [1e7, 3e38, float("inf"), float("nan")])
def test_an_arc_beyond_the_range_of_units_is_one_line(far_mm: float) -> None:
    """far_mm: the target of the axis outside the plane. 0 chords: a line to the target."""
    arc = Arc()
    arc.numbers[CENTRE_0] = arc.numbers[RADIUS] = 5.0
    course = array("i", [0] * arcs.course_length(3))
    steps_per_mm = array("f", (250, 250, 250))
    assert arc.lay(vector(3), array("f", (10, 0, far_mm)), steps_per_mm, course) == 0
    assert course[arcs.CHORDS_LEFT] == 0


# In the machine


class Bench:
    """A machine that plans and never moves: the wait for space takes blocks out of its ring.

    blocks_per_wait: how many at a time; changed: settings. blocks: signed steps of each block.
    """

    def __init__(self, blocks_per_wait: int = 15, axes: int = 3, **changed: float) -> None:
        rig = machine.build("sim", lambda rig: ProgramLink(rig, lambda _: iter(())), axes=axes)
        self.machine = made = wiring.build(rig.board, rig.link, rig.port, rig.engine, rig.store)
        made.settings.load()
        for name, value in changed.items():
            setattr(made.settings, name, value)
        made.configure()
        made.canon.configure()
        made.planner.override()
        made.canon.service = self._service
        self._blocks_per_wait = blocks_per_wait
        self.blocks: "list[list[int]]" = []
        self.chords_per_service: "list[int]" = []  # blocks planned since the link was last served
        self._planned = 0  # blocks until the link was last served

    def _service(self) -> None:
        """Replace the function that serves the link while the planner is full or chords are
        made."""
        planner = self.machine.planner
        flow = planner.flow
        queued = (flow[layout.HEAD] - flow[layout.TAIL]) % flow[layout.ROWS]
        self.chords_per_service.append(len(self.blocks) + queued - self._planned)
        self._planned = len(self.blocks) + queued
        for _ in range(self._blocks_per_wait if planner.full() else 0):
            self._take()

    def _take(self) -> None:
        """Take out the oldest block."""
        planner = self.machine.planner
        flow, size = planner.flow, planner.flow[layout.ROW_SIZE]
        if not planner.empty():
            row = planner.ring[flow[layout.TAIL] * size :][:size]
            steps = row[layout.STEPS : layout.STEPS + planner.axes]
            dirs = row[layout.DIRS]
            self.blocks.append([-n if dirs >> i & 1 else n for i, n in enumerate(steps)])
            flow[layout.TAIL] = (flow[layout.TAIL] + 1) % flow[layout.ROWS]

    def run_lines(self, *lines: str) -> "Bench":
        """Execute lines and take out everything planned."""
        for text in lines:
            self.machine.interpreter.execute(bytearray(text.encode() + b"\0"), len(text))
        while not self.machine.planner.empty():
            self._take()
        return self

    def end_steps(self) -> "list[int]":
        """Return the position after all blocks, in steps from the start."""
        return [sum(steps) for steps in zip(*self.blocks, strict=True)]


@pytest.mark.parametrize("text", ["G2X3.643Y1.508I2J0Z0.7", "G3X-1Y2R-3", "G18G2X1.5Z0.25R-3"])
def test_the_last_chord_ends_at_the_target(text: str) -> None:
    """A line to the same target makes the same steps."""
    arc_bench, line_bench = Bench(), Bench()
    arc_bench.run_lines("G1F500X0.111Y0.222", text)
    target = list(arc_bench.machine.modes.position)
    assert len(arc_bench.blocks) > 5
    line_bench.run_lines("G1F500X%.9gY%.9gZ%.9g" % tuple(target))
    assert arc_bench.end_steps() == line_bench.end_steps()


@pytest.mark.parametrize("blocks_per_wait", [1, 2, 15])
def test_a_chord_that_has_to_wait_is_not_lost(blocks_per_wait: int) -> None:
    lines = ("F500", "G3X-2Y0Z1I-1", "G2X0R2")
    assert (
        Bench(blocks_per_wait=blocks_per_wait).run_lines(*lines).blocks
        == Bench(blocks_per_wait=7).run_lines(*lines).blocks
    )


def test_the_link_is_served_every_eight_chords() -> None:
    bench = Bench().run_lines("F500", "G3X0I-20")  # a circle of 20 mm radius
    assert len(bench.blocks) > 200
    assert max(bench.chords_per_service) == 8  # chords between two services


def test_check_mode_serves_the_link_as_often_and_plans_nothing() -> None:
    bench = Bench(soft_limits=1)
    bench.machine.state.enter(run.CHECK)
    bench.run_lines("F500", "G1X-10Y-50", "G3X-10I-20")
    assert not bench.blocks
    assert len(bench.chords_per_service) > 25  # 200 chords; served after every 8


def test_check_mode_skips_chords_if_there_are_no_soft_limits() -> None:
    """Only soft limits need the chords: without them an arc is just a new position."""
    bench = Bench()
    bench.machine.state.enter(run.CHECK)
    bench.run_lines("F500", "G1X-10Y-50", "G3X30I20")
    assert not bench.blocks and not bench.chords_per_service
    assert list(bench.machine.modes.position) == [30, -50, 0]


def test_a_fourth_axis_moves_evenly_along_an_arc() -> None:
    bench = Bench(axes=4).run_lines("F500", "G1A5", "G3X0I-2A6")
    steps_of_a = [steps[3] for steps in bench.blocks[1:]]  # without the line G1A5
    assert len(steps_of_a) > 20
    assert max(steps_of_a) - min(steps_of_a) <= 1


def test_the_time_of_an_inverse_time_arc_is_divided_among_chords() -> None:
    bench = Bench()
    bench.run_lines("G93", "G3X-4I-2F2")
    # F2: the arc twice a minute; of n chords each one n times as often
    assert abs(bench.machine.planner._feed[0] - 2 * len(bench.blocks)) < 0.001


def test_a_spindle_override_applies_from_the_next_chords() -> None:
    bench = Bench(laser_mode=1)
    powers: "list[int]" = []  # of the newest block, each time the link is served
    service, planner = bench.machine.canon.service, bench.machine.planner

    def override_at_20() -> None:
        """Serve the link; the 20th time, override the spindle to 50 %. Note the power planned."""
        service()
        if len(bench.chords_per_service) == 20:
            bench.machine.state.override_spindle(50)
            bench.machine.state.invalidate_lines()
        newest_row = (planner.flow[layout.HEAD] - 1) % planner.flow[layout.ROWS]
        powers.append(planner.ring[newest_row * planner.flow[layout.ROW_SIZE] + layout.POWER])

    bench.machine.canon.service = override_at_20
    bench.run_lines("F500M3S500", "G3X0I-20")
    assert set(powers[1:20]) == {128} and set(powers[20:]) == {64}  # half of 255, and half of that


def test_laser_power_is_set_if_chords_have_no_steps() -> None:
    """A circle of 0.02 mm in chords shorter than a step: the last S must still be set at once."""
    bench = Bench(laser_mode=1, arc_tolerance_mm=0.0000001)
    speeds_set: "list[float]" = []
    canon = bench.machine.canon
    canon.spin = lambda direction, rpm: speeds_set.append(rpm)  # type: ignore[method-assign]
    bench.run_lines("F500M3S500", "G3X0I-0.01")
    assert 500.0 in speeds_set
