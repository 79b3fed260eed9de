"""Test skew: motors move so that the tool is where that of a square machine would be."""

import sys
from array import array
from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import atan2, hypot
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

_PER_MM = 250
_BIAS = 1 << 29
_TICK_HZ = 13_107_200
_FAST = {
    1: 0,
    24: 300,
    25: 3000,
    26: 5,
    27: 1,
    **{number + i: value for number, value in ((110, 6000), (120, 1000)) for i in range(3)},
}
_LEANING = (100.0, -50.0, 30.0)

skews = st.tuples(*[st.floats(-100, 100).map(lambda mm: round(mm, 3)) for _ in range(3)])
places = st.lists(st.tuples(*[st.integers(-200, 200) for _ in "XYZ"]), min_size=1, max_size=6)


def skewed(skew: Sequence[float] = _LEANING) -> "dict[int, float]":
    """Return settings of a machine with this skew."""
    return {**_FAST, **{780 + i: mm for i, mm in enumerate(skew)}}


def board(**options: Any) -> ModuleType:
    """Return the board sim_skew with other options."""
    made = ModuleType("board")
    made.__dict__.update({**vars(load_board("sim_skew")), **options})
    return made


def machine(
    skew: Sequence[float] = _LEANING,
    settings: "dict[int, float] | None" = None,
    watched: bool = True,
    **options: Any,
) -> Machine:
    """Return a machine with this skew. watched: plans and segments are checked."""
    return Machine({**skewed(skew), **(settings or {})}, board(**options), watched)


def tool(motors: Sequence[float], skew: Sequence[float] = _LEANING) -> "list[float]":
    """Return the tool's position in mm: Y moves X along, and Z moves both."""
    x, y, z = [n / _PER_MM for n in motors]
    xy, xz, yz = [mm / 1000 for mm in skew]
    return [x + xy * y + xz * z, y + yz * z, z]


def way(made: Machine) -> "list[list[float]]":
    """Return the motors' positions after each segment, in steps since power-up."""
    at = [0.0, 0.0, 0.0]
    found = [at[:]]
    for _, row in made.rows:
        for i in range(3):
            count = row[ROW_AXES + ROW_STRIDE * i]
            at[i] += -count if row[ROW_DIRS] >> i & 1 else count
        found.append(at[:])
    return found


def close(skew: Sequence[float]) -> "list[float]":
    """Return the allowed distance of the tool from a place, in mm.

    It is a step of each motor that moves the tool, and 1/32 step for rounding of the sums of
    shears.
    """
    xy, xz, yz = [abs(mm) / 1000 for mm in skew]
    steps = (1 + xy + xz, 1 + yz, 1)
    return [(n + 1 / 32) / _PER_MM for n in steps]


def rows(made: Machine) -> "list[tuple[int, list[int]]]":
    """Return the rows with their start."""
    return [(start, list(row)) for start, row in made.rows]


@pytest.mark.thorough
@given(skews, places)
@example((100.0, 100.0, 100.0), [(200, 200, 200), (-200, -200, -200)])
def test_tool_is_on_target_and_reports_match_a_square_machine(
    skew: "tuple[float, ...]", lines: "list[tuple[int, int, int]]"
) -> None:
    program = [f"G1X{x / 10}Y{y / 10}Z{z / 10}F3000" for x, y, z in lines]
    made = machine(skew)
    made.play(program)
    square = Machine(_FAST, "sim")
    square.play(program)
    assert made.received[-2:] == square.received[-2:]
    for here, there, near in zip(tool(made.physical(), skew), lines[-1], close(skew), strict=True):
        assert abs(here - there / 10) <= near


@given(st.lists(st.integers(-(2**24), 2**24), min_size=9, max_size=9), skews)
def test_inverse_is_exact_for_any_numbers(numbers: "list[int]", skew: "tuple[float, ...]") -> None:
    kinematics = SkewKinematics(3, [1, 2, 4], 0)
    kinematics.set_factors([mm / 1000 for mm in skew])
    for axis in range(3):
        kinematics.note_homed(array("i", numbers[6:]), axis)
    table = array("i", bytes(4 * (LIMITS + TARGET * 3 + 6)))
    table[AXES] = 3
    at = LIMITS + TARGET * 3
    for i in range(3):
        table[at + i] = _BIAS + numbers[i]
    skew_kernel.to_motors(table, kinematics.skew)
    motors = array("i", (table[at + i] - _BIAS for i in range(3)))
    assert [kinematics.axis_steps(motors, axis) for axis in range(3)] == numbers[:3]
    # It also inverts the shear, to half a step and the accumulated rounding.
    away = [motors[i] - numbers[6 + i] for i in range(3)]
    xy, xz, yz = [mm / 1000 for mm in skew]
    assert numbers[1] - motors[1] == pytest.approx(yz * away[2], abs=0.54, rel=1e-7)
    wanted = xy * away[1] + xz * away[2]
    assert numbers[0] - motors[0] == pytest.approx(wanted, abs=0.6, rel=1e-7)


@given(skews, st.tuples(*[st.integers(-300, 300) for _ in "XYZ"]).filter(any))
def test_tool_stays_on_a_line(skew: "tuple[float, ...]", end: "tuple[int, int, int]") -> None:
    made = machine(skew, watched=False)
    made.play([f"G1X{end[0] / 10}Y{end[1] / 10}Z{end[2] / 10}F4000"])
    x, y, z = [n / 10 for n in end]
    length = hypot(x, y, z)
    near = 2 * hypot(*close(skew))  # motors make whole steps
    for at in way(made):
        a, b, c = tool(at, skew)
        off = hypot(b * z - c * y, c * x - a * z, a * y - b * x) / length
        assert off <= near


@pytest.mark.parametrize("plane", ["G17", "G18", "G19"])
def test_tool_stays_on_an_arc(plane: str) -> None:
    made = machine()
    line = {"G17": "G2X0Y0I20J0Z3", "G18": "G2X0Z0I20K0Y3", "G19": "G2Y0Z0J20K0X3"}[plane]
    made.play([plane, f"{line}F4000"])
    first, second, up = {"G17": (0, 1, 2), "G18": (0, 2, 1), "G19": (1, 2, 0)}[plane]
    near = 0.002 + 2 * hypot(*close(_LEANING))
    turned, last = 0.0, None
    for motors in way(made):
        at = tool(motors)
        assert abs(hypot(at[first] - 20, at[second]) - 20) <= near
        angle = atan2(at[second], at[first] - 20)
        if last is not None:
            step = angle - last
            turned += step - 6.283185307179586 * round(step / 6.283185307179586)
        last = angle
        assert at[up] == pytest.approx(3 * abs(turned) / 6.283185307179586, abs=3 * near)
    assert abs(turned) == pytest.approx(6.2832, abs=0.001)
    assert made.reported()[up] == 3


def test_line_is_one_block_and_kernels_match_the_interpreter() -> None:
    lines = ["G1F3000", *[f"X{x}Y{x * x % 7}Z{-x % 3}" for x in range(30)], "G20", "X1F50", "G91"]
    lines += ["X.1Y.1", "G21", "G0X1", "Y2"]
    found = []
    for watched in (0, MOVE):
        made = machine(settings={780: 12.0}, watched=False)
        rig: Any = made.rig
        rig.on_built = lambda rig=rig, bits=watched: rig.controller.interpreter.watch(bits)
        made.play(lines)
        found.append((way(made)[-1], made.reported()))
    assert found[0] == found[1]


def test_zero_skew_moves_step_for_step_like_a_machine_without_the_module() -> None:
    lines = ["G0X1Y1Z1", "G1X-2Y3F900", "G2X0Y0I3J-1", "G1Z-3", "$J=G91X3F900", "G0X0", "$780=0"]
    with_it = machine((0, 0, 0), watched=False)
    with_it.play(lines)
    without = Machine(_FAST, "sim", watched=False)
    without.play(lines[:-1])
    assert rows(with_it) == rows(without)


def test_each_motor_keeps_its_own_rate_and_acceleration() -> None:
    """Y moves fast, and the skew of 0.1 moves the slower X along. X limits the motion."""
    mm_s, mm_s2 = 1.0, 2.0  # of X; Y has 100 mm/s and 1000 mm/s²
    made = machine(settings={110: 60 * mm_s, 120: mm_s2})
    made.play(["G0Y20", "G0Y0"])
    steps_s = []  # times of X's steps
    for start, row in made.rows:
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
    said: dict[bool, list[str]] = {}
    for leans in (False, True):
        made = machine() if leans else Machine(_FAST, "sim")
        heard: list[str] = []

        def script(made: Machine = made, heard: "list[str]" = heard) -> Iterator[Any]:
            yield from made.start()
            for line in lines:
                yield from made.sender.wait("idle", line + "\n", 1)
                heard.extend(made.take())
                yield from made.rest()
                heard.append(made.received[-1])
                heard.append(next(n for n in reversed(made.received) if n.startswith("<")))

        made.run(script())
        said[leans] = heard
    assert said[True] == said[False]


@pytest.mark.parametrize("byte", ["!", "\x18", "\x85", "\x84"])
def test_position_is_right_after_a_stop_anywhere(byte: str) -> None:
    straight = machine()
    straight.play(["G0X7Y-6Z5"])
    for ms in range(3, 700, 41):
        made = machine()
        asked = "$J=G91X20Y-10Z5F4000\n" if byte == "\x85" else "G2X0Y0I8J6Z9F4000\n"

        def script(made: Machine = made, asked: str = asked, ms: int = ms) -> Iterator[Any]:
            yield from made.start()
            yield from made.sender.wait("idle", "G0X1Y2Z-3\n", 1)
            yield from made.rest()
            made.rig.link.send(asked.encode())
            yield made.rig.ms(ms)
            made.rig.link.send(byte.encode("latin-1"))
            yield from made.rest()
            for here, told, near in zip(
                tool(made.physical()), made.reported(), close(_LEANING), strict=True
            ):
                assert abs(here - told) <= near + 0.0005, ms
            made.take()
            yield from made.sender.wait("idle", "$X\n" if byte == "\x18" else "\n", 1)
            yield from made.sender.wait("idle", "G0X7Y-6Z5\n", 1)
            yield from made.rest()

        made.run(script())
        assert made.physical() == straight.physical(), ms
        assert made.reported() == [7, -6, 5], ms


def _switched(made: Machine, above: bool = True) -> None:
    for i, letter in enumerate("xyz"):
        at = (700, 900, 500)[i]
        made.rig.engine.switches.append(Switch(f"limit_{letter}", i, above, at if above else -at))


@pytest.mark.parametrize("inverted", [0, 7])
def test_homing_moves_each_motor_alone_and_sets_grbls_position(inverted: int) -> None:
    made = machine(settings={22: 1, 23: inverted})
    _switched(made, not inverted)
    found: list[list[int]] = []

    def script() -> Iterator[Any]:
        yield from made.start()
        for line in ("$H", "G53G0X-40Y-60Z-20", "$H"):
            yield from made.sender.wait("idle", line + "\n", 1)
            yield from made.rest()
            found.append(made.physical())
            if line == "$H":
                wanted = [-1, -1, -1] if not inverted else [-199, -199, -199]
                assert made.reported() == wanted

    made.run(script())
    assert found[0] == pytest.approx(found[2], abs=2)
    pulled = [(n + (-_PER_MM if not inverted else _PER_MM)) for n in found[0]]
    switches = [700, 900, 500] if not inverted else [-700, -900, -500]
    assert pulled == pytest.approx(
        [n - 2 * _PER_MM * (1 - 2 * bool(inverted)) for n in switches], abs=4
    )
    # The machine is square from there on.
    gone = [b - a for a, b in zip(found[0], found[1], strict=True)]
    wanted = [-40 + 1, -60 + 1, -20 + 1] if not inverted else [159, 139, 179]
    assert tool(gone) == pytest.approx(wanted, abs=0.01)


def test_axis_homed_alone_finds_its_place_wherever_the_others_are() -> None:
    made = machine(settings={22: 1}, SINGLE_AXIS_HOMING=True)
    _switched(made)
    told: list[list[float]] = []

    def script() -> Iterator[Any]:
        yield from made.start()
        for line in ("$H", "G53G0X-20Y-100", "$HX", "G53G0X-5Y-1Z-1"):
            yield from made.sender.wait("idle", line + "\n", 1)
            yield from made.rest()
            told.append(made.reported())
        told.append([float(n) for n in made.physical()])
        yield from made.sender.wait("idle", "$H\n", 1)
        yield from made.sender.wait("idle", "G53G0X-5\n", 1)
        yield from made.rest()
        told.append([float(n) for n in made.physical()])

    made.run(script())
    # X pulls off to its earlier place; Y is 99 mm lower, which moves the tool by -9.9 mm.
    assert told[2] == pytest.approx([-1 - 9.9, -100, -1], abs=0.02)
    assert told[4] == pytest.approx(told[5], abs=2)


@pytest.mark.parametrize("byte", ["\x18", "\x84"])
def test_machine_can_be_homed_after_aborted_homing(byte: str) -> None:
    for ms in (5, 60, 300, 900):
        made = machine(settings={22: 1}, SAFETY_DOOR=byte == "\x84")
        _switched(made)

        def script(made: Machine = made, ms: int = ms) -> Iterator[Any]:
            yield from made.start()
            made.rig.link.send(b"$H\n")
            yield made.rig.ms(ms)
            made.rig.link.send(byte.encode("latin-1"))
            yield from made.rest()
            assert not made.rig.controller.planner.kinematics.homing  # type: ignore[union-attr]
            made.take()
            made.rig.link.send(b"\x18")
            yield from made.rest()
            yield from made.sender.wait("idle", "$H\n", 1)
            yield from made.rest()

        made.run(script())
        assert made.reported() == [-1, -1, -1]


def test_soft_limits_apply_to_the_tools_position() -> None:
    made = machine(settings={20: 1, 22: 1, 130: 50, 131: 50, 132: 50})
    _switched(made)

    def script() -> Iterator[Any]:
        yield from made.start()
        for line in ("$H", "G53G1X-50Y-50Z-50F3000", "$J=G53X-50.01F900", "G53G0X-1Y-1Z-1"):
            yield from made.sender.wait("idle", line + "\n", 1)
            yield from made.rest()
        made.rig.link.send(b"G53G0Y-50.01\n")
        yield made.rig.ms(1500)
        made.rig.link.send(b"\x18")  # ALARM:2 requires it
        yield from made.rest()

    made.run(script())
    assert "error:15" in made.received and "ALARM:2" in made.received
    assert made.reported() == [-1, -1, -1]


def test_probe_reports_the_tools_position() -> None:
    made = machine(watched=False)
    usual: Any = made.rig.engine.trace
    at = [0, 0, 0]

    def trace(start: int, row: Any) -> None:
        usual(start, row)
        for i in range(3):
            count = row[ROW_AXES + ROW_STRIDE * i]
            at[i] += -count if row[ROW_DIRS] >> i & 1 else count
        made.rig.port.push({"probe": at[2] <= -2 * _PER_MM})

    made.rig.engine.trace = trace
    made.play(["G0X4Y5", "G38.2Z-10F100", "$#", "G1Z0F900", "$#"])
    told = {line for line in made.received if line.startswith("[PRB:")}
    assert len(told) == 1
    x, y, z = [float(n) for n in told.pop()[5:].split(":")[0].split(",")]
    # Straight down: X and Y of the tool stay, although their motors move.
    assert (x, y) == (pytest.approx(4, abs=0.008), pytest.approx(5, abs=0.008))
    assert z == pytest.approx(-2, abs=0.05)
    assert made.reported() == pytest.approx([4, 5, 0], abs=0.008)


def test_positions_follow_a_change_of_skew_and_lines_continue_there() -> None:
    made = machine((0, 0, 0))
    told: list[Any] = []

    def script() -> Iterator[Any]:
        yield from made.start()
        for line in ("G0X10Y20", "$780=50", "G91", "G0Z1", "G90", "G0X10", "$780=0"):
            yield from made.sender.wait("idle", line + "\n", 1)
            yield from made.rest()
            told.append((made.physical(), made.reported()))

    made.run(script())
    assert told[1] == ([2500, 5000, 0], [11, 20, 0])
    assert told[3] == ([2500, 5000, 250], [11, 20, 1])
    assert told[5] == ([2250, 5000, 250], [10, 20, 1])
    assert told[6] == ([2250, 5000, 250], [9, 20, 1])


def test_parking_moves_the_tool_straight_up_and_back() -> None:
    made = machine(settings={22: 1, 132: 200}, PARKING=True, SAFETY_DOOR=True)
    _switched(made)

    def script() -> Iterator[Any]:
        yield from made.start()
        for line in ("$H", "M3S500", "G53G0X-40Y-60Z-90"):
            yield from made.sender.wait("idle", line + "\n", 1)
        yield from made.rest()
        before = made.physical()
        made.take()
        made.rig.link.send(b"G1X-10F600\n")
        yield made.rig.ms(800)
        made.rig.link.send(b"\x84")
        yield made.rig.ms(14_000)
        yield from made.sender.wait("report", "?")
        told = [line for line in made.take() if line.startswith("<Door")][-1]
        x, y, z = [float(n) for n in told.split("MPos:")[1].split("|")[0].split(",")]
        assert -40 < x < -10 and y == pytest.approx(-60, abs=0.002)
        assert z == pytest.approx(-5, abs=0.005)
        gone = [b - a for a, b in zip(before, made.physical(), strict=True)]
        assert tool(gone) == pytest.approx([x + 40, 0, 85], abs=0.02)
        yield from made.rest()

    made.run(script())
    assert made.reported() == [-10, -60, -90]


def test_corexy_and_ganged_motors_can_have_skew() -> None:
    line, ends = "G1X10Y20Z-5F900", [10, 20, -5]
    plain = machine()
    plain.play([line])
    x, y, z = plain.physical()
    for options, motors in (
        ({"COREXY": True}, [x + y, x - y, z]),
        ({"MOVES": ("X+Z", "Y", "X-Z")}, [x + z, y, x - z]),
        ({"STEP": (0, 1, 2, 3), "MOTORS": "XYZY"}, [x, y, z, y]),
    ):
        made = machine(watched=False, **options)
        made.play([line])
        assert made.physical() == motors
        assert made.reported() == ends
        made = machine(watched=False, **options)
        made.play([line, "G2X0Y0I-5J-10", "G1Z0", "$J=G91X5Y7F900", "G90G0X10Y20Z-5"])
        assert made.physical() == motors
        assert made.reported() == ends


def test_axes_may_have_different_resolutions() -> None:
    made = machine((40.0, -80.0, 20.0), {100: 80, 101: 1600, 102: 400}, watched=False)
    made.play(["G1X10Y20Z-5F900", "G2X0Y0I-5J-10", "G1X30Y-10Z7"])
    x, y, z = [n / per for n, per in zip(made.physical(), (80, 1600, 400), strict=True)]
    assert z == 7
    assert y + 0.02 * z == pytest.approx(-10, abs=1 / 1600)
    assert x + 0.04 * y - 0.08 * z == pytest.approx(30, abs=1 / 80)
    assert made.reported() == [30, -10, 7]


def test_settings_may_be_negative_are_listed_bounded_and_stored() -> None:
    made = machine((0, 0, 0), watched=False)
    made.play(["$780=-1.75", "$781=100.001", "$782=-101", "$781=nan", "$130=-1", "$$"])
    assert made.received.count("error:3") >= 2 and "error:4" in made.received
    listed = [line for line in made.received if line.startswith("$78")]
    assert listed == ["$780=-1.750", "$781=0.000", "$782=0.000"]
    assert "$780=-1.75" in made.rig.store.files["settings"]  # type: ignore[attr-defined]
    again = Machine(_FAST, board(), watched=False)
    again.rig.store.files["settings"][:] = made.rig.store.files["settings"]  # type: ignore[attr-defined]
    again.play(["$$", "G0X1"])
    assert "$780=-1.750" in again.received and "error:7" not in again.received


@pytest.mark.parametrize("word", ["KINEMATICS", "ROTARY", "BACKLASH", "JERK", "CLUSTERS"])
def test_conflicting_options_are_refused_with_the_reason(
    word: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    geometry = ModuleType("A")
    places = dict.fromkeys(("START", "HOME", "TRAVEL"), (0, 0, 0))
    vars(geometry).update(inverse=None, forward=None, CENTRED=(), FASTEST=1, **places)
    monkeypatch.setitem(sys.modules, "A", geometry)
    options: dict[str, Any] = {"KINEMATICS": {"KINEMATICS": "A"}}
    options["ROTARY"] = {"ROTARY": "A", "STEP": (0, 1, 2, 3), "DIR": (4, 5, 6, 7)}
    with pytest.raises(ValueError, match=f"SKEW and {word} are not for the same machine"):
        machine(**options.get(word, {word: True})).play([])


def test_default_beyond_the_bound_is_refused_with_the_reason() -> None:
    with pytest.raises(ValueError, match=r"DEFAULTS: \$781 may be at most 100 mm/m"):
        machine(DEFAULTS={781: -101.0}).play([])


def test_run_reports_positions_and_distances_of_the_tool(tmp_path: Path) -> None:
    file = tmp_path / "skew.nc"
    file.write_text("G0X10\nG1X10Y-30F900\n")
    asked = ["run", str(file), "--board", "sim_skew", "--set", "780=100"]
    said = CliRunner().invoke(app, asked)
    assert said.exit_code == 0, said.output
    assert "0.000 to 10.000 mm" in said.output and "-30.000 to 0.000 mm" in said.output
    assert "40.0 mm" in said.output
    assert "3250 commanded = 3250 made" in said.output


def test_board_without_skew_has_none_of_the_modules() -> None:
    plain = build.modules_of(load_board("rpi_pico"))
    extras = {"extras.kinematics.skew", "extras.kinematics.skew_kernel"}
    assert not {*extras, "motion.kinematics"} & set(plain)
    made = ModuleType("board")
    vars(made).update({**vars(load_board("rpi_pico")), "SKEW": True})
    assert list(board_check.problems(made)) == []
    assert {"extras.kinematics.skew", "motion.kinematics"} <= set(build.modules_of(made))
