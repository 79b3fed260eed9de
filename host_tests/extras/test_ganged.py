"""Test two motors on an axis: homing, squaring, and motion of all motors afterwards.

Gantry.output_after() plays lines, with real-time bytes at some ms, and returns the output;
physical() are the steps of the motors X, Y, Z and of Y's second motor, reported() the last
reported position.
"""

import json
import os
import random
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from extras.motors import ganged
from motion.kinematics import COREXY, Kinematics
from rig_bench import Machine
from typer.testing import CliRunner
from ugrbl.boardfile import board_check
from ugrbl.boardfile.files import load, load_board
from ugrbl.cli.app import app
from ugrbl.compiling import build
from ugrbl.paths import BOARDS
from ugrbl.run import inputs
from ugrbl.sim.engine import Switch

# Many cases: the first ring runs a sample of them.
pytestmark = pytest.mark.sampled(2)

_STEPS_PER_MM = 250  # of the board sim
_PULL_OFF_MM = 1
_SWITCH_STEPS = 800  # steps from power-up to the switches, which are at the upper ends
_DEAD = 1 << 28  # steps: a switch that is never reached
_GANTRIES = int(os.environ.get("UGRBL_TORTURE", "40"))
SETTINGS = {
    1: 255,
    22: 1,
    24: 100,
    25: 3000,
    26: 5,
    27: _PULL_OFF_MM,
    110: 3000,
    111: 3000,
    112: 3000,
    120: 400,
    121: 400,
    122: 400,
}
_RESET = "\x18"


def board(**options: Any) -> ModuleType:
    """Return the board sim_ganged with other options."""
    module = ModuleType("board")
    module.__dict__.update({**vars(load_board("sim_ganged")), **options})
    return module


class Gantry(Machine):
    """A machine whose second Y motor is `racked` steps further from its switch than the first.

    switches: where those of the motors close; one may be dead.
    """

    def __init__(
        self,
        racked: int = 0,
        settings: "dict[int, float] | None" = None,
        switches: "dict[str, int] | None" = None,
        **options: Any,
    ) -> None:
        """racked: steps; settings: by $-number; switches: steps at which they close, by name;
        options: of the board file."""
        super().__init__({**SETTINGS, **(settings or {})}, board(**options), watched=False)
        self.at = {
            "limit_x": _SWITCH_STEPS,
            "limit_y": _SWITCH_STEPS,
            "limit_z": _SWITCH_STEPS,
            "limit_y2": _SWITCH_STEPS + racked,
        }
        self.at.update(switches or {})
        for motor, (pin, at) in enumerate(self.at.items()):
            if pin in self.rig.port.limit_names:
                self.rig.engine.switches.append(Switch(pin, motor, True, at))
        self.rig.port.update()  # reads the switches

    def output_after(self, *lines: str, at_ms: "tuple[tuple[int, str], ...]" = ()) -> "list[str]":
        """Play lines from power-up; return the whole output."""
        self.play(lines, at_ms)
        return self.received


def assert_all_motors_move(gantry: Gantry) -> None:
    """Check that after a reset every motor of an axis makes every commanded step."""
    before = gantry.physical()
    gantry.received.clear()
    gantry.play([_RESET, "$X", "G91", "G1 X-1 Y-2 Z-3 F3000"])
    moved_steps = [at - was for at, was in zip(gantry.physical(), before, strict=True)]
    # 250 steps/mm; the motors are X, Y, Z and the second of Y.
    assert moved_steps == [-250, -500, -750, -500], gantry.received


# Homing


def test_each_motor_stops_at_its_own_switch() -> None:
    """Y's second motor starts 300 steps (1.2 mm) further from its switch than the first."""
    gantry = Gantry(racked=300)
    output = gantry.output_after("$H")
    assert "ok" in output and not any("ALARM" in line for line in output)
    _, y, _, y2 = gantry.physical()
    assert abs(y - (_SWITCH_STEPS - _PULL_OFF_MM * _STEPS_PER_MM)) <= 1
    assert abs(y2 - y - 300) <= 1
    assert gantry.reported() == [-1.0, -1.0, -1.0]


@pytest.mark.thorough
def test_gantry_is_square_within_a_step_for_any_offset() -> None:
    """Home gantries with random rack, offset ($171), seek rate ($25) and direction ($23).

    $171 is how much further from its switch the second motor ends than the first, in mm.
    UGRBL_TORTURE=1000 tries 1000 gantries.
    """
    rng = random.Random(19)
    for _ in range(_GANTRIES):
        racked, offset = rng.randint(-600, 600), round(rng.uniform(-3, 3), 3)
        seek = rng.choice((600, 1500, 3000))
        negative = rng.random() < 0.5
        gantry = Gantry(racked, settings={25: seek, 171: offset, 23: 2 if negative else 0})
        if negative:  # the switch of Y is at the other end
            for switch in gantry.rig.engine.switches:
                if switch.axis in (1, 3):
                    switch.above, switch.steps = False, -switch.steps
        output = gantry.output_after("$H")
        case = f"racked {racked}, $171={offset}, $25={seek}, $23={negative}: {output}"
        assert not any("ALARM" in line for line in output), case
        _, y, _, y2 = gantry.physical()
        further_steps = racked - round(offset * _STEPS_PER_MM)  # of the second motor
        assert abs(y2 - y - (-further_steps if negative else further_steps)) <= 1, case


@pytest.mark.parametrize("offset", [0.5, -0.5])
def test_offset_moves_the_motor_that_must_be_further_away(offset: float) -> None:
    """With $171=0.5 the second motor ends 0.5 mm further from its switch, with -0.5 the first.

    Both motors are then moved to Y-4.
    """
    gantry = Gantry(settings={171: offset})
    gantry.output_after("$H", "G90 G53 G0 Y-4")
    _, y, _, y2 = gantry.physical()
    assert abs(y - y2 - offset * _STEPS_PER_MM) <= 1
    target_steps = _SWITCH_STEPS - 4 * _STEPS_PER_MM  # of the motor nearer to its switch
    assert abs(max(y, y2) - target_steps) <= 1


def test_one_axis_homed_alone_is_squared() -> None:
    gantry = Gantry(racked=200, SINGLE_AXIS_HOMING=True)
    gantry.output_after("$HY")
    x, y, _, y2 = gantry.physical()
    assert x == 0 and abs(y2 - y - 200) <= 1


def test_both_motors_home_as_one_without_a_second_switch() -> None:
    """Y homes by its one switch; the pull-off is 1 mm."""
    gantry = Gantry(LIMIT=(0, 1, 2, None))
    output = gantry.output_after("$H", "$$")
    _, y, _, y2 = gantry.physical()
    assert y == y2 and abs(y - (_SWITCH_STEPS - _STEPS_PER_MM)) <= 1
    # Settings of the second motor: its direction, but none of squaring.
    assert "$8=0" in output and not any(line.startswith(("$17", "$347=")) for line in output)


# Failures


@pytest.mark.parametrize(
    ("switches", "alarm"),
    [
        ({"limit_y2": _DEAD}, "ALARM:10"),
        ({"limit_y": _DEAD}, "ALARM:10"),
        ({"limit_y": _DEAD, "limit_y2": _DEAD}, "ALARM:9"),
        ({"limit_y2": _SWITCH_STEPS + 11 * _STEPS_PER_MM}, "ALARM:10"),  # 10 mm are 5 % of 200
    ],
    ids=["second dead", "first dead", "both dead", "racked too far"],
)
def test_missing_switch_is_an_alarm(switches: "dict[str, int]", alarm: str) -> None:
    """One motor may search alone for 10 mm: 5 % ($347) of X's travel ($130), not of Y's ($131).

    Alarm 10: only one motor has found its switch; alarm 9: none.
    """
    gantry = Gantry(settings={130: 200, 131: 20}, switches=switches)
    output = gantry.output_after("$H")
    assert [line for line in output if line.startswith("ALARM")] == [alarm]
    _, y, _, y2 = gantry.physical()
    if alarm == "ALARM:10":
        assert 2450 <= abs(y - y2) <= 2600, "10 mm, and what passes until it is seen"
    assert_all_motors_move(gantry)


def test_repeated_homing_racks_no_further() -> None:
    """Y's second switch never closes. The racking limit of 10 mm holds for all homings together,
    until the gantry is straightened by hand and the board restarts."""
    gantry = Gantry(switches={"limit_y2": _DEAD})

    def script() -> Any:
        """Home four times, each with an alarm, and move Y back in between."""
        yield from gantry.start()
        for _ in range(4):
            gantry.rig.link.send(b"$H\n")
            yield gantry.rig.ms(12_000)  # the alarm has come
            gantry.rig.link.send(b"$X\nG91 G1 Y-6 F3000\n")
            yield gantry.rig.ms(3_000)  # until it has moved
        gantry.take()

    gantry.run(script())
    _, y, _, y2 = gantry.physical()
    assert gantry.received.count("ALARM:10") == 4
    assert 2500 < abs(y - y2) <= 2600, "10 mm"


@pytest.mark.parametrize("offset", [6, -6])
def test_offset_beyond_the_racking_limit_homes_repeatedly(offset: float) -> None:
    """$171 is 6 mm, and the racking limit 5 mm (5 % of 100): a wanted offset is not racking."""
    gantry = Gantry(settings={171: offset, 130: 100})
    output = gantry.output_after("$H", "G91 G1 Y-2 F3000", "$H", "G1 Y-2", "$H")
    assert not any("ALARM" in line for line in output)
    _, y, _, y2 = gantry.physical()
    assert abs(y - y2 - offset * _STEPS_PER_MM) <= 1


@pytest.mark.parametrize("ms", range(1150, 1700, 50))
def test_false_switch_signal_leaves_no_rack(ms: int) -> None:
    """Y's second switch closes for 2 ms during homing: an alarm, or both motors end equally."""
    gantry = Gantry()

    def script() -> Any:
        """Home, and close Y's second switch for 2 ms at the time `ms`."""
        yield from gantry.start()
        gantry.rig.link.send(b"$H\n")
        yield gantry.rig.ms(ms)  # the tested times are within the homing of Y
        gantry.rig.port.push({"limit_y2": True})
        yield gantry.rig.ms(2)
        gantry.rig.port.push({"limit_y2": False})
        yield gantry.rig.ms(6000)  # homing has ended
        gantry.take()

    gantry.run(script())
    _, y, _, y2 = gantry.physical()
    assert "ALARM:9" in gantry.received or abs(y - y2) <= 1, gantry.received


@pytest.mark.parametrize(
    ("settings", "mm"),
    [({130: 10}, 2.5), ({130: 1000}, 25), ({130: 200, 347: 1.5}, 3), ({130: 10, 348: 1}, 1)],
)
def test_racking_limit_is_a_setting(settings: "dict[int, float]", mm: float) -> None:
    """Y's second motor searches alone for so many mm.

    It is $347 percent (5) of the travel of X ($130), not of Y ($131); at least $348 (2.5 mm), at
    most $349 (25 mm).
    """
    gantry = Gantry(settings={131: 60, **settings}, switches={"limit_y2": _DEAD})
    gantry.output_after("$H")
    _, y, _, y2 = gantry.physical()
    assert mm * _STEPS_PER_MM < y2 - y < (mm + 0.5) * _STEPS_PER_MM


@pytest.mark.parametrize("ms", range(60, 3200, 170))
@pytest.mark.parametrize("stop", [_RESET, "door"])
def test_all_motors_move_after_a_stop_at_any_time(ms: int, stop: str) -> None:
    """A reset or an open door so many ms after $H, at which a motor of Y may be moved alone."""
    door = stop == "door"
    gantry = Gantry(racked=400, settings={171: 0.7}, SAFETY_DOOR=door)
    gantry.output_after("$H", at_ms=((ms, "\x84" if door else _RESET),))
    assert_all_motors_move(gantry)


def test_closed_switch_at_the_start_is_refused_with_the_reason() -> None:
    """Y's second switch closes above -5 steps: it is closed at 0, where the gantry starts."""
    gantry = Gantry(switches={"limit_y2": -5})
    output = gantry.output_after("$H", at_ms=((1000, _RESET),))
    index = output.index("[MSG:Y: move off the closed limit switch first]")
    # As Grbl with two switches on one input.
    assert output[index + 1 : index + 3] == ["ok", "ALARM:1"]
    assert gantry.physical() == [0, 0, 0, 0]


def test_either_switch_is_reported_and_stops_the_machine() -> None:
    """Hard limits ($21): here the second switch, at 800 steps, closes long before the first."""
    gantry = Gantry(settings={22: 0, 21: 1}, switches={"limit_y": 2000})
    output = gantry.output_after("G91 G1 Y8 F3000", at_ms=((2000, _RESET),))
    assert "ALARM:1" in output
    assert [line for line in output if "|Pn:Y|" in line]
    assert gantry.physical()[3] < _SWITCH_STEPS + 100


def test_switches_may_be_normally_closed() -> None:
    """$5: a motor without an input must not count as open."""
    gantry = Gantry(settings={5: 1, 22: 0}, LIMIT=(0, 1, 2, None))
    gantry.rig.port.push(dict.fromkeys(gantry.rig.port.limit_names[:3], True))
    assert not [line for line in gantry.output_after("") if "Pn:" in line]


# Settings


def test_second_motor_turns_as_the_settings_say() -> None:
    """$3 inverts Y's direction, $8 that of its second motor relative to it.

    pins: mask of inverted direction pins; the motors of Y are bits 1 and 3.
    """
    for inverted, ganged_inverted, pins in ((0, 0, 0), (2, 0, 0b1010), (2, 2, 0b0010)):
        gantry = Gantry(settings={3: inverted, 8: ganged_inverted, 22: 0})
        gantry.output_after("G91 G1 Y1 F3000")
        assert gantry.rig.engine.dir_invert == pins
        signs = [-1 if pins >> motor & 1 else 1 for motor in (1, 3)]
        assert [gantry.physical()[motor] for motor in (1, 3)] == [250 * sign for sign in signs]


def test_direction_of_a_second_motor_never_changes_alone() -> None:
    """Not even for a moment: that would be a step of the second motor alone.

    $2 and $3 invert step and direction pins of Y, $8 the direction of its second motor.
    """
    gantry = Gantry(settings={2: 2, 3: 2, 8: 2, 22: 0})
    configured: "list[tuple[int, int]]" = []  # masks of inverted step and direction pins
    configure = gantry.rig.engine.configure

    def note(pulse_us: int, step_invert: int, dir_invert: int) -> None:
        configured.append((step_invert, dir_invert))
        configure(pulse_us, step_invert, dir_invert)

    gantry.rig.engine.configure = note  # type: ignore[method-assign]
    output = gantry.output_after("$10=3", "$2=255", "$3=0", "$2=0", "$$")
    # At power-up and for each changed setting; Y's motors are bits 1 and 3.
    assert configured == [
        *((0b1010, 0b0010), (0b1010, 0b0010)),
        *((0b1111, 0b0010), (0b1111, 0b1000), (0, 0b1000)),
    ]
    assert "$2=0" in output and "$3=0" in output and "$8=2" in output


@pytest.mark.parametrize("kept", ["-11", "500", "-nan", "x"])
def test_impossible_stored_offset_resets_all_settings(kept: str) -> None:
    gantry = Gantry()
    gantry.rig.store.files["settings"].append(f"$171={kept}")
    output = gantry.output_after("$$")
    assert "error:7" in output and "$171=0.000" in output


def test_offset_may_be_negative_and_is_stored() -> None:
    """11 mm is too much, and only $171, Y's offset, may be negative: X has no second motor."""
    gantry = Gantry()
    output = gantry.output_after("$171=-0.75", "$171=11", "$170=-1", "$100=-1", "$171=x")
    assert [line for line in output if line == "ok" or "error" in line] == [
        *("ok", "error:3", "error:4", "error:4", "error:2")
    ]
    gantry.received.clear()
    assert "$171=-0.750" in gantry.output_after("$$")


def test_stored_settings_of_a_gantry_do_no_harm_on_another_board() -> None:
    machine = Machine({171: -0.5, 8: 2, 110: 777}, watched=False)
    machine.play(["$$"])
    assert "$110=777.000" in machine.received and not any("$171" in x for x in machine.received)


# Board files


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"MOTORS": "XYZ"}, "MOTORS has 3 letters, and STEP 4 pins"),
        ({"MOTORS": "XZYY"}, "MOTORS: XYZ first, then second motors: XYZY"),
        ({"MOTORS": "XYZB"}, "MOTORS: XYZA first, then second motors: XYZY"),
        ({"MOTORS": "XYZYY", "STEP": (0, 1, 2, 3, 4)}, "MOTORS: Y has more than two"),
        ({"MOTORS": "XYXY"}, "MOTORS: XYZ first, then second motors: XYZY"),
        ({"DEFAULTS": {171: 500}}, "DEFAULTS: $171 may be at most 10 mm"),
        ({"LIMIT": (0, None, 2, 3)}, "LIMIT: Y has its second switch only"),
        ({"COREXY": True}, "MOTORS: Y shares its motor, and has no second"),
    ],
)
def test_impossible_gantry_is_reported(options: "dict[str, Any]", why: str) -> None:
    assert board_check.problems(board(**options)) == [why]


def test_second_motor_of_a_real_board_needs_no_switch(tmp_path: Path) -> None:
    """LIMIT may have None for it: edited into a board file, and as `ugrbl new-board` writes it."""
    text = (BOARDS / "pico_gantry.py").read_text()
    without = tmp_path / "without.py"
    without.write_text(text.replace("(9, 10, 11, 21)", "(9, 10, 11, None)"))
    assert board_check.problems(load(without)) == []
    file = tmp_path / "made.py"
    words = ["new-board", "made", "--chip", "pico", "--motors", "xyzy", "-o", str(file)]
    words += ["--pin", "step=2,3,4,19", "--pin", "dir=5,6,7,20", "--pin", "limit=9,10,11,none"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    module: Any = load(file)
    assert (module.MOTORS, module.LIMIT) == ("XYZY", (9, 10, 11, None))


@pytest.mark.parametrize(
    ("name", "pins", "why"),
    [
        ("DIR", (2, 6, 4), "DIR needs 4 pins, not 3"),
        ("LIMIT", (36, 35, 34, 39, 33), "LIMIT needs 4 pins, not 5"),
    ],
)
def test_motors_on_shift_registers_are_counted(
    name: str, pins: "tuple[int, ...]", why: str
) -> None:
    """Pins on shift registers must be as many as MOTORS has letters."""
    module = ModuleType("board")
    four = {"MOTORS": "XYZY", "STEP": (1, 5, 3, 9), "DIR": (2, 6, 4, 10)}
    module.__dict__.update({**vars(load_board("mks_dlc32")), **four, name: pins})
    assert why in board_check.problems(module)


def test_switch_of_a_second_motor_can_be_placed_by_an_option(tmp_path: Path) -> None:
    """`ugrbl run --input limit_y2=Y3`: the second motor of Y goes 1 mm further than the first."""
    program = tmp_path / "h.nc"
    program.write_text("$H\n")
    words = ["run", str(program), "--board", "sim_ganged", "--json", str(tmp_path / "out.json")]
    for setting in ("22=1", "24=100", "25=3000", "26=5", "111=3000", "121=400"):
        words += ["--set", setting]
    for place in ("limit_x=X2", "limit_z=Z2", "limit_y=Y2", "limit_y2=Y3"):
        words += ["--input", place]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    steps = json.loads((tmp_path / "out.json").read_text())["steps_made"]
    assert abs(steps["Y2"] - steps["Y"] - _STEPS_PER_MM) <= 2


def test_missing_switch_is_not_an_input_of_the_simulator() -> None:
    names = inputs.names(Gantry(LIMIT=(0, 1, 2, None)).rig)
    assert list(names) == ["probe", "limit_x", "limit_y", "limit_z", "reset", "hold", "start"]


def test_z_of_a_corexy_may_have_two_motors() -> None:
    """CoreXY's two motors move X and Y together: a switch of either axis stops both."""
    options: Any = SimpleNamespace(kinematics=Kinematics(3, COREXY), defaults={})
    ganged.prepare(options, board(MOTORS="XYZZ"))
    assert options.axes == 3
    assert options.kinematics.moves == [*COREXY, 4, 4]  # masks of the axes that each motor moves
    # Masks of the motors that each motor's limit switch stops.
    assert [options.kinematics.stopped_by(1 << i) for i in range(4)] == [3, 3, 4, 8]


def test_board_without_second_motors_has_none_of_the_modules() -> None:
    assert "extras.motors.ganged" not in build.modules_of(load_board("rpi_pico"))
    assert "motion.kinematics" not in build.modules_of(load_board("rpi_pico"))
    modules = build.modules_of(load_board("pico_gantry"))
    assert {"extras.motors.ganged", "motion.kinematics"} <= set(modules)
