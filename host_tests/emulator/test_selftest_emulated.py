"""Test `ugrbl selftest` at an emulated Pico: all checks pass, and faults make them fail."""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from chips import CHIP
from emulated import STEP, Board, firmware, for_this_chip
from ugrbl.compiling import build
from ugrbl.device.deploy import About
from ugrbl.device.selftest import program
from ugrbl.device.selftest.row import Row
from ugrbl.device.selftest.session import WIRING, Wiring, check, look
from ugrbl.paths import BOARDS

pytestmark = pytest.mark.xdist_group("pico selftest")

_CHIP = getattr(program, CHIP.name.upper())
_RAW = "raw REPL; CTRL-B to exit\r\n>"
_PIECE_US = 5_000
_MOST_S = 15  # of emulated time: enough for any check, and a hang does not take hours
# The default watchdog waits 5 s for a hanging main loop; a shorter time is enough here.
_BOARD = {"board.py": firmware()["board.py"] + b"WATCHDOG_MS = 1500\n"}
_ERASE_US = 45_000


class Emulated:
    """A Board of session.py on an emulated chip."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._is_at_prompt = False
        board.pico.record([STEP[0]])  # lets PIO keep its time while the processor sleeps

    def enter(self) -> None:
        """Go to the raw prompt, with a soft reset: Ctrl-D."""
        if not self._is_at_prompt:
            self._board.python("pass")
            self._is_at_prompt = True
        self._board.clear_output()
        self._board.send("\x04")
        self._board.wait_for("soft reboot\r\n")
        self._board.wait_for(_RAW)

    def about(self) -> About:
        """Return MicroPython's version and the name of the board."""
        printed = self._board.python_again("import os, sys; print(os.uname()[2], os.uname()[4])")
        version, _, machine = printed.strip().partition(" ")
        return About(0, version, machine)

    def wiring(self) -> Wiring:
        """Return the engine's name, two pins, and the number of motors."""
        printed = self._board.python_again(WIRING + "print(wiring())")
        engine, enable, pwm, has_pcnt, motors = printed.strip()[1:-1].split(", ")
        assert has_pcnt == "False"
        return Wiring(engine.strip("'"), int(enable), int(pwm), False, int(motors))

    def run(self, script: str, heard: "Callable[[str], None]", seconds: float) -> str:
        """Run a script at the raw prompt; pass its lines to heard(), return its exception.

        The raw prompt sends "OK", the output, Ctrl-D, the exception and Ctrl-D.
        """
        self._send(script, lambda: self._board.output.count("\x04") >= 2, seconds)
        output, exception, _ = self._board.output.removeprefix("OK").split("\x04", 2)
        for line in output.split("\r\n"):
            heard(line)
        return exception

    def until_restart(self, script: str, heard: "Callable[[str], None]", seconds: float) -> bool:
        """Run a script that reports "= hang" and hangs; return whether the board restarts."""

        def is_back() -> bool:
            return "Grbl 1.1h" in self._board.output.partition("= hang")[2]

        self._send(script, is_back, seconds)
        for line in self._board.output.split("\r\n"):
            heard(line)
        return is_back()

    def start(self) -> None:
        """Leave the prompt and start the firmware, by a soft reset."""
        self._board.send("\x02\x04")

    def _send(self, script: str, done: "Callable[[], bool]", seconds: float) -> None:
        """Send a script to the raw prompt; run until done() holds or the time is over."""
        self._board.clear_output()
        self._board.send(script + "\x04")
        self._board.pico.run_until(done, min(seconds, _MOST_S) * 1e6, _PIECE_US)


def test_firmware_passes_all_checks_that_can_be_shown_here(uf2: Path) -> None:
    """None fails and none is left out; a save of settings blocks interrupts for an erasure."""
    machine = Board(uf2, _BOARD).boot().settled()
    board = Emulated(machine)
    chip, wiring = look(board)
    # ENABLE at pin 8, the spindle's PWM at 16, no pulse counter, three motors.
    assert (chip, wiring) == (_CHIP, Wiring("pio", 8, 16, False, 3))
    machine.pico.erase_takes_us(_ERASE_US)
    rows: "dict[str, Row]" = {}
    check(
        board,
        chip,
        program.QUICK,
        pwm=True,
        seed=13,
        tell=lambda row: rows.update({row.what: row}),
    )
    failed = [row for row in rows.values() if row.passed is False]
    assert not failed
    assert not [row for row in rows.values() if row.passed is None]
    assert {"stops at random instants", "limit: time to the last step edge"} <= set(rows)
    assert rows["settings save: interrupts off"].figures["longest_us"] >= _ERASE_US
    assert machine.status()["state"] in ("Idle", "Alarm")


@pytest.mark.parametrize("motors", [5, 6])
def test_five_and_six_motors_are_counted_in_turn(
    uf2: Path, motors: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their engine uses machines of PIO 1; the free machines count some motors at a time."""
    less = f"STEP, DIR, LIMIT = STEP[:{motors}], DIR[:{motors}], LIMIT[:{motors}]\n"
    file = for_this_chip(BOARDS / "pico_six.py", f"WATCHDOG_MS = 1500\n{less}")
    # fromkeys(): None instead of each file of the common board.
    files = {**dict.fromkeys(firmware()), **build.for_board(file).files}
    machine = Board(uf2, files)
    for pin in (*range(15, 23), 0, 1, 28):  # open inputs
        machine.pico.drive(pin, 1)
    board = Emulated(machine.boot().settled())
    chip, wiring = look(board)
    assert (chip, wiring) == (_CHIP, Wiring("pio", 14, 26, False, motors))
    rows: "dict[str, Row]" = {}
    monkeypatch.setattr(sys.modules[__name__], "_MOST_S", 30)  # counting in turn takes longer
    check(
        board, chip, program.QUICK, pwm=True, seed=5, tell=lambda row: rows.update({row.what: row})
    )
    failed = [row for row in rows.values() if row.passed is False]
    # At most this check fails.
    assert [row.what for row in failed] == ["settings save: interrupts off"][: len(failed)]
    for rate in ("1 kHz", "50 kHz", "the highest"):
        row = rows[f"steps at {rate}, all axes"]
        assert row.passed and f"on each of {motors} axes" in row.text
    limit = "limit: time to the last step edge"
    for what in ("stops at random instants", "starts from rest", limit):
        assert rows[what].passed, what


# An engine whose pulses are too short, that gives DIR no time, and that is one step off.
_WORSE = """
from pio import engine, pulses
set_timing, position = pulses.set_timing, engine.PioEngine.position
pulses.set_timing = lambda timing, pulse, hold, setup: set_timing(timing, pulse - 5, 0, 0)
def lie(self, steps):
    position(self, steps)
    steps[0] += 1
engine.PioEngine.position = lie
"""
_FEW = replace(
    program.QUICK, run_ms=1, seen=(2, 1), windows=1, stops=4, starts=2, limits=1, saves=1
)


class Worse(Emulated):
    """A board with that engine."""

    def run(self, script: str, heard: "Callable[[str], None]", seconds: float) -> str:
        return super().run(_WORSE + script, heard, seconds)

    def until_restart(self, script: str, heard: "Callable[[str], None]", seconds: float) -> bool:
        return False


def test_wrong_engine_fails(uf2: Path) -> None:
    """_WORSE is put in front of each script: pulses too short, no time for DIR, a wrong position.
    Checks that do not depend on these pass."""
    board = Worse(Board(uf2, {"main.py": b""}))
    board._is_at_prompt = True
    machine = board._board
    machine.pico.run_us(400_000)  # MicroPython starts
    machine.send("\r\x03\x01")  # Ctrl-C, and Ctrl-A: the raw prompt
    machine.wait_for(_RAW)
    chip, _ = look(board)
    rows: "dict[str, Row]" = {}
    check(board, chip, _FEW, pwm=False, seed=13, tell=lambda row: rows.update({row.what: row}))
    failed = {row.what for row in rows.values() if row.passed is False}
    assert failed >= {
        "steps at 1 kHz, all axes",
        "steps at the highest, all axes",
        "pulse width, 50 kHz",
        "direction hold",
        "direction set-up",
        "stops at random instants",
        "starts from rest",
        "limit: time to the last step edge",
        "hang on purpose: watchdog",
    }
    assert rows["watchers see the pins"].passed and rows["skew between axes, 50 kHz"].passed
    assert rows["spindle PWM"].passed is None  # left out
