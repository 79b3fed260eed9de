"""Test two motors on an axis of the emulated Pico: squaring, and motion after a stop."""

from pathlib import Path

import pytest
from chips import Edge
from emulated import Board, Odometer, files_of
from test_pico_stack import RESERVE_BYTES, STACK_BYTES, Stack
from test_pico_talk import MAIN, free_heap_bytes
from ugrbl.boardfile.files import load_board

pytestmark = pytest.mark.xdist_group("pico ganged")

_BOARD = load_board("pico_gantry")
_SETTINGS = (
    *[
        f"${number + axis}={value}"
        for number, value in ((100, 100), (110, 6000), (120, 500))
        for axis in range(3)
    ],
    *("$22=1", "$23=0", "$24=100", "$25=1200", "$26=5", "$27=0.5", "$171=0.3"),
)
# Steps from the start to each switch; the second motor of Y has its switch later.
_SWITCH_STEPS = (100, 100, 100, 160)
_OFFSET_STEPS = 30  # $171, in steps
_HEAP_BYTES = 68_000
_TICK_NS = 80


class Gantry:
    """The board, with switches that close at positions of its motors."""

    def __init__(self, uf2: Path) -> None:
        files = {**files_of("pico_gantry"), "main.py": MAIN}
        self.machine = Board(uf2, files)
        for pin in _BOARD.LIMIT:
            self.machine.pico.drive(pin, 1)  # open
        self.machine.pico.record([*_BOARD.STEP, *_BOARD.DIR])
        self.machine.boot().settled()
        self.odometer = Odometer(self.machine.pico, _BOARD.STEP, _BOARD.DIR)
        self.edges: list[Edge] = []  # of all pins, since a test has cleared it
        for setting in _SETTINGS:
            assert self.machine.ask(setting).endswith("ok\r\n"), setting
        self._update_switches()

    def _update_switches(self) -> None:
        """Set the switches for the motors' positions, every millisecond from now on."""
        self.edges += self.machine.pico.edges
        for pin, steps, closes_at in zip(
            _BOARD.LIMIT, self.odometer.read(), _SWITCH_STEPS, strict=True
        ):
            self.machine.pico.drive(pin, 0 if steps >= closes_at else 1)
        self.machine.pico.at_us(1_000, self._update_switches)

    def assert_all_motors_step(self) -> None:
        """Check that every motor makes every commanded step."""
        machine = self.machine
        machine.pico.run_us(2_000)
        before = self.odometer.read()
        machine.ask("G91 F3000")
        machine.ask("G1 X-1 Y-1.5 Z-2")
        machine.ask("G4P.01")
        machine.pico.run_us(2_000)
        steps = [after - b for after, b in zip(self.odometer.read(), before, strict=True)]
        assert steps == [-100, -150, -200, -150]  # X, Y, Z, Y at 100 steps/mm


@pytest.fixture(scope="module")
def gantry(uf2: Path) -> Gantry:
    return Gantry(uf2)


def test_heap_is_free(gantry: Gantry) -> None:
    """As after power-up: this test is the first to use the machine."""
    assert free_heap_bytes(gantry.machine) >= _HEAP_BYTES


def test_axis_is_squared_at_its_two_switches(gantry: Gantry) -> None:
    """Homing stops each motor of Y at its own switch, moves the second one by $171, and both away
    by the pull-off of 0.5 mm ($27), 50 steps. The stack suffices."""
    machine = gantry.machine
    stack = Stack(machine)
    stack.start_measuring()
    machine.ask("$H", limit_us=20_000_000)
    assert stack.most_used() <= STACK_BYTES - RESERVE_BYTES
    _, y_steps, _, y2_steps = gantry.odometer.read()
    assert abs(y_steps - (_SWITCH_STEPS[1] - 50)) <= 1
    assert abs(y2_steps - y_steps - (_SWITCH_STEPS[3] - _SWITCH_STEPS[1] - _OFFSET_STEPS)) <= 1
    assert machine.status()["MPos"] == "-0.500,-0.500,-0.500"
    gantry.assert_all_motors_step()


def test_both_motors_of_an_axis_step_at_the_same_time(gantry: Gantry) -> None:
    """Motors 1 and 3 are of Y, which assert_all_motors_step() moves by 150 steps."""
    gantry.edges.clear()
    gantry.assert_all_motors_step()
    y_ns, y2_ns = (
        [edge.ns for edge in gantry.edges if edge.pin == _BOARD.STEP[motor] and edge.level]
        for motor in (1, 3)
    )
    assert len(y_ns) == len(y2_ns) == 150
    assert max(abs(a - b) for a, b in zip(y_ns, y2_ns, strict=True)) <= _TICK_NS


@pytest.mark.parametrize("ms", [150, 420, 700])
def test_all_motors_work_after_a_reset_during_homing(gantry: Gantry, ms: int) -> None:
    """Homing locks motors that have reached their switches; a reset must release them.

    ms: from the command to the reset.
    """
    machine = gantry.machine
    machine.clear_output()
    machine.send("$H\n")
    machine.pico.run_us(ms * 1000)
    machine.send("\x18")
    machine.wait_for("ALARM:6")
    machine.wait_for("Grbl 1.1h")
    machine.ask("$X")
    gantry.assert_all_motors_step()
