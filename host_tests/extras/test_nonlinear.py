"""Test user-defined kinematics: the tool stays on its path, joints within their limits.

The machines are the two examples: a SCARA (two arms, joints in degrees) and a polar plotter (an
arm in mm, a table in degrees). Machine.physical() returns the steps of the motors,
Machine.reported() the last reported position of the tool, Machine.received all output.
Machine.rest() resumes holds, waits until motion has ended, and asks for a report.
sender.wait("idle", text, settle=1) sends a text and waits for its answers, the end of motion, and
1 ms of silence. With $12=0.002 (arc tolerance, mm) a line has more chords than 8 planner blocks
hold.
"""

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
_WINDOW_S = 0.02  # in which rates are measured
_PULSES_PER_CHECK = 7  # checks every 7th pulse; a chord has some hundred
_KINDS = ("scara", "polar")
# A place in reach with space around it, X and Y in mm, for each machine.
_MIDDLE = {"scara": (0.0, 120.0), "polar": (60.0, 20.0)}

Place = tuple[float, ...]


def board(kind: str, **options: Any) -> ModuleType:
    """Return the example's board file for the simulator, with fine steps; options change it.

    $1=255: motors stay on; $100 to $102: steps per unit; $110 to $112: rates.
    """
    example = load(_EXAMPLES / {"scara": "my_scara.py", "polar": "my_plotter.py"}[kind])
    module = ModuleType("board")
    defaults = {**example.DEFAULTS, 1: 255, **{100 + i: _FINE for i in range(3)}}
    defaults.update({110 + i: 5000.0 for i in range(3)})
    module.__dict__.update({**vars(load_board("sim")), "KINEMATICS": kind, "DEFAULTS": defaults})
    module.__dict__.update(options)
    return module


def geometry(kind: str) -> Any:
    """Return the example's module: inverse(), forward(), START and HOME."""
    return __import__(kind)


def make_machine(kind: str, settings: "dict[int, float] | None" = None, **options: Any) -> Machine:
    """Return that machine, idle."""
    return Machine(settings, board(kind, **options), watched=False)


def machine_after(
    kind: str,
    lines: Sequence[str],
    settings: "dict[int, float] | None" = None,
    events: "Sequence[tuple[int, str]]" = (),
    **options: Any,
) -> Machine:
    """Return the machine after these lines; events: real-time bytes at their ms."""
    cnc = make_machine(kind, settings, **options)
    cnc.play(lines, events)
    return cnc


def joints(kind: str, steps: Sequence[int], per_unit: float = _FINE) -> "list[float]":
    """Return the joints for these motor steps since power-up."""
    start: Sequence[float] = geometry(kind).START
    return [start_position + n / per_unit for start_position, n in zip(start, steps, strict=True)]


def tool_position(kind: str, steps: Sequence[int], per_unit: float = _FINE) -> Place:
    """Return the tool's position in mm for these motor steps since power-up."""
    position = array("d", (0.0, 0.0, 0.0))
    geometry(kind).forward(joints(kind, steps, per_unit), position)
    return tuple(position)


def pulses(cnc: Machine) -> "Iterator[tuple[float, int, int]]":
    """Yield every step of every motor in order: seconds, motor, +1 or -1."""
    for start, row in cnc.rows:
        row_steps = []
        for motor in range(3):
            # The motor's part of the row begins with its number of steps.
            motor_at = ROW_AXES + ROW_STRIDE * motor
            direction = -1 if row[ROW_DIRS] >> motor & 1 else 1
            row_steps += [
                (start + step_tick(row, motor_at, k), motor, direction)
                for k in range(row[motor_at])
            ]
        for tick, motor, direction in sorted(row_steps):
            yield tick / _TICK_HZ, motor, direction


def step_mm(kind: str, steps: Sequence[int]) -> float:
    """Return the motion of the tool in mm if all motors make a step, at most."""
    position = tool_position(kind, steps)
    total = 0.0
    for motor in range(3):
        neighbour = list(steps)
        neighbour[motor] += 1
        total += math.dist(position, tool_position(kind, neighbour))
    return total


def from_line(at: Place, start: Place, end: Place) -> float:
    """Return the distance of a place to a straight line with ends, in mm."""
    vector = [b - a for a, b in zip(start, end, strict=True)]
    length_sqr = sum(w * w for w in vector)
    part = sum((p - a) * w for p, a, w in zip(at, start, vector, strict=True))
    part /= length_sqr or 1.0
    part = min(max(part, 0.0), 1.0)
    return math.dist(at, [a + part * w for a, w in zip(start, vector, strict=True)])


def largest_deviation(cnc: Machine, kind: str, distance: "Callable[[Place], float]") -> float:
    """Return the largest distance from the path in mm, less a step; distance(place): from it."""
    steps = [0, 0, 0]
    largest_mm = 0.0
    for i, (_, motor, direction) in enumerate(pulses(cnc)):
        steps[motor] += direction
        if i % _PULSES_PER_CHECK == 0:
            largest_mm = max(
                largest_mm, distance(tool_position(kind, steps)) - step_mm(kind, steps)
            )
    return largest_mm


def start_position(kind: str) -> Place:
    """Return the tool's position at power-up."""
    return tool_position(kind, (0, 0, 0))


def random_places(kind: str, seed: int, count: int) -> "list[Place]":
    """Return count + 1 places from start_position() on; the lines between them are in reach."""
    rng = random.Random(seed)
    model = geometry(kind)
    places = [start_position(kind)]
    while len(places) <= count:
        x, y = _MIDDLE[kind]
        spread = 55 if kind == "scara" else 85
        end = (x + rng.uniform(-spread, spread), y + rng.uniform(-spread, spread) * 0.8)
        end = (round(end[0], 3), round(end[1], 3), round(rng.uniform(-20, 0), 3))
        axes = zip(places[-1], end, strict=True)
        begins_and_lengths = [(a, b - a) for a, b in axes]
        # 51 points of the line are in reach: for others, inverse() returns False.
        if all(
            model.inverse([a + w * part / 50 for a, w in begins_and_lengths], list(model.START))
            for part in range(51)
        ):
            places.append(end)
    return places


def axis_words(at: Place) -> str:
    """Return a place as words of a program."""
    return "".join(f"{letter}{mm:.3f}" for letter, mm in zip("XYZ", at, strict=True))


@pytest.mark.parametrize("kind", _KINDS)
@pytest.mark.parametrize("tolerance", [0.01, 0.1])
def test_lines_keep_within_the_arc_tolerance(kind: str, tolerance: float) -> None:
    """Random lines of the tool, which joints follow by many short chords."""
    places = random_places(kind, seed=7, count=4)
    lines = [f"G1{axis_words(end)}F3000" for end in places[1:]]
    # $12 is the arc tolerance, in mm.
    cnc = machine_after(kind, lines, settings={12: tolerance})
    assert "error" not in " ".join(cnc.received)
    error_mm = largest_deviation(
        cnc, kind, lambda at: min(from_line(at, a, b) for a, b in pairwise(places))
    )
    assert error_mm <= tolerance
    assert math.dist(tool_position(kind, cnc.physical()), places[-1]) < 0.01


@pytest.mark.parametrize("kind", _KINDS)
def test_chords_of_a_tolerance_of_0_come_to_an_end(kind: str) -> None:
    x, y = _MIDDLE[kind]
    cnc = machine_after(kind, [f"G1X{x + 20}Y{y + 5}F3000"], settings={12: 0})
    assert "error" not in " ".join(cnc.received)
    assert math.dist(tool_position(kind, cnc.physical())[:2], (x + 20, y + 5)) < 0.01


@pytest.mark.parametrize("kind", _KINDS)
def test_arcs_and_helices_keep_within_the_arc_tolerance(kind: str) -> None:
    """A line to a circle with radius 20 mm, half of it down to Z-5, and the same half back."""
    x, y = _MIDDLE[kind]
    first = (x + 20.0, y, 0.0)
    lines = [f"G1{axis_words(first)}F3000", f"G3X{x - 20}Y{y}Z-5I-20J0", f"G2X{x + 20}Y{y}I20J0"]
    cnc = machine_after(kind, lines, settings={12: 0.02})

    def distance(at: Place) -> float:
        from_circle = abs(math.hypot(at[0] - x, at[1] - y) - 20)
        return min(from_line(at, start_position(kind), first), from_circle)

    assert largest_deviation(cnc, kind, distance) <= 0.02
    assert math.dist(tool_position(kind, cnc.physical()), (x + 20, y, -5)) < 0.01


@pytest.mark.thorough
def test_plotter_moves_straight_through_and_past_the_middle_of_its_table() -> None:
    """At the middle of a polar machine's table, a straight line turns the table by 180 degrees."""
    for y_mm in (0.0, 0.001, 0.3):
        lines = ["G0X40Y0", f"G1X40Y{y_mm}F3000", f"G1X-40Y{y_mm}"]
        cnc = machine_after("polar", lines, settings={12: 0.02})
        places = [(0.0, 0.0, 0.0), (40.0, 0.0, 0.0), (40.0, y_mm, 0.0), (-40.0, y_mm, 0.0)]
        lines_of_path = list(pairwise(places))
        error_mm = largest_deviation(
            cnc,
            "polar",
            lambda at, lines_of_path=lines_of_path: min(from_line(at, *w) for w in lines_of_path),
        )
        assert error_mm <= 0.02, y_mm
        assert math.dist(tool_position("polar", cnc.physical()), places[-1]) < 0.01


def rates(cnc: Machine) -> "list[list[float]]":
    """Return each motor's mean rate, in units of the joint per second, in each window of time."""
    end_s = cnc.rows[-1][0] / _TICK_HZ
    first_s = cnc.rows[0][0] / _TICK_HZ
    count = int((end_s - first_s) / _WINDOW_S) + 2
    motor_rates = [[0.0] * count for _ in range(3)]
    for second, motor, direction in pulses(cnc):
        motor_rates[motor][int((second - first_s) / _WINDOW_S)] += direction / _FINE / _WINDOW_S
    return motor_rates


@pytest.mark.parametrize("kind", _KINDS)
@pytest.mark.parametrize("word", ["G0", "G1F6000"])
def test_joints_keep_their_rate_and_acceleration(kind: str, word: str) -> None:
    """Joints keep $110 to $122 on paths that demand the most of them.

    These are close to the middle or to the end of the reach. Only the steps of the last move are
    checked.
    """
    ends = {
        "scara": ["X-60Y130", "X60Y130", "X0Y80", "X0Y165"],
        "polar": ["X100Y1", "X-100Y1", "X-100Y-3", "X100Y-3"],
    }[kind]
    for end, before in zip(ends[1:], ends, strict=False):
        cnc = make_machine(kind, settings={12: 0.02})
        rows_before: list[Any] = []

        def script(
            cnc: Machine = cnc,
            end: str = end,
            before: str = before,
            rows_before: Any = rows_before,
        ) -> Iterator[Any]:
            """Move to the first place, note the number of rows, and make the measured move."""
            yield from cnc.start()
            yield from cnc.sender.wait("idle", f"G0{before}\n", settle=1)
            cnc.take()
            rows_before.append(len(cnc.rows))
            yield from cnc.sender.wait("idle", f"{word}{end}\n", settle=1)

        cnc.run(script())
        cnc.rows = cnc.rows[rows_before[0] :]
        settings: Any = cnc.rig.controller.settings
        slack = 1.02 / _FINE / _WINDOW_S  # a step more or less in a window
        for i, motor_rates in enumerate(rates(cnc)):
            fastest = settings.max_rate[i] / 60  # settings: units per min
            assert max(map(abs, motor_rates)) <= fastest * 1.01 + slack
            largest_change = max(abs(after - before) for before, after in pairwise(motor_rates))
            # Settings: units per min2.
            allowed_change = settings.acceleration[i] / 3600 * _WINDOW_S
            assert largest_change <= allowed_change * 1.1 + 2 * slack, (end, i)


@pytest.mark.parametrize("kind", _KINDS)
def test_feed_rate_is_the_tools_speed_along_its_path(kind: str) -> None:
    """F1200 is 20 mm/s: the speed between places of the last line, without its ends."""
    x, y = _MIDDLE[kind]
    cnc = machine_after(
        kind, [f"G0X{x - 30}Y{y}", "G4P0.1", f"G1X{x + 30}F1200"], settings={12: 0.02}
    )
    steps = [0, 0, 0]
    positions_by_s = []
    for second, motor, direction in pulses(cnc):
        steps[motor] += direction
        position = tool_position(kind, steps)
        positions_by_s.append((second, position))
    middle = [(s, position) for s, position in positions_by_s if x - 20 < position[0] < x + 20]
    # The rapid has crossed these places before: the line takes 3 s of the end.
    last_line = [row for row in middle if row[0] > positions_by_s[-1][0] - 3.2]
    # Every 400th step: a step more or less does not matter.
    for (s, a), (t, b) in pairwise(last_line[::400]):
        assert math.dist(a, b) / (t - s) == pytest.approx(20, rel=0.02)


@pytest.mark.parametrize("kind", _KINDS)
def test_inverse_time_is_kept_for_a_line_of_many_chords(kind: str) -> None:
    """G93 F20 asks for 1/20 min, 3 s. The line begins after the last gap in motion (G4)."""
    x, y = _MIDDLE[kind]
    cnc = machine_after(kind, [f"G0X{x - 30}Y{y}", "G4P0.1", f"G93G1X{x + 30}F20"])
    last_start, row = cnc.rows[-1]
    row_ends = [start + row[ROW_TICKS] for start, row in cnc.rows]
    starts_after_gaps = [
        s for (s, _), end in zip(cnc.rows[1:], row_ends, strict=False) if s - end > _TICK_HZ / 50
    ]
    duration_s = (last_start + row[ROW_TICKS] - starts_after_gaps[-1]) / _TICK_HZ
    assert duration_s == pytest.approx(3, abs=0.25)


@pytest.mark.parametrize("kind", _KINDS)
@pytest.mark.parametrize(
    "line", ["G0X0Y300", "G1X0Y300F500", "G2X0Y290R145F500", "G38.2X0Y300F50"]
)
def test_unreachable_target_is_refused_without_any_effect(kind: str, line: str) -> None:
    """Y300 is out of reach. M3, S500 and the motion mode of the refused line must not apply."""
    cnc = machine_after(kind, ["M3S500" + line, "$G"])
    assert "error:33" in cnc.received
    assert any("is out of reach" in x for x in cnc.received)
    assert cnc.physical() == [0, 0, 0]
    # M3, S500 and G1 of the refused line are not in force.
    (modes,) = [x for x in cnc.received if x.startswith("[GC:")]
    assert "M5" in modes and "S0]" in modes and "G0 " in modes


def test_target_beyond_single_precision_is_refused() -> None:
    """45 digits are more than its largest number, 3.4e38."""
    cnc = machine_after("polar", [f"G1X{'9' * 45}F500"])
    assert "error:33" in cnc.received and cnc.physical() == [0, 0, 0]


def test_hole_out_of_reach_is_an_alarm_and_the_next_place_is_not_drilled() -> None:
    """Y300 is out of reach. After a reset the last line is a rapid, not another hole."""
    cnc = make_machine("polar", LENIENT=True)
    sender = cnc.sender

    def script() -> Iterator[Any]:
        yield from cnc.start()
        yield from sender.wait("idle", "G1X50F3000\nG0Z-5\n", settle=1)
        cnc.take()
        yield from sender.wait("ms 3000", "G81X40Y300Z-9R-2F300M3S500\n")
        assert "ALARM:2" in cnc.take() and not cnc.rig.port.spindle_pwm
        yield from sender.wait("banner", "\x18")
        yield from sender.wait("idle", "$X\nX40Y0\n", settle=1)
        yield from cnc.rest()
        assert not cnc.rig.port.spindle_pwm

    cnc.run(script())
    assert cnc.reported() == pytest.approx([40, 0, -5], abs=0.01)


def test_drilling_cycle_is_checked_with_the_offsets_of_its_own_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """R5 is in reach in G54, and not in G55, which is active before the line."""
    model = geometry("scara")
    inverse = model.inverse
    monkeypatch.setattr(
        model, "inverse", lambda place, joints: place[2] < 100 and inverse(place, joints)
    )
    cnc = make_machine("scara", LENIENT=True)

    def script() -> Iterator[Any]:
        yield from cnc.start()
        for line in ("G0X0Y120", "G10L2P2Z96", "G55", "G54G81X10Y120Z-1R5F300"):
            yield from cnc.sender.wait("idle", line + "\n", settle=1)
        answers.extend(cnc.take())

    answers: "list[str]" = []
    cnc.run(script())
    assert "[MSG:G81: executed as a drilling cycle]" in answers


def test_line_between_reachable_places_is_refused_if_it_leaves_the_reach() -> None:
    """The line passes too close to the base of the SCARA; both of its ends are in reach."""
    model = geometry("scara")
    ends = (-60.0, 40.0, 0.0), (60.0, 40.0, 0.0)
    assert all(model.inverse(end, list(model.START)) for end in ends)
    cnc = machine_after("scara", ["G0X-60Y40", "G1X60Y40F900"])
    assert "error:33" in cnc.received
    assert "[MSG:X-" in " ".join(cnc.received)  # the place where it would leave it
    assert math.dist(tool_position("scara", cnc.physical()), ends[0]) < 0.01


@pytest.mark.parametrize("kind", _KINDS)
def test_unreachable_jog_is_refused_with_the_error_of_jogs(kind: str) -> None:
    cnc = machine_after(kind, ["$J=G91X900F900", "$J=G90X0Y500F900"])
    assert cnc.received.count("error:15") == 2
    assert cnc.physical() == [0, 0, 0]


@pytest.mark.parametrize("kind", _KINDS)
def test_jog_is_straight_and_can_be_cancelled_anywhere(kind: str) -> None:
    """A jog of 75 mm at 50 mm/s is cancelled after some ms.

    The reported position is that of the motors, on the line, and the next move ends at its target.
    """
    x, y = _MIDDLE[kind]
    for ms in range(20, 1500, 130):
        cnc = make_machine(kind, settings={12: 0.002}, PLANNER_BLOCKS=8)
        cancelled = []

        def script(cnc: Machine = cnc, ms: int = ms, cancelled: Any = cancelled) -> Iterator[Any]:
            """Jog, cancel (0x85) after some ms, note both positions, and move to the middle."""
            yield from cnc.start()
            yield from cnc.sender.wait("idle", f"G0X{x - 35}Y{y}\n", settle=1)
            cnc.rig.link.send(f"$J=X{x + 40}F3000\n".encode())
            yield cnc.rig.ms(ms)
            cnc.rig.link.send(b"\x85")
            yield from cnc.rest()
            cnc.take()
            cancelled.append((cnc.reported(), tool_position(kind, cnc.physical())))
            yield from cnc.sender.wait("idle", f"G1X{x}Y{y}F3000\n", settle=1)
            yield from cnc.rest()

        cnc.run(script())
        ((reported, position),) = cancelled
        assert reported == pytest.approx(position, abs=0.002)
        assert position[1] == pytest.approx(y, abs=0.01)
        # As far as the feed allows, and 6 mm to brake.
        assert x - 35 <= position[0] < x - 35 + 50 * ms / 1000 + 6
        assert math.dist(tool_position(kind, cnc.physical()), (x, y, 0)) < 0.01


@pytest.mark.thorough
@pytest.mark.parametrize("kind", _KINDS)
def test_hold_anywhere_keeps_the_path(kind: str) -> None:
    """A hold at different ms, ended 400 ms later, does not move the tool off its lines."""
    places = random_places(kind, seed=3, count=4)
    lines = [f"G1{axis_words(end)}F3000" for end in places[1:]]
    for ms in range(700, 2500, 480):
        cnc = machine_after(kind, lines, settings={12: 0.02}, events=[(ms, "!"), (ms + 400, "~")])
        error_mm = largest_deviation(
            cnc, kind, lambda at: min(from_line(at, a, b) for a, b in pairwise(places))
        )
        assert error_mm <= 0.02
        assert math.dist(tool_position(kind, cnc.physical()), places[-1]) < 0.01


@pytest.mark.parametrize("kind", _KINDS)
def test_position_is_right_after_a_reset_in_motion(kind: str) -> None:
    """A reset (0x18) at different ms: the report is that of the motors' steps."""
    x, y = _MIDDLE[kind]
    for ms in range(500, 1400, 170):
        cnc = machine_after(kind, [f"G1X{x}Y{y}F1500", f"G1X{x + 20}F1500"], events=[(ms, "\x18")])
        at = tool_position(kind, cnc.physical())
        assert cnc.reported() == pytest.approx(at, abs=0.002)


@pytest.mark.parametrize("kind", _KINDS)
def test_probe_reports_a_contact_in_the_middle_of_a_long_line(kind: str) -> None:
    """The probe closes where the tool is beyond x + 10.

    The report has the position of that step, and the tool stops within 3 mm.
    """
    x, y = _MIDDLE[kind]
    cnc = make_machine(kind, settings={12: 0.002}, PLANNER_BLOCKS=8)
    places = []

    def set_probe() -> None:
        at = tool_position(kind, cnc.physical())
        cnc.rig.port.push({"probe": at[0] > x + 10.0})
        places.append(at)

    # The engine calls trace() for each row of steps.
    call_trace: Any = cnc.rig.engine.trace

    def trace(start: int, row: "array[int]") -> None:
        call_trace(start, row)
        set_probe()

    cnc.rig.engine.trace = trace
    cnc.play([f"G0X{x - 30}Y{y}", f"G38.2X{x + 60}F600", f"G1X{x - 30}F1000"])
    (report,) = [line for line in cnc.received if line.startswith("[PRB:")]
    reported_mm = [float(n) for n in report[5:].split(":")[0].split(",")]
    assert report.endswith(":1]")
    contact = next(at for at in places if at[0] > x + 10.0)
    assert reported_mm == pytest.approx(contact, abs=0.001)
    assert reported_mm[0] == pytest.approx(x + 10, abs=0.3)
    assert reported_mm[1] == pytest.approx(y, abs=0.01)
    assert math.dist(tool_position(kind, cnc.physical()), (x - 30, y, 0)) < 0.01
    assert max(at[0] for at in places) < x + 13


@pytest.mark.parametrize("kind", _KINDS)
def test_touch_that_ends_during_a_hold_is_ignored_on_a_long_line(kind: str) -> None:
    """The probe closes and opens while the machine is held.

    G38.3 without contact then moves on to its target, and reports failure (:0).
    """
    x, y = _MIDDLE[kind]
    cnc = make_machine(kind, settings={12: 0.002}, PLANNER_BLOCKS=8)
    rig = cnc.rig

    def script() -> "Iterator[Any]":
        """Probe towards x + 30, hold, close and open the probe meanwhile, and resume."""
        yield from cnc.start()
        yield from cnc.sender.wait("idle", f"G0X{x - 30}Y{y}\n", settle=1)
        rig.link.send(f"G38.3X{x + 30}F1500\n".encode())
        yield rig.ms(600)  # in motion
        rig.link.send(b"!")
        yield rig.ms(400)  # held
        held_steps = cnc.physical()
        rig.port.push({"probe": True})
        yield rig.ms(50)  # several checks of the probe
        rig.port.push({"probe": False})
        rig.link.send(b"~")
        yield rig.ms(400)  # it moves on
        assert cnc.physical() != held_steps
        yield from cnc.rest()

    cnc.run(script())
    assert cnc.received[-1].startswith("<Idle"), cnc.received
    (report,) = [line for line in cnc.received if line.startswith("[PRB:")]
    assert report.endswith(":0]")
    assert math.dist(tool_position(kind, cnc.physical()), (x + 30, y, 0)) < 0.01


@pytest.mark.parametrize("kind", _KINDS)
def test_homing_moves_joints_to_their_switches_and_sets_the_tools_position(kind: str) -> None:
    """HOME in the example's module has the joints at their switches.

    After the pull-off from there, the tool's position is that of forward().
    """
    model = geometry(kind)
    cnc = make_machine(kind, settings={22: 1, 24: 600, 25: 3000, 26: 5})
    pull_off = {"scara": 5.0, "polar": 2.0}[kind]  # $27 of the example boards
    at_upper_end = [True, kind == "polar", True]  # of the range of each joint
    for i, letter in enumerate("xyz"):
        # A joint that starts at HOME begins 9 units away; its switch defines the place.
        distance = model.HOME[i] - model.START[i] or 9.0
        cnc.rig.engine.switches.append(
            Switch(f"limit_{letter}", i, at_upper_end[i], round(distance * _FINE))
        )
    cnc.play(["$H", "?"])
    joints_after = [
        home - pull_off if up else home + pull_off
        for home, up in zip(model.HOME, at_upper_end, strict=True)
    ]
    expected = array("d", (0.0, 0.0, 0.0))
    model.forward(joints_after, expected)
    assert cnc.reported() == pytest.approx(list(expected), abs=0.02)


@pytest.mark.parametrize("kind", _KINDS)
def test_soft_limits_apply_to_the_tools_position(kind: str) -> None:
    """$130 and $131 are the largest X and Y, here close to the tool.

    A line is refused at its end, an arc at its middle; a reset ends the alarm.
    """
    x, y = _MIDDLE[kind]
    settings = {20: 1, 22: 1, 130: x + 10, 131: 200}
    reset = [(6000, "\x18")]
    cnc = machine_after(
        kind, ["$X", f"G0X{x + 5}Y{y}", "G4P0.1", f"G0X{x + 11}"], settings, events=reset
    )
    assert "ALARM:2" in cnc.received
    assert math.dist(tool_position(kind, cnc.physical()), (x + 5, y, 0)) < 0.01
    arc_lines = [f"G0X{x + 5}Y{y}", f"G2X{x + 5}Y{y - 10}J-5F900"]
    cnc = machine_after(kind, ["$X", *arc_lines], settings={**settings, 130: x + 8}, events=reset)
    assert "ALARM:2" in cnc.received


def test_check_mode_refuses_the_same_lines_and_moves_nothing() -> None:
    cnc = machine_after("scara", ["$C", "G0X0Y120", "G0X0Y300", "G0X40", "$C"])
    answers = [x for x in cnc.received if x in ("ok", "error:33")]
    assert answers[:4] == ["ok", "ok", "error:33", "ok"]
    assert cnc.physical() == [0, 0, 0]


@pytest.mark.parametrize("kind", _KINDS)
def test_both_moves_of_g28_are_checked(kind: str) -> None:
    """G28 moves by way of the given place. Y400 is out of reach, and refuses the whole line."""
    x, y = _MIDDLE[kind]
    lines = [f"G0X{x}Y{y}", "G28.1", f"G0X{x + 20}", "G28X0Y400", f"G28Y{y - 10}"]
    cnc = machine_after(kind, lines)
    assert cnc.received.count("error:33") == 1
    assert math.dist(tool_position(kind, cnc.physical()), (x + 20, y, 0)) < 0.01


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
    """`ugrbl run` of a square with sides of 40 mm."""
    file = tmp_path / "square.nc"
    file.write_text("G1X40F3000\nY40\nX0\nY0\n")
    result = CliRunner().invoke(
        app, ["run", str(file), "--board", str(_EXAMPLES / "my_plotter.py")]
    )
    assert result.exit_code == 0, result.output
    # Four sides of 40 mm.
    assert "160" in result.output and "40.0" in result.output, result.output


@pytest.mark.parametrize("name", ["my_scara.py", "my_plotter.py"])
def test_examples_are_boards_that_can_be_built(name: str) -> None:
    assert list(board_check.problems(load(_EXAMPLES / name))) == []


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"COREXY": True}, "KINEMATICS and COREXY cannot be combined"),
        ({"JERK": True}, "KINEMATICS and JERK cannot be combined"),
        ({"STEP": (0, 1, 2, 3)}, "KINEMATICS: START has 3 numbers, but STEP has 4 pins"),
        ({"KINEMATICS": "random"}, "KINEMATICS: random.py has no inverse"),
    ],
)
def test_conflicting_options_are_refused_with_the_reason(
    options: "dict[str, Any]", said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        make_machine("scara", **options).play([])
