"""Test pins other than steps on the emulated Pico: its pads and its hard interrupts.

Only the port is there, at MicroPython's prompt. Its interrupts cannot allocate, because the heap
is locked, so a callback that allocates would be reported as failed.
"""

from functools import partial
from pathlib import Path

import pytest
from emulated import LIMIT, PROBE, RESET, SPINDLE_PWM, Board

pytestmark = pytest.mark.xdist_group("pico port")

FLOOD, ESTOP = 18, 21

SETUP = f"""
import board
from pio import pins
board.INVERT = ("FLOOD",)
board.ESTOP = {ESTOP}
port = pins.GpioPort(board)
heard = bytearray(4)
def note(i):
    heard[i] += 1
class Listener:
    def on_limits(self):
        note(0)
    def on_controls(self, active):
        note(1)
    def on_fault(self):
        note(2)
port.attach(Listener())
port.enable_limits(True)
"""


@pytest.fixture(scope="module")
def machine(uf2: Path) -> Board:
    """Return a board at the raw prompt, where SETUP has made the port.

    Its `heard` counts the callbacks: limits, controls, faults, and the probe's contact.
    """
    made = Board(uf2, {"main.py": b""})
    assert made.pico.run_until(lambda: made.pico.usb.connected > 0, 3_000_000)
    made.send("\x03")  # Ctrl-C: the prompt
    made.wait_for(">>> ")
    made.send("\x01")  # Ctrl-A: the raw prompt
    made.wait_for("raw REPL; CTRL-B to exit\r\n>")
    assert made.python_again(SETUP) == ""
    made.pico.drive(ESTOP, 0)
    return made


def pads(machine: Board) -> "tuple[int | None, int | None]":
    """Return the outputs: power, and flood coolant, which is on when low."""
    machine.pico.run_us(1_000)
    return machine.pico.level(SPINDLE_PWM), machine.pico.level(FLOOD)


OFF, ON = (0, 1), (1, 0)
SWITCH_ON = "port.spindle(True, port_max)\nport.coolant(1)"


def test_killed_pads_stay_off_whatever_is_written_to_pin_and_pwm(machine: Board) -> None:
    """From kill() to revive(); that does not switch them on itself."""
    machine.python_again("port_max = board.PWM_MAX")
    assert pads(machine) == OFF
    machine.python_again(SWITCH_ON)
    assert pads(machine) == ON
    machine.python_again("port.kill()")
    assert pads(machine) == OFF
    machine.python_again(SWITCH_ON)
    assert pads(machine) == OFF
    machine.python_again("port.revive()")
    assert pads(machine) == OFF
    machine.python_again(SWITCH_ON)
    assert pads(machine) == ON
    machine.python_again("port.kill()\nport.revive()")
    assert pads(machine) == OFF


def test_storm_on_a_limit_input_is_limited_to_one_call_in_2_ms(machine: Board) -> None:
    """The storm has an edge every 25 us for 10 ms."""
    machine.python_again("heard[0] = 0\nimport time")
    for number in range(400):
        level = number & 1
        edge_us = 1_000 + 25 * number
        machine.pico.at_us(edge_us, partial(machine.pico.drive, LIMIT[0], level))
    machine.python_again("time.sleep_ms(20)")
    calls, _, failed, _ = machine.python_again("print(*heard)").split()
    assert 1 <= int(calls) <= 11  # 10 ms; there are at least 2 ms between calls
    assert failed == "0"


def test_inputs_are_handled_in_hard_interrupts_that_allocate_nothing(machine: Board) -> None:
    """All inputs close (the emergency stop opens), then all change back.

    heard: calls for limits, controls, faults, and the probe when it closes (True).
    """
    machine.python_again("heard[:] = bytes(4)\nport.watch_probe(lambda: note(3), True)")
    for pin, level in ((LIMIT[1], 0), (RESET, 0), (PROBE, 0), (ESTOP, 1)):
        machine.pico.drive(pin, level)
        machine.pico.run_us(6_000)
    # One call each for limit, button and probe; the emergency stop is polled again, so controls
    # have three.
    assert machine.python_again("print(*heard, port.estop())") == "1 3 0 1 True\r\n"
    for pin, level in ((LIMIT[1], 1), (RESET, 1), (PROBE, 1), (ESTOP, 0)):
        machine.pico.drive(pin, level)
        machine.pico.run_us(6_000)
    calls = machine.python_again("print(*heard, port.estop())").split()
    assert (calls[0], calls[2:]) == ("2", ["0", "1", "False"])


def test_disabled_limits_are_ignored(machine: Board) -> None:
    """heard: calls for limits, controls, faults, and the probe."""
    machine.python_again("heard[:] = bytes(4)\nport.enable_limits(False)")
    machine.pico.drive(LIMIT[2], 0)
    machine.pico.run_us(6_000)
    machine.pico.drive(RESET, 0)  # MicroPython then reads all pins
    machine.pico.run_us(6_000)
    machine.pico.drive(LIMIT[2], 1)
    machine.pico.drive(RESET, 1)
    machine.pico.run_us(6_000)
    assert machine.python_again("print(*heard)") == "0 2 0 0\r\n"


FAILING = """
def note(i):
    if i == 2:
        heard[2] += 1
    else:
        [0] * i
"""


def test_failing_callback_kills_the_tool_in_its_interrupt(machine: Board) -> None:
    """FAILING's callbacks allocate a list, which fails there; heard[2] counts calls of
    on_fault."""
    machine.python_again("port.enable_limits(True)\n" + SWITCH_ON)
    assert pads(machine) == ON
    machine.python_again(FAILING)
    machine.pico.drive(RESET, 0)
    machine.pico.run_us(2_000)
    assert pads(machine) == OFF
    assert machine.python_again("print(heard[2])") == "1\r\n"
    machine.pico.drive(RESET, 1)
