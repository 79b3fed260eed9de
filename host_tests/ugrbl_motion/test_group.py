"""Groups of axes: the laws of motion, stops at any instant, outputs, a queue that runs dry."""

import asyncio
from collections.abc import Iterator
from math import hypot, inf
from typing import Any

import pytest
from group_bench import NAMES, RESOLUTION, SPEED, GroupBench
from hypothesis import given
from hypothesis import strategies as st
from laws import some
from motion.layout import ROW_TICKS
from ugrbl.sim import virtual_asyncio
from ugrbl.sim.group_hardware import SimHardware
from ugrbl_motion import Axis, Group, GroupError, Output

_PLACES = st.floats(-20, 20).map(lambda x: round(x, 3))
_TARGETS = st.dictionaries(st.sampled_from(NAMES), _PLACES, min_size=1)
_SPEEDS = st.one_of(st.none(), st.floats(0.5, 400))
_MOVES = st.lists(st.tuples(_TARGETS, _SPEEDS, st.booleans()), min_size=1, max_size=12)


# Steps by which two motors may be off their line besides the step under way: each row's end may be
# 2**-7 step off (slice_kernel.STEP_BIAS).
_OFF = 2 * 2**-7


def rounded(place: float, axis: int) -> int:
    """Return a position in units as steps, rounded as the planner does; half a step goes up."""
    # 1e6 makes it positive, because int() rounds towards 0
    return int(place * RESOLUTION[axis] + 0.5 + 1e6) - 1_000_000


@pytest.fixture
def bench() -> GroupBench:
    return GroupBench()


# Laws of motion


@some(40)
@given(_MOVES)
def test_any_moves_obey_the_laws_of_motion_and_end_at_their_targets(moves: Any) -> None:
    """moves: targets by axis, speed (None: the fastest), level of an output. bench.check() runs
    all, under all laws."""
    bench = GroupBench()
    targets = dict.fromkeys(NAMES, 0.0)
    for target, speed, level in moves:
        bench.group.move(speed, out0=level, **target)
        targets |= target
    bench.check()
    assert bench.steps == [rounded(targets[name], i) for i, name in enumerate(NAMES)]


@some(20)
@given(_MOVES, st.lists(st.floats(0, 0.4), min_size=12, max_size=12))
def test_a_queue_that_runs_dry_between_moves_loses_nothing(moves: Any, pauses: Any) -> None:
    """Moves come late, early, and exactly as the last one ends."""
    bench = GroupBench()
    for (target, speed, _), pause in zip(moves, pauses, strict=False):
        bench.group.move(speed, **target)
        bench.run(pause)  # s
    bench.check()


def test_distances_do_not_drift_by_rounding_to_steps(bench: GroupBench) -> None:
    for _ in range(700):
        bench.group.move_by(z=0.01, x=-0.003)
    bench.check()
    assert bench.steps == [rounded(-2.1, 0), 0, rounded(7.0, 2)]  # 700 * -0.003 and 700 * 0.01


def test_a_move_lasts_as_long_as_asked_for(bench: GroupBench) -> None:
    bench.group.move(seconds=4.0, x=20, y=3)
    begin_s = bench.hardware.now_s
    bench.group.wait()
    ramps_s = 2 * (5.0 / 500)  # to 5 units/s and back: half of each is lost
    assert bench.hardware.now_s - begin_s == pytest.approx(4.0 + ramps_s / 2, abs=0.01)


def test_a_faster_speed_than_an_axis_has_is_its_own(bench: GroupBench) -> None:
    bench.group.move(1e6, x=50, y=50)
    bench.group.move(seconds=1e-6, x=0)
    bench.check()


# Stops


def steps_off_line(bench: GroupBench, target: "tuple[float, ...]") -> float:
    """Return how far the motors are off the line from 0 to the target, in steps."""
    end_steps = [place * per for place, per in zip(target, RESOLUTION, strict=True)]
    length_sqr = sum(n * n for n in end_steps)
    fraction = sum(a * b for a, b in zip(bench.steps, end_steps, strict=True)) / length_sqr
    return max(abs(a - fraction * b) for a, b in zip(bench.steps, end_steps, strict=True))


@some(60)
@given(st.floats(0, 1.0), st.sampled_from(["stop", "halt", "pause"]))
def test_a_stop_at_any_instant_keeps_position_and_path(after_s: float, method: str) -> None:
    """A pause continues to the last target. stop() and halt() discard moves; the next move begins
    where the motors are."""
    bench = GroupBench()
    group, target = bench.group, (20.0, 7.0, -35.0)
    group.move(x=target[0], y=target[1], z=target[2])
    group.move(x=0)
    bench.run(after_s)
    steps_before, asked_at_s = bench.steps, bench.hardware.now_s
    getattr(group, method)()
    if method == "pause":
        bench.run(1.5)
        steps_in_pause = bench.steps
        bench.run(0.1)
        assert bench.steps == steps_in_pause
        group.resume()
        bench.check()
        assert bench.steps[0] == 0
        return
    group.wait()
    assert bench.steps == [axis.steps for axis in bench.axes]
    assert [group.end(i) for i in range(3)] == bench.steps  # the next move begins here
    ends = [rounded(place, i) for i, place in enumerate(target)]
    if bench.steps[1:] != ends[1:]:  # stopped within the first move, not in the second, of X only
        assert steps_off_line(bench, target) <= 1 + _OFF
    if method == "halt":  # at once, without braking
        assert bench.steps == steps_before and bench.hardware.now_s == asked_at_s
    group.move(x=1, y=2, z=3)
    group.wait()
    assert bench.steps == [80, 400, rounded(3.0, 2)]


def test_a_stop_brakes_as_hard_as_the_axis_may_and_no_harder(bench: GroupBench) -> None:
    bench.group.move(x=200)
    bench.run(1.0)
    speed = SPEED[0]
    position_before, asked_at_s = bench.axes[0].position, bench.hardware.now_s
    bench.group.stop()
    bench.group.wait()
    travel = bench.axes[0].position - position_before
    # v**2 / 2 a, with a = 500; before that, at most 0.06 s of segments that the engine has already
    assert speed**2 / 2 / 500 <= travel <= speed**2 / 2 / 500 + speed * 0.06
    assert bench.hardware.now_s - asked_at_s <= speed / 500 + 0.08


def test_moves_wait_for_the_end_of_a_stop(bench: GroupBench) -> None:
    bench.group.move(x=200)
    bench.run(1.0)
    bench.group.stop()
    assert bench.group.space() == 0 and not bench.group.done()
    bench.group.move_by(x=1)
    bench.group.wait()
    # 80 steps per unit: it stopped before x=200
    assert bench.steps[0] == bench.group.end(0) and bench.steps[0] < 200 * 80


def test_waiting_in_a_pause_is_refused(bench: GroupBench) -> None:
    """wait() would never return."""
    bench.group.move(x=5)
    bench.group.pause()
    with pytest.raises(GroupError, match=r"resume\(\) or stop\(\) first"):
        bench.group.wait()
    bench.group.stop()
    bench.group.wait()
    assert bench.group.done()


def test_a_failed_engine_is_reported_and_everything_is_off(bench: GroupBench) -> None:
    bench.group.move(x=50, out0=1)
    bench.run(0.1)
    # what the engine reports from now on
    bench.engine.fault = lambda: "pulses were lost"  # type: ignore[method-assign]
    with pytest.raises(GroupError, match=r"pulses were lost.*position again"):
        bench.group.wait()
    assert bench.engine.idle() and bench.hardware.outputs[-1][1] == 0
    # restores the method: the group can be used again
    del bench.engine.fault  # type: ignore[method-assign]
    bench.group.move(x=0, out0=1)
    bench.group.wait()
    assert bench.steps[0] == 0 and bench.hardware.outputs[-1][1] == 1


# Outputs and progress


def test_outputs_change_exactly_where_their_move_begins(bench: GroupBench) -> None:
    for k in range(40):
        bench.group.move_by(20, x=0.5, out0=k % 2 == 0)
    bench.group.wait()
    # (time, levels, steps) of each change; the first sets all to 0
    changes = bench.hardware.outputs[1:]
    assert [levels for _, levels, _ in changes] == [1, 0] * 20
    # 0.5 units of 80 steps
    assert [steps[0] for _, _, steps in changes] == [40 * k for k in range(40)]


def test_outputs_without_a_move_change_when_the_moves_are_done(bench: GroupBench) -> None:
    bench.group.set(out0=1)
    assert bench.hardware.outputs[-1][1] == 1
    bench.group.move(x=3)
    bench.group.set(out0=0)
    bench.group.wait()
    # 3 units of 80 steps
    assert [steps[0] for _, _, steps in bench.hardware.outputs[1:]] == [0, 240]
    bench.group.move(x=3, out0=1)  # no step: at once
    assert bench.hardware.outputs[-1][1] == 1


def test_several_outputs_change_independently() -> None:
    bench = GroupBench(outputs=8)
    bench.group.move_by(x=1, out7=1, out0=1)
    bench.group.move_by(x=1, out7=0)
    bench.group.wait()
    # a bit per output; all are 0 at the start
    assert [levels for _, levels, _ in bench.hardware.outputs] == [0, 0x81, 0x01]


def test_a_move_is_done_as_the_next_one_begins(bench: GroupBench) -> None:
    """wait(number) returns in the first fifth of the following move."""
    numbers = [bench.group.move_by(10, x=1) for _ in range(6)]
    for k, number in enumerate(numbers):
        bench.group.wait(number)
        position = bench.axes[0].position
        assert k + 1 <= position < k + 1.2
        assert (bench.group.done(number) and not bench.group.done(numbers[-1])) or k == 5


def test_a_full_queue_makes_the_caller_wait_and_ready_does_not() -> None:
    """A queue of 4 holds 3 moves: only the fourth call of move_by() takes (simulated) time."""
    bench = GroupBench(queue=4)
    for _ in range(3):
        bench.group.move_by(10, x=1)
    assert bench.group.space() == 0 and bench.hardware.now_s == 0
    bench.group.move_by(10, x=1)
    assert bench.hardware.now_s > 0
    bench.check()


def test_a_pace_applies_to_the_present_move_too(bench: GroupBench) -> None:
    bench.group.move(10, x=500)
    bench.run(1)
    for factor, speed in ((1.5, 15), (0.2, 2), (1, 10), (10, 100)):
        bench.group.pace(factor)
        bench.run(0.4)  # s, to reach the new speed
        position_before = bench.axes[0].position
        bench.run(0.5)
        measured = (bench.axes[0].position - position_before) / 0.5
        assert measured == pytest.approx(speed, rel=0.02)


# Positions


def test_a_position_is_declared_without_motion(bench: GroupBench) -> None:
    """place() changes the position of the axis; motors (80 steps per unit) stay where they are."""
    x = bench.axes[0]
    bench.group.move(x=2)
    with pytest.raises(GroupError, match="during motion"):
        x.place(100)
    bench.group.wait()
    x.place(100.5)
    assert x.position == x.target == 100.5 and bench.steps[0] == 160
    x.move(100)
    bench.group.wait()
    assert bench.steps[0] == 120


def test_an_inverted_axis_counts_the_other_way_at_the_pins() -> None:
    hardware = SimHardware()
    x = Axis(2, 5, 100, 10, 100, invert=True)
    group = Group(x=x, hardware=hardware)
    x.move(1)
    group.wait()
    assert x.position == 1 and list(hardware.steps()) == [-100]


# asyncio


@pytest.fixture
def use_virtual_time() -> "Iterator[Any]":
    """Return a function that makes asyncio.run() use the virtual time of a bench."""
    policy = asyncio.get_event_loop_policy()
    yield lambda bench: virtual_asyncio.install([bench.hardware])
    asyncio.set_event_loop_policy(policy)


def test_tasks_run_while_a_task_waits_for_motion(bench: GroupBench, use_virtual_time: Any) -> None:
    use_virtual_time(bench)
    positions: "list[float]" = []

    async def watch() -> None:
        while not bench.group.done():
            positions.append(bench.axes[0].position)
            await asyncio.sleep(0.02)

    async def main() -> None:
        """Wait for the first of two moves, then for the second."""
        first = bench.group.move(10, x=2)
        bench.group.move(10, x=4)
        watcher = asyncio.create_task(watch())
        await bench.axes[0].moved(first)
        assert 2 <= bench.axes[0].position < 2.2
        await bench.group.moved()
        assert bench.axes[0].position == 4
        await watcher

    asyncio.run(main())
    assert len(positions) > 15 and positions == sorted(positions)
    bench.check()


def test_a_stop_from_another_task_ends_the_wait(bench: GroupBench, use_virtual_time: Any) -> None:
    use_virtual_time(bench)

    async def main() -> None:
        """Stop a long move after 1 s, while another task waits for its end."""
        bench.group.move(5, x=500)
        waiting = asyncio.create_task(bench.group.moved())
        await asyncio.sleep(1)
        bench.group.stop()
        await waiting
        assert 4.5 < bench.axes[0].position < 6

    asyncio.run(main())


def test_a_task_fills_the_queue_without_blocking_others(use_virtual_time: Any) -> None:
    """After `await ready()` a move needs no time; another task ran every 10 ms meanwhile."""
    bench = GroupBench(queue=4)
    use_virtual_time(bench)
    ticks = 0

    async def count_ticks() -> None:
        nonlocal ticks
        while True:
            ticks += 1
            await asyncio.sleep(0.01)

    async def main() -> None:
        """Add 20 moves, each when the queue has space for it."""
        counting = asyncio.create_task(count_ticks())
        for _ in range(20):
            await bench.group.ready()
            before_s = bench.hardware.now_s
            bench.group.move_by(10, x=1)
            assert bench.hardware.now_s == before_s
        await bench.group.moved()
        counting.cancel()

    asyncio.run(main())
    assert ticks > 150  # 20 units at 10 per second: 2 s
    bench.check()


def test_a_program_in_which_every_task_waits_for_ever_is_reported(
    bench: GroupBench, use_virtual_time: Any
) -> None:
    """Virtual time could not go on: no task waits for a time or a move."""
    use_virtual_time(bench)

    async def main() -> None:
        await asyncio.Event().wait()

    with pytest.raises(RuntimeError, match="every task waits"):
        asyncio.run(main())


# Refusals

WRONG = [
    (lambda group: group.move(q=1), "no axis or output in this group is named q"),
    (lambda group: group.move(x=1, q=1), "named q"),
    (lambda group: group.set(x=1), "no axis or output"),
    (lambda group: group.move(0, x=1), "above 0"),
    (lambda group: group.move(-3, x=1), "above 0"),
    (lambda group: group.move(seconds=0, x=1), "above 0"),
    (lambda group: group.move(x=1, y=1e9), "y is out of reach"),
    (lambda group: group.move_by(x=-1e9), "x is out of reach"),
    (lambda group: group.axes[0].run(0), "stop"),
    (lambda group: group.pace(0), "0.01 to 10"),
]


@pytest.mark.parametrize(("call", "text"), WRONG)
def test_a_refused_call_changes_nothing(call: Any, text: str, bench: GroupBench) -> None:
    bench.group.move_by(x=0.004)  # 0.32 of a step: none is made, but it counts later
    bench.group.wait()
    with pytest.raises(ValueError, match=text):
        call(bench.group)
    assert bench.group.done() and bench.steps == [0, 0, 0]
    bench.group.move_by(x=0.0095)  # 0.0135 in all: 1.08 steps
    bench.check()
    assert bench.steps[0] == 1


def test_parts_that_make_no_group_are_refused() -> None:
    x = Axis(2, 5, 80, 100, 500)
    with pytest.raises(ValueError, match="in no group"):
        x.move(1)
    with pytest.raises(ValueError, match="at least one Axis"):
        Group(out=Output(3), hardware=SimHardware())
    Group(x=x, hardware=SimHardware())
    with pytest.raises(ValueError, match="in two groups"):
        Group(x=x, hardware=SimHardware())
    for numbers in ((0, 1, 1), (1, 0, 1), (1, 1, -1)):  # steps per unit, speed, acceleration
        with pytest.raises(ValueError, match="above 0"):
            Axis(2, 5, *numbers)


def test_this_computer_has_no_step_engine() -> None:
    with pytest.raises(OSError, match="no step engine for linux"):
        Group(x=Axis(2, 5, 80, 100, 500))


def test_the_path_of_a_corner_is_that_of_its_lines(bench: GroupBench) -> None:
    """Corners are slowed down for, and never cut."""
    positions: "list[tuple[float, float]]" = []
    bench.group.move(100, x=10)
    bench.group.move(100, y=10)
    while not bench.group.done():
        bench.run(0.001)
        positions.append((bench.axes[0].position, bench.axes[1].position))
    off_path = max(min(abs(y) if x <= 10 else inf, abs(x - 10)) for x, y in positions)
    # half a step
    assert off_path <= 0.5 / 80 + 1e-9 and hypot(*positions[-1]) == pytest.approx(200**0.5)
    assert sum(row[ROW_TICKS] for _, row in bench.hardware.made) > 0
