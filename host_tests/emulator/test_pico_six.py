"""Test six motors on an emulated Pico, two of them on PIO 1: steps, stops, rates, cost."""

import random
import sys
from itertools import pairwise
from pathlib import Path

import emulated
import pytest
from chips import Edge
from emulated import Board, Odometer, files_of, for_this_chip
from test_pico_stack import RESERVE_BYTES, STACK_BYTES, Stack
from test_pico_talk import MAIN as FREE
from test_pico_talk import free_heap_bytes
from ugrbl.boardfile.files import load_board
from ugrbl.compiling import build
from ugrbl.paths import BOARDS

sys.path.append(str(Path(__file__).parent.parent / "bench"))

from bench_setup import Bench
from on_board import MAIN
from talking import of_axes

pytestmark = pytest.mark.xdist_group("pico six")

_SIX = load_board("pico_six")
_LETTERS = "XYZABC"
_PER_MM = 250
_SETTINGS = (
    *("$0=3", "$1=255"),
    *(
        f"${number + axis}={value}"
        for number, value in ((100, _PER_MM), (110, 120_000), (120, 40_000))
        for axis in range(6)
    ),
)
_HEAP_BYTES, _HEAP_BYTES_OF_SIX = 62_000, 82_000
_TICK_US = 0.08
# The emulator records an edge up to a few instructions late.
_SEEN_US = 0.3
_MOVE_MM = 0.05
_COUNTED_US = 35_000
# Limit of the interrupt's share with six motors, relative to three motors.
_DEARER = 1.5


class Machine:
    """The board, set up, with its motor pins recorded."""

    def __init__(self, board: Board) -> None:
        self.board = board
        for setting in _SETTINGS:
            assert board.ask(setting).endswith("ok\r\n"), setting
        board.pico.record([*_SIX.STEP, *_SIX.DIR])
        self.odometer = Odometer(board.pico, _SIX.STEP, _SIX.DIR)

    def step_times_us(self, motor: int) -> "list[float]":
        """Return the times of a motor's steps, in us."""
        return _step_times_us(self.board.pico.edges, motor)

    def reported_steps(self) -> "list[float]":
        """Return the reported position, in steps."""
        return [round(float(mm) * _PER_MM, 3) for mm in self.board.status()["MPos"].split(",")]


def _step_times_us(edges: "list[Edge]", motor: int) -> "list[float]":
    return [edge.ns / 1000 for edge in edges if edge.pin == _SIX.STEP[motor] and edge.level]


def _board(uf2: Path, files: "dict[str, bytes | None]", main: bytes = MAIN) -> Board:
    """Return a started board with these files, and open inputs."""
    board = Board(uf2, {**files, "main.py": main})
    for pin in (*_SIX.LIMIT, _SIX.PROBE, *_SIX.CONTROL[:3], _SIX.REPL_PIN):
        board.pico.drive(pin, 1)
    return board.boot().settled()


@pytest.fixture(scope="module")
def machine(uf2: Path) -> Machine:
    return Machine(_board(uf2, dict(files_of("pico_six"))))


def test_every_motor_makes_every_step_of_random_lines(machine: Machine) -> None:
    """It stays within the stack, and the board reports the positions of the motors."""
    chance = random.Random(6)
    board = machine.board
    due_steps = machine.odometer.read()
    stack = Stack(board)
    stack.start_measuring()
    board.ask("G91 G1 F6000")
    for _ in range(50):
        steps = [chance.choice((0, chance.randrange(-200, 201))) for _ in _LETTERS]
        words = "".join(f"{a}{n / _PER_MM:.3f}" for a, n in zip(_LETTERS, steps, strict=True))
        # Lines for the kernel and, with S, for the interpreter.
        board.ask(chance.choice(("G1", "S100 G1", "")) + words)
        due_steps = [at + n for at, n in zip(due_steps, steps, strict=True)]
    board.ask("G4P.01", limit_us=5_000_000)  # the end of motion
    assert stack.most_used() <= STACK_BYTES - RESERVE_BYTES
    assert machine.odometer.read() == due_steps == machine.reported_steps()


def test_motors_of_both_pios_step_in_the_same_tick(machine: Machine) -> None:
    """First steps, last steps and all between: the two blocks start a few cycles apart."""
    board = machine.board
    for _ in range(3):
        machine.odometer.read()
        board.ask("G91 G1 X2Y-2Z2A-2B2C-2 F9000")
        board.ask("G4P.01", limit_us=3_000_000)
        tracks = [machine.step_times_us(motor) for motor in range(6)]
        assert {len(track) for track in tracks} == {2 * _PER_MM}
        for track in tracks[1:]:
            apart_us = [abs(a - b) for a, b in zip(tracks[0], track, strict=True)]
            assert max(apart_us) <= _TICK_US + _SEEN_US


def test_six_motors_at_once_make_250_khz(machine: Machine) -> None:
    _check_rate(machine, 249.97)


def _check_rate(machine: Machine, khz: float) -> None:
    """Check that all motors at once make that rate in the middle 10 ms of a move of 46 mm, and
    every step."""
    board = machine.board
    before = machine.odometer.read()
    board.ask("G91 G1" + "".join(f"{letter}46" for letter in _LETTERS) + "F999999")
    board.until_idle()
    tracks = [machine.step_times_us(motor) for motor in range(6)]
    middle_us = (tracks[0][0] + tracks[0][-1]) / 2
    for track in tracks:
        gaps_us = [b - a for a, b in pairwise(track) if abs(a - middle_us) < 5_000]
        assert 1e3 * len(gaps_us) / sum(gaps_us) == pytest.approx(khz, rel=4e-4)
        assert min(gaps_us) >= 1e3 // khz - _SEEN_US  # the period is 4.0005 or 2 us
    after = machine.odometer.read()
    assert [b - a for a, b in zip(before, after, strict=True)] == [46 * _PER_MM] * 6
    assert machine.reported_steps() == after


def test_a_board_that_allows_pulses_of_1_us_makes_500_khz_on_six_motors(uf2: Path) -> None:
    """With $0=1 and an acceleration that reaches this rate."""
    file = for_this_chip(BOARDS / "pico_six.py", "STEP_PULSE_MIN_US = 1")
    made = build.for_board(file).files
    # fromkeys(): None instead of each file of the common board.
    machine = Machine(_board(uf2, {**dict.fromkeys(emulated.firmware()), **made}))
    for line in ("$0=1", *(f"${120 + axis}=160000" for axis in range(6))):
        assert machine.board.ask(line).endswith("ok\r\n"), line
    _check_rate(machine, 500)


@pytest.mark.parametrize("ms", [3, 14.3, 26.1, 37.7, 55])
def test_reset_stops_all_six_motors_and_their_positions_are_known(
    machine: Machine, ms: float
) -> None:
    """ms: from the start of motion, back and forth at 1 m/s, to the reset. All six motors work
    afterwards."""
    board = machine.board
    board.ask("G91 G1 F60000")
    board.clear_output()
    for mm in (12, -12, 15):
        board.send("".join(f"{letter}{mm}" for letter in _LETTERS) + "\n")
    board.pico.run_us(ms * 1000)
    board.send("\x18")
    assert "ALARM:3" in board.wait_for("Grbl 1.1h"), "it had stopped before"
    stopped_at = machine.odometer.read()
    board.pico.run_us(20_000)
    assert machine.odometer.read() == stopped_at
    board.ask("$X")
    assert machine.reported_steps() == stopped_at
    board.ask("G91 G1 F6000" + "".join(f"{a}{k / 10:.1f}" for k, a in enumerate(_LETTERS, 1)))
    board.ask("G4P.01")
    steps = [b - a for a, b in zip(stopped_at, machine.odometer.read(), strict=True)]
    assert steps == [25 * k for k in range(1, 7)]  # 0.1 mm of X to 0.6 mm of C, 250 steps/mm


@pytest.mark.parametrize("motor", [1, 3, 4, 5])
def test_any_limit_switch_stops_all_six_motors(machine: Machine, motor: int) -> None:
    """motor: whose switch closes in motion; no step comes 200 us later."""
    board = machine.board
    board.ask("$21=1")
    board.ask("G91 G1 F6000")
    board.send("".join(f"{letter}3" for letter in _LETTERS) + "\n")
    board.pico.run_us(15_000 + 700 * motor)
    machine.odometer.read()  # clears the edges
    closed_us = board.pico.us
    board.pico.drive(_SIX.LIMIT[motor], 0)
    board.wait_for("[MSG:Reset to continue]")
    late_steps = [us for k in range(6) for us in machine.step_times_us(k) if us > closed_us + 200]
    board.pico.drive(_SIX.LIMIT[motor], 1)
    assert late_steps == []
    board.send("\x18")
    board.wait_for("Grbl 1.1h")
    board.ask("$X")
    board.ask("$21=0")
    assert machine.reported_steps() == machine.odometer.read()


def test_interrupt_of_six_motors_takes_at_most_one_and_a_half_of_three(
    machine: Machine, uf2: Path
) -> None:
    """300 short blocks a second in which every motor moves: the time that a loop loses.

    The other board has three motors, and of the settings those of its axes.
    """
    three = Board(uf2, {"main.py": MAIN}).boot().settled()
    for setting in _SETTINGS:
        if int(setting[1:].partition("=")[0]) % 10 < 3:  # axes X, Y, Z
            three.ask(setting)
    shares = [_interrupt_share(board, axes) for board, axes in ((three, 3), (machine.board, 6))]
    assert 0 < shares[1] <= _DEARER * shares[0]


def _interrupt_share(board: Board, axes: int) -> float:
    """Return the interrupt's share of the processor's time, from 0 to 1.

    The board counts in a loop for _COUNTED_US, at once ($COUNT) and during motion ($LATER).
    """
    (idle_count,) = _numbers(board.ask(f"$COUNT={_COUNTED_US}"))
    board.ask("G91 G1 X1.5 F900")  # 0.1 s in which the short ones are planned
    for k in range(14):
        axis_mm = _MOVE_MM * (1 + k % 3) / 2 / axes**0.5  # of moves of 0.025 to 0.075 mm
        board.ask("".join(f"{letter}{axis_mm:.3f}" for letter in _LETTERS[:axes]))
    (moving_count,) = _numbers(board.ask(f"$LATER={_COUNTED_US}"))
    board.until_idle()
    return 1 - moving_count / idle_count


def _numbers(said: str) -> "list[int]":
    return [int(n) for n in said.partition("[MSG:")[2].partition(".]")[0].split()]


def test_four_axis_lines_reach_82_percent_of_the_three_axis_rate(uf2: Path) -> None:
    """Rates of streamed lines, as `make bench-board` measures them for docs/speed.md."""
    three, four = (next(of_axes(Bench(uf2), name)).figure for name in ("three axes", "four axes"))
    assert four >= 0.82 * three > 0


def test_heap_is_free_with_six_axes(uf2: Path) -> None:
    assert free_heap_bytes(_board(uf2, dict(files_of("pico_six")), FREE)) >= _HEAP_BYTES_OF_SIX


def test_heap_is_free_with_four_axes_and_a_pair(uf2: Path) -> None:
    five = 'MOTORS = "XYZAY"\nSTEP, DIR, LIMIT = STEP[:5], DIR[:5], LIMIT[:5]\n'
    file = for_this_chip(BOARDS / "pico_six.py", five)
    # fromkeys(): None instead of each file of the common board.
    files = {**dict.fromkeys(emulated.firmware()), **build.for_board(file).files}
    assert free_heap_bytes(_board(uf2, files, FREE)) >= _HEAP_BYTES
