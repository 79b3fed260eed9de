"""Test a rotary axis on an emulated Pico with four motors: steps, time, and cost."""

import random
from pathlib import Path

import emulated
import pytest
from emulated import Board, Odometer, for_this_chip
from test_pico_stack import RESERVE_BYTES, STACK_BYTES, Stack
from test_pico_talk import MAIN, free_heap_bytes
from ugrbl.boardfile.files import load_board
from ugrbl.compiling import build
from ugrbl.paths import BOARDS

pytestmark = pytest.mark.xdist_group("pico rotary")

_GANTRY = load_board("pico_gantry")
_PER_UNIT = (80, 80, 400, 50)
_SETTINGS = (
    *(f"${100 + axis}={steps}" for axis, steps in enumerate(_PER_UNIT)),
    *("$110=6000", "$111=6000", "$112=3000", "$113=60000"),
    *("$120=1000", "$121=1000", "$122=1000", "$123=10000", "$133=0"),
)
_HEAP_BYTES = 65_000


@pytest.fixture(scope="module")
def machine(uf2: Path, tmp_path_factory: pytest.TempPathFactory) -> Board:
    """Start pico_gantry with a rotary axis in place of the second motor."""
    file = tmp_path_factory.mktemp("boards") / "pico_rotary.py"
    gantry = (BOARDS / "pico_gantry.py").read_text("utf-8")
    assert 'MOTORS = "XYZY"' in gantry
    file.write_text(gantry.replace('MOTORS = "XYZY"', 'ROTARY = "A"'), "utf-8")
    files = build.for_board(for_this_chip(file)).files
    # fromkeys(): None instead of each file of the common board.
    made = Board(uf2, {**dict.fromkeys(emulated.firmware()), **files, "main.py": MAIN})
    made.boot().settled()
    for setting in _SETTINGS:
        assert made.ask(setting).endswith("ok\r\n"), setting
    made.pico.record([*_GANTRY.STEP, *_GANTRY.DIR])
    return made


@pytest.fixture(scope="module")
def odometer(machine: Board) -> Odometer:
    return Odometer(machine.pico, _GANTRY.STEP, _GANTRY.DIR)


def test_line_takes_the_time_of_its_linear_axes(machine: Board, odometer: Odometer) -> None:
    """10 mm at 10 mm/s with 360 degrees; then 45 degrees back at 90 degrees per second."""
    for line, seconds in (("G91 G1 X10 A360 F600", 1.0), ("A-45 F5400", 0.5)):
        odometer.read()  # clears the edges
        machine.ask(line)
        machine.ask("G4P.01", limit_us=3_000_000)
        a_ns = [e.ns for e in machine.pico.edges if e.pin == _GANTRY.STEP[3] and e.level]
        assert (a_ns[-1] - a_ns[0]) / 1e9 == pytest.approx(seconds, rel=0.06)


def test_every_step_is_made_within_the_stack(machine: Board, odometer: Odometer) -> None:
    """With random steps: lines for the kernel, lines for the interpreter (with S), and half
    circles of 2 mm while A turns."""
    chance = random.Random(19)
    due_steps = odometer.read()
    stack = Stack(machine)
    stack.start_measuring()
    machine.ask("G91 G1 F3000")
    for _ in range(60):
        steps = [chance.randrange(-40, 41) * 5 for _ in _PER_UNIT]
        words = [
            f"{axis}{n / per:.4f}" for axis, n, per in zip("XYZA", steps, _PER_UNIT, strict=True)
        ]
        kind = chance.randrange(3)
        if kind == 2:
            steps[:3] = 160, 0, 0  # 2 mm of X, 80 steps/mm
            words = ["G2X2Y0I1J0", words[3]]
        machine.ask(("G1", "S100 G1", "")[kind] + "".join(words))
        due_steps = [at + n for at, n in zip(due_steps, steps, strict=True)]
    machine.ask("G4P.01", limit_us=5_000_000)  # the end of motion
    assert stack.most_used() <= STACK_BYTES - RESERVE_BYTES
    assert odometer.read() == due_steps


def test_heap_is_free(machine: Board) -> None:
    assert free_heap_bytes(machine) >= _HEAP_BYTES
