"""Homing by a pin: the position is exact, and each failure leaves motors that stand still."""

import pytest
from group_bench import GroupBench
from hypothesis import given
from hypothesis import strategies as st
from laws import some
from ugrbl_motion import GroupError
from ugrbl_motion.homing import Homing, Switch

PIN = 20
X = 0


def home_x(bench: GroupBench, homing: Homing) -> None:
    """Home X, and check that it stands still afterwards."""
    homing.find(bench.axes[X])
    assert bench.group.done() and bench.engine.idle()


@some(20)
@given(st.integers(10, 2000), st.integers(0, 4), st.booleans(), st.floats(-50, 50))
def test_the_switch_is_where_it_is_declared(
    distance: int, bounces: int, is_above: bool, position: float
) -> None:
    """distance: steps to the switch; position: what is declared there. Then X backs off by 1.5
    units, 80 steps each."""
    switch_steps = distance if is_above else -distance
    bench = GroupBench()
    bench.hardware.switch(PIN, X, switch_steps, is_above, bounces)
    speed = 40.0 if is_above else -40.0
    home_x(bench, Homing(Switch(PIN, position), speed, slow=2.0, back_off=1.5, travel=60))
    x = bench.axes[X]
    # The first edge of a switch that bounces; steps and position differ there as after homing.
    edge = switch_steps - 2 * bounces if is_above else switch_steps + 2 * bounces
    error_steps = bench.steps[X] - round(x.position * 80) - (edge - round(position * 80))
    assert abs(error_steps) <= 2 * bounces + 1
    backed_off = position - 1.5 if is_above else position + 1.5
    assert x.position == pytest.approx(backed_off, abs=1 / 80)


def test_without_bounces_it_is_exact_to_the_step() -> None:
    bench = GroupBench()
    bench.hardware.switch(PIN, X, -800, above=False)
    home_x(bench, Homing(Switch(PIN, position=-2.0), -40.0, 2.0, back_off=1.0, travel=60))
    # backed off by 1 unit of 80 steps
    assert bench.steps[X] == -720 and bench.axes[X].position == -1.0


def test_a_switch_that_is_closed_at_the_start_is_left_and_found_again() -> None:
    bench = GroupBench()
    bench.hardware.switch(PIN, X, 40, above=False)  # closed up to step 40: X starts at 0
    home_x(bench, Homing(Switch(PIN), -40.0, 2.0, back_off=1.0, travel=60))
    assert bench.steps[X] == 40 + 80 and bench.axes[X].position == 1.0


def test_other_axes_stay_where_they_are_and_earlier_moves_are_finished() -> None:
    bench = GroupBench()
    bench.hardware.switch(PIN, X, -800, above=False)
    bench.group.move(x=2, y=3)
    home_x(bench, Homing(Switch(PIN), -40.0, 2.0, back_off=1.0, travel=60))
    assert bench.steps[1:] == [600, 0] and bench.axes[1].position == 3.0  # y=3, 200 steps per unit


def test_a_switch_that_is_not_there_is_reported() -> None:
    bench = GroupBench()
    with pytest.raises(GroupError, match="the switch at pin 20 was not reached: increase travel"):
        Homing(Switch(PIN), -40.0, 2.0, back_off=1.0, travel=6).find(bench.axes[X])
    assert bench.steps[X] == -480 and bench.group.done()  # travel 6, 80 steps per unit


def test_a_switch_that_stays_closed_is_reported() -> None:
    bench = GroupBench()
    # closed up to 100 units above: it cannot be left
    bench.hardware.switch(PIN, X, 8000, above=False)
    with pytest.raises(GroupError, match="pin 20 stays closed"):
        Homing(Switch(PIN), -40.0, 2.0, back_off=1.0, travel=60).find(bench.axes[X])
    assert bench.group.done()


def test_after_homing_the_switch_stops_nothing() -> None:
    bench = GroupBench()
    bench.hardware.switch(PIN, X, -800, above=False)
    home_x(bench, Homing(Switch(PIN), -40.0, 2.0, back_off=1.0, travel=60))
    bench.axes[X].move(-5)  # beyond the switch
    bench.group.wait()
    assert bench.axes[X].position == -5


def test_numbers_that_make_no_search_are_refused() -> None:
    for speed, slow, back_off, travel in ((0, 1, 1, 1), (1, 0, 1, 1), (1, 1, -1, 1), (1, 1, 1, 0)):
        with pytest.raises(ValueError, match="above 0"):
            Homing(Switch(PIN), speed, slow, back_off, travel)
