"""Test six axes, and rotary ones: meaning of their numbers, rates and ends.

Machine.received is all output; Machine.reported() returns the last reported position.
"""

import math
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from base.state import IDLE
from extras.custom.positions import ModalState
from hypothesis import given
from hypothesis import strategies as st
from language.block_layout import MOVE
from motion.layout import ROW_TICKS
from rig_bench import Machine
from typer.testing import CliRunner
from ugrbl.boardfile import board_check
from ugrbl.boardfile.files import load_board
from ugrbl.cli.app import app
from ugrbl.sim.engine import Switch

# Many cases: the first ring runs a sample of them.
pytestmark = pytest.mark.sampled(2)

_PER_MM = 250  # steps, also per degree
# Rates (mm/min) and accelerations (mm/s2) so high that ramps hardly count.
_SWIFT = {
    **{110 + i: 60000.0 for i in range(6)},
    **{120 + i: 100000.0 for i in range(6)},
}
_ANSWERS = ("ok", "error:", "ALARM:", "[MSG:")


def board(axes: int = 4, **options: Any) -> ModuleType:
    """Return the board sim_rotary with this number of axes and other options."""
    module = ModuleType("board")
    module.__dict__.update({**vars(load_board("sim_rotary")), "DEFAULTS": {}})
    module.__dict__.update({"STEP": tuple(range(axes)), **options})
    return module


def machine_after(
    lines: Sequence[str],
    settings: "dict[int, float] | None" = None,
    axes: int = 4,
    events: "Sequence[tuple[int, str]]" = (),
    **options: Any,
) -> Machine:
    """Return a machine after these lines; events: real-time bytes at their ms.

    _SWIFT has such high rates and accelerations that ramps hardly count.
    """
    machine = Machine({**_SWIFT, **(settings or {})}, board(axes, **options))
    machine.play(lines, events)
    return machine


def motion_seconds(machine: Machine) -> float:
    """Return the time in s from the first row of steps to the end of the last."""
    engine = machine.rig.engine
    first = machine.rows[0][0]
    start, row = machine.rows[-1]
    return float(start + row[ROW_TICKS] - first) / engine.tick_hz


def motor_positions(machine: Machine) -> "list[float]":
    """Return the motors' positions in mm and degrees, 250 steps each."""
    return [steps / _PER_MM for steps in machine.physical()]


# Six axes


def test_six_axes_move_by_lines_jogs_arcs_and_stored_places() -> None:
    """Six linear axes: a move, a helix, a jog and G28; offsets and settings have all axes."""
    lines = ["G0X1Y2Z3A4B5C6", "G28.1", "G2X3I1A5B7C9F500", "$J=G91C-1B-2A-3F900", "G90"]
    # G28 ends where it began: it was stored at the first target. No axis is rotary.
    machine = machine_after([*lines, "G28", "G92A0", "$#", "$$"], axes=6, ROTARY="")
    assert motor_positions(machine) == [1, 2, 3, 4, 5, 6]
    assert machine.reported() == [1, 2, 3, 4, 5, 6]
    output = machine.received
    assert "[G28:1.000,2.000,3.000,4.000,5.000,6.000]" in output
    assert "[G92:0.000,0.000,0.000,4.000,0.000,0.000]" in output
    # $100 to $105, $110 to $115 and so on: all settings of axes.
    assert {f"${n}" for n in range(100, 136) if n % 10 < 6} <= {x.split("=")[0] for x in output}


@pytest.mark.parametrize("axes", [3, 4, 5, 6])
def test_letters_of_missing_axes_are_refused(axes: int) -> None:
    lines = [f"G0{letter}1" for letter in "XYZABC"]
    output = machine_after(lines, axes=axes, ROTARY="").received
    answers = [x for x in output if x.startswith(_ANSWERS)]
    assert answers[:6] == ["ok"] * axes + ["error:20"] * (6 - axes)


@pytest.mark.parametrize("before", ["", "$C\n"])
def test_turn_beyond_single_precision_is_an_alarm_also_in_check_mode(before: str) -> None:
    """39 digits are more than the largest number of single precision, 3.4e38."""
    machine = Machine(_SWIFT, board())

    def script() -> Iterator[Any]:
        yield from machine.start()
        machine.rig.link.send(f"{before}A{'9' * 39}\n".encode())
        yield machine.rig.ms(1000)  # the alarm is reported
        assert "ALARM:2" in machine.take()

    machine.run(script())


@pytest.mark.parametrize("name", ["sim_rotary", "sim_wire"])
def test_arc_radius_beyond_single_precision_is_no_fault(name: str) -> None:
    """It is infinite, and the arc a straight line, as on a machine without rotary axes."""
    machine = Machine(_SWIFT, name)
    machine.play([f"G2X2R{'9' * 45}F600"])
    assert "ok" in machine.received and motor_positions(machine) == [2, 0, 0, 0]


def test_limit_switches_of_six_axes_are_reported_by_letter() -> None:
    """Pn: lists the closed inputs in status reports."""
    machine = Machine(board=board(6, ROTARY=""))
    names = [f"limit_{letter}" for letter in "xyzabc"]
    # All are closed at position 0.
    machine.rig.engine.switches += [Switch(name, i, True, 0) for i, name in enumerate(names)]
    machine.rig.port.update()
    machine.play([])  # ends with a status report
    assert any("|Pn:XYZABC" in line for line in machine.received)


def test_one_of_six_axes_is_homed_alone() -> None:
    """$HC homes C only, at a rate of 3000 and an acceleration of 400."""
    # $22 to $27: homing enabled, its rates, debounce in ms, pull-off in mm.
    settings = {22: 1, 24: 300, 25: 3000, 26: 5, 27: 1, **{110 + i: 3000.0 for i in range(6)}}
    machine = Machine(
        {**settings, **{120 + i: 400.0 for i in range(6)}},
        board(6, ROTARY="", SINGLE_AXIS_HOMING=True),
    )
    machine.rig.engine.switches.append(Switch("limit_c", 5, True, 800))
    machine.play(["$HC"])
    assert machine.reported() == [0, 0, 0, 0, 0, -1]  # $27, the pull-off, is 1


# Rotary axes: rates


def test_feed_rate_is_that_of_the_linear_axes() -> None:
    """10 mm at F600 take 1 s, and a turn of A in the same line does not count."""
    linear_only_s = motion_seconds(machine_after(["G1X10F600"]))
    assert linear_only_s == pytest.approx(1, rel=0.01)
    for line in ("G1X10A90F600", "G1X10A-100F600", "G1X6Y8A45F600"):
        assert motion_seconds(machine_after([line])) == pytest.approx(1, rel=0.01), line


@pytest.mark.thorough
@given(
    st.lists(st.integers(-400, 400), min_size=3, max_size=3),
    st.lists(st.integers(-4000, 4000), min_size=2, max_size=2),
    st.integers(50, 900),
)
def test_line_takes_the_time_of_the_standard(
    fiftieths_mm: "list[int]", fiftieths_deg: "list[int]", feed: int
) -> None:
    """F is the rate along X, Y and Z. If they do not move, it is that of the rotary axes."""
    x, y, z = (number / 50 for number in fiftieths_mm)
    a, b = (number / 50 for number in fiftieths_deg)
    length = math.hypot(x, y, z) or math.hypot(a, b)
    rates = [abs(number) / length for number in (x, y, z, a, b)] if length else [1000.0]
    # Too short to be measured, or faster than the axes allow.
    if length < 1 or max(rates) * feed > 50000:
        return
    line = f"G1X{x}Y{y}Z{z}A{a}B{b}F{feed}"
    ramps_s = max(rates) * feed / 60 / _SWIFT[120]  # both together, of the fastest axis
    assert motion_seconds(machine_after([line], axes=5, ROTARY="AB")) == pytest.approx(
        length / feed * 60 + ramps_s, rel=0.01
    )


def test_rotary_axis_alone_moves_in_degrees_a_minute_even_in_inches() -> None:
    """36 degrees at F720 take 3 s. G20 and G21 change neither, wherever F is given."""
    for lines in (
        ["G1A36F720"],
        ["G20", "G1A36F720"],
        ["G1F9", "G20", "G21", "A36F720"],
        ["G1F9", "G20", "G21A36F720"],
        ["G1F9", "G90", "G20A36F720"],
        ["$J=G20A36F720"],
        ["$J=A36F720"],
    ):
        machine = machine_after(lines)
        assert motion_seconds(machine) == pytest.approx(3, rel=0.01), lines
        assert motor_positions(machine) == [0, 0, 0, 36]


def test_helix_that_turns_an_axis_takes_the_time_of_its_arc() -> None:
    """The turn of A, in degrees, does not count."""
    for turn in (0, 90, -300):
        machine = machine_after([f"G2X20I10A{turn}F600"])
        # A half circle, radius 10 mm, at 10 mm/s.
        assert motion_seconds(machine) == pytest.approx(math.pi * 10 / 10, rel=0.01), turn
        assert motor_positions(machine) == [20, 0, 0, turn]


def test_inverse_time_is_kept_by_lines_and_arcs() -> None:
    """G93 F30 is 1/30 min, 2 s."""
    for line in ("G93G1X10A90F30", "G93G1A90F30", "G93G2X20I10A90F30", "G93G2X20I10F30"):
        assert motion_seconds(machine_after([line])) == pytest.approx(2, rel=0.01), line


def test_feed_override_applies_to_lines_that_turn() -> None:
    """Five times -10 %: 40 mm at 300 mm/min take 8 s."""
    machine = machine_after(["G1X40A90F600"], events=[(0, "\x92")] * 5)
    assert motion_seconds(machine) == pytest.approx(8, rel=0.02)


def test_lines_after_one_that_turns_have_their_own_rate() -> None:
    machine = machine_after(["G1X10A360F600", "X20", "Y10", "G2X40I10A0", "G1X50"])
    # Four lines of 10 mm, and a half circle, radius 10 mm, at 10 mm/s.
    assert motion_seconds(machine) == pytest.approx(4 + math.pi, rel=0.01)


# Numbers


def test_degrees_are_never_inches() -> None:
    """X moves 2 inches, A 180 degrees. $13=1 reports inches, but degrees of A; G54 is 180 - 10."""
    machine = machine_after(
        ["G20", "G0X1A90", "G91", "X1A90", "G90", "G10L20P1A10", "$13=1", "$#", "?"]
    )
    assert motor_positions(machine) == [50.8, 0, 0, 180]
    assert machine.reported() == [2, 0, 0, 180]
    assert any(line.startswith("[G54:0.0000,0.0000,0.0000,170.0000]") for line in machine.received)


def test_offsets_in_reports_in_inches_are_degrees() -> None:
    # Only some reports have WCO.
    machine = machine_after(["G10L2P1X25.4A90", "$13=1", *["?"] * 40])
    offsets = {line.split("WCO:")[1] for line in machine.received if "WCO:" in line}
    assert any(each.startswith("1.0000,0.0000,0.0000,90.0000") for each in offsets)


# Travel


def output_with_reset(line: str, settings: "dict[int, float]") -> "list[str]":
    """Return the output for a line, and for a reset after it."""
    return machine_after(["$X", line], settings, events=[(5000, "\x18")]).received


# Soft limits with a travel of 100 mm; A has none.
_LIMITED = {20: 1, 22: 1, 130: 100, 131: 100, 132: 100, 133: 0}


@pytest.mark.thorough
def test_axis_without_travel_turns_without_limit_and_others_do_not() -> None:
    """A has a travel of 0: none. X, Y and Z are limited also in lines that turn A."""
    turning_lines = [
        "$X",
        "G0A5000",
        "G1A-5000X-1F60000",
        "G2X-3I-1A900F6000",
        "G4P0",
        "$J=G90A-7000F60000",
    ]
    machine = machine_after(turning_lines, _LIMITED)
    assert motor_positions(machine) == [-3, 0, 0, -7000]
    assert not any("ALARM" in line or "error" in line for line in machine.received)
    for line, refusal in (
        ("G0A5X1", "ALARM:2"),
        ("$J=A5X1F100", "error:15"),
        ("G2X8I4A9F900", "ALARM:2"),
    ):
        assert refusal in output_with_reset(line, _LIMITED), line


def test_work_position_stays_if_axis_is_unwound_in_saved_block() -> None:
    """A is near 2**24 steps, up to which floats are exact: the line in m.saved(), here the block
    of a ModalState, unwinds it by whole turns. G92 is restored by the block, less these turns."""
    machine = Machine({**_SWIFT, 133: 0}, board())
    steps = array("i", (0, 0, 0, 16_770_000))
    block: "list[ModalState]" = []

    def answered(line: str, _: "list[str]") -> None:
        """Set A's steps, begin the block, or check and end it; called after each line."""
        controller: Any = machine.rig.controller
        if line == "$X":  # A is at 67080 degrees from here on
            controller.engine.set_position(steps)
            controller.resync()
        elif line == "G92A90":
            block.append(ModalState(controller, standard=False, blocks=[]))
            block[0].__enter__()
        elif line == "G91G0A100":
            assert controller.modes.position[3] == 67180 - 360 * 186  # it was unwound
            block[0].__exit__()
            assert controller.modes.position[3] - controller.coords.g92[3] == 90 + 100

    machine.converse(("$X", "G92A90", "G91G0A100"), answered)


@pytest.mark.parametrize("byte", ["\x85", "!", "\x84"])
def test_jog_cancelled_while_it_waits_to_be_unwound_does_not_move(byte: str) -> None:
    """A is near 2**24 steps: the second jog waits for the end of the first one. 0x85 cancels jogs,
    a hold and the door do so too. `~` then ends the door."""
    machine = Machine({**_SWIFT, 133: 0}, board(), watched=False)
    rig = machine.rig

    def script() -> Iterator[Any]:
        yield from machine.start()
        rig.controller.engine.set_position(array("i", (0, 0, 0, 16_770_000)))
        rig.controller.resync()
        rig.link.send(b"$J=G91A20F600\n$J=G91A100F6000\n")
        yield rig.ms(300)
        assert rig.moving()
        rig.link.send(byte.encode("latin-1"))
        yield rig.ms(100)
        stopped_at = machine.physical()
        yield rig.ms(500)
        rig.link.send(b"~")
        yield rig.ms(5000)
        assert machine.physical() == stopped_at
        assert rig.controller.state.run == IDLE

    machine.run(script())


def test_rotary_axis_with_travel_is_limited() -> None:
    assert "ALARM:2" in output_with_reset("G0A-91", {**_LIMITED, 133: 90})
    assert "ALARM:2" not in output_with_reset("G0A-89", {**_LIMITED, 133: 90})


# Homing is enabled; A has no travel ($133).
_HOMING = {
    22: 1,
    24: 300,
    25: 3000,
    26: 5,
    27: 1,
    133: 0,
    **{110 + i: 3000.0 for i in range(4)},
    **{120 + i: 400.0 for i in range(4)},
}


@pytest.mark.parametrize(
    ("limit", "command", "homed"),
    [
        ((), "$H", [-1, -1, -1, 0]),
        ((0, 1, 2, None), "$H", [-1, -1, -1, 0]),
        ((0, 1, 2, 3), "$H", [-1, -1, -1, -1]),
        ((), "$HA", [0, 0, 0, -1]),
    ],
)
def test_rotary_axis_is_homed_if_it_has_a_switch(
    limit: "tuple[int | None, ...]", command: str, homed: "list[float]"
) -> None:
    """LIMIT has the pins of the switches, None: no switch.

    With the default () $H leaves A out, but $HA homes it.
    """
    machine = Machine(_HOMING, board(LIMIT=limit, SINGLE_AXIS_HOMING=True))
    for axis, letter in enumerate("xyza"):
        machine.rig.engine.switches.append(Switch(f"limit_{letter}", axis, True, 800))
    machine.play([command])
    assert machine.reported() == homed
    controller: Any = machine.rig.controller
    # Homing A needs a travel for its search: it was only set meanwhile.
    assert controller.settings.max_travel[3] == 0


def test_failed_homing_leaves_travel_unchanged() -> None:
    """There is no switch, so the search fails. The travel that it used was set only meanwhile."""
    machine = Machine(_HOMING, board(SINGLE_AXIS_HOMING=True))
    machine.play(["$HA"])
    assert "ALARM:9" in machine.received
    controller: Any = machine.rig.controller
    assert controller.settings.max_travel[3] == 0


# Board files


@pytest.mark.parametrize("word", ["X", "B", "AA", "a"])
def test_impossible_rotary_axis_is_reported(word: str) -> None:
    why = f"ROTARY: {word[-1]} is no rotary axis here, or named twice"
    assert board_check.problems(board(ROTARY=word)) == [why]


def test_board_without_rotary_axes_treats_them_as_millimetres() -> None:
    machine = machine_after(["G20", "G1X1A1F100"], ROTARY="")
    assert motor_positions(machine) == [25.4, 0, 0, 25.4]
    # F100 are 2540 mm/min, along X and A.
    assert motion_seconds(machine) == pytest.approx(math.hypot(25.4, 25.4) / 2540 * 60, rel=0.02)


# The kernel's path of a line

_words = st.tuples(
    st.sampled_from(["", "G0", "G1", "G91", "G90", "G20", "G21", "S5", "N7"]),
    st.lists(st.sampled_from("XYZAB"), unique=True, max_size=4),
    st.integers(-300, 300),
    st.sampled_from(["", "", "F600", "F601", "F0"]),
)


@pytest.mark.thorough
@given(st.lists(_words, min_size=1, max_size=8))
def test_kernels_plan_like_the_interpreter(
    drawn: "list[tuple[str, list[str], int, str]]",
) -> None:
    """The fastest code (kernels) and the interpreter generate the same rows of steps.

    After watch(MOVE) the interpreter handles all moves.
    """
    lines = [
        word + "".join(f"{letter}{(tenths + 40 * i) / 10}" for i, letter in enumerate(letters)) + f
        for word, letters, tenths, f in drawn
    ]
    rows = []
    for by_kernels in (True, False):
        machine = Machine(_SWIFT, board(5))
        call_built = machine.rig.on_built

        def watch(
            call_built: Any = call_built, rig: Any = machine.rig, by_kernels: bool = by_kernels
        ) -> None:
            """Build the machine; without by_kernels the interpreter handles all moves."""
            if not by_kernels:
                rig.controller.interpreter.watch(MOVE)
            call_built()

        machine.rig.on_built = watch
        machine.play(["G1X-3F500", *lines])
        rows.append([list(row) for _, row in machine.rows])
    assert rows[0] == rows[1]


def test_run_reports_degrees_and_mm(tmp_path: Path) -> None:
    """`ugrbl run` reports the travel of A in degrees, and distances of linear axes in mm."""
    file = tmp_path / "turned.nc"
    file.write_text("G1 X10 A90 F600\nA-45\n")
    done = CliRunner().invoke(app, ["run", str(file), "--board", "sim_rotary"])
    assert "travel A" in done.output and "-45.000 to 90.000 degrees" in done.output
    assert "0.000 to 10.000 mm" in done.output
    assert "distance" in done.output and " 10.0 mm" in done.output
