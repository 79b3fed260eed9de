"""Test user-defined kinematics, backlash and skew on an emulated Pico."""

import math
import shutil
import sys
from pathlib import Path
from typing import Any

import emulated
import pytest
from emulated import BOARD_FILE, DIR, STEP, Board, Odometer, for_this_chip, steps
from rig_bench import Machine
from test_pico_talk import MAIN, free_heap_bytes
from ugrbl.boardfile.files import load
from ugrbl.compiling import build

pytestmark = pytest.mark.xdist_group("pico kinematics")

_EXAMPLES = Path(__file__).parent.parent.parent / "examples" / "kinematics"
_HEAP_BYTES = 60_000
_CHORD_US = 17_500  # checked and planned; 80 mm are 57 chords
_TOLERANCE = 0.05


def start_board(uf2: Path, file: Path, *settings: str) -> Board:
    """Start a Pico with that board file and settings, and record its motor pins."""
    files = build.for_board(file).files
    # fromkeys(): None instead of each file of the common board.
    made = Board(uf2, {**dict.fromkeys(emulated.firmware()), **files, "main.py": MAIN})
    made.boot().settled()
    for setting in settings:
        assert made.ask(setting).endswith("ok\r\n"), setting
    made.pico.record([*STEP, *DIR])
    return made


@pytest.fixture(scope="module")
def scara(uf2: Path) -> Board:
    """Return a board with the example of a SCARA's kinematics, whose motors stay on."""
    file = for_this_chip(_EXAMPLES / "my_scara.py")
    shutil.copy(_EXAMPLES / "scara.py", file.parent)
    return start_board(uf2, file, f"$12={_TOLERANCE}", "$1=255")


def scara_module() -> Any:
    """Return the module examples/kinematics/scara.py."""
    load(_EXAMPLES / "my_scara.py")
    return sys.modules.get("scara") or __import__("scara")


def test_line_is_straight_and_has_the_commanded_speed(scara: Board) -> None:
    """80 mm along X at Y 120 and 20 mm/s. The tool's path follows from the motors' steps, by the
    example's own forward kinematics."""
    scara.ask("G1X-40Y120F1200")
    scara.ask("G4P.01", limit_us=10_000_000)
    start_mm = [float(x) for x in scara.status()["MPos"].split(",")]
    assert start_mm == pytest.approx([-40, 120, 0], abs=0.1)
    scara.pico.edges.clear()
    scara.ask("X40")
    scara.ask("G4P.01", limit_us=10_000_000)
    per_degree = 44.444  # steps
    model: Any = scara_module()
    joints = list(model.START)  # degrees of both arms, mm of Z
    assert model.inverse(start_mm, joints)
    steps_in_order = sorted(
        (us, axis, sign) for axis in range(3) for us, sign in steps(scara.pico.edges, axis)
    )
    tool_mm = [0.0, 0.0, 0.0]
    step_mm = 2 * math.radians(1 / per_degree) * 200  # two arms, each reaching less than 200 mm
    for _, axis, sign in steps_in_order:
        joints[axis] += sign / (per_degree if axis < 2 else 400)
        model.forward(joints, tool_mm)
        assert abs(tool_mm[1] - 120) <= _TOLERANCE + step_mm
    assert tool_mm == pytest.approx([40, 120, 0], abs=0.2)
    seconds = (steps_in_order[-1][0] - steps_in_order[0][0]) / 1e6
    assert seconds == pytest.approx(80 / 20, rel=0.06)


def test_unreachable_target_is_refused(scara: Board) -> None:
    before = scara.status()["MPos"]
    assert "is out of reach]\r\nerror:33" in scara.ask("G1X0Y300F900", until="error:33\r\n")
    assert scara.status()["MPos"] == before


def test_chords_are_planned_in_time_and_heap_is_free(scara: Board) -> None:
    """The figures are those of docs/kinematics.md: a line is answered when its chords, here 57,
    are planned."""
    free_bytes = free_heap_bytes(scara)
    scara.ask("$12=0.002")  # mm: the tolerance that decides the number of chords
    scara.ask("G1X-40Y120F6000")
    scara.ask("G4P.01", limit_us=10_000_000)  # the end of motion
    begun_us = scara.pico.us
    scara.ask("G1X40Y121F6000", limit_us=20_000_000)
    assert (scara.pico.us - begun_us) / 57 < _CHORD_US
    assert free_bytes >= _HEAP_BYTES


def test_backlash_is_compensated_to_the_step(uf2: Path, tmp_path: Path) -> None:
    """Backlash of X is 0.1 mm ($160), of Y 0.05 mm ($161). After a move in the negative direction
    the motor stands that much lower than the axis. After the arc the motors are not checked."""
    file = tmp_path / "pico_backlash.py"
    file.write_text(BOARD_FILE.read_text() + "BACKLASH = True\n")
    machine = start_board(
        uf2,
        file,
        "$100=80",
        "$101=80",
        "$160=0.1",
        "$161=0.05",
        "$110=3000",
        "$111=3000",
        "$1=255",
    )
    odometer = Odometer(machine.pico, STEP, DIR)
    for line, motors_mm in (
        ("G0X1Y1", (1, 1)),
        ("G1X0.5F900", (0.4, 1)),
        ("G1X0Y0", (-0.1, -0.05)),
        ("G2X0Y0I2J0", None),
        ("G1X1Y-1", (1, -1.05)),
    ):
        machine.ask(line, limit_us=10_000_000)
        machine.ask("G4P.01", limit_us=10_000_000)
        motor_steps = odometer.read()
        if motors_mm:
            assert motor_steps[:2] == [round(mm * 80) for mm in motors_mm], line  # 80 steps/mm
    axes_mm = [float(x) for x in machine.status()["MPos"].split(",")]
    assert axes_mm == pytest.approx([1, -1, 0], abs=0.001)


def test_skewed_motors_make_the_simulators_steps(uf2: Path, tmp_path: Path) -> None:
    """Lines and arcs, with the skew of three planes ($780 to $782)."""
    file = tmp_path / "pico_skew.py"
    file.write_text(BOARD_FILE.read_text() + "SKEW = True\n")
    settings = {110: 3000, 111: 3000, 112: 3000, 780: 100, 781: -50, 782: 30}
    machine = start_board(uf2, file, *[f"${n}={value}" for n, value in settings.items()], "$1=255")
    odometer = Odometer(machine.pico, STEP, DIR)
    simulated = Machine({**settings, 1: 255}, load(file), watched=False)
    lines = [
        "G1X4Y-7Z2F2000",
        "X1.3Y.77",
        "G2X1.3Y0.77I-2J3Z-1",
        "G0X3",
        "G18",
        "Z2",
    ]
    for line in lines:
        machine.ask(line, limit_us=10_000_000)
        machine.ask("G4P.01", limit_us=10_000_000)
    simulated.play(lines)
    assert list(odometer.read()) == simulated.physical()
    assert [float(x) for x in machine.status()["MPos"].split(",")] == simulated.reported()
