"""Watched on the emulated Pico: a main loop that hangs, a port that opens, flash, a deaf host."""

from pathlib import Path

import pytest
from emulated import ENABLE, SPINDLE_PWM, STEP, Board, steps

pytestmark = pytest.mark.xdist_group("pico watch")

_LIMIT_MS = 250  # how long the main loop may be away
_BEAT_MS = 5

# A user's commands, in main.py. How long they last: $BUSY=ms; for ever: $HANG.
_MAIN = b"""
import time

import commands
import power_up
import store_flash

usual = commands.Commands.execute
replace = store_flash.FlashStore._replace


def execute(self, line, length):
    what = bytes(line[1:length])
    if what == b"HANG":
        while True:
            pass
    elif what[:5] == b"BUSY=":
        since = time.ticks_ms()
        while time.ticks_diff(time.ticks_ms(), since) < int(what[5:]):
            pass
    else:
        usual(self, line, length)


def slow(self, path, kept):
    # As slow as a chip's flash: the emulator's takes no time.
    time.sleep_ms(400)
    replace(self, path, kept)


commands.Commands.execute = execute
machine = power_up.main()
"""


@pytest.fixture(scope="module")
def machine(uf2: Path) -> Board:
    made = Board(uf2, {"main.py": _MAIN}).boot().settled()
    made.pico.record([*STEP, SPINDLE_PWM, ENABLE])
    return made


def moving(machine: Board) -> None:
    """A long move with the spindle on."""
    machine.ask("M3 S500")
    machine.ask("G91 G1 X20 F500")
    machine.pico.run_us(100_000)
    machine.forget()


def last_ms(machine: Board, since_us: float) -> "tuple[float, float]":
    """When the last step came, and the last edge of the spindle's PWM, in ms."""
    step = steps(machine.pico.edges, 0)[-1][0]
    pwm = max(e.ns for e in machine.pico.edges if e.pin == SPINDLE_PWM) / 1000
    return (step - since_us) / 1000, (pwm - since_us) / 1000


def test_a_main_loop_that_hangs_is_stopped_and_told_of_when_it_is_back(machine: Board) -> None:
    moving(machine)
    since = machine.pico.us
    machine.send("$BUSY=400\n")
    machine.wait_for("ALARM:16\r\n[MSG:RuntimeErr: the main loop was away for ")
    machine.pico.run_us(20_000)
    for stopped_ms in last_ms(machine, since):
        assert _LIMIT_MS - _BEAT_MS < stopped_ms <= _LIMIT_MS + 2 * _BEAT_MS + 2
    away = int(machine.said.split("away for ")[1].split(" ms")[0])
    assert 400 - 2 * _BEAT_MS <= away <= 400 + _BEAT_MS
    assert machine.said.startswith("ok\r\nALARM:16\r\n")  # the line itself was no fault
    machine.forget()
    machine.send("\x18")
    machine.wait_for("Grbl 1.1h")
    assert machine.ask("$X").endswith("ok\r\n")


def test_it_works_again_after_that_and_a_shorter_time_is_no_fault(machine: Board) -> None:
    moving(machine)
    machine.ask("$BUSY=200")
    before = len(steps(machine.pico.edges, 0))
    machine.pico.run_us(50_000)
    assert len(steps(machine.pico.edges, 0)) > before
    machine.send("\x18")
    machine.wait_for("Grbl 1.1h")
    machine.ask("$X")
