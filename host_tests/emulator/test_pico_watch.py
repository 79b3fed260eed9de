"""Test the watch on the emulated Pico: hanging main loop, opened port, flash, deaf host.

ask() sends a line and returns its answer, clear_output() forgets the output so far. Inputs are
closed at level 0. Steps are found in the edges recorded at the pins.
"""

from collections.abc import Callable
from pathlib import Path

import pytest
from emulated import ENABLE, LIMIT, SPINDLE_PWM, STEP, Board, steps

pytestmark = pytest.mark.xdist_group("pico watch")

_LIMIT_MS = 250  # how long the main loop may be away
_BEAT_MS = 5

# A user's commands in main.py: $BUSY=ms blocks so long, $HANG blocks forever.
_MAIN = b"""
import time

from boot import power_up

from talk import commands
usual = commands.Commands.find_command


def find_command(self, line, length):
    what = bytes(line[1:length])
    if what == b"HANG":
        while True:
            pass
    elif what[:5] == b"BUSY=":
        since = time.ticks_ms()
        while time.ticks_diff(time.ticks_ms(), since) < int(what[5:]):
            pass
    else:
        return usual(self, line, length)
    return lambda line, length: None


commands.Commands.find_command = find_command
machine = power_up.run_machine(power_up.build())
"""


@pytest.fixture(scope="module")
def machine(uf2: Path) -> Board:
    made = Board(uf2, {"main.py": _MAIN}).boot().settled()
    made.pico.record([*STEP, SPINDLE_PWM, ENABLE])
    return made


def start_long_move(machine: Board) -> None:
    """Start a long move with the spindle on."""
    machine.ask("M3 S500")
    machine.ask("G91 G1 X20 F500")
    machine.pico.run_us(100_000)
    machine.clear_output()


def last_edges_ms(machine: Board, since_us: float) -> "tuple[float, float]":
    """Return the times of the last step and of the last edge of the spindle's PWM, in ms."""
    step = steps(machine.pico.edges, 0)[-1][0]
    pwm = max(e.ns for e in machine.pico.edges if e.pin == SPINDLE_PWM) / 1000
    return (step - since_us) / 1000, (pwm - since_us) / 1000


def test_hanging_main_loop_is_stopped_and_reported_when_it_returns(machine: Board) -> None:
    """$BUSY=400, a command added by the fixture, takes 400 ms; motors and spindle stop after
    250 ms, checked every 5 ms."""
    start_long_move(machine)
    sent_us = machine.pico.us
    machine.send("$BUSY=400\n")
    machine.wait_for("ALARM:16\r\n[MSG:RuntimeErr: the main loop was blocked for ")
    machine.pico.run_us(20_000)
    for stopped_ms in last_edges_ms(machine, sent_us):
        assert _LIMIT_MS - _BEAT_MS < stopped_ms <= _LIMIT_MS + 2 * _BEAT_MS + 2
    blocked_ms = int(machine.output.split("blocked for ")[1].split(" ms")[0])
    assert 400 - 2 * _BEAT_MS <= blocked_ms <= 400 + _BEAT_MS
    assert machine.output.startswith("ok\r\nALARM:16\r\n")  # the line itself is accepted
    machine.clear_output()
    machine.send("\x18")
    machine.wait_for("Grbl 1.1h")
    assert machine.ask("$X").endswith("ok\r\n")


def test_machine_works_after_that_alarm_and_a_shorter_delay_is_no_fault(machine: Board) -> None:
    """$BUSY=200, a command added by the fixture, takes 200 ms: less than the limit of 250 ms."""
    start_long_move(machine)
    machine.ask("$BUSY=200")
    before = len(steps(machine.pico.edges, 0))
    machine.pico.run_us(50_000)
    assert len(steps(machine.pico.edges, 0)) > before
    machine.send("\x18")
    machine.wait_for("Grbl 1.1h")
    machine.ask("$X")


def test_host_that_does_not_read_stops_no_motion(machine: Board) -> None:
    """The answer to $$ does not fit into the buffers; after 900 ms the motor still steps."""
    start_long_move(machine)
    machine.pico.usb.read(False)
    machine.send("$$\n")
    machine.pico.edges.clear()
    machine.pico.run_us(900_000)
    last_step_us = steps(machine.pico.edges, 0)[-1][0]
    assert last_step_us > machine.pico.us - 2_000
    machine.pico.usb.read(True)
    machine.pico.run_us(50_000)
    assert machine.status()["state"] == "Run"
    machine.send("\x18")
    machine.wait_for("Grbl 1.1h")
    machine.ask("$X")


# The requests that close and open a port. None is SET_LINE_CODING, numbers are levels of DTR (1)
# and RTS (2). Linux: cdc-acm sends the coding first, then pyserial sets it again.
_REOPENED: "dict[str, tuple[list[int | None], list[int | None]]]" = {
    "Linux": ([0], [None, 3]),
    "Linux, pyserial": ([0], [None, 3, None, 3, None]),
    "Linux, coding last": ([0], [3, None]),
    "Windows": ([1, 0], [0, None, 1, 3, None]),
    "macOS": ([0], [3, None, None]),
    "coding after the end": ([0, None], [3]),
}


def welcomes_after_reopening(
    machine: Board, closing: "list[int | None]", opening: "list[int | None]"
) -> int:
    """Close and open the port by these requests (see _REOPENED); return the number of welcomes."""
    machine.clear_output()
    for requests in (closing, opening):
        for request in requests:
            machine.pico.usb.ask(request)
            machine.pico.run_us(300)  # all within one poll of the firmware
        machine.pico.run_us(20_000)
    machine.pico.run_us(330_000)  # a silent sender is greeted after a delay
    return machine.output.count("Grbl 1.1h")


@pytest.mark.parametrize("system", list(_REOPENED))
def test_sender_is_welcomed_for_the_requests_of_every_system(machine: Board, system: str) -> None:
    assert welcomes_after_reopening(machine, *_REOPENED[system]) == 1
    assert machine.ask("G90") == "ok\r\n"


def test_sender_that_changes_its_speed_is_not_welcomed_again(machine: Board) -> None:
    assert welcomes_after_reopening(machine, [None], [3, None]) == 0


def test_sender_that_opens_the_port_in_motion_is_welcomed(machine: Board) -> None:
    start_long_move(machine)
    # The requests of Linux: DTR low; line coding, DTR and RTS high.
    assert welcomes_after_reopening(machine, [0], [None, 3]) == 1
    assert machine.status()["state"] == "Run"
    machine.send("\x18")
    machine.wait_for("to unlock]")
    machine.ask("$X")


def pwm_rises_us(machine: Board, since_us: float) -> "list[float]":
    """Return the times of rising edges of the spindle's PWM, in us."""
    edges = (e for e in machine.pico.edges if e.pin == SPINDLE_PWM and e.level)
    return [e.ns / 1000 for e in edges if e.ns / 1000 > since_us]


_ERASE_US = 45_000


def save_until(machine: Board, until: "Callable[[list[float]], bool]") -> "list[float]":
    """Save offsets until the condition holds; return the times at which erasures began, in us.

    until() is passed these times. Most saves fit into a sector that was erased before.
    """
    begins: list[float] = []
    machine.pico.erase_takes_us(_ERASE_US)
    machine.pico.on_erase = lambda: begins.append(machine.pico.us)
    for x in range(40):
        machine.clear_output()
        machine.send(f"G10 L2 P1 X{x}\n")
        machine.pico.run_until(
            lambda: until(begins) or "ok\r\n" in machine.output, 3_000_000, step_us=50
        )
        if until(begins):
            break
    machine.pico.on_erase = lambda: None
    assert until(begins)
    return begins


def test_laser_is_off_while_flash_is_written_and_on_again_afterwards(machine: Board) -> None:
    """No pulse from 0.5 ms before the erasure to its end."""
    for line in ("$32=1", "G91", "M3 S500", "G1 X0.1 F600"):
        machine.ask(line)
    machine.until_idle()
    machine.pico.edges.clear()
    machine.pico.run_us(5_000)
    assert pwm_rises_us(machine, 0)  # it burns while idle, as M3 requires
    begins = save_until(machine, lambda begins: bool(begins) and "ok\r\n" in machine.output)
    answered_us = machine.pico.us
    machine.pico.run_us(5_000)
    end_us = begins[-1] + _ERASE_US
    assert not [us for us in pwm_rises_us(machine, begins[-1] - 500) if us < end_us]
    assert pwm_rises_us(machine, answered_us)
    machine.ask("M5")


def test_events_during_a_flash_erasure_are_handled_afterwards(machine: Board) -> None:
    """A limit switch with the spindle on, and a byte: late, but not lost."""
    for line in ("$32=0", "$21=1", "M3 S500"):
        machine.ask(line)
    (begun_us,) = save_until(machine, bool)  # until an erasure has begun
    machine.pico.drive(LIMIT[0], 0)
    machine.clear_output()
    machine.send("?")
    machine.wait_for("Reset to continue")
    machine.pico.run_us(20_000)
    assert pwm_rises_us(machine, begun_us)  # no reaction during the erasure
    assert pwm_rises_us(machine, begun_us)[-1] - begun_us < _ERASE_US + 2_000
    machine.pico.drive(LIMIT[0], 1)
    machine.pico.erase_takes_us(0)
    machine.send("\x18")
    machine.wait_for("Grbl 1.1h")
    machine.ask("$X")
    machine.ask("$21=0")


# MicroPython builds with another memory layout


def test_last_request_shows_an_opened_port_when_control_lines_are_unknown(uf2: Path) -> None:
    """find_line() looks for the control lines in MicroPython's memory; here it finds nothing."""
    hidden = b"from ports.usb import usb_ring\nusb_ring.find_line = lambda memory: 0\n"
    machine = Board(uf2, {"main.py": hidden + _MAIN}).boot().settled()
    for closing, opening in _REOPENED.values():
        if closing[-1] == 0:  # otherwise the last request says that it is open
            assert welcomes_after_reopening(machine, closing, opening) == 1
    assert welcomes_after_reopening(machine, [None], [3, None]) == 0  # only a new speed
    assert "slow-reset" not in machine.ask("$I")


def test_board_without_the_usb_ring_works_and_reports_a_slow_reset(uf2: Path) -> None:
    """find() looks for the ring of received bytes in MicroPython's memory; here it finds nothing.

    So an interrupt cannot see a Ctrl-X: "slow-reset". The watch still acts.
    """
    hidden = b"from ports.usb import usb_ring\nusb_ring.find = lambda at, drain, take: None\n"
    machine = Board(uf2, {"main.py": hidden + _MAIN}).boot().settled()
    assert "[VER:1.1h." in machine.ask("$I") and " slow-reset]" in machine.output
    machine.pico.record([*STEP, SPINDLE_PWM])
    start_long_move(machine)
    machine.send("$BUSY=400\n")
    machine.wait_for("the main loop was blocked for ")
