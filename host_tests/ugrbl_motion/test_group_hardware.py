"""The pins of a chip, with the stand-ins for its modules: outputs, switches, one engine."""

import sys
from collections.abc import Iterator
from typing import Any

import machine
import pytest
from ugrbl.sim.engine import SimEngine
from ugrbl_motion import Axis, Group, Output
from ugrbl_motion import hardware as chip


@pytest.fixture(params=["rp2", "esp32"])
def board(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> "Iterator[Any]":
    """Return the hardware of a chip whose engine is the simulator's."""
    monkeypatch.setattr(sys, "platform", request.param)
    monkeypatch.setattr("base.float32.address_of", lambda memory: memory)
    monkeypatch.setattr(chip, "pio", lambda step, direction: SimEngine(len(step)))
    monkeypatch.setattr(chip, "rmt", lambda step, direction: SimEngine(len(step)))
    monkeypatch.setattr(chip.Hardware, "_has_engine", False)
    machine.Pin.pins.clear()
    yield chip.Hardware()
    machine.Pin.pins.clear()


def test_outputs_have_their_levels(board: Any) -> None:
    board.make_outputs((15, 16, 17), 0b101)  # levels: bit 0 is that of the first pin
    levels = [machine.Pin.pins[pin].value() for pin in (15, 16, 17)]
    board.write(0b010)
    assert levels == [1, 0, 1]
    assert [machine.Pin.pins[pin].value() for pin in (15, 16, 17)] == [0, 1, 0]


@pytest.mark.parametrize("level", [0, 1])
def test_a_switch_is_reported_when_it_closes(board: Any, level: int) -> None:
    """level: of the closed switch, which is reported once; opening is not reported."""
    reports: "list[int]" = []
    is_closed = board.watch(20, level, lambda: reports.append(level))
    pin = machine.Pin.pins[20]
    pin.drive(1 - level)
    assert not is_closed() and not reports
    pin.drive(level)
    assert is_closed() and reports == [level]
    pin.drive(1 - level)
    assert len(reports) == 1


def test_a_chip_has_one_engine(board: Any) -> None:
    Group(x=Axis(2, 5, 80, 10, 100), lamp=Output(15, 1), hardware=board)
    assert machine.Pin.pins[15].value() == 1
    with pytest.raises(OSError, match="put all axes into one Group"):
        Group(y=Axis(3, 6, 80, 10, 100), hardware=chip.Hardware())
