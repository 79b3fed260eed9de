"""Laws of motion on examples and random programs: planner and segments alone, then the machine.

Bench: planner and segments, with support/laws.py watching. bench.line(target in mm, mm/min) plans;
bench.pull(n) takes n segments, as the engine does; bench.check() takes all and checks every law.
Machine: the whole simulated machine, with the same watch. machine.play(lines, events) sends lines,
and each event's bytes at its ms. Settings are given by number: {110: 3000.0} is $110=3000.
"""

from dataclasses import replace
from math import cos, pi, sin

import pytest
from hypothesis import given
from hypothesis import strategies as st
from laws import (
    Bench,
    Limits,
    check_plan,
    check_pulses,
    check_segments,
    check_spacing,
    pulses,
    some,
    uneven,
)
from motion import layout
from motion.kinematics import COREXY
from rig_bench import Machine
from ugrbl.sim.engine import Switch

# Many cases of each: the first ring runs a sample.
pytestmark = pytest.mark.sampled(4)

SECOND_Y = (0x001, 0x002, 0x004, 0x200)
EIGHT_MOTORS = (*(1 << axis for axis in range(6)), 0x001, 0x200)  # the second Y is reversed
fast = Limits((250.0, 250.0, 250.0), (3000.0, 3000.0, 1500.0), (500.0, 500.0, 200.0))


def circle(bench: Bench, radius: float, chords: int, feed: float) -> None:
    for i in range(chords + 1):
        angle = 2 * pi * i / chords
        bench.line((radius * cos(angle) - radius, radius * sin(angle), 0), feed)


def zigzag(bench: Bench) -> None:
    for i in range(12):
        bench.line((i % 2 * 3.0, i * 0.1, 0), 2000)


def staircase(bench: Bench) -> None:
    for i in range(40):
        bench.line(((i + 1) // 2 * 0.05, i // 2 * 0.05, 0), 1500)


def reversals(bench: Bench) -> None:
    for i in range(6):
        bench.line((0, 0, -5.0 * (i % 2)))


def plunges(bench: Bench) -> None:
    for i in range(5):
        bench.line((i * 4, 0, 2))
        bench.line((i * 4, 0, -1), 100)
        bench.line((i * 4, 0, 2))


def slow(bench: Bench) -> None:
    bench.line((0.05, 0, 0), 1)
    bench.line((0.1, 0.03, 0), 5)


def single_steps(bench: Bench) -> None:
    for i in range(20):
        bench.line((0.004 * i, 0.004 * (i // 3), 0), 1000)


programs = pytest.mark.parametrize(
    "program", [zigzag, staircase, reversals, plunges, slow, single_steps]
)


@programs
@pytest.mark.parametrize("limits", [Limits(), fast], ids=["factory", "fast"])
def test_examples_keep_every_law(program, limits: Limits) -> None:
    bench = Bench(limits)
    program(bench)
    bench.check()


@pytest.mark.parametrize("chords", [24, 300])
def test_a_circle_of_chords_keeps_every_law(chords: int) -> None:
    bench = Bench(fast)
    circle(bench, 4.0, chords, 2400)
    bench.check()


@pytest.mark.parametrize("segment_log2", [13, 17])
def test_coarse_ticks_keep_every_law(segment_log2: int) -> None:
    bench = Bench(fast, 16, 100 << segment_log2, segment_log2)
    zigzag(bench)
    bench.check()


@programs
def test_corexy_keeps_every_law_of_its_motors(program) -> None:
    bench = Bench(replace(fast, moves=COREXY))
    program(bench)
    bench.check()


@pytest.mark.parametrize("segments_before", [1, 7, 20, 40])
def test_a_hold_at_any_moment_keeps_every_law(segments_before: int) -> None:
    """Hold, come to rest and resume; segments_before: of a zigzag, before the hold."""
    bench = Bench(fast)
    zigzag(bench)
    bench.pull(segments_before)
    bench.hold()
    bench.check()


@pytest.mark.parametrize("feed", [10, 200])
@pytest.mark.parametrize("segments_before", [1, 7, 20, 40])
def test_an_override_at_any_moment_keeps_every_law(feed: int, segments_before: int) -> None:
    """Feed overrides of 10 % and 200 % begin and end after so many segments."""
    bench = Bench(fast)
    zigzag(bench)
    bench.pull(segments_before)
    bench.override(feed)
    bench.pull(segments_before)
    bench.override(100)
    bench.check()


def test_an_override_too_late_to_brake_for_keeps_every_law() -> None:
    """A feed override of 10 % just before a short line, at a speed that cannot drop in time."""
    bench = Bench(Limits((80.0,) * 3, (3000.0,) * 3, deviation=0.05))
    bench.line((0.5, 0, 0), 1000)
    bench.line((0.7, 0, 0), 1000)
    bench.pull(20)  # so many that the tool is fast, and near the end
    bench.override(10)  # %
    bench.check()


# Even steps


def cruise_ticks(bench: Bench, axis: int) -> "list[int]":
    """Execute everything; return the ticks of the middle half of an axis' pulses, in cruise."""
    bench.finish()
    rows = [(segment.start, segment.row) for segment in bench.watch.made]
    ticks = [tick for tick, _ in pulses(rows, axis)]
    return ticks[len(ticks) // 4 : -len(ticks) // 4]


@pytest.mark.parametrize("feed", [3, 61, 450, 1000, 2999, 5400])
def test_steps_of_a_constant_rate_move_are_even(feed: int) -> None:
    bench = Bench(Limits(rate=(6000.0,) * 3, acceleration=(2000.0,) * 3))
    bench.line((max(0.4, feed / 200), 0, 0), feed)
    assert uneven(cruise_ticks(bench, 0)) <= 1


@pytest.mark.parametrize("y_mm", [0.7, 9.99, 13.37, 20.0, 39.996])
def test_steps_of_a_minor_axis_are_even(y_mm: float) -> None:
    bench = Bench(fast)
    bench.line((40, y_mm, 0), 2500)
    for axis in (0, 1):
        assert uneven(cruise_ticks(bench, axis)) <= 1


@pytest.mark.parametrize("pieces", [2, 15, 100])
def test_steps_are_even_across_the_joints_of_a_straight_line(pieces: int) -> None:
    """A line of 45 mm in pieces: intervals between steps differ by a tick, or by 1 %, at most."""
    bench = Bench(fast)
    for i in range(1, pieces + 1):
        bench.line((40 * i / pieces, 20 * i / pieces, 0), 2000)
    for axis in (0, 1):
        assert uneven(cruise_ticks(bench, axis)) <= 1


# Random programs


def any_limits(axes: int):
    """Return a strategy for Limits: steps/mm, rates in mm/min, accelerations in mm/s², junction
    deviation in mm, the highest step frequency in Hz, and motors as masks of the axes they follow.
    """

    def per_axis(*values):
        return st.tuples(*[st.sampled_from(values)] * axes)

    return st.builds(
        Limits,
        per_axis(40.0, 80.0, 250.0, 800.0, 26.667),
        per_axis(100.0, 500.0, 3000.0, 20_000.0),
        per_axis(5.0, 10.0, 200.0, 3000.0),
        st.sampled_from([0.001, 0.01, 0.05, 0.5]),
        st.just(90_909),
        st.sampled_from({3: [(), COREXY, SECOND_Y], 6: [(), EIGHT_MOTORS]}.get(axes, [()])),
    )


def actions(axes: int):
    """Return a strategy for what a program does to a Bench: a method's name and its arguments.

    "line" has the distances in mm instead of the target, and the feed in mm/min (0: rapid); six of
    nine actions are lines. "override" has the feed and the rapid override in %.
    """
    distances = st.one_of(
        *[st.tuples(*[st.floats(-size, size)] * axes) for size in (0.02, 0.5, 4.0)],
        st.tuples(st.floats(-5, 5), *[st.just(0.0)] * (axes - 1)),
    )
    return st.one_of(
        *[st.tuples(st.just("line"), distances, st.sampled_from([0, 30, 600, 2000, 9000]))] * 6,
        st.tuples(st.just("pull"), st.integers(1, 9)),
        st.tuples(st.just("hold")),
        st.tuples(st.just("override"), st.integers(10, 200), st.sampled_from([25, 50, 100])),
    )


@pytest.mark.parametrize("axes", [3, 4, 5, 6])
@some(40)
@given(st.data())
def test_random_programs_keep_every_law(axes: int, data) -> None:
    """Each action calls the Bench's method of that name."""
    limits = data.draw(any_limits(axes))
    program = data.draw(st.lists(actions(axes), min_size=5, max_size=30))
    bench = Bench(limits)
    place = (0.0,) * axes
    for name, *arguments in program:
        if name == "line":  # distances become the target
            place = tuple(a + b for a, b in zip(place, arguments[0], strict=True))
            arguments[0] = place
        getattr(bench, name)(*arguments)
    bench.check()


# Lookahead

short = st.floats(-0.3, 0.3).map(lambda x: round(x, 3))  # mm
short_moves = st.lists(st.tuples(short, short, st.sampled_from([300.0, 6000.0, 0.0])), max_size=60)


def positions_and_feeds(moves):
    """Yield (position in mm, feed) after each of these moves, (dx, dy, feed)."""
    x = y = 0.0
    for dx, dy, feed in moves:
        x, y = x + dx, y + dy
        yield (x, y, 0.0), feed


@some(20)
@given(short_moves)
def test_planning_several_lines_at_once_equals_planning_one_by_one(moves) -> None:
    """The planner adds a line at once, and replans only now and then; catch_up() does it now.

    The ring of 64 blocks is the same in the end. 30 short lines before let it become long.
    """
    at_once, singly = Bench(Limits(), 64), Bench(Limits(), 64)
    for place, feed in positions_and_feeds([(0.1, 0.0, 6000.0)] * 30 + moves):
        at_once.line(place, feed)
        check_plan(at_once.watch)
        singly.line(place, feed)
        singly.planner.catch_up()
    at_once.planner.catch_up()
    assert at_once.planner.ring == singly.planner.ring


@some(20)
@given(short_moves, st.integers(1, 40))
def test_a_long_ring_filled_while_it_empties_keeps_every_law(
    moves, lines_per_segment: int
) -> None:
    """A segment is executed after every lines_per_segment lines, when 25 have been planned."""
    bench = Bench(Limits(), 64)
    for i, (place, feed) in enumerate(positions_and_feeds([(0.1, 0.0, 6000.0)] * 40 + moves)):
        bench.line(place, feed)
        check_plan(bench.watch)
        if i > 25 and i % lines_per_segment == 0:
            bench.pull()
    bench.check()


def test_a_long_ring_is_not_replanned_for_each_line() -> None:
    """While speeding up, each new line would change all earlier blocks of the ring.

    So the planner does this pass for the first 15 lines, and then for every fourth.
    """
    bench = Bench(Limits(), 64)
    passes = 0
    for place, feed in positions_and_feeds([(0.1, 0.0, 6000.0)] * 60):
        bench.line(place, feed)
        passes += bench.planner.flow[layout.UNPLANNED] == 0  # all lines so far are planned
    assert passes == 15 + (60 - 15) // 4


# The whole machine

machines = st.fixed_dictionaries(
    {},
    optional={
        11: st.sampled_from([0.002, 0.1]),
        100: st.sampled_from([40.0, 320.0]),
        101: st.sampled_from([80.0, 53.3]),
        110: st.sampled_from([100.0, 2000.0, 8000.0]),
        111: st.sampled_from([3000.0]),
        112: st.sampled_from([60.0, 1200.0]),
        120: st.sampled_from([5.0, 400.0]),
        121: st.sampled_from([50.0, 1000.0]),
        122: st.sampled_from([20.0]),
    },
)
places = st.floats(-3, 3).map(lambda x: round(x, 3))
words = st.tuples(places, places, places)
blocks = st.one_of(
    words.map("G1X%.3fY%.3fZ%.3f".__mod__),
    st.tuples(places, places).map("G0X%.3fY%.3f".__mod__),
    places.map("G0Z%.3f".__mod__),
    st.tuples(st.sampled_from("23"), st.floats(0.1, 2)).map("G91G%sI%.3f".__mod__),
    st.tuples(st.floats(0.1, 2)).map("G3X0Y1R%.3f".__mod__),
    st.sampled_from("F60 F800 F3000 G90 G91 G4P.05 M0 M3S500 M8 G93 G94 G17 G18".split()),
)
moments = st.integers(0, 4000)
harmless = st.sampled_from(["!", "~", "?", "\x90", "\x91", "\x92", "\x93", "\x95", "\x96", "\x97"])


def events(bytes_: st.SearchStrategy) -> st.SearchStrategy:
    return st.lists(st.tuples(moments, bytes_), min_size=1, max_size=8)


def check_position(machine: Machine) -> None:
    """Check that the report agrees with the motors, and so do the pulses of the trace."""
    physical = machine.physical()
    for i, reported_mm in enumerate(machine.reported()):
        assert sum(sign for _, sign in pulses(machine.rows, i)) == physical[i]
        exact_mm = physical[i] / machine.limits.steps_per_mm[i]
        # Three decimals, and the rounding of a 32-bit float.
        assert abs(reported_mm - exact_mm) <= 0.00051 + abs(exact_mm) * 1e-6
    for i in range(3):
        check_spacing(list(pulses(machine.rows, i)), machine.watch.tick_hz, pulse_us=10)


@some(15)
@given(machines, st.lists(blocks, min_size=4, max_size=16), events(harmless))
def test_nothing_is_lost_through_holds_and_overrides(settings_, lines, bytes_) -> None:
    """Random lines with real-time bytes that discard nothing: steps and position stay right."""
    machine = Machine(settings_)
    machine.play(["G21G91F500", *lines], bytes_)
    check_segments(machine.watch)
    check_pulses(machine.watch, machine.rows)
    check_position(machine)


@some(15)
@given(
    machines, st.lists(blocks, min_size=2, max_size=12), events(st.sampled_from("!~?\x18\x84\x91"))
)
def test_position_is_known_through_resets_and_doors(settings_, lines, bytes_) -> None:
    machine = Machine(settings_)
    machine.play(["G21G91F500", *lines], bytes_)
    check_position(machine)


jogs = st.one_of(
    st.tuples(places, places).map("$J=G91G21X%.3fY%.3fF2000".__mod__),
    places.map("$J=G90Z%.3fF300".__mod__),
)


@some(15)
@given(machines, st.lists(jogs, min_size=2, max_size=6), events(st.sampled_from("\x85!?~")))
def test_position_is_known_through_jog_cancels(settings_, lines, bytes_) -> None:
    machine = Machine(settings_)
    machine.play(lines, bytes_)
    check_segments(machine.watch)
    check_position(machine)


@pytest.mark.parametrize("at_ms", range(600, 1200, 31))
@pytest.mark.parametrize("stop", ("\x85", "!"))
def test_a_stop_during_braking_ends_at_rest(stop: str, at_ms: int) -> None:
    machine = Machine({100: 320.0, 110: 3000.0, 120: 5.0})
    machine.play(["$J=G91X2F2000"], [(at_ms, stop)])
    check_segments(machine.watch)
    check_position(machine)


def test_a_program_ends_at_its_target() -> None:
    """It returns to 0, with a hold at 120 ms and the resume at 900 ms."""
    machine = Machine({110: 3000.0, 111: 3000.0, 120: 200.0, 121: 200.0})
    machine.play(["G90G1X3Y4F2000", "G2X5Y4I1", "G0X0Y0"], [(120, "!"), (900, "~")])
    check_pulses(machine.watch, machine.rows)
    assert machine.reported() == [0, 0, 0]
    assert max(abs(n) for n in machine.physical()) == 0


def test_a_reset_in_motion_keeps_the_steps_made() -> None:
    machine = Machine({110: 3000.0, 120: 200.0})
    machine.play(["G1X20F2000"], [(400, "\x18")])
    assert 0 < machine.physical()[0] < 5000
    check_position(machine)


def test_a_reset_restores_overrides() -> None:
    """The same moves, after a reset and from the start, have as many pulses and take as long."""
    # A dwell of 9 s, and a comment that fills the buffer of 128 bytes: the moves are not sent
    # before the reset.
    waiting = ["G4P9", "(" + 118 * "-" + ")"]
    pulses_and_ticks = []
    # At 100 ms: feed three times -10 %, rapids 25 %. At 300 ms: the reset.
    for before, events in ((waiting, [(100, "\x92\x92\x92\x97"), (300, "\x18")]), ([], [])):
        machine = Machine({110: 6000.0, 120: 1000.0})
        machine.play([*before, "G91G1X5F6000", "G0X5"], events)
        ticks = [tick for tick, _ in pulses(machine.rows, 0)]
        pulses_and_ticks.append((len(ticks), ticks[-1] - ticks[0]))  # number of pulses, duration
    assert pulses_and_ticks[0] == pulses_and_ticks[1]


# The machine model


def test_homing_with_bouncing_switches_ends_like_clean_ones() -> None:
    """Switches close at 500, 700 and 300 steps; the pull-off, $27, is 0.5 mm: 125 steps."""
    places = []
    for bounces in (0, 3):
        # Homing on; its feed and seek rate; 5 ms for a switch to settle; pull-off.
        machine = Machine({22: 1, 24: 150.0, 25: 1200.0, 26: 5, 27: 0.5, 110: 3000.0, 120: 200.0})
        for axis, (pin, steps) in enumerate(
            (("limit_x", 500), ("limit_y", 700), ("limit_z", 300))
        ):
            switch = Switch(pin, axis, above=True, steps=steps, bounces=bounces)
            machine.rig.engine.switches.append(switch)
        machine.play(["$H"])
        assert machine.reported() == [-0.5, -0.5, -0.5]
        places.append(machine.physical())
    assert places[0] == places[1] == [375, 575, 175]  # each switch's steps - 125


def test_a_switch_that_bounces_changes_at_every_step_of_its_bounces() -> None:
    """The simulator's Switch, here at 10 steps: it opens twice more, at 11 and 13.

    crossing(start, end): steps from start until it changes, on the way to end; 0: never.
    """
    switch = Switch("probe", axis=0, above=True, steps=10, bounces=2)
    closed = [switch.closed(steps) for steps in range(8, 17)]
    assert closed == [False, False, True, False, True, False, True, True, True]
    at, changes = 0, []  # from step 0 to step 20
    while switch.crossing(at, 20):
        at += switch.crossing(at, 20)
        changes.append(at)
    assert changes == [10, 11, 12, 13, 14]
    assert [switch.crossing(20, 0), switch.crossing(14, 13)] == [7, 1]
