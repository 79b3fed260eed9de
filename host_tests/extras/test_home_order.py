"""Test which axes $H homes, and in which order.

home() returns a machine after $H, and its axes in the order in which they met their switches.
Machine.physical() are the motors' steps, Machine.reported() is the last reported position in mm.
"""

from collections.abc import Iterator
from types import ModuleType
from typing import Any

import pytest
from base import state as st
from motion.layout import ROW_AXES, ROW_STRIDE
from rig_bench import Machine
from ugrbl.boardfile import board_check
from ugrbl.boardfile.files import load_board
from ugrbl.sim.engine import Switch

_SWITCH_STEPS = 800  # steps from power-up to each switch
_PER_MM = 250  # steps
_MIN_STEPS = 10  # steps of a row, for a rate
_SETTINGS = {
    22: 1,
    24: 300,
    25: 3000,
    26: 5,
    27: 1,
    **{number + axis: value for number, value in ((110, 3000), (120, 400)) for axis in range(3)},
}


def machine_with_switches(
    settings: "dict[int, float] | None" = None, name: str = "sim_home_order", **options: Any
) -> Machine:
    """Return a machine of this board with options, and with a switch at each of X, Y and Z."""
    board = ModuleType("board")
    board.__dict__.update({**vars(load_board(name)), **options})
    machine = Machine({**_SETTINGS, **(settings or {})}, board, watched=False)
    for axis, letter in enumerate("xyz"):
        machine.rig.engine.switches.append(Switch(f"limit_{letter}", axis, True, _SWITCH_STEPS))
    return machine


def home(
    settings: "dict[int, float] | None" = None,
    command: str = "$H",
    stop_ms: int = 0,
    **options: Any,
) -> "tuple[Machine, list[str]]":
    """Return a machine after $H, and its axes in the order in which they met their switches.

    settings: by $-number; stop_ms: a reset then, 0: none; options: of the board sim_home_order,
    which homes X, then Y.
    """
    machine = machine_with_switches(settings, **options)
    order: list[str] = []
    update = machine.rig.port.update

    def note_closed() -> None:
        """Note axes whose switches have closed; called when an input has changed."""
        update()
        for letter in "XYZ":
            if machine.rig.port.is_closed(f"limit_{letter.lower()}") and letter not in order:
                order.append(letter)

    machine.rig.engine.pins_changed = note_closed
    machine.play([command], [(stop_ms, "\x18")] if stop_ms else [])
    return machine, order


def test_axes_are_homed_in_order_and_unnamed_ones_are_not() -> None:
    machine, order = home()
    assert order == ["X", "Y"]
    assert machine.reported() == [-1, -1, 0]  # $27, the pull-off, is 1 mm
    assert machine.physical()[2] == 0


@pytest.mark.parametrize(
    ("masks", "order"),
    [
        ((4, 1, 2), "ZXY"),
        ((2, 0, 4, 0, 0, 1), "YZX"),
        ((3, 4), "XYZ"),
        ((0, 0), "ZXY"),  # none: Grbl's own
    ],
)
def test_settings_change_the_order_at_run_time(masks: "tuple[int, ...]", order: str) -> None:
    """masks: $44 to $49, axes homed in each of six cycles; bits 1 X, 2 Y, 4 Z."""
    settings = {44 + i: (masks + (0,) * 6)[i] for i in range(6)}
    machine, letters = home(settings)
    assert "".join(letters) == order
    assert machine.reported() == [-1, -1, -1]


def test_one_axis_is_homed_alone_on_request() -> None:
    machine, order = home(command="$HZ", SINGLE_AXIS_HOMING=True)
    assert order == ["Z"] and machine.reported() == [0, 0, -1]


def test_failed_cycle_ends_homing() -> None:
    """X's travel ($130) is 1 mm: the search ends before its switch at 3.2 mm. Y and Z stay."""
    machine, order = home({130: 1}, HOMING=("X", "YZ"))
    assert "ALARM:9" in machine.received and order == []
    assert machine.physical()[1:] == [0, 0]


@pytest.mark.parametrize("name", ["sim_home_order", "sim_rotary"])
@pytest.mark.parametrize("byte", ["!", "\x84"])
def test_hold_between_two_cycles_is_ignored_and_a_door_is_an_alarm(name: str, byte: str) -> None:
    """sim_rotary homes Z, then X and Y. A cycle ends with the pause of $26 after its last move."""
    machine = machine_with_switches({26: 50}, name)
    rig, port = machine.rig, machine.rig.port
    moves: list[int] = []  # masks of axes, of each move of homing

    def script() -> Iterator[Any]:
        """Home with M3 and M8 on, and send the byte after the first cycle; resume what is held."""
        yield from machine.start()
        yield from machine.sender.wait("ok", "$X\nM3S800M8\n")
        hooks = rig.controller.state.hooks
        home_phase = hooks.home_phase

        def note_move(axes: int, *arguments: Any) -> None:
            home_phase(axes, *arguments)
            moves.append(axes)

        hooks.home_phase = note_move
        machine.take()
        rig.link.send(b"$H\n")
        yield lambda: len(moves) == 4  # of the first cycle
        rig.link.send(byte.encode("latin-1"))
        for _ in range(60):
            yield rig.ms(100)
            if rig.controller.state.run & (st.HOLD | st.DOOR):
                rig.link.send(b"~")
            assert not port.spindle_pwm

    machine.run(script())
    lines = machine.take()
    if byte == "!":
        assert lines == ["ok"] and len(moves) == 8
        assert rig.controller.state.run == st.IDLE
    else:
        assert lines[0] == "ALARM:7" and len(moves) == 4


def rates(machine: Machine) -> "list[float]":
    """Return the highest rate of each motor, mm/min."""
    highest = [0.0, 0.0, 0.0]
    for _, row in machine.rows:
        for axis in range(3):
            # Steps of this row; ticks of the first and the last one.
            count, first, last = row[ROW_AXES + axis * ROW_STRIDE :][:3]
            if count > _MIN_STEPS:
                gap_s = (last - first) / (count - 1) / machine.rig.engine.tick_hz
                highest[axis] = max(highest[axis], 60 / gap_s / _PER_MM)
    return highest


def test_each_axis_has_a_rate_of_its_own() -> None:
    homing = ("Z", "X", "Y")
    machine, _ = home({190: 600, 192: 1200}, HOMING=homing)
    assert rates(machine) == pytest.approx([600, 3000, 1200], rel=0.02)


def test_axes_homed_together_move_at_their_slowest_rate() -> None:
    machine, _ = home({190: 600, 191: 900}, HOMING=("Z", "XY"))
    assert rates(machine) == pytest.approx([600, 600, 3000], rel=0.02)


@pytest.mark.parametrize("ms", [50, 400])
def test_rates_are_restored_after_a_reset(ms: int) -> None:
    """While X is homed, its own feed and seek rate ($180, $190) are in place of $24 and $25.

    ms: time of a reset after the start of homing.
    """
    machine, _ = home({180: 60, 190: 600}, stop_ms=ms)
    assert "ALARM:6" in machine.received
    machine.play(["$X", "$$"])
    assert {"$24=300.000", "$25=3000.000", "$180=60.000", "$190=600.000"} <= {*machine.received}


def test_settings_are_masks_of_axes() -> None:
    """Of three axes, 7 is the largest mask. $45 and $49 are among the six cycles."""
    machine = Machine(board="sim_home_order", watched=False)
    machine.play(["$44=8", "$45=7", "$44=-1", "$$"])
    output = machine.received
    assert [x for x in output if x == "ok" or "error" in x] == ["error:3", "ok", "error:4", "ok"]
    assert "$44=1" in output and "$45=7" in output and "$49=0" in output


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("XX",), "HOMING: X is no axis, or named twice"),
        (("A",), "HOMING: A is no axis, or named twice"),
        (("x",), "HOMING: x is no axis, or named twice"),
        (("X",) * 7, "HOMING has 7 parts: there may be 6"),
    ],
)
def test_impossible_order_is_reported(words: "tuple[str, ...]", why: str) -> None:
    board = ModuleType("board")
    board.__dict__.update({**vars(load_board("sim")), "HOMING": words})
    assert board_check.problems(board) == [why]
