"""Test switches, buttons and a probe at the emulated Pico, and stops of its motors.

ask() sends a line and returns its answer, clear_output() forgets the output so far. Inputs are
closed at level 0. Steps are found in the edges recorded at the pins.
"""

from pathlib import Path

import pytest
from emulated import (
    BOARD_FILE,
    DIR,
    HOLD,
    LIMIT,
    PROBE,
    RESET,
    SPINDLE_PWM,
    START,
    STEP,
    Board,
    steps,
)

pytestmark = pytest.mark.xdist_group("pico inputs")

ESTOP = 21  # closed until it is pressed
BOARD = BOARD_FILE.read_bytes() + b"ESTOP = 21\n"
SETTINGS = (
    *("$0=3", "$100=80", "$101=80", "$102=80"),
    *("$110=3000", "$111=3000", "$112=3000"),
    *("$120=400", "$121=400", "$122=400"),
)


@pytest.fixture(scope="module")
def machine(uf2: Path) -> Board:
    """Return a board with an emergency stop, set up, after a first start with it open."""
    made = Board(uf2, {"board.py": BOARD})
    said = made.boot().wait_for("[MSG:Emergency stop]")  # nothing is wired: it is open
    assert "[MSG:First start: factory settings]" in said
    made.pico.drive(ESTOP, 0)
    made.ask("$X")
    made.clear_output()
    made.send("\x18")
    made.wait_for("Grbl 1.1h")
    made.ask("")
    for setting in SETTINGS:
        assert made.ask(setting) == "ok\r\n"
    made.pico.record([*STEP, *DIR, SPINDLE_PWM])
    return made


def position_mm(machine: Board) -> "list[float]":
    return [float(mm) for mm in machine.status()["MPos"].split(",")]


def test_hold_button_stops_and_start_button_resumes_to_the_step(machine: Board) -> None:
    """A move of 12 mm is 960 steps, at 80 steps/mm; each button is pressed for 5 ms."""
    machine.pico.edges.clear()
    start_mm = position_mm(machine)[0]
    machine.ask("G91 G1 X12 F1800")
    machine.pico.run_us(150_000)
    machine.pico.drive(HOLD, 0)
    machine.pico.run_us(5_000)
    machine.pico.drive(HOLD, 1)
    machine.pico.run_us(250_000)
    steps_until_hold = len(steps(machine.pico.edges, 0))
    assert 0 < steps_until_hold < 960
    assert machine.status()["state"] == "Hold:0"
    machine.pico.run_us(50_000)
    assert len(steps(machine.pico.edges, 0)) == steps_until_hold
    machine.pico.drive(START, 0)
    machine.pico.run_us(5_000)
    machine.pico.drive(START, 1)
    machine.until_idle()
    assert len(steps(machine.pico.edges, 0)) == 960
    assert position_mm(machine)[0] == pytest.approx(start_mm + 12, abs=0.001)


def test_sender_holds_and_resumes(machine: Board) -> None:
    """The sender sends "!" and "~" in motion; no step is lost."""
    machine.pico.edges.clear()
    machine.ask("G91 G1 X6 F1800")
    machine.pico.run_us(80_000)
    machine.send("!")
    machine.pico.run_us(200_000)
    assert machine.status()["state"] == "Hold:0"
    machine.send("~")
    machine.until_idle()
    assert len(steps(machine.pico.edges, 0)) == 480  # 6 mm * 80 steps/mm


@pytest.mark.parametrize("how", ["ctrl-x", "button"])
def test_reset_in_motion_stops_at_once_and_position_matches_the_steps(
    machine: Board, how: str
) -> None:
    """The last edge of any pin comes within 1 ms of the button, and within 7 ms of Ctrl-X."""
    start_mm = position_mm(machine)
    machine.pico.edges.clear()
    machine.ask("G91 G1 X12 Y5 F1800")
    machine.pico.run_us(150_000)
    machine.clear_output()
    reset_us = machine.pico.us
    if how == "button":
        machine.pico.drive(RESET, 0)
        machine.pico.at_us(2_000, lambda: machine.pico.drive(RESET, 1))
    else:
        machine.send("\x18")
    machine.wait_for("Grbl 1.1h")
    assert "ALARM:3" in machine.output
    latency_us = machine.pico.edges[-1].ns / 1000 - reset_us
    assert latency_us <= (1_000 if how == "button" else 7_000)
    machine.ask("$X")
    moved_mm = [sum(sign for _, sign in steps(machine.pico.edges, axis)) / 80 for axis in range(3)]
    assert position_mm(machine) == pytest.approx(
        [a + b for a, b in zip(start_mm, moved_mm)], abs=0.001
    )


def test_limit_switch_stops_all_axes_within_300_us(machine: Board) -> None:
    machine.ask("$21=1")  # hard limits
    machine.pico.edges.clear()
    machine.ask("G91 G1 X12 Y5 F1800")
    machine.pico.run_us(150_000)
    machine.clear_output()
    closed_us = machine.pico.us
    machine.pico.drive(LIMIT[1], 0)  # Y's switch closes
    machine.wait_for("Reset to continue")
    assert machine.pico.edges[-1].ns / 1000 - closed_us <= 300
    machine.pico.drive(LIMIT[1], 1)
    machine.clear_output()
    machine.send("\x18")
    machine.wait_for("Grbl 1.1h")
    machine.ask("$X")
    machine.ask("$21=0")


def test_emergency_stop_stops_everything_and_locks_the_machine(machine: Board) -> None:
    """Its contact opens in motion, with the spindle on: all edges end within 300 us."""
    machine.ask("M3 S500")
    machine.ask("G91 G1 X12 Y5 F1800")
    machine.pico.run_us(150_000)
    machine.clear_output()
    opened_us = machine.pico.us
    machine.pico.drive(ESTOP, 1)
    machine.wait_for("unlock]\r\n")
    assert "ALARM:17\r\n" in machine.output and "[MSG:Emergency stop]" in machine.output
    # The last edge of steps and of the spindle's PWM.
    assert machine.pico.edges[-1].ns / 1000 - opened_us <= 300
    # It cannot be unlocked while the contact is open.
    assert machine.ask("$X", "error:9\r\n") == "[MSG:Emergency stop]\r\nerror:9\r\n"
    machine.pico.drive(ESTOP, 0)
    machine.ask("$X")


def test_probe_position_is_that_of_the_contact(machine: Board) -> None:
    """The reported position is a step off at most (1/80 mm) from the steps made at the contact."""
    start_z_mm = position_mm(machine)[2]
    machine.pico.edges.clear()
    contact_steps: list[int] = []

    def touch() -> None:
        """Record Z's steps until now, and close the probe's contact."""
        contact_steps.append(sum(sign for _, sign in steps(machine.pico.edges, 2)))
        machine.pico.drive(PROBE, 0)

    machine.pico.at_us(213_000, touch)
    said = machine.ask("G91 G38.2 Z-20 F600", limit_us=4_000_000)
    machine.pico.drive(PROBE, 1)
    probed_mm = float(said.partition("[PRB:")[2].split(":")[0].split(",")[2])
    assert probed_mm == pytest.approx(start_z_mm + contact_steps[0] / 80, abs=0.0126)


def test_homing_finds_the_switches(machine: Board) -> None:
    """Switches of X and Y are 3 mm away, Z's 2 mm; they follow the motors."""
    switches = [240, 240, 160]  # steps, 80 per mm
    for setting in ("$23=0", "$24=300", "$25=1200", "$27=1", "$26=5", "$22=1"):
        machine.ask(setting)
    machine.ask("$X")
    at_steps = [0, 0, 0]

    def update_switches() -> None:
        """Set the switches for the motors' positions, every millisecond from now on."""
        for axis in range(3):
            at_steps[axis] = sum(sign for _, sign in steps(machine.pico.edges, axis))
            machine.pico.drive(LIMIT[axis], 0 if at_steps[axis] >= switches[axis] else 1)
        machine.pico.at_us(1_000, update_switches)

    machine.pico.edges.clear()
    update_switches()
    machine.ask("$H", limit_us=12_000_000)
    # The home position is the pull-off ($27, 1 mm) from the place where the switch closes.
    assert position_mm(machine) == pytest.approx([-1, -1, -1], abs=0.001)
    for axis in range(3):
        assert abs(at_steps[axis] - (switches[axis] - 80)) <= 3
