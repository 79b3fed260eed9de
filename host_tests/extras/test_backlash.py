"""Test backlash: motors compensate it, and no report shows it.

machine_after() plays lines on a new machine, with settings and with real-time bytes at some ms.
table_mm() is the position of a model of its table, Machine.physical() the steps of the motors and
Machine.reported() the last reported position in mm. The settings are $160 to $162. In a script,
Machine.take() stores the lines received, and Machine.rest() resumes a hold, waits for the end of
motion and asks for a report.
"""

import random
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from motion.layout import ROW_AXES, ROW_DIRS, ROW_STRIDE
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
_SLACK_STEPS = (25, 10, 40)  # steps
_TICK_HZ = 13_107_200  # of the simulated step engine
_SETTINGS = {
    1: 0,
    24: 300,
    25: 3000,
    26: 5,
    27: 1,
    **{160 + i: steps / _PER_MM for i, steps in enumerate(_SLACK_STEPS)},
    **{number + i: value for number, value in ((110, 6000), (120, 1000)) for i in range(3)},
}


def board(**options: Any) -> ModuleType:
    """Return the board sim_backlash with other options."""
    module = ModuleType("board")
    module.__dict__.update({**vars(load_board("sim_backlash")), **options})
    return module


def make_machine(settings: "dict[int, float] | None" = None, **options: Any) -> Machine:
    """Return that machine with a model of its table (see Table)."""
    machine = Machine({**_SETTINGS, **(settings or {})}, board(**options), watched=False)
    machine.table = Table(machine)  # type: ignore[attr-defined]
    return machine


def machine_with_much_slack() -> Machine:
    """Return a machine whose Z has 2 mm of slack and accelerates slowly."""
    machine = make_machine(settings={162: 2.0, 122: 50})
    machine.table.slack = (*_SLACK_STEPS[:2], 2 * _PER_MM)  # type: ignore[attr-defined]
    return machine


def moved_up(machine: Machine) -> Iterator[Any]:
    """Start the machine, and execute _UP; the next move of Z downwards begins with slack."""
    yield from machine.start()
    yield from machine.sender.wait("idle", f"{_UP}\n", settle=1)
    machine.take()  # empties the list of replies


class Table:
    """A table on a screw with backlash: it moves after its motor has taken up the slack.

    It starts at the lower end of its slack, as if pushed up. motors, at: position of the motors
    and of the table, in steps; places: the table's positions so far; slack: steps per axis.
    """

    def __init__(self, machine: Machine, slack: Sequence[int] = _SLACK_STEPS) -> None:
        """Follow the steps of this machine: the engine calls trace() for each row of steps."""
        self.slack = slack
        self.motors = [0, 0, 0]
        self.at = [0, 0, 0]
        self.places = [(0, 0, 0)]
        machine_trace: Any = machine.rig.engine.trace

        def trace(start: int, row: Any) -> None:
            """Move the table by each row of steps, which the machine also records."""
            machine_trace(start, row)
            self._move(row)

        machine.rig.engine.trace = trace

    def _move(self, row: Any) -> None:
        """Move motors and table by a row: number of steps of each axis, and a direction bit."""
        for i in range(3):
            count = row[ROW_AXES + ROW_STRIDE * i]
            self.motors[i] += -count if row[ROW_DIRS] >> i & 1 else count
            # Moved up, the table is at the position of the motor; moved down, it is above it
            # by the slack.
            low, high = self.motors[i], self.motors[i] + self.slack[i]
            self.at[i] = min(max(self.at[i], low), high)
        self.places.append((self.at[0], self.at[1], self.at[2]))


def table_mm(machine: Machine) -> "list[float]":
    """Return the table's position in mm."""
    return [n / _PER_MM for n in machine.table.at]  # type: ignore[attr-defined]


def machine_after(
    lines: Sequence[str],
    settings: "dict[int, float] | None" = None,
    events: "Sequence[tuple[int, str]]" = (),
    **options: Any,
) -> Machine:
    """Return a machine after these lines.

    settings: by $-number; events: (ms, real-time byte); options: of the board file.
    """
    machine = make_machine(settings, **options)
    machine.play(lines, events)
    return machine


# First all axes move up, so that their side of the slack, and the table's position, are known.
_UP = "G0X1Y1Z1"  # from 0, mm


def reported_positions(machine: Machine) -> "list[list[float]]":
    """Return MPos of each status report."""
    texts = [line.split("MPos:")[1].split("|")[0] for line in machine.received if "MPos:" in line]
    return [[float(n) for n in text.split(",")] for text in texts]


def test_table_reaches_the_target_from_either_side() -> None:
    """The table model is where the reports say, with the last direction up or down."""
    for end in ("X0.5", "X2", "X0.5Y0.2", "X0.5Y3Z-1", "X-3Y-3Z-3"):
        machine = machine_after([_UP, f"G1{end}F600"])
        assert table_mm(machine) == machine.reported(), end
        machine = machine_after([_UP, "G1X-2Y-2Z-2F600", "X-1Y-1Z-1", f"G1{end}F600"])
        assert table_mm(machine) == machine.reported(), end


def test_motors_differ_from_the_target_by_the_slack_of_the_last_direction() -> None:
    """60 random moves: the motors are at the commanded position, less the slack if moved down."""
    rng = random.Random(5)
    # directions: of the last move of each axis, 1 up, -1 down.
    lines, directions, position_mm = [_UP], [1, 1, 1], [1.0, 1.0, 1.0]
    for _ in range(60):
        word = "G1" if rng.random() < 0.8 else "G0"
        for i in range(3):
            if rng.random() < 0.6:
                target_mm = round(rng.uniform(-2, 2), 2)
                if target_mm != position_mm[i]:
                    directions[i] = 1 if target_mm > position_mm[i] else -1
                position_mm[i] = target_mm
                word += f"{'XYZ'[i]}{target_mm}"
        lines.append(word + "F3000")
    machine = machine_after(lines)
    commanded = [round(mm * _PER_MM) for mm in position_mm]
    slack_steps = [
        0 if sign > 0 else -slack for sign, slack in zip(directions, _SLACK_STEPS, strict=True)
    ]
    assert machine.physical() == [n + m for n, m in zip(commanded, slack_steps, strict=True)]
    assert table_mm(machine) == pytest.approx(position_mm, abs=0.003)
    assert machine.reported() == pytest.approx(table_mm(machine), abs=0.0005)


def test_zero_backlash_moves_step_for_step_like_a_machine_without_the_module() -> None:
    lines = [_UP, "G1X-2Y3F900", "G2X0Y0I3J-1", "G1Z-3", "$J=G91X3F900", "G0X0"]
    off = dict.fromkeys((160, 161, 162), 0.0)  # $160 to $162: backlash of X, Y, Z in mm
    rows = machine_after(lines, off).rows
    plain = Machine({k: v for k, v in _SETTINGS.items() if k not in off}, "sim", watched=False)
    plain.play(lines)
    assert [(start, list(row)) for start, row in rows] == [
        (start, list(row)) for start, row in plain.rows
    ]


def test_arc_stops_for_the_slack_where_an_axis_reverses() -> None:
    """Without stops for the slack, the table would leave the circle after each quadrant."""
    # Two full circles about X5 Y5 with a radius of 5 mm.
    machine = machine_after([_UP, "G1X10Y5F1500", "G2X10Y5I-5J0", "G3X10Y5I-5J0"])
    assert machine.reported() == [10, 5, 1]
    assert table_mm(machine) == [10, 5, 1]
    places = machine.table.places  # type: ignore[attr-defined]
    off_circle_mm = [
        abs(((x / _PER_MM - 5) ** 2 + (y / _PER_MM - 5) ** 2) ** 0.5 - 5) for x, y, _ in places
    ]
    # Not on the circle are the first move, whose X equals Y, and the line to X10 Y5, which is
    # within the first quarter of the places.
    later_mm = [mm for mm, (x, y, _) in zip(off_circle_mm, places, strict=True) if x != y]
    assert max(later_mm[len(later_mm) // 4 :]) < 0.02


def test_slack_is_taken_up_alone_within_rate_and_acceleration() -> None:
    """The first steps down move X through its 2 mm of slack, from standstill to standstill."""
    # Slack 2 mm, rate 900 mm/min (15 mm/s), acceleration 100 mm/s2.
    machine = machine_after([_UP, "G1X-5F3000"], settings={160: 2.0, 110: 900, 120: 100})
    steps = []  # of X: tick, direction
    for start, row in machine.rows:
        sign = -1 if row[ROW_DIRS] & 1 else 1
        steps += [(start + step_tick(row, ROW_AXES, k), sign) for k in range(row[ROW_AXES])]
    down_s = [tick / _TICK_HZ for tick, sign in steps if sign < 0]
    assert len(down_s) == round((6 + 2) * _PER_MM)  # 6 mm from X1 to X-5, 2 mm of slack
    slack_s = down_s[: 2 * _PER_MM]  # times of the steps within the slack
    # 100 steps from standstill take sqrt(2 * distance / acceleration).
    assert slack_s[100] - slack_s[0] == pytest.approx((2 * 100 / _PER_MM / 100) ** 0.5, rel=0.1)
    gaps_s = [b - a for a, b in pairwise(slack_s)]
    assert min(gaps_s) >= 1 / (15 * _PER_MM) * 0.98
    # It stops at the end of the slack: the last 0.4 mm take 0.089 s, as the first do.
    assert slack_s[-1] - slack_s[-100] > 0.08


@pytest.mark.parametrize("byte", ["!", "\x18", "?", "\x84"])
def test_position_stays_right_after_any_interruption_of_the_slack(byte: str) -> None:
    """Hold, reset, status query or door, at each time of a Z move that reverses.

    Z takes up 2 mm of slack first, slowly (50 mm/s2), so that many times are within the slack.
    """
    settings = {162: 2.0, 122: 50}
    for ms in range(0, 900, 37):
        machine = make_machine(settings)
        machine.table.slack = (*_SLACK_STEPS[:2], 2 * _PER_MM)  # type: ignore[attr-defined]

        def script(machine: Machine = machine, ms: int = ms) -> Iterator[Any]:
            """Send the byte `ms` after the start of the move; come to a stop, through a hold."""
            yield from moved_up(machine)
            machine.rig.link.send(b"G1Z-1F1500\n")
            yield machine.rig.ms(ms)
            machine.rig.link.send(byte.encode("latin-1"))
            yield machine.rig.ms(300)  # a hold has stopped the motors
            machine.rig.link.send(b"?")
            yield machine.rig.ms(20)  # the report arrives
            yield from machine.rest()  # resumes a hold

        machine.run(script())
        assert table_mm(machine) == pytest.approx(machine.reported(), abs=0.0005), ms
        for x, y, z in reported_positions(machine):  # none includes motor steps in the slack
            assert [x, y] in ([0, 0], [1, 1]) and -1 <= z <= 1, ms
        if byte != "\x18":  # all except a reset: the move was completed
            assert machine.reported() == [1, 1, -1], ms


@pytest.mark.thorough
def test_rest_of_the_slack_is_taken_up_after_a_reset_in_the_middle() -> None:
    """A reset within 2 mm of slack; then lines in both directions: table and report agree."""
    for ms in range(20, 900, 79):
        machine = machine_with_much_slack()

        def script(machine: Machine = machine, ms: int = ms) -> Iterator[Any]:
            """Reset `ms` after the start of the move; unlock, and move Z up and down."""
            yield from moved_up(machine)
            machine.rig.link.send(b"G1Z-1F1500\n")
            yield machine.rig.ms(ms)
            machine.rig.link.send(b"\x18")
            yield from machine.rest()
            machine.take()
            for line in ("$X", "G1Z-2F1500", "Z3", "Z-0.5", "Z2"):
                yield from machine.sender.wait("idle", line + "\n", settle=1)
                machine.take()
                yield from machine.rest()
                reported_mm = machine.reported()
                assert table_mm(machine) == pytest.approx(reported_mm, abs=0.0005), (ms, line)

        machine.run(script())


def test_jog_cancelled_in_the_slack_moves_the_table_no_further() -> None:
    """Jog cancel (0x85) at each time of a jog down, which begins with 2 mm of slack."""
    for ms in range(30, 800, 59):
        machine = machine_with_much_slack()

        def script(machine: Machine = machine, ms: int = ms) -> Iterator[Any]:
            """Cancel the jog `ms` after its start; then move to Z0."""
            yield from moved_up(machine)
            machine.rig.link.send(b"$J=G91Z-30F900\n")
            yield machine.rig.ms(ms)
            machine.rig.link.send(b"\x85")
            yield from machine.rest()
            assert table_mm(machine) == pytest.approx(machine.reported(), abs=0.0005), ms
            assert machine.reported()[2] > -12  # it was cancelled: 15 mm/s in < 0.8 s
            machine.take()
            yield from machine.sender.wait("idle", "G0Z0\n", settle=1)
            yield from machine.rest()
            assert table_mm(machine) == pytest.approx([1, 1, 0])

        machine.run(script())


def test_jog_that_reverses_in_the_packet_of_a_line_begins_after_the_line() -> None:
    """Received with the line, before its motion has begun, the jog is accepted."""
    machine = make_machine({1: 25})

    def script() -> Iterator[Any]:
        yield from moved_up(machine)
        machine.rig.link.send(b"G1X2F500\n$J=G91X-3F900\n")
        yield from machine.rest()
        assert machine.received[-3:-1] == ["ok", "ok"]
        assert table_mm(machine) == machine.reported() == [-1, 1, 1]

    machine.run(script())


@pytest.mark.parametrize("inverted", [0, 7])
def test_slack_after_homing_is_on_the_side_of_the_pull_off(inverted: int) -> None:
    """The table's distance from its report is the same after homing and after moves.

    inverted: $23, axes that home in negative direction.
    """
    machine = make_machine(settings={22: 1, 23: inverted})
    above = not inverted
    for i, letter in enumerate("xyz"):
        at = 700 if above else -700  # steps
        machine.rig.engine.switches.append(Switch(f"limit_{letter}", i, above, at))
    origins: list[list[float]] = []  # mm from the reported position to the table, after each line

    def script() -> Iterator[Any]:
        """Home and move in both directions; compare table and report after each line."""
        yield from machine.start()
        for line in ("$H", "G53G0X-3Y-3Z-3", "G53G0X-2Y-2Z-2", "G53G1X-4Y-4Z-4F900"):
            yield from machine.sender.wait("idle", line + "\n", settle=1)
            machine.take()
            yield from machine.rest()
            pairs = zip(table_mm(machine), machine.reported(), strict=True)
            origins.append([at - reported_mm for at, reported_mm in pairs])

    machine.run(script())
    assert machine.reported() == [-4, -4, -4]
    for origin in origins[1:]:
        assert origin == pytest.approx(origins[0], abs=0.0025)


def test_probe_reports_the_tables_position_and_stays_right_after_a_reversal() -> None:
    """The probe closes at Z-2 of the table. No later reversal changes the stored position."""
    machine = make_machine()

    def update_probe() -> None:
        machine.rig.port.push({"probe": machine.table.at[2] <= -2 * _PER_MM})  # type: ignore[attr-defined]

    machine_trace: Any = machine.rig.engine.trace  # called for each row of steps

    def trace(start: int, row: Any) -> None:
        machine_trace(start, row)
        update_probe()

    machine.rig.engine.trace = trace
    machine.play([_UP, "G38.2Z-10F100", "$#", "G1Z0F900", "$#", "G1Z-1", "$#"])
    reports = [line for line in machine.received if line.startswith("[PRB:")]
    assert len(set(reports)) == 1 and len(reports) == 4  # one of G38.2, three of $#
    z_mm = float(reports[0][5:].split(":")[0].split(",")[2])  # of [PRB:x,y,z:1]
    assert z_mm == pytest.approx(-2, abs=0.05)
    assert table_mm(machine) == pytest.approx([1, 1, -1])


def test_laser_is_dark_in_the_slack_and_a_spindle_stays_on() -> None:
    for laser, stays_on in ((1, False), (0, True)):
        # laser mode, largest S, backlash of X
        machine = make_machine(settings={32: laser, 30: 1000, 160: 0.4})
        powers: list[int] = []  # PWM at each row of steps within the slack
        machine_trace: Any = machine.rig.engine.trace

        def trace(
            start: int,
            row: Any,
            before: Any = machine_trace,
            powers: Any = powers,
            m: Any = machine,
        ) -> None:
            """Record the power of each row of steps within the slack."""
            before(start, row)
            # While the slack is taken up, the axes stand and only motors move.
            if m.rig.controller.planner.kinematics.standing:
                powers.append(m.rig.port.spindle_pwm)

        machine.rig.engine.trace = trace
        machine.play(["M3S800", _UP, "G1X2F900", "G1X-2F900"])
        # The first and last row may also have steps of the moves around the slack.
        assert powers and all(bool(power) == stays_on for power in powers[1:-1]), (laser, powers)


@pytest.mark.parametrize("after_ms", [10, 40, 80])
def test_laser_is_dark_after_a_hold_of_the_slack_before_a_rapid(after_ms: int) -> None:
    """M3 has lit it in G1. 2 mm of slack are taken up before G0; `~` then lights nothing."""
    machine = make_machine(settings={32: 1, 30: 1000, 160: 2.0})
    rig, port = machine.rig, machine.rig.port

    def script() -> Iterator[Any]:
        """Hold in the slack, resume, and look at the pin each 0.2 ms."""
        yield from machine.start()
        yield from machine.sender.wait("idle", "M3S800\nG1X3F3000\n")
        assert port.spindle_pwm
        rig.link.send(b"G0X0\n")
        yield rig.ms(after_ms)
        assert rig.controller.planner.kinematics.standing
        rig.link.send(b"!")
        yield rig.ms(300)
        rig.link.send(b"~")
        for _ in range(2500):
            yield rig.ms(0.2)
            assert port.spindle_pwm == 0
        yield from machine.rest()
        assert machine.reported()[0] == 0

    machine.run(script())


def test_second_motors_take_up_the_slack() -> None:
    machine = Machine({**_SETTINGS}, board(STEP=(0, 1, 2, 3), MOTORS="XYZY"), watched=False)
    machine.play(["G0X1Y1Z1", "G1Y0F900"])
    assert machine.physical() == [250, -10, 250, -10]
    assert machine.reported() == [1, 0, 1]


def test_soft_limits_and_check_mode_act_before_the_slack() -> None:
    """A refused or only checked line moves no motor, also not through the slack."""
    # Soft limits, homing, 50 mm of travel: X is allowed from -50 to 0. The reset after 4 s ends
    # the alarm, which answers no more lines.
    machine = machine_after(
        ["$X", "G0X-1", "G4P0.1", "G0X0.5"], {20: 1, 22: 1, 130: 50}, [(4000, "\x18")]
    )
    assert "ALARM:2" in machine.received
    assert machine.physical()[0] == -250  # still at X-1: a first move takes up no slack
    machine = machine_after([_UP, "G4P0.5", "$C", "G1X0F900", "$C"])
    assert machine.physical() == [250, 250, 250]


def test_settings_are_listed_and_bounded() -> None:
    machine = machine_after(["$161=0.05", "$160=6", "$$", "$I"])
    assert "error:3" in machine.received
    assert "$161=0.050" in machine.received and "$160=0.100" in machine.received


@pytest.mark.parametrize("word", ["COREXY", "JERK", "PARKING", "CLUSTERS", "POWER_FAIL_UP_MM"])
def test_conflicting_option_is_refused_with_the_reason(word: str) -> None:
    with pytest.raises(ValueError, match=f"BACKLASH and {word} cannot be combined"):
        make_machine(**{word: True}).play([])


def test_run_reports_axes_and_counts_motor_steps(tmp_path: Path) -> None:
    file = tmp_path / "back.nc"
    file.write_text("G0X1\nG1X-2F900\nX0\n")
    words = ["run", str(file), "--board", "sim_backlash", "--set", "160=0.1"]
    result = CliRunner().invoke(app, words)  # ugrbl run; $160 is 0.1 mm of backlash of X
    assert result.exit_code == 0, result.output
    # Steps: (1 + 3 + 2) mm * 250, and 25 of slack at each of two reversals. Reports have no slack.
    assert "1550 commanded = 1550 made" in result.output
    assert "-2.000 to 1.000 mm" in result.output and "6.0 mm" in result.output


def test_board_without_backlash_has_none_of_the_modules() -> None:
    modules = build.modules_of(load_board("rpi_pico"))
    assert not {"extras.motors.backlash", "motion.kinematics"} & set(modules)
    module = ModuleType("board")
    vars(module).update({**vars(load_board("rpi_pico")), "BACKLASH": True})
    assert list(board_check.problems(module)) == []
    assert {"extras.motors.backlash", "motion.kinematics"} <= set(build.modules_of(module))
