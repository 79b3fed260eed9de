"""Test four to eight motors on an emulated RP2350: PIO 0 and 1, and PIO 2's clock for eight."""

import random
from itertools import pairwise
from pathlib import Path

import pytest
from chips import CHIP
from emulated import BOARD_FILE, Board, Odometer, firmware
from ugrbl.compiling import build

pytestmark = [
    pytest.mark.xdist_group("pico2 motors"),
    pytest.mark.skipif(CHIP.name != "rp2350", reason="an RP2040 has motors in test_pico_six.py"),
]

STEP = tuple(range(2, 10))
DIR = tuple(range(10, 18))
LIMIT = (19, 20, 21, 0, 1, 28)
_MOTORS = "XYZABCXY"
PINS = """
MOTORS = "{motors}"
STEP = {step}
DIR = {dir}
LIMIT = {limit}
ENABLE, PROBE, CONTROL, REPL_PIN = 18, None, (None,) * 4, 22
SPINDLE_PWM, SPINDLE_DIR, FLOOD = 26, None, None
"""
_PER_MM = 250
_TICK_US = 0.08 + 1e-6  # of rounding, as a float
_FASTEST_KHZ = 249.97


class Machine:
    """The board with this number of motors, set up, with their pins recorded."""

    def __init__(self, uf2: Path, folder: Path, motors: int) -> None:
        self.motors = _MOTORS[:motors]
        self.axes = "".join(dict.fromkeys(self.motors))
        limit = LIMIT[: len(self.axes)]
        pins = {"motors": self.motors, "step": STEP[:motors], "dir": DIR[:motors], "limit": limit}
        file = folder / f"pico2_{motors}.py"
        file.write_text(BOARD_FILE.read_text("utf-8") + PINS.format(**pins), "utf-8")
        # None instead of each file of the common board, then the files of this one.
        self.board = Board(uf2, {**dict.fromkeys(firmware()), **build.for_board(file).files})
        for pin in (*limit, 22):  # open switches; REPL_PIN is 22
            self.board.pico.drive(pin, 1)
        self.board.boot().settled()
        # Steps/mm, mm/min and mm/s2 of each axis.
        settings = [(100, _PER_MM), (110, 120_000), (120, 40_000)]
        each = [f"${n + k}={value}" for n, value in settings for k in range(len(self.axes))]
        for line in ("$0=3", "$1=255", *each):  # pulses of 3 us; motors stay on
            assert self.board.ask(line).endswith("ok\r\n"), line
        self.board.pico.record([*STEP[:motors], *DIR[:motors]])
        self.odometer = Odometer(self.board.pico, STEP[:motors], DIR[:motors])

    def reported_steps(self) -> "list[float]":
        """Return the reported position of each motor's axis, in steps."""
        mm = dict(zip(self.axes, self.board.status()["MPos"].split(","), strict=True))
        return [round(float(mm[axis]) * _PER_MM, 3) for axis in self.motors]

    def unlock(self) -> None:
        """Unlock the machine after a stop."""
        self.board.ask("$X")


@pytest.fixture(scope="module")
def eight(uf2: Path, tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return Machine(uf2, tmp_path_factory.mktemp("boards"), 8)


def check_random_lines(machine: Machine, lines: int) -> None:
    """Check that this number of random lines is executed to the step, and that the position is
    reported."""
    chance = random.Random(len(machine.motors))
    board = machine.board
    due_steps = machine.odometer.read()
    board.ask("G91 G1 F6000")
    for _ in range(lines):
        steps = {axis: chance.choice((0, chance.randrange(-200, 201))) for axis in machine.axes}
        board.ask("".join(f"{axis}{n / _PER_MM:.3f}" for axis, n in steps.items()))
        moved = [steps[axis] for axis in machine.motors]
        due_steps = [at + n for at, n in zip(due_steps, moved, strict=True)]
    board.ask("G4P.01", limit_us=5_000_000)  # answered when motion has ended
    assert machine.odometer.read() == due_steps == machine.reported_steps()


@pytest.mark.parametrize("motors", [4, 5, 6, 7])
def test_every_motor_makes_every_step(uf2: Path, tmp_path: Path, motors: int) -> None:
    check_random_lines(Machine(uf2, tmp_path, motors), 12)


def test_eight_motors_make_every_step(eight: Machine) -> None:
    check_random_lines(eight, 40)


def test_motors_of_both_pios_step_in_the_same_tick(eight: Machine) -> None:
    """All axes move 2 mm; the times of corresponding steps differ by a tick of 80 ns at most."""
    eight.odometer.read()  # clears the edges
    eight.board.ask("G91 G1 X2Y-2Z2A-2B2C-2 F9000")
    eight.board.until_idle()
    tracks = step_times_us(eight)
    assert {len(track) for track in tracks} == {2 * _PER_MM}
    for track in tracks[1:]:
        assert max(abs(a - b) for a, b in zip(tracks[0], track, strict=True)) <= _TICK_US


def test_eight_motors_at_once_make_250_khz(eight: Machine) -> None:
    """Measured in the middle 10 ms of a move of 46 mm, at the highest speed that the engine
    allows."""
    before = eight.odometer.read()
    eight.board.ask("G91 G1" + "".join(f"{axis}46" for axis in eight.axes) + "F999999")
    eight.board.until_idle()
    tracks = step_times_us(eight)
    middle = (tracks[0][0] + tracks[0][-1]) / 2
    for track in tracks:
        gaps = [b - a for a, b in pairwise(track) if abs(a - middle) < 5_000]  # us
        assert 1e3 * len(gaps) / sum(gaps) == pytest.approx(_FASTEST_KHZ, abs=0.1)
    after = eight.odometer.read()
    assert [b - a for a, b in zip(before, after, strict=True)] == [46 * _PER_MM] * 8
    assert eight.reported_steps() == after


@pytest.mark.parametrize("ms", [3, 14.3, 26.1, 37.7])
def test_reset_stops_all_eight_motors_at_their_reported_position(
    eight: Machine, ms: float
) -> None:
    """ms: from the start of motion, back and forth at 1 m/s, to the reset."""
    board = eight.board
    board.ask("G91 G1 F60000")
    board.clear_output()
    for mm in (12, -12, 15):
        board.send("".join(f"{axis}{mm}" for axis in eight.axes) + "\n")
    board.pico.run_us(ms * 1000)
    board.send("\x18")
    assert "ALARM:3" in board.wait_for("Grbl 1.1h"), "it had stopped before"
    stopped_at = eight.odometer.read()
    board.pico.run_us(20_000)
    assert eight.odometer.read() == stopped_at
    eight.unlock()
    assert eight.reported_steps() == stopped_at
    check_random_lines(eight, 2)


@pytest.mark.parametrize("axis", [0, 5])
def test_limit_switch_stops_all_eight_motors(eight: Machine, axis: int) -> None:
    """axis: whose switch closes, 15 ms after the move was sent; no step comes 200 us later."""
    board = eight.board
    board.ask("$21=1")
    board.ask("G91 G1 F6000")
    board.send("".join(f"{letter}3" for letter in eight.axes) + "\n")
    board.pico.run_us(15_000)
    eight.odometer.read()  # clears the edges
    closed_us = board.pico.us
    board.pico.drive(LIMIT[axis], 0)
    board.wait_for("[MSG:Reset to continue]")
    assert [us for track in step_times_us(eight) for us in track if us > closed_us + 200] == []
    board.pico.drive(LIMIT[axis], 1)
    board.send("\x18")
    board.wait_for("Grbl 1.1h")
    eight.unlock()
    board.ask("$21=0")
    assert eight.reported_steps() == eight.odometer.read()


def step_times_us(machine: Machine) -> "list[list[float]]":
    """Return the times of each motor's steps, in us, since the odometer was read."""
    edges = machine.board.pico.edges
    return [
        [edge.ns / 1000 for edge in edges if edge.pin == pin and edge.level]
        for pin in STEP[: len(machine.motors)]
    ]
