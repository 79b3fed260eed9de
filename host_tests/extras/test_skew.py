"""Test skew: motors move so that the tool is where that of a square machine would be.

A skewed machine's axes are not at right angles. $780 to $782 are the skew of XY, XZ and YZ, in mm
per m. Machine.physical() returns the steps of the motors, Machine.reported() the last reported
position of the tool. tool_position() computes the tool's position from motor steps.
Machine.rest() resumes holds, waits until motion has ended, and asks for a report.
sender.wait("idle", text, settle=1) sends a text and waits for its answers, the end of motion, and
1 ms of silence.
"""

import sys
from array import array
from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import atan2, hypot, tau
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from extras.kinematics import skew_kernel
from extras.kinematics.skew import SkewKinematics
from hypothesis import example, given
from hypothesis import strategies as st
from language.block_layout import MOVE
from motion.layout import AXES, LIMITS, ROW_AXES, ROW_DIRS, ROW_STRIDE, TARGET
from rig_bench import Machine
from typer.testing import CliRunner
from ugrbl.boardfile import board_check
from ugrbl.boardfile.files import load_board
from ugrbl.cli.app import app
from ugrbl.compiling import build
from ugrbl.sim.engine import Switch, step_tick

# Many cases: the first ring runs a sample of them.
pytestmark = pytest.mark.sampled(2)

_PER_MM = 250  # steps
_BIAS = 1 << 29  # of positions in the planner's table
_TICK_HZ = 13_107_200
_FAST = {
    1: 0,
    24: 300,
    25: 3000,
    26: 5,
    27: 1,
    **{number + i: value for number, value in ((110, 6000), (120, 1000)) for i in range(3)},
}
_LEANING = (100.0, -50.0, 30.0)  # $780 to $782: XY, XZ and YZ in mm per m

skews = st.tuples(*[st.floats(-100, 100).map(lambda mm: round(mm, 3)) for _ in range(3)])
places = st.lists(st.tuples(*[st.integers(-200, 200) for _ in "XYZ"]), min_size=1, max_size=6)


def skewed(skew: Sequence[float] = _LEANING) -> "dict[int, float]":
    """Return settings of a machine with this skew."""
    return {**_FAST, **{780 + i: mm for i, mm in enumerate(skew)}}


def board(**options: Any) -> ModuleType:
    """Return the board sim_skew with other options."""
    module = ModuleType("board")
    module.__dict__.update({**vars(load_board("sim_skew")), **options})
    return module


def make_machine(
    skew: Sequence[float] = _LEANING,
    settings: "dict[int, float] | None" = None,
    watched: bool = True,
    **options: Any,
) -> Machine:
    """Return a machine with this skew. watched: plans and segments are checked."""
    return Machine({**skewed(skew), **(settings or {})}, board(**options), watched)


def tool_position(motors: Sequence[float], skew: Sequence[float] = _LEANING) -> "list[float]":
    """Return the tool's position in mm: Y moves X along, and Z moves both."""
    x, y, z = [n / _PER_MM for n in motors]
    xy, xz, yz = [mm / 1000 for mm in skew]
    return [x + xy * y + xz * z, y + yz * z, z]


def motor_positions(cnc: Machine) -> "list[list[float]]":
    """Return the motors' positions after each segment, in steps since power-up."""
    position = [0.0, 0.0, 0.0]
    positions = [position[:]]
    for _, row in cnc.rows:
        for i in range(3):
            count = row[ROW_AXES + ROW_STRIDE * i]
            position[i] += -count if row[ROW_DIRS] >> i & 1 else count
        positions.append(position[:])
    return positions


def tolerance_mm(skew: Sequence[float]) -> "list[float]":
    """Return the allowed distance of the tool from a place, in mm.

    It is a step of each motor that moves the tool, and 1/32 step for rounding of the sums of
    shears.
    """
    xy, xz, yz = [abs(mm) / 1000 for mm in skew]
    steps = (1 + xy + xz, 1 + yz, 1)
    return [(n + 1 / 32) / _PER_MM for n in steps]


def rows(cnc: Machine) -> "list[tuple[int, list[int]]]":
    """Return the rows of steps with their start in ticks."""
    return [(start, list(row)) for start, row in cnc.rows]


@pytest.mark.thorough
@given(skews, places)
@example((100.0, 100.0, 100.0), [(200, 200, 200), (-200, -200, -200)])
def test_tool_is_on_target_and_reports_match_a_square_machine(
    skew: "tuple[float, ...]", lines: "list[tuple[int, int, int]]"
) -> None:
    """Lines are in tenths of mm. The square machine is one without skew."""
    program = [f"G1X{x / 10}Y{y / 10}Z{z / 10}F3000" for x, y, z in lines]
    cnc = make_machine(skew)
    cnc.play(program)
    square = Machine(_FAST, "sim")
    square.play(program)
    assert cnc.received[-2:] == square.received[-2:]  # the last answer and the report
    for tool_mm, target_tenths, allowed_mm in zip(
        tool_position(cnc.physical(), skew), lines[-1], tolerance_mm(skew), strict=True
    ):
        assert abs(tool_mm - target_tenths / 10) <= allowed_mm


@given(st.lists(st.integers(-(2**24), 2**24), min_size=6, max_size=6), skews)
def test_inverse_is_exact_for_any_numbers(numbers: "list[int]", skew: "tuple[float, ...]") -> None:
    """axis_steps() is the exact inverse of to_motors(), which works in the planner's table.

    Numbers 0 to 2 are axis steps, and 3 to 5 the motor steps at homing.
    """
    # Masks: the axes that each motor moves; the motors with a switch of their own.
    kinematics = SkewKinematics(axes=3, moves=[1, 2, 4], alone=0)
    kinematics.set_factors([mm / 1000 for mm in skew])
    for axis in range(3):
        kinematics.note_homed(array("i", numbers[3:]), axis)
    targets_at = LIMITS + TARGET * 3
    table = array("i", [0] * (targets_at + 6))  # up to targets and positions
    table[AXES] = 3
    for i in range(3):
        table[targets_at + i] = _BIAS + numbers[i]
    skew_kernel.to_motors(table, kinematics.skew)
    motors = array("i", (table[targets_at + i] - _BIAS for i in range(3)))
    assert [kinematics.axis_steps(motors, axis) for axis in range(3)] == numbers[:3]
    # It also inverts the shear, to half a step and the accumulated rounding.
    from_homed = [motors[i] - numbers[3 + i] for i in range(3)]
    xy, xz, yz = [mm / 1000 for mm in skew]
    assert numbers[1] - motors[1] == pytest.approx(yz * from_homed[2], abs=0.54, rel=1e-7)
    shear_steps = xy * from_homed[1] + xz * from_homed[2]
    assert numbers[0] - motors[0] == pytest.approx(shear_steps, abs=0.6, rel=1e-7)


@given(skews, st.tuples(*[st.integers(-300, 300) for _ in "XYZ"]).filter(any))
def test_tool_stays_on_a_line(
    skew: "tuple[float, ...]", end_tenths: "tuple[int, int, int]"
) -> None:
    """After each row of steps, the tool is close to the straight line from 0 to its end."""
    cnc = make_machine(skew, watched=False)
    cnc.play([f"G1X{end_tenths[0] / 10}Y{end_tenths[1] / 10}Z{end_tenths[2] / 10}F4000"])
    x, y, z = [n / 10 for n in end_tenths]
    length = hypot(x, y, z)
    allowed_mm = 2 * hypot(*tolerance_mm(skew))  # motors make whole steps
    for motors in motor_positions(cnc):
        a, b, c = tool_position(motors, skew)
        # The cross product with the direction of the line.
        distance_mm = hypot(b * z - c * y, c * x - a * z, a * y - b * x) / length
        assert distance_mm <= allowed_mm


@pytest.mark.parametrize("plane", ["G17", "G18", "G19"])
def test_tool_stays_on_an_arc(plane: str) -> None:
    """A full circle with a radius of 20 mm, as a helix of 3 mm, in each plane."""
    cnc = make_machine()
    arc = {"G17": "G2X0Y0I20J0Z3", "G18": "G2X0Z0I20K0Y3", "G19": "G2Y0Z0J20K0X3"}[plane]
    cnc.play([plane, f"{arc}F4000"])
    first, second, helix_axis = {"G17": (0, 1, 2), "G18": (0, 2, 1), "G19": (1, 2, 0)}[plane]
    allowed_mm = 0.002 + 2 * hypot(*tolerance_mm(_LEANING))  # 0.002: the arc tolerance
    turned_rad, last_angle = 0.0, None
    for motors in motor_positions(cnc):
        position = tool_position(motors)
        assert abs(hypot(position[first] - 20, position[second]) - 20) <= allowed_mm
        angle = atan2(position[second], position[first] - 20)
        if last_angle is not None:
            step = angle - last_angle
            turned_rad += step - tau * round(step / tau)
        last_angle = angle
        helix_mm = 3 * abs(turned_rad) / tau
        assert position[helix_axis] == pytest.approx(helix_mm, abs=3 * allowed_mm)
    assert abs(turned_rad) == pytest.approx(tau, abs=0.001)
    assert cnc.reported()[helix_axis] == 3


def test_kernels_match_the_interpreter() -> None:
    """The fastest code (kernels) and the interpreter end at the same place.

    After watch(MOVE) the interpreter handles all moves.
    """
    lines = ["G1F3000", *[f"X{x}Y{x * x % 7}Z{-x % 3}" for x in range(30)], "G20", "X1F50", "G91"]
    lines += ["X.1Y.1", "G21", "G0X1", "Y2"]
    results = []
    for watched_bits in (0, MOVE):
        cnc = make_machine(settings={780: 12.0}, watched=False)
        rig: Any = cnc.rig
        rig.on_built = lambda rig=rig, bits=watched_bits: rig.controller.interpreter.watch(bits)
        cnc.play(lines)
        results.append((motor_positions(cnc)[-1], cnc.reported()))
    assert results[0] == results[1]


def test_zero_skew_moves_step_for_step_like_a_machine_without_the_module() -> None:
    """$780=0, at the end, exists only with the module."""
    lines = ["G0X1Y1Z1", "G1X-2Y3F900", "G2X0Y0I3J-1", "G1Z-3", "$J=G91X3F900", "G0X0", "$780=0"]
    with_module = make_machine((0, 0, 0), watched=False)
    with_module.play(lines)
    without_module = Machine(_FAST, "sim", watched=False)
    without_module.play(lines[:-1])  # without $780
    assert rows(with_module) == rows(without_module)


def test_each_motor_keeps_its_own_rate_and_acceleration() -> None:
    """Y moves fast, and the skew of 0.1 moves the slower X along. X limits the motion."""
    mm_s, mm_s2 = 1.0, 2.0  # of X; Y has 100 mm/s and 1000 mm/s²
    cnc = make_machine(settings={110: 60 * mm_s, 120: mm_s2})
    cnc.play(["G0Y20", "G0Y0"])
    steps_s = []  # times of X's steps
    for start, row in cnc.rows:
        steps_s += [(start + step_tick(row, ROW_AXES, k)) / _TICK_HZ for k in range(row[ROW_AXES])]
    assert len(steps_s) == 2 * 2 * _PER_MM  # 2 mm each way
    assert min(b - a for a, b in pairwise(steps_s)) >= 0.98 / (mm_s * _PER_MM)
    # The acceleration follows from mean speeds over 10 steps; X needs 62 to its full rate.
    tens_s = steps_s[::10]
    speeds = [10 / _PER_MM / (b - a) for a, b in pairwise(tens_s)]
    middles_s = [(a + b) / 2 for a, b in pairwise(tens_s)]
    changes = [(v - u) / (t - s) for (u, v), (s, t) in zip(pairwise(speeds), pairwise(middles_s))]
    assert max(changes) == pytest.approx(mm_s2, rel=0.03)
    assert min(changes) == pytest.approx(-mm_s2, rel=0.03)


@pytest.mark.parametrize(
    "lines",
    [
        ["G92X3Y4", "$#", "G0X0Y0", "G92.1"],
        ["G10L2P1X1Y2Z3", "G0X0Y0Z0", "$#", "G55", "G0X1"],
        ["G0X3Y2", "G28.1", "G0X0Y0", "G28", "$#", "G30"],
        ["$J=G91X2Y-3F2000", "$J=G53X1Y1Z1F900", "$J=X3F0", "G91", "G0X1"],
        ["G93", "G1X3Y4F60", "G2X0Y0I-2J-2F30", "G94", "G1X1"],
        ["$C", "G1X3Y4F60", "G2X0Y0I-2J-2F30", "$C"],
        ["G1X3Y-400F600", "G2X1I0", "G38.9", "X"],
    ],
)
def test_conversations_match_a_square_machine_to_the_byte(lines: "list[str]") -> None:
    """Only the motors of a skewed machine differ.

    Its answers and reports are those of a square one.
    """
    outputs: dict[bool, list[str]] = {}
    for is_skewed in (False, True):
        cnc = make_machine() if is_skewed else Machine(_FAST, "sim")
        output: list[str] = []

        def script(cnc: Machine = cnc, output: "list[str]" = output) -> Iterator[Any]:
            """Send each line; note all output, the last line and the last report."""
            yield from cnc.start()
            for line in lines:
                yield from cnc.sender.wait("idle", line + "\n", settle=1)
                output.extend(cnc.take())
                yield from cnc.rest()
                output.append(cnc.received[-1])
                output.append(next(n for n in reversed(cnc.received) if n.startswith("<")))

        cnc.run(script())
        outputs[is_skewed] = output
    assert outputs[True] == outputs[False]


@pytest.mark.parametrize("byte", ["!", "\x18", "\x85", "\x84"])
def test_position_is_right_after_a_stop_anywhere(byte: str) -> None:
    """Holds, resets, jog cancels and doors stop an arc or a jog after some ms.

    The report must have the place of the tool then, and one more move must end with the same motor
    steps as that move alone.
    """
    undisturbed = make_machine()
    undisturbed.play(["G0X7Y-6Z5"])
    for ms in range(3, 700, 41):
        cnc = make_machine()
        motion_line = "$J=G91X20Y-10Z5F4000\n" if byte == "\x85" else "G2X0Y0I8J6Z9F4000\n"

        def script(
            cnc: Machine = cnc, motion_line: str = motion_line, ms: int = ms
        ) -> Iterator[Any]:
            """Stop a motion after some ms, compare report and steps; move to the end."""
            yield from cnc.start()
            yield from cnc.sender.wait("idle", "G0X1Y2Z-3\n", settle=1)
            yield from cnc.rest()
            cnc.rig.link.send(motion_line.encode())
            yield cnc.rig.ms(ms)
            cnc.rig.link.send(byte.encode("latin-1"))
            yield from cnc.rest()
            for tool_mm, reported_mm, allowed_mm in zip(
                tool_position(cnc.physical()), cnc.reported(), tolerance_mm(_LEANING), strict=True
            ):
                assert abs(tool_mm - reported_mm) <= allowed_mm + 0.0005, ms
            cnc.take()
            yield from cnc.sender.wait("idle", "$X\n" if byte == "\x18" else "\n", settle=1)
            yield from cnc.sender.wait("idle", "G0X7Y-6Z5\n", settle=1)
            yield from cnc.rest()

        cnc.run(script())
        assert cnc.physical() == undisturbed.physical(), ms
        assert cnc.reported() == [7, -6, 5], ms


def _add_switches(cnc: Machine, above: bool = True) -> None:
    """Add a limit switch for each axis, at its upper or lower end."""
    for i, letter in enumerate("xyz"):
        steps = (700, 900, 500)[i]
        cnc.rig.engine.switches.append(
            Switch(f"limit_{letter}", i, above, steps if above else -steps)
        )


@pytest.mark.parametrize("inverted", [0, 7])
def test_homing_moves_each_motor_alone_and_sets_grbls_position(inverted: int) -> None:
    """$23 inverts the direction of homing. The pull-off is 1 mm, and travel 200 mm."""
    cnc = make_machine(settings={22: 1, 23: inverted})
    _add_switches(cnc, not inverted)
    motor_steps: list[list[int]] = []

    def script() -> Iterator[Any]:
        """Home, move away, home again; note the motor steps after each."""
        yield from cnc.start()
        for line in ("$H", "G53G0X-40Y-60Z-20", "$H"):
            yield from cnc.sender.wait("idle", line + "\n", settle=1)
            yield from cnc.rest()
            motor_steps.append(cnc.physical())
            if line == "$H":
                expected = [-1, -1, -1] if not inverted else [-199, -199, -199]
                assert cnc.reported() == expected

    cnc.run(script())
    assert motor_steps[0] == pytest.approx(motor_steps[2], abs=2)
    # The motors stand 1 mm off their switches.
    sign = -1 if inverted else 1
    off_switches = [sign * (n - _PER_MM) for n in (700, 900, 500)]
    assert motor_steps[0] == pytest.approx(off_switches, abs=4)
    # The machine is square from there on.
    moved_steps = [b - a for a, b in zip(motor_steps[0], motor_steps[1], strict=True)]
    expected = [-40 + 1, -60 + 1, -20 + 1] if not inverted else [159, 139, 179]
    assert tool_position(moved_steps) == pytest.approx(expected, abs=0.01)


def test_axis_homed_alone_finds_its_place_wherever_the_others_are() -> None:
    """$HX homes X only, while Y is 99 mm lower than after $H."""
    cnc = make_machine(settings={22: 1}, SINGLE_AXIS_HOMING=True)
    _add_switches(cnc)
    positions: list[list[float]] = []

    def script() -> Iterator[Any]:
        """Home all, move away, home X, move; then home all and move to the same X."""
        yield from cnc.start()
        for line in ("$H", "G53G0X-20Y-100", "$HX", "G53G0X-5Y-1Z-1"):
            yield from cnc.sender.wait("idle", line + "\n", settle=1)
            yield from cnc.rest()
            positions.append(cnc.reported())
        positions.append([float(n) for n in cnc.physical()])  # in steps
        yield from cnc.sender.wait("idle", "$H\n", settle=1)
        yield from cnc.sender.wait("idle", "G53G0X-5\n", settle=1)
        yield from cnc.rest()
        positions.append([float(n) for n in cnc.physical()])

    cnc.run(script())
    # X pulls off to its earlier place; Y is 99 mm lower, which moves the tool by -9.9 mm.
    assert positions[2] == pytest.approx([-1 - 9.9, -100, -1], abs=0.02)
    # After $HX the motors stand where they would after a new $H.
    assert positions[4] == pytest.approx(positions[5], abs=2)


@pytest.mark.parametrize("byte", ["\x18", "\x84"])
def test_machine_can_be_homed_after_aborted_homing(byte: str) -> None:
    """A reset, or a door, ends homing after some ms; the next $H succeeds."""
    for ms in (5, 60, 300, 900):
        cnc = make_machine(settings={22: 1}, SAFETY_DOOR=byte == "\x84")
        _add_switches(cnc)

        def script(cnc: Machine = cnc, ms: int = ms) -> Iterator[Any]:
            """Abort homing by the byte after some ms; reset, and home again."""
            yield from cnc.start()
            cnc.rig.link.send(b"$H\n")
            yield cnc.rig.ms(ms)
            cnc.rig.link.send(byte.encode("latin-1"))
            yield from cnc.rest()
            assert not cnc.rig.controller.planner.kinematics.homing  # type: ignore[union-attr]
            cnc.take()
            cnc.rig.link.send(b"\x18")
            yield from cnc.rest()
            yield from cnc.sender.wait("idle", "$H\n", settle=1)
            yield from cnc.rest()

        cnc.run(script())
        assert cnc.reported() == [-1, -1, -1]


def test_soft_limits_apply_to_the_tools_position() -> None:
    """The whole travel of 50 mm can be reached, although motors move further.

    A jog and a line beyond it are refused.
    """
    cnc = make_machine(settings={20: 1, 22: 1, 130: 50, 131: 50, 132: 50})
    _add_switches(cnc)

    def script() -> Iterator[Any]:
        """Move to the far corner; jog and move beyond it; reset the alarm."""
        yield from cnc.start()
        for line in ("$H", "G53G1X-50Y-50Z-50F3000", "$J=G53X-50.01F900", "G53G0X-1Y-1Z-1"):
            yield from cnc.sender.wait("idle", line + "\n", settle=1)
            yield from cnc.rest()
        cnc.rig.link.send(b"G53G0Y-50.01\n")
        yield cnc.rig.ms(1500)  # the alarm is reported
        cnc.rig.link.send(b"\x18")  # ALARM:2 requires it
        yield from cnc.rest()

    cnc.run(script())
    assert "error:15" in cnc.received and "ALARM:2" in cnc.received
    assert cnc.reported() == [-1, -1, -1]


def test_probe_reports_the_tools_position() -> None:
    """The probe closes when the Z motor is 2 mm down."""
    cnc = make_machine(watched=False)
    call_trace: Any = cnc.rig.engine.trace
    motor_steps = [0, 0, 0]

    def trace(start: int, row: Any) -> None:
        """Add the steps of each row, and close the probe when Z is 2 mm down."""
        call_trace(start, row)
        for i in range(3):
            count = row[ROW_AXES + ROW_STRIDE * i]
            motor_steps[i] += -count if row[ROW_DIRS] >> i & 1 else count
        cnc.rig.port.push({"probe": motor_steps[2] <= -2 * _PER_MM})

    cnc.rig.engine.trace = trace
    cnc.play(["G0X4Y5", "G38.2Z-10F100", "$#", "G1Z0F900", "$#"])
    reports = {line for line in cnc.received if line.startswith("[PRB:")}
    assert len(reports) == 1
    x, y, z = [float(n) for n in reports.pop()[5:].split(":")[0].split(",")]
    # Straight down: X and Y of the tool stay, although their motors move.
    assert (x, y) == (pytest.approx(4, abs=0.008), pytest.approx(5, abs=0.008))
    assert z == pytest.approx(-2, abs=0.05)
    assert cnc.reported() == pytest.approx([4, 5, 0], abs=0.008)


def test_positions_follow_a_change_of_skew_and_lines_continue_there() -> None:
    """A change of $780 moves no motor.

    The same motor steps mean another X of the tool: 20 mm of Y times 0.05 is 1 mm.
    """
    cnc = make_machine((0, 0, 0))
    steps_and_reports: list[Any] = []

    def script() -> Iterator[Any]:
        """Send lines and changes of $780; note motor steps and report after each."""
        yield from cnc.start()
        for line in ("G0X10Y20", "$780=50", "G91", "G0Z1", "G90", "G0X10", "$780=0"):
            yield from cnc.sender.wait("idle", line + "\n", settle=1)
            yield from cnc.rest()
            steps_and_reports.append((cnc.physical(), cnc.reported()))

    cnc.run(script())
    # After $780=50, G0Z1, G0X10 and $780=0: motor steps, then reported mm.
    assert steps_and_reports[1] == ([2500, 5000, 0], [11, 20, 0])
    assert steps_and_reports[3] == ([2500, 5000, 250], [11, 20, 1])
    assert steps_and_reports[5] == ([2250, 5000, 250], [10, 20, 1])
    assert steps_and_reports[6] == ([2250, 5000, 250], [9, 20, 1])


def test_parking_moves_the_tool_straight_up_and_back() -> None:
    """A door opens in a line along X. Z is raised to -5, and X and Y of the tool must stay."""
    cnc = make_machine(settings={22: 1, 132: 200}, PARKING=True, SAFETY_DOOR=True)
    _add_switches(cnc)

    def script() -> Iterator[Any]:
        """Open the door in motion, compare report and steps with those before, and resume."""
        yield from cnc.start()
        for line in ("$H", "M3S500", "G53G0X-40Y-60Z-90"):
            yield from cnc.sender.wait("idle", line + "\n", settle=1)
        yield from cnc.rest()
        steps_before = cnc.physical()
        cnc.take()
        cnc.rig.link.send(b"G1X-10F600\n")
        yield cnc.rig.ms(800)  # in motion
        cnc.rig.link.send(b"\x84")  # door
        yield cnc.rig.ms(14_000)  # the tool is raised
        yield from cnc.sender.wait("report", "?")
        door_report = [line for line in cnc.take() if line.startswith("<Door")][-1]
        x, y, z = [float(n) for n in door_report.split("MPos:")[1].split("|")[0].split(",")]
        assert -40 < x < -10 and y == pytest.approx(-60, abs=0.002)
        assert z == pytest.approx(-5, abs=0.005)
        moved_steps = [b - a for a, b in zip(steps_before, cnc.physical(), strict=True)]
        # The move began at X-40, and Z was raised from -90 to -5.
        assert tool_position(moved_steps) == pytest.approx([x + 40, 0, 85], abs=0.02)
        yield from cnc.rest()

    cnc.run(script())
    assert cnc.reported() == [-10, -60, -90]


def test_corexy_and_ganged_motors_can_have_skew() -> None:
    """The motors combine the steps that the motors of a plain skewed machine make."""
    line, end_mm = "G1X10Y20Z-5F900", [10, 20, -5]
    separate = make_machine()
    separate.play([line])
    x, y, z = separate.physical()
    for options, motors in (
        ({"COREXY": True}, [x + y, x - y, z]),
        ({"MOVES": ("X+Z", "Y", "X-Z")}, [x + z, y, x - z]),
        ({"STEP": (0, 1, 2, 3), "MOTORS": "XYZY"}, [x, y, z, y]),
    ):
        cnc = make_machine(watched=False, **options)
        cnc.play([line])
        assert cnc.physical() == motors
        assert cnc.reported() == end_mm
        cnc = make_machine(watched=False, **options)
        cnc.play([line, "G2X0Y0I-5J-10", "G1Z0", "$J=G91X5Y7F900", "G90G0X10Y20Z-5"])
        assert cnc.physical() == motors
        assert cnc.reported() == end_mm


def test_axes_may_have_different_resolutions() -> None:
    """80, 1600 and 400 steps/mm ($100 to $102)."""
    cnc = make_machine((40.0, -80.0, 20.0), settings={100: 80, 101: 1600, 102: 400}, watched=False)
    cnc.play(["G1X10Y20Z-5F900", "G2X0Y0I-5J-10", "G1X30Y-10Z7"])
    x, y, z = [n / per for n, per in zip(cnc.physical(), (80, 1600, 400), strict=True)]
    assert z == 7
    # The tool: the motors and their shear, with $780 to $782 in mm per m.
    assert y + 0.02 * z == pytest.approx(-10, abs=1 / 1600)
    assert x + 0.04 * y - 0.08 * z == pytest.approx(30, abs=1 / 80)
    assert cnc.reported() == [30, -10, 7]


def test_settings_may_be_negative_are_listed_bounded_and_stored() -> None:
    """A skew is at most 100 mm/m in both directions: other values are refused by error 3."""
    cnc = make_machine((0, 0, 0), watched=False)
    cnc.play(["$780=-1.75", "$781=100.001", "$782=-101", "$781=nan", "$130=-1", "$$"])
    assert cnc.received.count("error:3") >= 2 and "error:4" in cnc.received
    listed = [line for line in cnc.received if line.startswith("$78")]
    assert listed == ["$780=-1.750", "$781=0.000", "$782=0.000"]
    assert "$780=-1.75" in cnc.rig.store.files["settings"]  # type: ignore[attr-defined]
    restarted = Machine(_FAST, board(), watched=False)
    restarted.rig.store.files["settings"][:] = cnc.rig.store.files["settings"]  # type: ignore[attr-defined]
    restarted.play(["$$", "G0X1"])
    assert "$780=-1.750" in restarted.received and "error:7" not in restarted.received


@pytest.mark.parametrize("word", ["KINEMATICS", "ROTARY", "BACKLASH", "JERK", "CLUSTERS"])
def test_conflicting_options_are_refused_with_the_reason(
    word: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A module A stands for user-defined kinematics; most options only need to be True."""
    kinematics_module = ModuleType("A")
    joints = dict.fromkeys(("START", "HOME", "TRAVEL"), (0, 0, 0))
    vars(kinematics_module).update(inverse=None, forward=None, CENTRED=(), FASTEST=1, **joints)
    monkeypatch.setitem(sys.modules, "A", kinematics_module)
    options: dict[str, Any] = {"KINEMATICS": {"KINEMATICS": "A"}}
    options["ROTARY"] = {"ROTARY": "A", "STEP": (0, 1, 2, 3), "DIR": (4, 5, 6, 7)}
    with pytest.raises(ValueError, match=f"SKEW and {word} cannot be combined"):
        make_machine(**options.get(word, {word: True})).play([])


def test_default_beyond_the_bound_is_refused_with_the_reason() -> None:
    with pytest.raises(ValueError, match=r"DEFAULTS: \$781 may be at most 100 mm/m"):
        make_machine(DEFAULTS={781: -101.0}).play([])


def test_run_reports_positions_and_distances_of_the_tool(tmp_path: Path) -> None:
    """`ugrbl run` with a skew of 100 mm/m: 10 mm along X, then 30 mm along -Y."""
    file = tmp_path / "skew.nc"
    file.write_text("G0X10\nG1X10Y-30F900\n")
    arguments = ["run", str(file), "--board", "sim_skew", "--set", "780=100"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "0.000 to 10.000 mm" in result.output and "-30.000 to 0.000 mm" in result.output
    assert "40.0 mm" in result.output
    # In the first line, 2500 steps of X; in the second, 30 mm of Y move X by 3 mm, 750 steps.
    assert "3250 commanded = 3250 made" in result.output


def test_board_without_skew_has_none_of_the_modules() -> None:
    """Only a board file with SKEW needs them in its firmware."""
    plain = build.modules_of(load_board("rpi_pico"))
    extras = {"extras.kinematics.skew", "extras.kinematics.skew_kernel"}
    assert not {*extras, "motion.kinematics"} & set(plain)
    module = ModuleType("board")
    vars(module).update({**vars(load_board("rpi_pico")), "SKEW": True})
    assert list(board_check.problems(module)) == []
    assert {"extras.kinematics.skew", "motion.kinematics"} <= set(build.modules_of(module))
