"""Test backlash: motors compensate it, and no report shows it."""

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

_PER_MM = 250
_SLACK = (25, 10, 40)  # steps
_TICK_HZ = 13_107_200
_SETTINGS = {
    1: 0,
    24: 300,
    25: 3000,
    26: 5,
    27: 1,
    **{160 + i: steps / _PER_MM for i, steps in enumerate(_SLACK)},
    **{number + i: value for number, value in ((110, 6000), (120, 1000)) for i in range(3)},
}


def board(**options: Any) -> ModuleType:
    """Return the board sim_backlash with other options."""
    made = ModuleType("board")
    made.__dict__.update({**vars(load_board("sim_backlash")), **options})
    return made


def machine(settings: "dict[int, float] | None" = None, **options: Any) -> Machine:
    """Return that machine with a model of its table (see Table)."""
    made = Machine({**_SETTINGS, **(settings or {})}, board(**options), watched=False)
    made.table = Table(made)  # type: ignore[attr-defined]
    return made


class Table:
    """A table on a screw with backlash: it moves after its motor has taken up the slack.

    It starts at the lower end of its slack, as if pushed up. at: steps.
    """

    def __init__(self, made: Machine, slack: Sequence[int] = _SLACK) -> None:
        self.slack = slack
        self.motors = [0, 0, 0]
        self.at = [0, 0, 0]
        self.places = [(0, 0, 0)]
        usual: Any = made.rig.engine.trace

        def trace(start: int, row: Any) -> None:
            usual(start, row)
            self._move(row)

        made.rig.engine.trace = trace

    def _move(self, row: Any) -> None:
        for i in range(3):
            count = row[ROW_AXES + ROW_STRIDE * i]
            self.motors[i] += -count if row[ROW_DIRS] >> i & 1 else count
            # Moved up, the table is at the position of the motor; moved down, it is above it
            # by the slack.
            low, high = self.motors[i], self.motors[i] + self.slack[i]
            self.at[i] = min(max(self.at[i], low), high)
        self.places.append((self.at[0], self.at[1], self.at[2]))


def table(made: Machine) -> "list[float]":
    """Return the table's position in mm."""
    return [n / _PER_MM for n in made.table.at]  # type: ignore[attr-defined]


def played(
    lines: Sequence[str],
    settings: "dict[int, float] | None" = None,
    events: "Sequence[tuple[int, str]]" = (),
    **options: Any,
) -> Machine:
    """Return a machine after these lines."""
    made = machine(settings, **options)
    made.play(lines, events)
    return made


# First all axes move up, so that their side of the slack, and the table's position, are known.
_UP = "G0X1Y1Z1"


def reported(made: Machine) -> "list[list[float]]":
    """Return MPos of each status report."""
    found = [line.split("MPos:")[1].split("|")[0] for line in made.received if "MPos:" in line]
    return [[float(n) for n in text.split(",")] for text in found]


def test_table_reaches_the_target_from_either_side() -> None:
    for end in ("X0.5", "X2", "X0.5Y0.2", "X0.5Y3Z-1", "X-3Y-3Z-3"):
        made = played([_UP, f"G1{end}F600"])
        assert table(made) == made.reported(), end
        made = played([_UP, "G1X-2Y-2Z-2F600", "X-1Y-1Z-1", f"G1{end}F600"])
        assert table(made) == made.reported(), end


def test_motors_differ_from_the_target_by_the_slack_of_the_last_direction() -> None:
    rng = random.Random(5)
    lines, last, at = [_UP], [1, 1, 1], [1.0, 1.0, 1.0]
    for _ in range(60):
        word = "G1" if rng.random() < 0.8 else "G0"
        for i in range(3):
            if rng.random() < 0.6:
                to = round(rng.uniform(-2, 2), 2)
                if to != at[i]:
                    last[i] = 1 if to > at[i] else -1
                at[i] = to
                word += f"{'XYZ'[i]}{to}"
        lines.append(word + "F3000")
    made = played(lines)
    commanded = [round(mm * _PER_MM) for mm in at]
    taken = [0 if way > 0 else -slack for way, slack in zip(last, _SLACK, strict=True)]
    assert made.physical() == [n + more for n, more in zip(commanded, taken, strict=True)]
    assert table(made) == pytest.approx(at, abs=0.003)
    assert made.reported() == pytest.approx(table(made), abs=0.0005)


def test_zero_backlash_moves_step_for_step_like_a_machine_without_the_module() -> None:
    lines = [_UP, "G1X-2Y3F900", "G2X0Y0I3J-1", "G1Z-3", "$J=G91X3F900", "G0X0"]
    off = dict.fromkeys((160, 161, 162), 0.0)
    with_it = played(lines, off).rows
    plain = Machine({k: v for k, v in _SETTINGS.items() if k not in off}, "sim", watched=False)
    plain.play(lines)
    assert [(start, list(row)) for start, row in with_it] == [
        (start, list(row)) for start, row in plain.rows
    ]


def test_arc_stops_for_the_slack_where_an_axis_reverses() -> None:
    made = played([_UP, "G1X10Y5F1500", "G2X10Y5I-5J0", "G3X10Y5I-5J0"])
    assert made.reported() == [10, 5, 1]
    assert table(made) == [10, 5, 1]
    on_arc = [place for place in made.table.places if place[1] != _PER_MM]  # type: ignore[attr-defined]
    away = [
        abs(((x / _PER_MM - 5) ** 2 + (y / _PER_MM - 5) ** 2) ** 0.5 - 5) for x, y, _ in on_arc
    ]
    inside = [n for n, (x, y, _) in zip(away, on_arc, strict=True) if x != y]
    assert max(inside[len(inside) // 4 :]) < 0.02


def test_slack_is_taken_up_alone_within_rate_and_acceleration() -> None:
    made = played([_UP, "G1X-5F3000"], {160: 2.0, 110: 900, 120: 100})
    steps = []
    for start, row in made.rows:
        way = -1 if row[ROW_DIRS] & 1 else 1
        steps += [(start + step_tick(row, ROW_AXES, k), way) for k in range(row[ROW_AXES])]
    back = [tick / _TICK_HZ for tick, way in steps if way < 0]
    assert len(back) == round((6 + 2) * _PER_MM)
    slack = back[: 2 * _PER_MM]
    assert (slack[100] - slack[0]) == pytest.approx((2 * 100 / _PER_MM / 100) ** 0.5, rel=0.1)
    gaps = [b - a for a, b in pairwise(slack)]
    assert min(gaps) >= 1 / (15 * _PER_MM) * 0.98
    assert slack[-1] - slack[-100] > 0.08  # it stops at the end of the slack


@pytest.mark.parametrize("byte", ["!", "\x18", "?", "\x84"])
def test_position_stays_right_after_any_interruption_of_the_slack(byte: str) -> None:
    settings = {162: 2.0, 122: 50}
    for ms in range(0, 900, 37):
        made = machine(settings)
        made.table.slack = (*_SLACK[:2], 2 * _PER_MM)  # type: ignore[attr-defined]

        def script(made: Machine = made, ms: int = ms) -> Iterator[Any]:
            yield from made.start()
            yield from made.sender.wait("idle", f"{_UP}\n", 1)
            made.take()
            made.rig.link.send(b"G1Z-1F1500\n")
            yield made.rig.ms(ms)
            made.rig.link.send(byte.encode("latin-1"))
            yield made.rig.ms(300)
            made.rig.link.send(b"?")
            yield made.rig.ms(20)
            yield from made.rest()

        made.run(script())
        assert table(made) == pytest.approx(made.reported(), abs=0.0005), ms
        for places in reported(made):
            assert places[:2] in ([0, 0], [1, 1]) or places[2] <= 1, ms
            assert -1 <= places[2] <= 1, ms
        if byte != "\x18":
            assert made.reported() == [1, 1, -1], ms


@pytest.mark.thorough
def test_rest_of_the_slack_is_taken_up_after_a_reset_in_the_middle() -> None:
    for ms in range(20, 900, 79):
        made = machine({162: 2.0, 122: 50})
        made.table.slack = (*_SLACK[:2], 2 * _PER_MM)  # type: ignore[attr-defined]

        def script(made: Machine = made, ms: int = ms) -> Iterator[Any]:
            yield from made.start()
            yield from made.sender.wait("idle", f"{_UP}\n", 1)
            made.take()
            made.rig.link.send(b"G1Z-1F1500\n")
            yield made.rig.ms(ms)
            made.rig.link.send(b"\x18")
            yield from made.rest()
            made.take()
            for line in ("$X", "G1Z-2F1500", "Z3", "Z-0.5", "Z2"):
                yield from made.sender.wait("idle", line + "\n", 1)
                made.take()
                yield from made.rest()
                assert table(made) == pytest.approx(made.reported(), abs=0.0005), (ms, line)

        made.run(script())


def test_jog_cancelled_in_the_slack_moves_the_table_no_further() -> None:
    for ms in range(30, 800, 59):
        made = machine({162: 2.0, 122: 50})
        made.table.slack = (*_SLACK[:2], 2 * _PER_MM)  # type: ignore[attr-defined]

        def script(made: Machine = made, ms: int = ms) -> Iterator[Any]:
            yield from made.start()
            yield from made.sender.wait("idle", f"{_UP}\n", 1)
            made.take()
            made.rig.link.send(b"$J=G91Z-30F900\n")
            yield made.rig.ms(ms)
            made.rig.link.send(b"\x85")
            yield from made.rest()
            assert table(made) == pytest.approx(made.reported(), abs=0.0005), ms
            assert made.reported()[2] > -12
            made.take()
            yield from made.sender.wait("idle", "G0Z0\n", 1)
            yield from made.rest()
            assert table(made) == pytest.approx([1, 1, 0])

        made.run(script())


@pytest.mark.parametrize("inverted", [0, 7])
def test_slack_after_homing_is_on_the_side_of_the_pull_off(inverted: int) -> None:
    made = machine({22: 1, 23: inverted})
    above = not inverted
    for i, letter in enumerate("xyz"):
        at = 700 if above else -700
        made.rig.engine.switches.append(Switch(f"limit_{letter}", i, above, at))
    origins: list[list[float]] = []

    def script() -> Iterator[Any]:
        yield from made.start()
        for line in ("$H", "G53G0X-3Y-3Z-3", "G53G0X-2Y-2Z-2", "G53G1X-4Y-4Z-4F900"):
            yield from made.sender.wait("idle", line + "\n", 1)
            made.take()
            yield from made.rest()
            pairs = zip(table(made), made.reported(), strict=True)
            origins.append([here - there for here, there in pairs])

    made.run(script())
    assert made.reported() == [-4, -4, -4]
    for origin in origins[1:]:
        assert origin == pytest.approx(origins[0], abs=0.0025)


def test_probe_reports_the_tables_position_and_stays_right_after_a_reversal() -> None:
    made = machine()

    def look() -> None:
        made.rig.port.push({"probe": made.table.at[2] <= -2 * _PER_MM})  # type: ignore[attr-defined]

    usual: Any = made.rig.engine.trace

    def trace(start: int, row: Any) -> None:
        usual(start, row)
        look()

    made.rig.engine.trace = trace
    made.play([_UP, "G38.2Z-10F100", "$#", "G1Z0F900", "$#", "G1Z-1", "$#"])
    told = [line for line in made.received if line.startswith("[PRB:")]
    assert len(set(told)) == 1 and len(told) == 4
    assert float(told[0][5:].split(":")[0].split(",")[2]) == pytest.approx(-2, abs=0.05)
    assert table(made) == pytest.approx([1, 1, -1])


def test_laser_is_dark_in_the_slack_and_a_spindle_stays_on() -> None:
    for laser, kept in ((1, False), (0, True)):
        made = machine({32: laser, 30: 1000, 160: 0.4})
        powers: list[int] = []
        usual: Any = made.rig.engine.trace

        def trace(
            start: int, row: Any, usual: Any = usual, powers: Any = powers, m: Any = made
        ) -> None:
            usual(start, row)
            if m.rig.controller.planner.kinematics.standing:
                powers.append(m.rig.port.spindle_pwm)

        made.rig.engine.trace = trace
        made.play(["M3S800", _UP, "G1X2F900", "G1X-2F900"])
        assert powers and all(bool(power) == kept for power in powers[1:-1]), (laser, powers)


def test_second_motors_take_up_the_slack() -> None:
    made = Machine({**_SETTINGS}, board(STEP=(0, 1, 2, 3), MOTORS="XYZY"), watched=False)
    made.play(["G0X1Y1Z1", "G1Y0F900"])
    assert made.physical() == [250, -10, 250, -10]
    assert made.reported() == [1, 0, 1]


def test_soft_limits_and_check_mode_act_before_the_slack() -> None:
    made = played(["$X", "G0X-1", "G4P0.1", "G0X0.5"], {20: 1, 22: 1, 130: 50}, [(4000, "\x18")])
    assert "ALARM:2" in made.received
    assert made.physical()[0] == -250
    made = played([_UP, "G4P0.5", "$C", "G1X0F900", "$C"])
    assert made.physical() == [250, 250, 250]


def test_settings_are_listed_and_bounded() -> None:
    made = played(["$161=0.05", "$160=6", "$$", "$I"])
    assert "error:3" in made.received
    assert "$161=0.050" in made.received and "$160=0.100" in made.received


@pytest.mark.parametrize("word", ["COREXY", "JERK", "PARKING", "CLUSTERS"])
def test_conflicting_option_is_refused_with_the_reason(word: str) -> None:
    with pytest.raises(ValueError, match=f"BACKLASH and {word} are not for the same machine"):
        machine(**{word: True}).play([])


def test_run_reports_axes_and_counts_motor_steps(tmp_path: Path) -> None:
    file = tmp_path / "back.nc"
    file.write_text("G0X1\nG1X-2F900\nX0\n")
    asked = ["run", str(file), "--board", "sim_backlash", "--set", "160=0.1"]
    said = CliRunner().invoke(app, asked)
    assert said.exit_code == 0, said.output
    assert "1550 commanded = 1550 made" in said.output
    assert "-2.000 to 1.000 mm" in said.output and "6.0 mm" in said.output


def test_board_without_backlash_has_none_of_the_modules() -> None:
    modules = build.modules_of(load_board("rpi_pico"))
    assert not {"extras.motors.backlash", "motion.kinematics"} & set(modules)
    made = ModuleType("board")
    vars(made).update({**vars(load_board("rpi_pico")), "BACKLASH": True})
    assert list(board_check.problems(made)) == []
    assert {"extras.motors.backlash", "motion.kinematics"} <= set(build.modules_of(made))
