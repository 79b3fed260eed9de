"""Exact rates: the mean rate of a long move differs from the one asked for by less than 1e-6."""

from array import array
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from laws import pulses, some, uneven
from motion.layout import ROW_AXES, ROW_TICKS
from ugrbl.sim.engine import SimEngine
from ugrbl.sim.group_hardware import SimHardware
from ugrbl_motion import Axis, Group

ERROR = 1e-6
_TO_SPEED_S = 1.0
# Ticks by which the time of the first and of the last step is rounded.
_ROUNDING = 2


class Hardware(SimHardware):
    """Hardware whose engine has another clock: ticks per second, log2 of the ticks of a
    segment."""

    def __init__(self, tick_hz: int = SimEngine.tick_hz, segment_log2: int = 17) -> None:
        super().__init__()
        self._clock = tick_hz, segment_log2

    def engine(self, step: "tuple[int, ...]", direction: "tuple[int, ...]") -> SimEngine:
        made = super().engine(step, direction)
        made.tick_hz, made.segment_log2 = self._clock
        return made


def rate_error(hardware: SimHardware, rate: float, axis: int = 0) -> float:
    """Return the relative error of an axis' mean rate (rate: steps/s), without the ramp at its
    start. 0: within the rounding of its first and last step."""
    cruising_from = _TO_SPEED_S * hardware.sim.tick_hz
    count_at = ROW_AXES + 3 * axis
    rows = [
        (start, row) for start, row in hardware.made if row[count_at] and start > cruising_from
    ]
    (first, first_row), (last, last_row) = rows[0], rows[-1]
    steps = sum(row[count_at] for _, row in rows) - first_row[count_at]
    ticks = last + last_row[count_at + 2] - first - first_row[count_at + 2]
    due_ticks = steps * hardware.sim.tick_hz / rate
    return max(abs(ticks - due_ticks) - _ROUNDING, 0) / due_ticks


CLOCKS = {"sim": (SimEngine.tick_hz, 17), "pio": (12_500_000, 17), "rmt": (1_000_000, 12)}


@pytest.mark.parametrize("engine", CLOCKS)
@pytest.mark.parametrize(
    ("per_unit", "speed"),
    [
        (64 / 15, 15.0),  # a mount, seconds of arc
        (64 / 15, 15.041),
        (64 / 15 * 3600, 15.041 / 3600),  # the same in degrees
        (10.0, 15.041),
        (0.5, 15.0),
        (1.0, 0.3),  # a step in three seconds
        (400.0, 7.0),
    ],
)
def test_a_long_move_has_exactly_its_rate(per_unit: float, speed: float, engine: str) -> None:
    hardware = Hardware(*CLOCKS[engine])
    # Pins of step and direction, steps per unit, greatest speed and acceleration.
    ra = Axis(2, 5, per_unit, max(20 * speed, 1.0), 100 * speed)
    Group(ra=ra, hardware=hardware)
    ra.run(speed)
    hardware.pass_s(60)
    assert rate_error(hardware, per_unit * speed) < ERROR


@some(30)
@given(st.floats(0.2, 80_000), st.floats(0.01, 1000), st.booleans())
def test_any_rate_is_exact(rate: float, per_unit: float, back: bool) -> None:
    """rate: steps/s; per_unit: steps per unit."""
    hardware = Hardware()
    speed = rate / per_unit
    axis = Axis(2, 5, steps_per_unit=per_unit, speed=2 * speed, acceleration=10 * speed)
    Group(x=axis, hardware=hardware)
    axis.run(-speed if back else speed)
    hardware.pass_s(max(5, 40 / rate))  # at least 40 steps
    assert rate_error(hardware, rate) < ERROR


def test_without_the_correction_the_rate_is_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """The planner's own error, which set_time() corrects: a rate of 64 steps/s."""
    monkeypatch.setattr("ugrbl_motion.exact.set_time", lambda *_: 0)
    hardware = Hardware()
    ra = Axis(2, 5, steps_per_unit=64 / 15, speed=300, acceleration=1500)
    Group(ra=ra, hardware=hardware)
    ra.run(15.0)
    hardware.pass_s(60)
    assert 3e-6 < rate_error(hardware, 64.0) < 1e-3  # 15 arc seconds/s * 64/15 steps


def test_all_axes_of_a_line_are_exact() -> None:
    hardware = Hardware()
    x, y = (Axis(2 + i, 5 + i, per, 100, 1000) for i, per in enumerate((80.0, 37.0)))
    group = Group(x=x, y=y, hardware=hardware)
    # 300, 400: a length of 500 at 5 units/s, 3 and 4 units/s of the axes
    group.move(5, x=300, y=400)
    hardware.pass_s(60)
    assert rate_error(hardware, 80 * 3.0, 0) < ERROR
    # The shorter axis' first and last step are placed within a tenth of its interval.
    steps_of_y = 37 * 4.0 * (60 - _TO_SPEED_S)
    assert rate_error(hardware, 37 * 4.0, 1) < ERROR + 0.1 / steps_of_y


def test_steps_stay_even() -> None:
    """The correction of each row must not show: the intervals of a steady rate differ by few
    ticks."""
    hardware = Hardware()
    ra = Axis(2, 5, steps_per_unit=100.0, speed=100, acceleration=1000)
    Group(ra=ra, hardware=hardware)
    ra.run(15.041)
    hardware.pass_s(20)
    # after the ramp of 2 s
    rows = [(start, row) for start, row in hardware.made if start > 2 * hardware.sim.tick_hz]
    ticks = [tick for tick, _ in pulses(rows, 0)]
    assert uneven(ticks) <= 1
    assert max(b - a for a, b in pairwise(ticks)) - min(b - a for a, b in pairwise(ticks)) <= 4


def test_a_pace_keeps_the_rate_exact_and_ends_exactly() -> None:
    """A camera guides a mount: half as fast again, then at the old rate."""
    hardware = Hardware()
    ra = Axis(2, 5, steps_per_unit=64 / 15, speed=300, acceleration=1500)
    group = Group(ra=ra, hardware=hardware)
    ra.run(15.0)
    for factor in (1.5, 0.5, 1.0):
        group.pace(factor)
        hardware.made.clear()
        hardware.pass_s(30)
        # without the first rows, where the speed changes; times from 0
        hardware.made[:] = [(start - hardware.made[0][0], row) for start, row in hardware.made[5:]]
        assert rate_error(hardware, 64.0 * factor) < ERROR  # 15 * 64 / 15 steps/s


def test_moves_at_one_speed_follow_one_another_exactly() -> None:
    """A turntable that triggers a camera: many short moves make one rate."""
    hardware = Hardware()
    turn = Axis(2, 5, steps_per_unit=12800 / 360, speed=60, acceleration=120)
    group = Group(turn=turn, hardware=hardware)
    group.move_by(10, turn=20)
    for _ in range(200):
        group.move_by(10, turn=0.75)
    group.wait()
    rows = hardware.made[: -len(hardware.made) // 10]  # without the ramp at the end
    hardware.made[:] = rows
    # 10 degrees/s; a move of 0.75 degrees has 26 or 27 steps, 26.67 on average
    assert rate_error(hardware, 12800 / 36) < 2e-5


def call_set_time(row_in: "list[int]", bits: int, cruise: int = 1 << 20) -> "tuple[int, Any, Any]":
    """Call set_time() with one motor. row_in: ticks, steps, first and last tick; bits: of a float,
    ticks per step; cruise: speed of the block. Return its result, the row and the remainder of a
    tick."""
    from motion.layout import BLOCK_AT, CRUISE, FLOW_LENGTH, LINE
    from ugrbl_motion.exact import set_time

    flow, ring = array("i", [0] * FLOW_LENGTH), array("i", [0] * 30)
    flow[BLOCK_AT] = 0
    ring[LINE], ring[CRUISE] = bits, cruise
    row_out, remainder = array("i", [row_in[0], 0, 0, *row_in[1:]]), array("i", [0])
    return set_time(flow, ring, row_out, 1, remainder), row_out, remainder


def test_rows_of_another_speed_are_left_alone() -> None:
    """At 1000 ticks per step, a row of 10 steps is corrected if it lasts about 10000 ticks; not
    without a period (bits 0), or without steps."""
    (bits,) = array("i", array("f", [1000.0]).tobytes())
    for ticks in (9_800, 10_200, 5_000, 40_000):
        is_corrected, row, remainder = call_set_time([ticks, 10, ticks // 10, ticks], bits)
        assert not is_corrected and row[ROW_TICKS] == ticks and remainder[0] == 0
    is_corrected, row, _ = call_set_time([10_009, 10, 1001, 10_009], bits)
    assert is_corrected and list(row) == [10_000, 0, 0, 10, 1001, 10_000]
    assert call_set_time([10_009, 10, 1001, 10_009], 0)[0] == 0
    assert call_set_time([10_009, 0, 0, 0], bits)[0] == 0


def test_the_longest_rows_fit() -> None:
    """No overflow of 32 bits: long periods, many steps. Rows that are off by up to 1/2000 are
    corrected."""
    for period, steps in ((2.0**27 - 8, 1), (32.0, 4095), (32.53, 4095), (33_000.25, 4000)):
        bits = array("i", array("f", [period]).tobytes())[0]
        exact = int(array("f", [period])[0] * steps)
        for error_ticks in (-exact // 2000, 0, exact // 2000):
            ticks = exact + error_ticks
            is_corrected, row, _ = call_set_time([ticks, steps, ticks // steps, ticks], bits)
            assert is_corrected and row[ROW_TICKS] == exact == row[ROW_AXES + 2]
