"""Test a wire cutter (XYUV): letters, feed rates of the two ends, arcs, homing, refusals.

A wire cutter moves a wire by its two ends: X and Y, and U and V. Machine.reported() returns the
last reported position.
"""

import math
from types import ModuleType
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from motion.layout import ROW_AXES, ROW_STRIDE
from rig_bench import Machine
from ugrbl.boardfile import board_check
from ugrbl.boardfile.files import load_board
from ugrbl.sim.engine import Switch

_PER_MM = 250  # steps
# Rates (mm/min) and accelerations (mm/s2) so high that ramps hardly count.
_SWIFT = {
    **{110 + i: 60000.0 for i in range(4)},
    **{120 + i: 100000.0 for i in range(4)},
}
_MM = st.integers(-400, 400).map(lambda tenths: tenths / 10)


def board(**options: Any) -> ModuleType:
    """Return the board sim_wire with other options."""
    module = ModuleType("board")
    module.__dict__.update({**vars(load_board("sim_wire")), **options})
    return module


def machine_after(*lines: str, **options: Any) -> Machine:
    """Return a wire cutter after these lines.

    _SWIFT has such high rates and accelerations that ramps hardly count.
    """
    machine = Machine(_SWIFT, board(**options))
    machine.play(lines)
    return machine


def motor_positions(machine: Machine) -> "list[float]":
    """Return the motors' positions, mm."""
    return [steps / _PER_MM for steps in machine.physical()]


def motion_seconds(machine: Machine) -> float:
    """Return the time in s from the first row of steps to the end of the last."""
    first, (start, row) = machine.rows[0][0], machine.rows[-1]
    return float(start + row[0] - first) / machine.rig.engine.tick_hz


def test_words_u_and_v_move_the_third_and_fourth_motor() -> None:
    machine = machine_after("G0X1Y2U3V4", "G91", "G1U-1V1F900", "$J=G91X1U1F900")
    assert motor_positions(machine) == [2, 2, 3, 5]
    assert machine.reported() == [2, 2, 3, 5]


@pytest.mark.parametrize("word", ["Z1", "A1", "B1", "W1"])
def test_letters_of_other_machines_are_refused_and_nothing_moves(word: str) -> None:
    machine = machine_after(f"G0X1{word}")
    assert "error:20" in machine.received
    assert motor_positions(machine) == [0, 0, 0, 0]


def test_a_drilling_cycle_is_refused_without_any_effect() -> None:
    """There is no Z. M3 and the cycle of the refused line are not in force: the next is a G1."""
    machine = Machine(_SWIFT, board(LENIENT=True))
    replies: list[str] = []

    def answered(_: str, lines: "list[str]") -> None:
        replies.append(lines[-1])
        assert machine.rig.port.spindle_pwm == 0

    machine.converse(("G1X1F900", "G81X2Y1Z-1R1F100M3S500", "X3Y2"), answered)
    assert replies == ["ok", "error:20", "ok"]
    assert motor_positions(machine) == [3, 2, 0, 0]


def test_a_machine_without_the_option_has_no_u() -> None:
    assert "error:20" in machine_after("G0U1", XYUV=False).received


def test_offsets_and_probed_places_are_in_the_order_of_the_motors() -> None:
    received = machine_after("G10L2P1X1Y2U3V4", "G92V7", "$#").received
    assert "[G54:1.000,2.000,3.000,4.000]" in received
    assert "[G92:0.000,0.000,0.000,-11.000]" in received  # machine position 0 is 7: 0 - 4 - 7


def test_a_sender_for_grblhal_is_given_the_letters() -> None:
    assert "[AXS:4:XYUV]" in machine_after("$I", DIALECT="hal").received


@pytest.mark.parametrize(
    ("line", "mm"),
    [
        ("X10U10", 10.0),  # straight: not the 14 mm of all four axes
        ("X3Y4U6V8", 10.0),  # the second end has the longer way
        ("X6Y8U3V4", 10.0),
        ("X6Y8", 10.0),  # one end stands
        ("U6V8", 10.0),
    ],
)
def test_the_end_with_the_longer_way_moves_at_the_feed_rate(line: str, mm: float) -> None:
    assert motion_seconds(machine_after(f"G1{line}F600")) == pytest.approx(mm / 600 * 60, rel=0.01)


@pytest.mark.thorough
@given(_MM, _MM, _MM, _MM, st.integers(100, 1500))
def test_any_line_takes_the_time_of_its_longer_end(
    x: float, y: float, u: float, v: float, feed: int
) -> None:
    """XY and UV are the two ends of the wire: the one with the longer way has the feed rate."""
    longer_mm = max(math.hypot(x, y), math.hypot(u, v))
    assume(longer_mm > 5)
    duration_s = motion_seconds(machine_after(f"G1X{x}Y{y}U{u}V{v}F{feed}"))
    assert duration_s == pytest.approx(longer_mm / feed * 60, rel=0.01)


@pytest.mark.parametrize("line", ["G93G1X3Y4U6V8F30", "G93G1U1F30"])
def test_inverse_time_is_the_time_of_the_line(line: str) -> None:
    assert motion_seconds(machine_after(line)) == pytest.approx(2, rel=0.01)


@pytest.mark.parametrize("end", ["", "U5", "U5V5"])
def test_on_an_arc_x_and_y_move_at_the_feed_rate(end: str) -> None:
    """A half circle with a radius of 10 mm; U and V, which are straight, do not count."""
    machine = machine_after(f"G2X20I10{end}F1200")
    assert motion_seconds(machine) == pytest.approx(math.pi * 10 / 1200 * 60, rel=0.02)
    assert motor_positions(machine)[:2] == [20, 0]


def test_rates_of_a_jog_and_in_inches_are_those_of_the_longer_end() -> None:
    assert motion_seconds(machine_after("$J=X3Y4U6V8F600")) == pytest.approx(1, rel=0.01)
    assert motion_seconds(machine_after("G20", "G1X1U2F60")) == pytest.approx(2, rel=0.01)


def homed_machine(**options: Any) -> Machine:
    """Return a machine after $H, with a switch per motor, each at another distance."""
    # $22 to $27: homing enabled, its rates, debounce in ms, pull-off in mm.
    settings = {22: 1, 24: 300, 25: 3000, 26: 5, 27: 1, **{110 + i: 3000.0 for i in range(4)}}
    machine = Machine({**settings, **{120 + i: 400.0 for i in range(4)}}, board(**options))
    switches = machine.rig.engine.switches
    # The simulator names the inputs of motors 2 and 3 as on other machines.
    # Distances are in steps.
    switches[:] = [
        Switch(f"limit_{name}", i, True, 500 + 250 * i) for i, name in enumerate("xyza")
    ]
    machine.play(["$H"])
    return machine


def first_motors(machine: Machine) -> "set[int]":
    """Return the motors that make steps in the first ten rows."""
    return {
        motor
        for _, row in machine.rows[:10]
        for motor in range(4)
        if row[ROW_AXES + ROW_STRIDE * motor]
    }


def test_both_ends_are_homed_together() -> None:
    machine = homed_machine()
    assert machine.reported() == [-1] * 4  # $27, the pull-off, is 1 mm
    assert first_motors(machine) == {0, 1, 2, 3}


def test_homing_has_the_order_of_the_board_file() -> None:
    machine = homed_machine(HOMING=("YV", "XU"))
    assert machine.reported() == [-1] * 4  # $27, the pull-off, is 1 mm
    assert first_motors(machine) == {1, 3}


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"STEP": (0, 1, 2)}, "XYUV needs four pins in STEP and in DIR: for X, Y, U and V"),
        ({"ROTARY": "A"}, "XYUV and ROTARY cannot be combined"),
        ({"JOBS": "jobs"}, "XYUV and JOBS cannot be combined"),
        ({"PARKING": True}, "XYUV and PARKING cannot be combined"),
        ({"HOMING": ("Z", "XY")}, "HOMING: Z is no axis, or named twice"),
    ],
)
def test_a_board_file_that_does_not_fit_is_refused(options: "dict[str, Any]", why: str) -> None:
    assert why in board_check.problems(board(**options))
