"""Pins of the RP2040 on stand-ins, and the power-up checks of a board file.

Limits of X, Y and Z are at pins 9, 10 and 11, the probe at 12, buttons at 13, 14 and 15; all are
closed at level 0. Pin.calls counts the interrupts of a pin. expire() runs the callback of a timer
as if its time were over.
"""

from collections.abc import Iterator
from types import ModuleType, SimpleNamespace
from typing import Any

import machine
import pytest
from boot import power_up
from machine import PWM, Pin
from pio import pins as gpio
from pio.pins import GpioPort
from ports import pin_check
from ugrbl.boardfile.engines import engines

BOARD: dict[str, Any] = {
    "ENGINE": "pio",
    "STEP": (2, 3, 4),
    "DIR": (5, 6, 7),
    "ENABLE": 8,
    "LIMIT": (9, 10, 11),
    "PROBE": 12,
    "CONTROL": (13, 14, 15, None),
    "SPINDLE_PWM": 16,
    "SPINDLE_DIR": 17,
    "SPINDLE_ON": 19,
    "FLOOD": 18,
}
MOTORS = engines()["pio"].pins


def board(**changes: Any) -> ModuleType:
    """Return a board file with BOARD's pins and these changes."""
    make_port = ModuleType("board")
    vars(make_port).update({**BOARD, **changes})
    return make_port


@pytest.fixture(autouse=True)
def new_chip(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Reset the stand-ins for pins, PWM outputs and registers."""
    # The chip's interpreter names the chip; CPython's does not.
    monkeypatch.setattr(gpio.sys, "implementation", SimpleNamespace(_machine="with RP2040"))
    Pin.pins.clear()
    PWM.outputs.clear()
    monkeypatch.setattr(machine, "mem32", machine._Memory())
    yield
    Pin.pins.clear()


class CallCounts:
    """Count the calls of each callback."""

    def __init__(self) -> None:
        self.limits = self.controls = self.probe = self.faults = 0

    def on_limits(self) -> None:
        self.limits += 1

    def on_controls(self, _active: int) -> None:
        self.controls += 1

    def on_contact(self) -> None:
        self.probe += 1

    def on_fault(self) -> None:
        self.faults += 1


def make_port(**changes: Any) -> "tuple[GpioPort, CallCounts]":
    """Return the port of a changed board, limits enabled, and the counter of its callbacks."""
    port, counts = GpioPort(board(**changes)), CallCounts()
    port.attach(counts)
    port.enable_limits(True)
    return port, counts


def test_inputs_are_closed_when_pulled_to_ground() -> None:
    port, _ = make_port()
    assert (port.limits(), port.controls(), port.probe()) == (0, 0, False)
    for pin in (10, 13, 12):  # limit of Y, first control input, probe
        Pin(pin).drive(0)
    # A mask of axes, a mask of inputs, a level.
    assert (port.limits(), port.controls(), port.probe()) == (2, 1, True)


def test_unwired_inputs_are_never_closed() -> None:
    port, _ = make_port(LIMIT=(), PROBE=None, CONTROL=(None,) * 4)
    assert (port.limits(), port.controls(), port.probe()) == (0, 0, False)


def test_a_switch_is_reported_at_once_in_a_hard_interrupt() -> None:
    """Hard: it runs at once, not when the scheduler allows it. All inputs have one."""
    _, counts = make_port()
    Pin(9).drive(0)  # limit of X
    Pin(14).drive(0)  # a control input
    assert (counts.limits, counts.controls) == (1, 1)
    assert all(Pin(pin).hard for pin in (9, 10, 11, 12, 13, 14, 15))


def test_a_shared_input_reports_each_axis_and_interrupts_once() -> None:
    """X and Y use pin 9 for both limits, which the check of pins allows."""
    port, counts = make_port(LIMIT=(9, 9, 11))
    pin_check.check(board(LIMIT=(9, 9, 11)), MOTORS)
    Pin(9).drive(0)
    assert (port.limits(), counts.limits, Pin(9).calls) == (3, 1, 1)
    Pin(9).drive(1)
    port._look_timer.expire()  # after an interrupt, the timer looks at the pin again
    assert (port.limits(), counts.limits) == (0, 2)


def test_limits_interrupt_only_while_enabled() -> None:
    port, counts = make_port()
    port.enable_limits(False)
    Pin(9).drive(0)  # limit of X closes
    assert (Pin(9).calls, counts.limits) == (0, 0)
    port.enable_limits(True)
    Pin(10).drive(0)  # limit of Y closes
    assert counts.limits == 1


def test_interference_interrupts_rarely_and_blocks_no_other_input() -> None:
    """A pin that has interrupted does not do so again until a timer has looked at it."""
    port, counts = make_port()
    for _ in range(1000):  # interference at the limit of X
        Pin(9).drive(0)
        Pin(9).drive(1)
    assert (Pin(9).calls, counts.limits) == (1, 1)
    Pin(10).drive(0)  # limit of Y
    assert counts.limits == 2
    port._look_timer.expire()  # same level as at the last reported edge
    assert counts.limits == 2
    Pin(9).drive(0)
    assert counts.limits == 3
    Pin(9).drive(1)
    port._look_timer.expire()  # an edge without interrupt, found by the timer
    assert counts.limits == 4


def test_nothing_is_reported_after_limits_are_disabled() -> None:
    """Neither by the timer that looks at a pin after its interrupt, nor by another pin."""
    port, counts = make_port()
    Pin(9).drive(0)  # limit of X closes: reported
    port.enable_limits(False)
    Pin(9).drive(1)
    port._look_timer.expire()
    Pin(10).drive(0)  # limit of Y closes
    assert (counts.limits, Pin(10).calls) == (1, 0)


@pytest.mark.parametrize("invert", [0, 7])
def test_a_debounced_limit_counts_if_it_is_closed_at_the_end(invert: int) -> None:
    """At the end of LIMIT_DEBOUNCE_MS, which begins with the first edge. Pins 9 to 11: X, Y, Z.

    invert: $5, a mask of the three axes.
    """
    port, counts = make_port(LIMIT_DEBOUNCE_MS=3)
    port.limit_invert = invert
    open_level, closed_level = (0, 1) if invert else (1, 0)
    for pin in (9, 10, 11):
        Pin(pin).drive(open_level)
    port._look_timer.expire()
    Pin(9).drive(closed_level)
    Pin(9).drive(open_level)
    assert (port._look_timer.period, counts.limits) == (3, 0)
    port._look_timer.expire()
    assert counts.limits == 0
    Pin(9).drive(closed_level)
    port._look_timer.expire()
    assert counts.limits == 1


def test_pins_interrupt_before_all_others() -> None:
    machine.mem32[0xE000E40C] = 0x80808080  # IO_IRQ_BANK0 is number 13
    make_port()
    assert machine.mem32[0xE000E40C] == 0x80804080


def test_a_button_is_reported_at_once_and_a_storm_is_not() -> None:
    """A storm: many edges, of which only the first and the last are reported; another button is
    reported at once meanwhile. Pins 13 and 14: the buttons."""
    port, counts = make_port()
    for _ in range(1000):
        Pin(13).drive(0)
        Pin(13).drive(1)
    Pin(14).drive(0)
    assert (Pin(13).calls, counts.controls) == (1, 2)  # one report of each button
    Pin(13).drive(0)
    port._control_timer.expire()
    assert counts.controls == 3  # the last edge is not lost
    port._control_timer.expire()  # nothing has changed: the timer ends
    assert (counts.controls, port._control_timer.callback) == (3, None)
    Pin(13).drive(1)
    assert counts.controls == 4


def test_an_input_is_active_when_open_if_the_board_says_so() -> None:
    """CONTROL_INVERT: a mask of the inputs at pins 13, 14 and 15."""
    port, _ = make_port(CONTROL_INVERT=0b011)
    assert port.controls() == 0b011
    for pin in (13, 14, 15):
        Pin(pin).drive(0)
    assert port.controls() == 0b100


def test_an_open_emergency_stop_is_reported_also_during_debounce() -> None:
    """The emergency stop at pin 22 opens its contact when pressed: estop() is true."""
    port, counts = make_port(ESTOP=22, CONTROL_DEBOUNCE_MS=20)
    assert port.estop is not None and port.estop()
    Pin(22).drive(0)
    assert not port.estop()
    port._control_timer.expire()
    before = counts.controls
    Pin(13).drive(0)  # a button
    Pin(22).drive(1)  # while a button bounces
    assert counts.controls == before + 2  # button, emergency stop
    port._control_timer.expire()
    assert counts.controls == before + 3  # it is still pressed
    assert port._control_timer.callback is None


def test_a_board_without_emergency_stop_has_none() -> None:
    port, _ = make_port()
    assert port.estop is None


def test_a_bouncing_button_is_reported_once_and_again_after_a_change() -> None:
    """Pins 13 and 14: two buttons; each report is followed by CONTROL_DEBOUNCE_MS without one, and
    another one at the end if something has changed."""
    port, counts = make_port(CONTROL_DEBOUNCE_MS=20)
    for level in (0, 1, 0, 1, 0):
        Pin(13).drive(level)
    assert counts.controls == 1
    port._control_timer.expire()  # the time of debouncing is over
    assert counts.controls == 1
    Pin(13).drive(1)
    Pin(14).drive(0)  # while the contacts of the other still bounce
    assert counts.controls == 2
    port._control_timer.expire()
    assert counts.controls == 3
    port._control_timer.expire()
    assert counts.controls == 3


@pytest.mark.parametrize("closed", [True, False])
def test_the_probe_is_reported_once(closed: bool) -> None:
    """closed: wait until it closes (level 0), otherwise until it opens."""
    port, counts = make_port()
    Pin(12).drive(1 if closed else 0)  # the probe's pin
    port.watch_probe(counts.on_contact, closed)
    assert counts.probe == 0
    for level in (0, 1, 0, 1):
        Pin(12).drive(level)
    assert counts.probe == 1


def test_a_probe_interrupts_only_while_it_is_watched() -> None:
    port, counts = make_port()
    Pin(12).drive(0)  # the probe is closed
    port.watch_probe(counts.on_contact, closed=False)  # until it opens
    port.watch_probe(None, closed=False)  # not any more
    Pin(12).drive(1)
    assert (Pin(12).calls, counts.probe) == (0, 0)


def test_an_already_touching_probe_is_reported_at_once() -> None:
    port, counts = make_port()
    Pin(12).drive(0)
    port.watch_probe(counts.on_contact, True)
    assert counts.probe == 1


def test_spindle_power_sets_the_duty_cycle() -> None:
    """In proportion, 65535 at PWM_MAX; SPINDLE_ON (pin 19) is on at any power but 0."""
    port, _ = make_port(PWM_MAX=1000)
    for power, duty in ((0, 0), (1, 65), (500, 32767), (1000, 65535)):
        port.spindle(power > 0, power)
        assert (PWM.outputs[16].duty, Pin(19).value()) == (duty, int(power > 0))


def test_safe_switches_off_all_dangerous_outputs() -> None:
    """Spindle on (pin 19) and its PWM (16), flood (18) and mist (20)."""
    port, _ = make_port(MIST_PIN=20)
    port.spindle(True, 1000)
    port.coolant(3)  # flood and mist
    port.safe()
    assert [Pin(pin).value() for pin in (18, 19, 20)] == [0, 0, 0]
    assert PWM.outputs[16].duty == 0


def test_motors_are_off_until_the_machine_enables_them() -> None:
    port, _ = make_port(ENABLE=(8, 21, 22))
    assert [Pin(pin).value() for pin in (8, 21, 22)] == [1, 1, 1]
    port.enable(0)
    assert [Pin(pin).value() for pin in (8, 21, 22)] == [0, 0, 0]


def test_an_extra_can_add_pins() -> None:
    """Outputs 20 and 21 and inputs 22 and 26, which drive() and sense() address by masks."""
    port, counts = make_port()
    port.add_pins((20, 21), (22, 26))
    port.watch_pins(counts.on_contact)  # counts in counts.probe
    port.drive(1)
    assert (Pin(20).value(), Pin(21).value(), port.sense()) == (1, 0, 3)
    Pin(26).drive(0)
    assert (port.sense(), counts.probe) == (1, 1)


def test_the_watchdog_is_stopped_for_the_repl() -> None:
    port, _ = make_port()
    assert port.watch(5000) is not None
    assert port.watch(0) is None
    assert machine.mem32[0x4005B000] == 1 << 30  # CTRL.ENABLE, through the alias that clears bits


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"DIR": (5, 6, 2)}, "DIR: pin 2 is STEP already"),
        ({"PROBE": 30}, "PROBE: this chip has no pin 30"),
        ({"CONTROL": (13, 9, None, None)}, "CONTROL: pin 9 is LIMIT already"),
        ({"FLOOD": -1}, "FLOOD: this chip has no pin -1"),
        ({"ESTOP": 9}, "ESTOP: pin 9 is LIMIT already"),
        ({"INPUTS": {"door": 9}}, "INPUTS: pin 9 is LIMIT already"),
        ({"OUTPUTS": {"lamp": 30}}, "OUTPUTS: this chip has no pin 30"),
        ({"CONTROL_INVERT": 8}, "CONTROL_INVERT: 8 stands for an input"),
    ],
)
def test_a_wrong_pin_is_named(changes: "dict[str, Any]", message: str) -> None:
    with pytest.raises(ValueError, match=message):
        pin_check.check(board(**changes), MOTORS)


def test_outputs_of_shift_registers_are_not_pins() -> None:
    """STEP and LIMIT may have the same numbers; I2S itself uses pins of the chip."""
    pins = engines()["i2s"].pins
    pin_check.check(board(STEP=(2, 3, 101), LIMIT=(2, 3, 4), I2S=(20, 21, 22)), pins)
    with pytest.raises(ValueError, match="PROBE: pin 21 is I2S already"):
        pin_check.check(board(PROBE=21, I2S=(20, 21, 22)), pins)


def test_a_fault_message_cannot_be_taken_for_an_answer() -> None:
    """Senders look for "ok" and "error" anywhere in a line, and for its end."""
    try:
        raise ValueError("token: Error in [book], ok")
    except ValueError as fault:
        line = power_up._line(power_up._text(fault))
    assert line.startswith(b"[MSG:ValueErr: to-ken: Err in  boo-k , o-k ")
    assert line.endswith(b"]\r\n") and line.count(b"\n") == 1
    assert b"ok" not in line and b"rror" not in line
