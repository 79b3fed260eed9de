"""Test faults on the emulated Pico: one line reports the fault, and motors and tool are off.

ask() sends a line and returns its answer, clear_output() forgets the output so far. Inputs are
closed at level 0. Steps are found in the edges recorded at the pins.
"""

from pathlib import Path

import pytest
from chips import BLOCK, CHIP, file_system
from emulated import ENABLE, SPINDLE_PWM, STEP, Board, build_id, firmware, steps
from ugrbl.image.uf2 import Uf2Error

pytestmark = pytest.mark.xdist_group("pico faults")

BOARD = firmware()["board.py"]
_HOOK = b"""
from boot import power_up
import time

from talk import commands
from motion import segments
following = segments.Segments.next
spoilt = bytearray(1)


def next(self, row):
    if spoilt[0]:
        spoilt[0] = 0
        spoilt[1]
    return following(self, row)


segments.Segments.next = next

usual = commands.Commands.find_command


def whose(self, line, length):
    what = bytes(line[1:length])
    if what == b"FAULT":
        [][1]
    elif what == b"TURN":
        spoilt[0] = 1
    elif what == b"HANG":
        while True:
            pass
    elif what == b"BUSY":
        since = time.ticks_ms()
        while time.ticks_diff(time.ticks_ms(), since) < 200:
            pass
    else:
        return usual(self, line, length)
    return lambda line, length: None


commands.Commands.find_command = whose
power_up.run_machine(power_up.build())
"""


@pytest.fixture(scope="module")
def machine(uf2: Path) -> Board:
    """Return a board whose main.py (_HOOK) adds commands.

    $FAULT raises in the main loop, $TURN in the engine's interrupt, $HANG never ends, and $BUSY
    takes 200 ms. The watchdog restarts the chip after 1.5 s.
    """
    made = (
        Board(uf2, {"main.py": _HOOK, "board.py": BOARD + b"WATCHDOG_MS = 1500\n"})
        .boot()
        .settled()
    )
    made.ask("$120=200")
    made.pico.record([*STEP, SPINDLE_PWM, ENABLE])
    return made


def assert_no_pulses(machine: Board) -> None:
    """Check that steps and spindle pulses have ended."""
    machine.pico.run_us(5_000)
    machine.pico.edges.clear()
    machine.pico.run_us(100_000)
    assert not [edge for edge in machine.pico.edges if edge.pin != ENABLE]


def test_firmware_fault_is_an_alarm_and_a_reset_recovers(machine: Board) -> None:
    """$FAULT, a command added by the fixture, raises an IndexError in motion."""
    machine.ask("M3 S500")
    machine.ask("G91 G1 X20 F500")
    machine.pico.run_us(200_000)
    assert steps(machine.pico.edges, 0)
    machine.clear_output()
    machine.send("$FAULT\n")
    machine.wait_for("ALARM:16\r\n[MSG:IndexErr: list index out of range")
    assert_no_pulses(machine)
    assert machine.status()["state"] == "Alarm"
    machine.clear_output()
    machine.send("G0 X1\n")  # only a reset is accepted
    machine.pico.run_us(50_000)
    assert machine.output == ""
    machine.send("$")  # the fault is reported again on request
    machine.wait_for(f"({build_id()})]\r\n")
    machine.send("\x18")
    machine.wait_for("Grbl 1.1h")
    assert "[MSG:Last fault: IndexErr: list index out of range" in machine.ask("$I+")
    assert machine.ask("$X").endswith("ok\r\n")
    assert machine.ask("G90") == "ok\r\n"


def test_exception_in_the_engines_interrupt_is_an_alarm_and_the_engine_recovers(
    machine: Board,
) -> None:
    """$TURN, a command added by the fixture, makes the next call for a segment raise."""
    machine.ask("$X")
    machine.ask("M3 S500")
    machine.ask("G91 G1 X20 F500")
    machine.pico.run_us(200_000)
    assert steps(machine.pico.edges, 0)
    machine.clear_output()
    machine.send("$TURN\n")
    machine.wait_for("the pulse engine's interrupt has failed")
    assert "ALARM:16" in machine.output and "Uncaught" not in machine.output
    assert_no_pulses(machine)
    machine.clear_output()
    machine.send("\x18")
    machine.wait_for("Grbl 1.1h")
    machine.ask("$X")
    machine.pico.edges.clear()
    machine.ask("G91 G1 X1 F500")
    machine.until_idle()
    assert len(steps(machine.pico.edges, 0)) == 250  # per mm


def test_ctrl_x_stops_motion_while_the_main_loop_is_busy(machine: Board) -> None:
    """$BUSY, a command added by the fixture, takes 200 ms; the last step comes within 10 ms."""
    machine.ask("G91 G1 X20 F500")
    machine.pico.run_us(100_000)
    machine.send("$BUSY\n")
    machine.pico.run_us(50_000)
    sent_us = machine.pico.us
    machine.clear_output()
    machine.send("\x18")
    machine.pico.run_us(20_000)
    machine.pico.run_until(lambda: "Grbl 1.1h" in machine.output, 1_000_000)
    assert "ALARM:3" in machine.output
    last_step_us = steps(machine.pico.edges, 0)[-1][0]
    assert last_step_us - sent_us <= 10_000
    machine.pico.run_us(50_000)
    assert machine.output.count("Grbl") == 1


def test_hanging_main_loop_restarts_the_chip(machine: Board) -> None:
    """$HANG, a command added by the fixture, never ends; the watchdog is set to 1.5 s."""
    machine.ask("$X")
    machine.ask("M3 S500")
    machine.clear_output()
    machine.send("$HANG\n")
    machine.wait_for("Grbl 1.1h", 8_000_000)
    assert_no_pulses(machine)


_GOOD = "ENGINE = 'pio'\nSTEP = (2, 3, 4)\nDIR = (5, 6, 7)\n"


@pytest.mark.parametrize(
    ("changes", "cause"),
    [
        ({"motion/planner.mpy": None}, "no module named 'motion.planner'"),
        ({"board.py": _GOOD.replace("7", "2").encode()}, "DIR: pin 2 is STEP already"),
        ({"board.py": _GOOD.replace("4", "40").encode()}, "STEP: this chip has no pin 40"),
        (
            {"board.py": _GOOD.replace("pio", "steam").encode()},
            "ENGINE must be i2s, pio or rmt, not steam",
        ),
        ({"board.py": (_GOOD + "TOOL = 'punch'\n").encode()}, "no module named 'extras"),
    ],
)
def test_machine_that_cannot_be_built_reports_the_cause_on_request(
    uf2: Path, changes: "dict[str, bytes | None]", cause: str
) -> None:
    """changes: files to replace, or to leave out (None). No step is made, and the
    prompt is available."""
    machine = Board(uf2, changes)
    machine.pico.record([*STEP])
    machine.wait_for("]\r\n")
    machine.clear_output()
    machine.send("?")
    answer = machine.wait_for("]\r\n")
    # "ok" and "error" would be taken for answers to lines.
    assert cause in answer and "ok" not in answer and "rror" not in answer
    assert not machine.pico.edges
    assert machine.python("print(2 + 2)", prompt="") == "4\r\n"


@pytest.mark.parametrize(
    ("board_file", "cause"),
    [(None, "no module named 'board'"), (b"STEP = (2, 3, 4\n", "SyntaxErr")],
)
def test_missing_board_file_is_reported_and_leads_to_the_prompt(
    uf2: Path, board_file: "bytes | None", cause: str
) -> None:
    """board_file: content of board.py, None: no such file."""
    machine = Board(uf2, {"board.py": board_file})
    assert cause in machine.wait_for(">>> ")
    machine.clear_output()
    machine.send("print(2 + 2)\r")
    machine.wait_for("4\r\n")


def test_damaged_settings_file_is_reported_and_factory_settings_apply(uf2: Path) -> None:
    machine = Board(uf2, {"saved/settings.txt": b"0=3\n110=99999\n#crc32=00000000\n"}).boot()
    assert "error:7" in machine.output and "$110=500.000" in machine.output


def files_that_fill_flash() -> "dict[str, bytes]":
    """Return files that leave no space: one takes all blocks, and empty ones fill the folder."""
    files: dict[str, bytes] = {}
    for name, size in (("filler", BLOCK), ("0" * 240, 0), ("0" * 30, 0), ("0", 0)):
        fits, too_many = 0, CHIP.blocks  # numbers of blocks or empty files, bisected
        while too_many - fits > 1:
            count = (fits + too_many) // 2
            try:
                file_system({**firmware(), **files, **_parts(name, size, count)})
                fits = count
            except Uf2Error:
                too_many = count
        files |= _parts(name, size, fits)
    return files


def _parts(name: str, size: int, count: int) -> "dict[str, bytes]":
    """Return one file of count times this size; with size 0 return count empty files."""
    if size:
        return {name: bytes(size * count)}
    return {f"{name}{k}": b"" for k in range(count)}


def test_full_flash_is_reported_and_a_setting_holds_until_power_off(uf2: Path) -> None:
    """The setting is used but cannot be stored: error 7. The machine moves: 250 steps/mm."""
    machine = Board(uf2, files_that_fill_flash()).boot()
    assert machine.status()["state"] == "Idle"
    said = machine.ask("$110=600", "error:")
    machine.pico.run_us(20_000)
    assert machine.output.startswith("[MSG:") and machine.output.endswith("error:7\r\n"), said
    assert "$110=600.000" in machine.ask("$$")
    machine.pico.record([*STEP])
    machine.ask("G91 G1 X1 F600")
    machine.until_idle()
    assert len(steps(machine.pico.edges, 0)) == 250
