"""Test limit switches of several axes on one input: reports, stops, and homing one by one."""

from types import ModuleType
from typing import Any

import pytest
from rig_bench import Machine
from ugrbl.boardfile import board_check
from ugrbl.boardfile.files import load_board
from ugrbl.compiling import build
from ugrbl.sim.engine import Switch

_AT = 800
_SETTINGS = {
    1: 255,
    22: 1,
    24: 300,
    25: 3000,
    26: 5,
    27: 1,
    **{number + axis: value for number, value in ((110, 3000), (120, 400)) for axis in range(3)},
}
_ORDER = ("Z", "X", "Y")


def board(limits: "tuple[int | None, ...]" = (9, 9, 9), **options: Any) -> ModuleType:
    """Return the simulator's board with its limit switches on these pins."""
    made = ModuleType("board")
    made.__dict__.update({**vars(load_board("sim")), "LIMIT": limits, "HOMING": _ORDER, **options})
    return made


def machine(
    settings: "dict[int, float] | None" = None,
    limits: "tuple[int | None, ...]" = (9, 9, 9),
    at: int = _AT,
    **options: Any,
) -> Machine:
    """Return a machine on this board with a switch for each axis."""
    made = Machine({**_SETTINGS, **(settings or {})}, board(limits, **options), watched=False)
    for axis, letter in enumerate("xyz"):
        made.rig.engine.switches.append(Switch(f"limit_{letter}", axis, True, at))
    return made


@pytest.mark.parametrize(
    ("limits", "closed", "told"),
    [
        ((9, 9, 9), "x", "XYZ"),
        ((9, 9, 9), "z", "XYZ"),
        ((9, 9, 11), "y", "XY"),
        ((9, 9, 11), "z", "Z"),
        ((9, 10, 9), "x", "XZ"),
        ((9, None, 9), "z", "XZ"),
        ((9, 10, 11), "y", "Y"),
    ],
)
def test_all_axes_of_an_input_are_reported(
    limits: "tuple[int | None, ...]", closed: str, told: str
) -> None:
    made = machine(limits=limits)
    made.rig.port.push({f"limit_{closed}": True})
    made.play(["?"])
    reports = [line for line in made.received if line.startswith("<")]
    assert reports and all(f"|Pn:{told}" in line for line in reports)
    assert not any(f"|Pn:{told}{more}" in line for line in reports for more in "XYZ")


@pytest.mark.parametrize("limits", [(9, 9, 9), (9, 9, 11), (9, 10, 9), (9, 10, 10)])
def test_axes_are_homed_one_by_one_to_their_own_switches(
    limits: "tuple[int | None, ...]",
) -> None:
    made = machine(limits=limits)
    made.play(["$H"])
    assert made.reported() == [-1, -1, -1]
    assert made.physical() == pytest.approx([_AT - 250] * 3, abs=10)


def test_z_may_share_with_an_axis_homed_after_it_in_grbls_order() -> None:
    made = machine(limits=(9, 10, 9), HOMING=())
    made.play(["$H"])
    assert made.reported() == [-1, -1, -1]
    assert made.physical() == pytest.approx([_AT - 250] * 3, abs=10)


@pytest.mark.parametrize("axis", range(3))
def test_homing_does_not_start_with_a_closed_switch(axis: int) -> None:
    made = machine()
    made.rig.engine.switches[axis] = Switch(f"limit_{'xyz'[axis]}", axis, True, 0)
    made.rig.port.update()
    made.play(["$H"], [(1500, "\x18")])
    assert "[MSG:Move off the closed limit switch first]" in made.received
    assert "ALARM:1" in made.received
    assert made.physical() == [0, 0, 0]


def test_cycle_of_two_axes_that_share_is_refused() -> None:
    made = machine()
    made.play(["$44=3", "$45=1", "$46=0"])
    assert made.received.count("error:3") == 1
    made = machine({44: 0, 45: 0, 46: 0})
    made.play(["$H"], [(3000, "\x18")])
    told = "X and Y share a limit input: home them one after the other, by $44 to $49"
    assert f"[MSG:{told}]" in made.received
    assert "ALARM:6" in made.received
    assert made.physical()[:2] == [0, 0]


def test_position_stays_right_after_a_reset_at_any_time_of_homing() -> None:
    for ms in range(50, 4000, 370):
        made = machine()
        before: list[Any] = []

        def script(made: Machine = made, ms: int = ms, before: Any = before) -> Any:
            yield from made.start()
            made.rig.link.send(b"$H\n")
            yield made.rig.ms(ms)
            made.rig.link.send(b"\x18")
            yield from made.rest()
            before.append(made.physical())
            if any(steps >= _AT for steps in before[0]):  # it stands on a switch
                return
            made.take()
            yield from made.sender.wait("idle", "$H\n", 1)
            yield from made.rest()

        made.run(script())
        if all(steps < _AT for steps in before[0]):
            assert made.reported() == [-1, -1, -1], ms
            assert made.physical() == pytest.approx([_AT - 250] * 3, abs=10), ms


@pytest.mark.parametrize("axis", range(3))
def test_any_of_the_switches_stops_motion(axis: int) -> None:
    for at in range(300, 2300, 271):
        made = machine({21: 1, 22: 0}, at=at)
        made.play([f"G1{'XYZ'[axis]}20F1500", "G4P0.1"], [(4000, "\x18")])
        assert "ALARM:1" in made.received
        assert any("|Pn:XYZ" in line for line in made.received if line.startswith("<"))
        assert made.physical()[axis] == at  # no step after the one that closed it


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {},
            'LIMIT: X and Y share a pin and are homed together: write HOMING = ("Z", "X", "Y")',
        ),
        ({"HOMING": ("Z", "XY")}, "LIMIT: X and Y share a pin and are homed together"),
        ({"HOMING": ("ZX", "Y")}, ""),
        ({"HOMING": ("ZX", "Y"), "LIMIT": (9, 9, 9)}, "LIMIT: X and Z share a pin"),
        ({"HOMING": _ORDER, "LIMIT": (9, 9, 9)}, ""),
        ({"LIMIT": (9, 10, 9)}, ""),
        ({"LIMIT": (9, 9, 2), "HOMING": _ORDER}, "LIMIT: pin 2 is STEP already"),
        ({"PROBE": 9, "HOMING": _ORDER}, "PROBE: pin 9 is LIMIT already"),
        (
            {
                "MOTORS": "XYZY",
                "STEP": (2, 3, 4, 19),
                "DIR": (5, 6, 7, 20),
                "LIMIT": (9, 10, 11, 10),
            },
            "LIMIT: both switches of Y are on pin 10: None for the second motor's",
        ),
    ],
)
def test_impossible_homing_is_named_by_board_check(changes: "dict[str, Any]", said: str) -> None:
    made = ModuleType("board")
    base = load_board("rpi_pico")
    kept = {"FLOOD": None, "SPINDLE_ON": None, "MIST_PIN": None}
    vars(made).update({**vars(base), **kept, "LIMIT": (9, 9, 11), **changes})
    found = list(board_check.problems(made))
    assert any(said in problem for problem in found) if said else found == []


def test_board_with_separate_inputs_has_no_module_for_shared_ones() -> None:
    assert "extras.motors.shared_limits" not in build.modules_of(load_board("rpi_pico"))
    made = ModuleType("board")
    vars(made).update({**vars(load_board("rpi_pico")), "LIMIT": (9, 9, 11), "HOMING": _ORDER})
    assert "extras.motors.shared_limits" in build.modules_of(made)
