"""Test limit switches of several axes on one input: reports, stops, and homing one by one.

LIMIT has the pin of each axis; axes with the same pin share an input. Machine.physical() returns
the steps of the motors, Machine.reported() the last reported position. Machine.play(lines, events)
also sends real-time bytes at their ms. Machine.rest() resumes holds, waits until motion has ended,
and asks for a report.
"""

from types import ModuleType
from typing import Any

import pytest
from rig_bench import Machine
from ugrbl.boardfile import board_check
from ugrbl.boardfile.files import load_board
from ugrbl.compiling import build
from ugrbl.sim.engine import Switch

_SWITCH_STEPS = 800  # steps at which switches close; 250 steps are 1 mm
_SETTINGS = {
    1: 255,
    22: 1,
    24: 300,
    25: 3000,
    26: 5,
    27: 1,
    **{number + axis: value for number, value in ((110, 3000), (120, 400)) for axis in range(3)},
}
_ORDER = ("Z", "X", "Y")  # of homing


def board(limits: "tuple[int | None, ...]" = (9, 9, 9), **options: Any) -> ModuleType:
    """Return the simulator's board with its limit switches on these pins; None: no switch."""
    module = ModuleType("board")
    module.__dict__.update(
        {**vars(load_board("sim")), "LIMIT": limits, "HOMING": _ORDER, **options}
    )
    return module


def machine(
    settings: "dict[int, float] | None" = None,
    limits: "tuple[int | None, ...]" = (9, 9, 9),
    switch_steps: int = _SWITCH_STEPS,
    **options: Any,
) -> Machine:
    """Return a machine on this board; switch_steps: where each switch closes."""
    cnc = Machine({**_SETTINGS, **(settings or {})}, board(limits, **options), watched=False)
    for axis, letter in enumerate("xyz"):
        cnc.rig.engine.switches.append(Switch(f"limit_{letter}", axis, True, switch_steps))
    return cnc


@pytest.mark.parametrize(
    ("limits", "closed", "letters"),
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
    limits: "tuple[int | None, ...]", closed: str, letters: str
) -> None:
    """closed: the axis whose switch closes; letters: the axes in the report."""
    cnc = machine(limits=limits)
    cnc.rig.port.push({f"limit_{closed}": True})
    cnc.play(["?"])
    reports = [line for line in cnc.received if line.startswith("<")]
    assert reports and all(f"|Pn:{letters}" in line for line in reports)
    assert not any(f"|Pn:{letters}{more}" in line for line in reports for more in "XYZ")


@pytest.mark.parametrize("limits", [(9, 9, 9), (9, 9, 11), (9, 10, 9), (9, 10, 10)])
def test_axes_are_homed_one_by_one_to_their_own_switches(
    limits: "tuple[int | None, ...]",
) -> None:
    """All switches close at _SWITCH_STEPS, and _ORDER homes one axis after the other."""
    cnc = machine(limits=limits)
    cnc.play(["$H"])
    assert cnc.reported() == [-1, -1, -1]
    # After a pull-off of 1 mm.
    assert cnc.physical() == pytest.approx([_SWITCH_STEPS - 250] * 3, abs=10)


def test_z_may_share_with_an_axis_homed_after_it_in_grbls_order() -> None:
    """HOMING=() is Grbl's order: Z first, then X and Y together. X and Z share an input."""
    cnc = machine(limits=(9, 10, 9), HOMING=())
    cnc.play(["$H"])
    assert cnc.reported() == [-1, -1, -1]
    assert cnc.physical() == pytest.approx([_SWITCH_STEPS - 250] * 3, abs=10)


@pytest.mark.parametrize("axis", range(3))
def test_homing_does_not_start_with_a_closed_switch(axis: int) -> None:
    """With a shared input, a closed switch could be that of any axis."""
    cnc = machine()
    # It is closed at the start.
    cnc.rig.engine.switches[axis] = Switch(f"limit_{'xyz'[axis]}", axis, True, 0)
    cnc.rig.port.update()
    cnc.play(["$H"], [(1500, "\x18")])  # a reset ends the alarm
    assert "[MSG:Move off the closed limit switch first]" in cnc.received
    assert "ALARM:1" in cnc.received
    assert cnc.physical() == [0, 0, 0]


def test_cycle_of_two_axes_that_share_is_refused() -> None:
    """$44 to $49 are the axes (bits) of each homing cycle.

    A cycle of X and Y (3) cannot be set. Without cycles, in Grbl's order, $H is refused.
    """
    cnc = machine()
    cnc.play(["$44=3", "$45=1", "$46=0"])
    assert cnc.received.count("error:3") == 1
    cnc = machine({44: 0, 45: 0, 46: 0})
    cnc.play(["$H"], [(3000, "\x18")])  # a reset ends the alarm
    reason = "X and Y share a limit input: home them one after the other, by $44 to $49"
    assert f"[MSG:{reason}]" in cnc.received
    assert "ALARM:6" in cnc.received
    assert cnc.physical()[:2] == [0, 0]


def test_position_stays_right_after_a_reset_at_any_time_of_homing() -> None:
    """A reset ends $H after some ms. A second $H then ends as usual, unless a switch is closed."""
    for ms in range(50, 4000, 370):
        cnc = machine()
        steps_after_reset: list[Any] = []

        def script(
            cnc: Machine = cnc, ms: int = ms, steps_after_reset: Any = steps_after_reset
        ) -> Any:
            """Reset (0x18) in homing; note the steps; home again unless a switch is closed."""
            yield from cnc.start()
            cnc.rig.link.send(b"$H\n")
            yield cnc.rig.ms(ms)
            cnc.rig.link.send(b"\x18")
            yield from cnc.rest()
            steps_after_reset.append(cnc.physical())
            if any(steps >= _SWITCH_STEPS for steps in steps_after_reset[0]):
                return
            cnc.take()
            yield from cnc.sender.wait("idle", "$H\n", settle=1)
            yield from cnc.rest()

        cnc.run(script())
        if all(steps < _SWITCH_STEPS for steps in steps_after_reset[0]):
            assert cnc.reported() == [-1, -1, -1], ms
            assert cnc.physical() == pytest.approx([_SWITCH_STEPS - 250] * 3, abs=10), ms


@pytest.mark.parametrize("axis", range(3))
def test_any_of_the_switches_stops_motion(axis: int) -> None:
    """$21=1 enables hard limits. The report has all axes that share the input."""
    for stop_steps in range(300, 2300, 271):
        cnc = machine({21: 1, 22: 0}, switch_steps=stop_steps)
        cnc.play([f"G1{'XYZ'[axis]}20F1500", "G4P0.1"], [(4000, "\x18")])  # a reset ends the alarm
        assert "ALARM:1" in cnc.received
        assert any("|Pn:XYZ" in line for line in cnc.received if line.startswith("<"))
        assert cnc.physical()[axis] == stop_steps  # no step after the one that closed it


@pytest.mark.parametrize(
    ("changes", "expected"),
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
def test_impossible_homing_is_named_by_board_check(
    changes: "dict[str, Any]", expected: str
) -> None:
    """In this board, X and Y share pin 9. An empty text: no problem is found."""
    module = ModuleType("board")
    base = load_board("rpi_pico")
    vars(module).update({**vars(base), "LIMIT": (9, 9, 11), **changes})
    found_problems = list(board_check.problems(module))
    assert (
        any(expected in problem for problem in found_problems)
        if expected
        else found_problems == []
    )


def test_board_with_separate_inputs_has_no_module_for_shared_ones() -> None:
    assert "extras.motors.shared_limits" not in build.modules_of(load_board("rpi_pico"))
    module = ModuleType("board")
    vars(module).update({**vars(load_board("rpi_pico")), "LIMIT": (9, 9, 11), "HOMING": _ORDER})
    assert "extras.motors.shared_limits" in build.modules_of(module)
