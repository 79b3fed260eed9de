"""Test user-defined kinematics: the tool stays on its path, joints within their limits."""

import math
import random
import sys
from array import array
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from motion.layout import ROW_AXES, ROW_DIRS, ROW_STRIDE, ROW_TICKS
from rig_bench import Machine
from typer.testing import CliRunner
from ugrbl.boardfile import board_check
from ugrbl.boardfile.files import load, load_board
from ugrbl.cli.app import app
from ugrbl.compiling import build
from ugrbl.sim.engine import Switch, step_tick

# Many cases: the first ring runs a sample of them.
pytestmark = pytest.mark.sampled(1)

_EXAMPLES = Path(__file__).parents[2] / "examples" / "kinematics"
if str(_EXAMPLES) not in sys.path:
    sys.path.append(str(_EXAMPLES))
_FINE = 1000.0  # steps per unit of a joint: fine, so that steps hide no error
_TICK_HZ = 13_107_200
_WINDOW_S = 0.02
_LOOK = 7  # checks every 7th pulse; a chord has some hundred
_KINDS = ("scara", "polar")
# A place in reach with space around it, for each machine.
_MIDDLE = {"scara": (0.0, 120.0), "polar": (60.0, 20.0)}

Place = tuple[float, ...]


def board(kind: str, **options: Any) -> ModuleType:
    """Return the example's machine in the simulator, with fine steps."""
    example = load(_EXAMPLES / {"scara": "my_scara.py", "polar": "my_plotter.py"}[kind])
    made = ModuleType("board")
    defaults = {**example.DEFAULTS, 1: 255, **{100 + i: _FINE for i in range(3)}}
    defaults.update({110 + i: 5000.0 for i in range(3)})
    made.__dict__.update({**vars(load_board("sim")), "KINEMATICS": kind, "DEFAULTS": defaults})
    made.__dict__.update(options)
    return made


def geometry(kind: str) -> Any:
    """Return the example's module."""
    return __import__(kind)


def machine(kind: str, settings: "dict[int, float] | None" = None, **options: Any) -> Machine:
    """Return that machine, idle."""
    return Machine(settings, board(kind, **options), watched=False)


def played(
    kind: str,
    lines: Sequence[str],
    settings: "dict[int, float] | None" = None,
    events: "Sequence[tuple[int, str]]" = (),
    **options: Any,
) -> Machine:
    """Return the machine after these lines."""
    made = machine(kind, settings, **options)
    made.play(lines, events)
    return made


def joints(kind: str, steps: Sequence[int], per_unit: float = _FINE) -> "list[float]":
    """Return the joints for these motor steps since power-up."""
    start: Sequence[float] = geometry(kind).START
    return [begin + n / per_unit for begin, n in zip(start, steps, strict=True)]


def place(kind: str, steps: Sequence[int], per_unit: float = _FINE) -> Place:
    """Return the tool's position for these motor steps."""
    found = array("d", (0.0, 0.0, 0.0))
    geometry(kind).forward(joints(kind, steps, per_unit), found)
    return tuple(found)


def pulses(made: Machine) -> "Iterator[tuple[float, int, int]]":
    """Yield every step of every motor in order: seconds, motor, +1 or -1."""
    for start, row in made.rows:
        found = []
        for motor in range(3):
            base = ROW_AXES + ROW_STRIDE * motor
            way = -1 if row[ROW_DIRS] >> motor & 1 else 1
            found += [(start + step_tick(row, base, k), motor, way) for k in range(row[base])]
        for tick, motor, way in sorted(found):
            yield tick / _TICK_HZ, motor, way


def step_mm(kind: str, at: Sequence[int]) -> float:
    """Return the largest motion of the tool in mm for one step of each motor."""
    here = place(kind, at)
    total = 0.0
    for motor in range(3):
        near = list(at)
        near[motor] += 1
        total += math.dist(here, place(kind, near))
    return total


def from_line(at: Place, begin: Place, end: Place) -> float:
    """Return the distance of a place to a straight line."""
    way = [b - a for a, b in zip(begin, end, strict=True)]
    squares = sum(w * w for w in way)
    along = sum((p - a) * w for p, a, w in zip(at, begin, way, strict=True)) / (squares or 1.0)
    along = min(max(along, 0.0), 1.0)
    return math.dist(at, [a + along * w for a, w in zip(begin, way, strict=True)])


def strayed(made: Machine, kind: str, away: "Callable[[Place], float]") -> float:
    """Return the largest distance from the path, less the size of a step."""
    steps = [0, 0, 0]
    worst = 0.0
    for i, (_, motor, way) in enumerate(pulses(made)):
        steps[motor] += way
        if i % _LOOK == 0:
            worst = max(worst, away(place(kind, steps)) - step_mm(kind, steps))
    return worst


def begin(kind: str) -> Place:
    """Return the tool's position at power-up."""
    return place(kind, (0, 0, 0))


def random_places(kind: str, seed: int, count: int) -> "list[Place]":
    """Return random places; straight lines between them, from begin() on, are in reach."""
    rng = random.Random(seed)
    model = geometry(kind)
    found = [begin(kind)]
    while len(found) <= count:
        x, y = _MIDDLE[kind]
        spread = 55 if kind == "scara" else 85
        end = (x + rng.uniform(-spread, spread), y + rng.uniform(-spread, spread) * 0.8)
        end = (round(end[0], 3), round(end[1], 3), round(rng.uniform(-20, 0), 3))
        way = zip(found[-1], end, strict=True)
        ends = [(a, b - a) for a, b in way]
        if all(
            model.inverse([a + w * part / 50 for a, w in ends], list(model.START))
            for part in range(51)
        ):
            found.append(end)
    return found


def words(at: Place) -> str:
    """Return a place as words of a program."""
    return "".join(f"{letter}{mm:.3f}" for letter, mm in zip("XYZ", at, strict=True))


@pytest.mark.parametrize("kind", _KINDS)
@pytest.mark.parametrize("tolerance", [0.01, 0.1])
def test_lines_keep_within_the_arc_tolerance(kind: str, tolerance: float) -> None:
    places = random_places(kind, 7, 4)
    lines = [f"G1{words(end)}F3000" for end in places[1:]]
    made = played(kind, lines, {12: tolerance})
    assert "error" not in " ".join(made.received)
    worst = strayed(made, kind, lambda at: min(from_line(at, a, b) for a, b in pairwise(places)))
    assert worst <= tolerance
    assert math.dist(place(kind, made.physical()), places[-1]) < 0.01


@pytest.mark.parametrize("kind", _KINDS)
def test_arcs_and_helices_keep_within_the_arc_tolerance(kind: str) -> None:
    x, y = _MIDDLE[kind]
    first = (x + 20.0, y, 0.0)
    lines = [f"G1{words(first)}F3000", f"G3X{x - 20}Y{y}Z-5I-20J0", f"G2X{x + 20}Y{y}I20J0"]
    made = played(kind, lines, {12: 0.02})

    def away(at: Place) -> float:
        ring = abs(math.hypot(at[0] - x, at[1] - y) - 20)
        return min(from_line(at, begin(kind), first), ring)

    assert strayed(made, kind, away) <= 0.02
    assert math.dist(place(kind, made.physical()), (x + 20, y, -5)) < 0.01


@pytest.mark.thorough
def test_plotter_moves_straight_through_and_past_the_middle_of_its_table() -> None:
    for aside in (0.0, 0.001, 0.3):
        lines = ["G0X40Y0", f"G1X40Y{aside}F3000", f"G1X-40Y{aside}"]
        made = played("polar", lines, {12: 0.02})
        places = [(0.0, 0.0, 0.0), (40.0, 0.0, 0.0), (40.0, aside, 0.0), (-40.0, aside, 0.0)]
        ways = list(pairwise(places))
        worst = strayed(made, "polar", lambda at, ways=ways: min(from_line(at, *w) for w in ways))
        assert worst <= 0.02, aside
        assert math.dist(place("polar", made.physical()), places[-1]) < 0.01


def rates(made: Machine) -> "list[list[float]]":
    """Return each motor's mean rate, in units per second, in each window of time."""
    end = made.rows[-1][0] / _TICK_HZ
    first = made.rows[0][0] / _TICK_HZ
    count = int((end - first) / _WINDOW_S) + 2
    found = [[0.0] * count for _ in range(3)]
    for second, motor, way in pulses(made):
        found[motor][int((second - first) / _WINDOW_S)] += way / _FINE / _WINDOW_S
    return found


@pytest.mark.parametrize("kind", _KINDS)
@pytest.mark.parametrize("word", ["G0", "G1F6000"])
def test_joints_keep_their_rate_and_acceleration(kind: str, word: str) -> None:
    ends = {
        "scara": ["X-60Y130", "X60Y130", "X0Y80", "X0Y165"],
        "polar": ["X100Y1", "X-100Y1", "X-100Y-3", "X100Y-3"],
    }[kind]
    for end, before in zip(ends[1:], ends, strict=False):
        made = machine(kind, {12: 0.02})
        rows: list[Any] = []

        def script(
            made: Machine = made, end: str = end, before: str = before, rows: Any = rows
        ) -> Iterator[Any]:
            yield from made.start()
            yield from made.sender.wait("idle", f"G0{before}\n", 1)
            made.take()
            rows.append(len(made.rows))
            yield from made.sender.wait("idle", f"{word}{end}\n", 1)

        made.run(script())
        made.rows = made.rows[rows[0] :]
        settings: Any = made.rig.controller.settings
        slack = 1.02 / _FINE / _WINDOW_S  # a step more or less in a window
        for i, found in enumerate(rates(made)):
            fastest = settings.max_rate[i] / 60
            assert max(map(abs, found)) <= fastest * 1.01 + slack
            sooner = max(abs(after - before) for before, after in pairwise(found))
            most = settings.acceleration[i] / 3600 * _WINDOW_S
            assert sooner <= most * 1.1 + 2 * slack, (end, i)


@pytest.mark.parametrize("kind", _KINDS)
def test_feed_rate_is_the_tools_speed_along_its_path(kind: str) -> None:
    x, y = _MIDDLE[kind]
    made = played(kind, [f"G0X{x - 30}Y{y}", "G4P0.1", f"G1X{x + 30}F1200"], {12: 0.02})
    steps = [0, 0, 0]
    times = []
    for second, motor, way in pulses(made):
        steps[motor] += way
        at = place(kind, steps)
        times.append((second, at))
    cut = [(s, at) for s, at in times if x - 20 < at[0] < x + 20]
    late = [row for row in cut if row[0] > times[-1][0] - 3.2]
    for (s, a), (t, b) in pairwise(late[::400]):
        assert math.dist(a, b) / (t - s) == pytest.approx(20, rel=0.02)


@pytest.mark.parametrize("kind", _KINDS)
def test_inverse_time_is_kept_for_a_line_of_many_chords(kind: str) -> None:
    x, y = _MIDDLE[kind]
    made = played(kind, [f"G0X{x - 30}Y{y}", "G4P0.1", f"G93G1X{x + 30}F20"])
    last, row = made.rows[-1]
    ends = [start + row[ROW_TICKS] for start, row in made.rows]
    begun = [
        s for (s, _), end in zip(made.rows[1:], ends, strict=False) if s - end > _TICK_HZ / 50
    ]
    took = (last + row[ROW_TICKS] - begun[-1]) / _TICK_HZ
    assert took == pytest.approx(3, abs=0.25)


@pytest.mark.parametrize("kind", _KINDS)
@pytest.mark.parametrize(
    "line", ["G0X0Y300", "G1X0Y300F500", "G2X0Y290R145F500", "G38.2X0Y300F50"]
)
def test_unreachable_target_is_refused_without_any_effect(kind: str, line: str) -> None:
    made = played(kind, ["M3S500" + line, "$G"])
    assert "error:33" in made.received
    assert any("is out of reach" in x for x in made.received)
    assert made.physical() == [0, 0, 0]
    (modes,) = [x for x in made.received if x.startswith("[GC:")]
    assert "M5" in modes and "S0]" in modes and "G0 " in modes


def test_line_between_reachable_places_is_refused_if_it_leaves_the_reach() -> None:
    model = geometry("scara")
    ends = (-60.0, 40.0, 0.0), (60.0, 40.0, 0.0)
    assert all(model.inverse(end, list(model.START)) for end in ends)
    made = played("scara", ["G0X-60Y40", "G1X60Y40F900"])
    assert "error:33" in made.received
    assert "[MSG:X-" in " ".join(made.received)  # the place where it would leave it
    assert math.dist(place("scara", made.physical()), ends[0]) < 0.01


@pytest.mark.parametrize("kind", _KINDS)
def test_unreachable_jog_is_refused_with_the_error_of_jogs(kind: str) -> None:
    made = played(kind, ["$J=G91X900F900", "$J=G90X0Y500F900"])
    assert made.received.count("error:15") == 2
    assert made.physical() == [0, 0, 0]


@pytest.mark.parametrize("kind", _KINDS)
def test_jog_is_straight_and_can_be_cancelled_anywhere(kind: str) -> None:
    x, y = _MIDDLE[kind]
    for ms in range(20, 1500, 130):
        made = machine(kind, {12: 0.002}, PLANNER_BLOCKS=8)
        cancelled = []

        def script(
            made: Machine = made, ms: int = ms, cancelled: Any = cancelled
        ) -> Iterator[Any]:
            yield from made.start()
            yield from made.sender.wait("idle", f"G0X{x - 35}Y{y}\n", 1)
            made.rig.link.send(f"$J=X{x + 40}F3000\n".encode())
            yield made.rig.ms(ms)
            made.rig.link.send(b"\x85")
            yield from made.rest()
            made.take()
            cancelled.append((made.reported(), place(kind, made.physical())))
            yield from made.sender.wait("idle", f"G1X{x}Y{y}F3000\n", 1)
            yield from made.rest()

        made.run(script())
        ((told, at),) = cancelled
        assert told == pytest.approx(at, abs=0.002)
        assert at[1] == pytest.approx(y, abs=0.01)
        assert x - 35 <= at[0] < x - 35 + 50 * ms / 1000 + 6
        assert math.dist(place(kind, made.physical()), (x, y, 0)) < 0.01


@pytest.mark.thorough
@pytest.mark.parametrize("kind", _KINDS)
def test_hold_anywhere_keeps_the_path(kind: str) -> None:
    places = random_places(kind, 3, 4)
    lines = [f"G1{words(end)}F3000" for end in places[1:]]
    for ms in range(700, 2500, 480):
        made = played(kind, lines, {12: 0.02}, [(ms, "!"), (ms + 400, "~")])
        worst = strayed(
            made, kind, lambda at: min(from_line(at, a, b) for a, b in pairwise(places))
        )
        assert worst <= 0.02
        assert math.dist(place(kind, made.physical()), places[-1]) < 0.01


@pytest.mark.parametrize("kind", _KINDS)
def test_position_is_right_after_a_reset_in_motion(kind: str) -> None:
    x, y = _MIDDLE[kind]
    for ms in range(500, 1400, 170):
        made = played(kind, [f"G1X{x}Y{y}F1500", f"G1X{x + 20}F1500"], {}, [(ms, "\x18")])
        at = place(kind, made.physical())
        assert made.reported() == pytest.approx(at, abs=0.002)


@pytest.mark.parametrize("kind", _KINDS)
def test_probe_reports_a_contact_in_the_middle_of_a_long_line(kind: str) -> None:
    x, y = _MIDDLE[kind]
    made = machine(kind, {12: 0.002}, PLANNER_BLOCKS=8)
    places = []

    def look() -> None:
        at = place(kind, made.physical())
        made.rig.port.push({"probe": at[0] > x + 10.0})
        places.append(at)

    usual: Any = made.rig.engine.trace

    def trace(start: int, row: "array[int]") -> None:
        usual(start, row)
        look()

    made.rig.engine.trace = trace
    made.play([f"G0X{x - 30}Y{y}", f"G38.2X{x + 60}F600", f"G1X{x - 30}F1000"])
    (told,) = [line for line in made.received if line.startswith("[PRB:")]
    touched = [float(n) for n in told[5:].split(":")[0].split(",")]
    assert told.endswith(":1]")
    contact = next(at for at in places if at[0] > x + 10.0)
    assert touched == pytest.approx(contact, abs=0.001)
    assert touched[0] == pytest.approx(x + 10, abs=0.3)
    assert touched[1] == pytest.approx(y, abs=0.01)
    assert math.dist(place(kind, made.physical()), (x - 30, y, 0)) < 0.01
    assert max(at[0] for at in places) < x + 13


@pytest.mark.parametrize("kind", _KINDS)
def test_touch_that_ends_during_a_hold_is_ignored_on_a_long_line(kind: str) -> None:
    x, y = _MIDDLE[kind]
    made = machine(kind, {12: 0.002}, PLANNER_BLOCKS=8)
    rig = made.rig

    def script() -> "Iterator[Any]":
        yield from made.start()
        yield from made.sender.wait("idle", f"G0X{x - 30}Y{y}\n", 1)
        rig.link.send(f"G38.3X{x + 30}F1500\n".encode())
        yield rig.ms(600)
        rig.link.send(b"!")
        yield rig.ms(400)
        held = made.physical()
        rig.port.push({"probe": True})
        yield rig.ms(50)
        rig.port.push({"probe": False})
        rig.link.send(b"~")
        yield rig.ms(400)
        assert made.physical() != held
        yield from made.rest()

    made.run(script())
    assert made.received[-1].startswith("<Idle"), made.received
    (told,) = [line for line in made.received if line.startswith("[PRB:")]
    assert told.endswith(":0]")
    assert math.dist(place(kind, made.physical()), (x + 30, y, 0)) < 0.01


@pytest.mark.parametrize("kind", _KINDS)
def test_homing_moves_joints_to_their_switches_and_sets_the_tools_position(kind: str) -> None:
    model = geometry(kind)
    made = machine(kind, {22: 1, 24: 600, 25: 3000, 26: 5})
    pull_off = {"scara": 5.0, "polar": 2.0}[kind]  # $27 of the example boards
    above = [True, kind == "polar", True]
    for i, letter in enumerate("xyz"):
        way = model.HOME[i] - model.START[i] or 9.0  # without HOME the switch defines the place
        made.rig.engine.switches.append(Switch(f"limit_{letter}", i, above[i], round(way * _FINE)))
    made.play(["$H", "?"])
    pulled = [
        home - pull_off if up else home + pull_off
        for home, up in zip(model.HOME, above, strict=True)
    ]
    expected = array("d", (0.0, 0.0, 0.0))
    model.forward(pulled, expected)
    assert made.reported() == pytest.approx(list(expected), abs=0.02)


@pytest.mark.parametrize("kind", _KINDS)
def test_soft_limits_apply_to_the_tools_position(kind: str) -> None:
    x, y = _MIDDLE[kind]
    settings = {20: 1, 22: 1, 130: x + 10, 131: 200}
    reset = [(6000, "\x18")]
    made = played(kind, ["$X", f"G0X{x + 5}Y{y}", "G4P0.1", f"G0X{x + 11}"], settings, reset)
    assert "ALARM:2" in made.received
    assert math.dist(place(kind, made.physical()), (x + 5, y, 0)) < 0.01
    bent = [f"G0X{x + 5}Y{y}", f"G2X{x + 5}Y{y - 10}J-5F900"]
    made = played(kind, ["$X", *bent], {**settings, 130: x + 8}, reset)
    assert "ALARM:2" in made.received


def test_check_mode_refuses_the_same_lines_and_moves_nothing() -> None:
    made = played("scara", ["$C", "G0X0Y120", "G0X0Y300", "G0X40", "$C"])
    answers = [x for x in made.received if x in ("ok", "error:33")]
    assert answers[:4] == ["ok", "ok", "error:33", "ok"]
    assert made.physical() == [0, 0, 0]


@pytest.mark.parametrize("kind", _KINDS)
def test_both_moves_of_g28_are_checked(kind: str) -> None:
    x, y = _MIDDLE[kind]
    lines = [f"G0X{x}Y{y}", "G28.1", f"G0X{x + 20}", "G28X0Y400", f"G28Y{y - 10}"]
    made = played(kind, lines)
    assert made.received.count("error:33") == 1
    assert math.dist(place(kind, made.physical()), (x + 20, y, 0)) < 0.01


def test_board_without_user_kinematics_has_none_of_its_modules() -> None:
    names = ("nonlinear", "nonlinear_canon", "joint_planner", "segmenter")
    extras = {f"extras.kinematics.{name}" for name in names}
    assert not extras & set(build.modules_of(load_board("rpi_pico")))
    assert extras <= set(build.modules_of(load(_EXAMPLES / "my_scara.py")))


def test_documentation_shows_the_example_unchanged() -> None:
    page = (_EXAMPLES.parent.parent / "docs" / "kinematics.md").read_text(encoding="utf-8")
    shown = page.split("```python polar.py\n")[1].split("```")[0]
    assert shown == (_EXAMPLES / "polar.py").read_text(encoding="utf-8")


def test_run_reports_distance_and_bounds_of_the_tool(tmp_path: Path) -> None:
    file = tmp_path / "square.nc"
    file.write_text("G1X40F3000\nY40\nX0\nY0\n")
    said = CliRunner().invoke(app, ["run", str(file), "--board", str(_EXAMPLES / "my_plotter.py")])
    assert said.exit_code == 0, said.output
    assert "160" in said.output and "40.0" in said.output, said.output


@pytest.mark.parametrize("name", ["my_scara.py", "my_plotter.py"])
def test_examples_are_boards_that_can_be_built(name: str) -> None:
    assert list(board_check.problems(load(_EXAMPLES / name))) == []


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"COREXY": True}, "KINEMATICS and COREXY are not for the same machine"),
        ({"JERK": True}, "KINEMATICS and JERK are not for the same machine"),
        ({"STEP": (0, 1, 2, 3)}, "KINEMATICS: START has 3 numbers, but STEP has 4 pins"),
        ({"KINEMATICS": "random"}, "KINEMATICS: random.py has no inverse"),
    ],
)
def test_conflicting_options_are_refused_with_the_reason(
    options: "dict[str, Any]", said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        machine("scara", **options).play([])
