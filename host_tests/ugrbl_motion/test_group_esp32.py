"""A group on the models of the ESP32's engines: steps, stops, outputs and rate."""

from typing import Any

import pytest
from esp_bench import EspEngine
from ugrbl.sim.group_hardware import SimHardware
from ugrbl_motion import Axis, Group, Output


class Hardware(SimHardware):
    """Hardware with the model of an engine of the ESP32: "rmt" or "i2s"."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self._name = name

    def engine(self, step: "tuple[int, ...]", direction: "tuple[int, ...]") -> Any:
        made = super().engine(step, direction)
        self.sim: Any = EspEngine(self._name, len(step))
        self.sim.trace = made.trace
        return self.sim


@pytest.fixture(params=["rmt", "i2s"])
def group(request: pytest.FixtureRequest) -> Group:
    """Return a group with 80 and 40 steps per unit; speed 20, acceleration 200; and an output."""
    x, y = Axis(2, 5, 80, 20, 200), Axis(3, 6, 40, 20, 200)
    return Group(x=x, y=y, lamp=Output(15), hardware=Hardware(request.param))


def steps(group: Group) -> "list[int]":
    return list(group.hardware.steps())  # type: ignore[attr-defined]


def test_moves_make_their_steps_and_switch_the_output(group: Group) -> None:
    group.move(10, x=5, y=3, lamp=1)
    group.move(10, x=2, lamp=0)
    number = group.move(x=4)
    group.wait(number)
    assert steps(group) == [320, 120] == [axis.steps for axis in group.axes]  # x=4 and y=3
    hardware: Any = group.hardware
    assert [levels for _, levels, _ in hardware.outputs] == [0, 1, 0]


def test_a_stop_slows_down_and_the_next_move_begins_there(group: Group) -> None:
    group.move(x=50)
    group.hardware.sleep_ms(1000)
    group.stop()
    group.wait()
    x = group.axes[0]
    assert 10 < x.position < 30 and steps(group)[0] == x.steps  # 20 units/s, for 1 s
    x.move(1)
    group.wait()
    assert steps(group)[0] == 80  # x=1


def test_the_rate_is_exact(group: Group) -> None:
    group.axes[0].run(3.0133)
    group.hardware.sleep_ms(20_000)
    hardware: Any = group.hardware
    # steps of X, without those of the ramp
    times_us = [step[0] for step in hardware.sim.steps if step[1] == 0][100:]
    rate = (len(times_us) - 1) / (times_us[-1] - times_us[0]) * 1e6
    # first and last step may be off by some us
    assert abs(rate / (3.0133 * 80) - 1) < 1e-6 + 4 / (times_us[-1] - times_us[0])
