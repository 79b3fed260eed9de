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
    """Hardware with another engine's clock."""

    def __init__(self, tick_hz: int = SimEngine.tick_hz, segment_log2: int = 17) -> None:
        super().__init__()
        self._clock = tick_hz, segment_log2

    def engine(self, step: "tuple[int, ...]", direction: "tuple[int, ...]") -> SimEngine:
        made = super().engine(step, direction)
        made.tick_hz, made.segment_log2 = self._clock
        return made


def error(hardware: SimHardware, rate: float, axis: int = 0) -> float:
    """Return the relative error of an axis' mean rate, steps/s, without the ramp at its start."""
    begin = _TO_SPEED_S * hardware.sim.tick_hz
    base = ROW_AXES + 3 * axis
    rows = [(start, row) for start, row in hardware.made if row[base] and start > begin]
    (first, a), (last, b) = rows[0], rows[-1]
    steps = sum(row[base] for _, row in rows) - a[base]
    ticks = last + b[base + 2] - first - a[base + 2]
    due = steps * hardware.sim.tick_hz / rate
    return max(abs(ticks - due) - _ROUNDING, 0) / due


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
    ra = Axis(2, 5, per_unit, max(20 * speed, 1.0), 100 * speed)
    Group(ra=ra, hardware=hardware)
    ra.run(speed)
    hardware.pass_s(60)
    assert error(hardware, per_unit * speed) < ERROR


@some(30)
@given(st.floats(0.2, 80_000), st.floats(0.01, 1000), st.booleans())
def test_any_rate_is_exact(rate: float, per_unit: float, back: bool) -> None:
    hardware = Hardware()
    speed = rate / per_unit
    axis = Axis(2, 5, per_unit, 2 * speed, 10 * speed)
    Group(x=axis, hardware=hardware)
    axis.run(-speed if back else speed)
    hardware.pass_s(max(5, 40 / rate))
    assert error(hardware, rate) < ERROR


def test_without_the_correction_the_rate_is_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """The planner's own error: what the correction is for."""
    monkeypatch.setattr("ugrbl_motion.exact.set_time", lambda *_: 0)
    hardware = Hardware()
    ra = Axis(2, 5, 64 / 15, 300, 1500)
    Group(ra=ra, hardware=hardware)
    ra.run(15.0)
    hardware.pass_s(60)
    assert 3e-6 < error(hardware, 64.0) < 1e-3


def test_all_axes_of_a_line_are_exact() -> None:
    hardware = Hardware()
    x, y = (Axis(2 + i, 5 + i, per, 100, 1000) for i, per in enumerate((80.0, 37.0)))
    group = Group(x=x, y=y, hardware=hardware)
    group.move(5, x=300, y=400)
    hardware.pass_s(60)
    assert error(hardware, 80 * 3.0, 0) < ERROR
    # The shorter axis' first and last step are placed within a tenth of its interval.
    steps = 37 * 4.0 * (60 - _TO_SPEED_S)
    assert error(hardware, 37 * 4.0, 1) < ERROR + 0.1 / steps


def test_steps_stay_even() -> None:
    hardware = Hardware()
    ra = Axis(2, 5, 100.0, 100, 1000)
    Group(ra=ra, hardware=hardware)
    ra.run(15.041)
    hardware.pass_s(20)
    rows = [(start, row) for start, row in hardware.made if start > 2 * hardware.sim.tick_hz]
    ticks = [tick for tick, _ in pulses(rows, 0)]
    assert uneven(ticks) <= 1
    assert max(b - a for a, b in pairwise(ticks)) - min(b - a for a, b in pairwise(ticks)) <= 4


def test_a_pace_keeps_the_rate_exact_and_ends_exactly() -> None:
    """A camera guides a mount: half as fast again, then at the old rate."""
    hardware = Hardware()
    ra = Axis(2, 5, 64 / 15, 300, 1500)
    group = Group(ra=ra, hardware=hardware)
    ra.run(15.0)
    for factor in (1.5, 0.5, 1.0):
        group.pace(factor)
        hardware.made.clear()
        hardware.pass_s(30)
        hardware.made[:] = [(start - hardware.made[0][0], row) for start, row in hardware.made[5:]]
        assert error(hardware, 64.0 * factor) < ERROR


def test_moves_at_one_speed_follow_one_another_exactly() -> None:
    """A turntable that triggers a camera: many short moves make one rate."""
    hardware = Hardware()
    turn = Axis(2, 5, 12800 / 360, 60, 120)
    group = Group(turn=turn, hardware=hardware)
    group.move_by(10, turn=20)
    for _ in range(200):
        group.move_by(10, turn=0.75)
    group.wait()
    rows = hardware.made[: -len(hardware.made) // 10]
    hardware.made[:] = rows
    assert error(hardware, 12800 / 36) < 2e-5  # the steps of a move: 26 or 27 of 26.67


def kernel(row: "list[int]", bits: int, cruise: int = 1 << 20) -> "tuple[int, Any, Any]":
    """Call set_time() with one motor; return its result, the row and the rest."""
    from motion.layout import BLOCK_AT, CRUISE, FLOW_LENGTH, LINE
    from ugrbl_motion.exact import set_time

    flow, ring = array("i", [0] * FLOW_LENGTH), array("i", [0] * 30)
    flow[BLOCK_AT] = 0
    ring[LINE], ring[CRUISE] = bits, cruise
    made, rest = array("i", [row[0], 0, 0, *row[1:]]), array("i", [0])
    return set_time(flow, ring, made, 1, rest), made, rest


def test_rows_of_another_speed_are_left_alone() -> None:
    (bits,) = array("i", array("f", [1000.0]).tobytes())
    for ticks in (9_800, 10_200, 5_000, 40_000):
        done, made, rest = kernel([ticks, 10, ticks // 10, ticks], bits)
        assert not done and made[ROW_TICKS] == ticks and rest[0] == 0
    done, made, _ = kernel([10_009, 10, 1001, 10_009], bits)
    assert done and list(made) == [10_000, 0, 0, 10, 1001, 10_000]
    assert kernel([10_009, 10, 1001, 10_009], 0)[0] == 0
    assert kernel([10_009, 0, 0, 0], bits)[0] == 0


def test_the_longest_rows_fit() -> None:
    for period, steps in ((2.0**27 - 8, 1), (32.0, 4095), (32.53, 4095), (33_000.25, 4000)):
        bits = array("i", array("f", [period]).tobytes())[0]
        exact = int(array("f", [period])[0] * steps)
        for off in (-exact // 2000, 0, exact // 2000):
            ticks = exact + off
            done, made, _ = kernel([ticks, steps, ticks // steps, ticks], bits)
            assert done and made[ROW_TICKS] == exact == made[ROW_AXES + 2]
