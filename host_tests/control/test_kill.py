"""Test kill() between any two bytecodes that switch a tool: it goes off, and stays off.

let_pass(us) lets time pass: on an RP2, a new PWM value takes effect at the end of a period.
"""

import sys
from collections.abc import Callable, Iterator
from types import FrameType, SimpleNamespace
from typing import Any

import esp_bench
import machine
import pytest
from pio import pins as gpio
from test_pio_pins import board
from ugrbl.boardfile.files import load_board
from ugrbl.sim.rig import Rig

# Many cases: the first ring runs a sample of them.
pytestmark = pytest.mark.sampled(5)

OUTPUTS = {"SPINDLE_PWM": 16, "SPINDLE_DIR": 17, "FLOOD": 18, "SPINDLE_ON": 19, "MIST_PIN": 20}
ENABLES = {"SPINDLE_ENABLE_PIN": True}
POLARITIES = [(), ("SPINDLE_PWM",), ("SPINDLE_ON", "MIST_PIN"), tuple(OUTPUTS)]

# What the machine does with its tools, on a port.
WORK: "dict[str, Callable[[Any], object]]" = {
    "spindle": lambda port: port.spindle(on=True, power=700),
    "coolant": lambda port: port.coolant(3),
    "direction": lambda port: port.direction(1),
    "punch": lambda port: port.drive(1),
}


class Bench:
    """A port of a chip ("rp2", "esp" or "sim"), and the outputs of its pins by name; 0 is off."""

    def __init__(self, chip: str, inverted: "tuple[str, ...]") -> None:
        self.inverted = inverted
        board_module = board(**OUTPUTS, **ENABLES, INVERT=inverted)
        if chip == "sim":
            vars(board_module).update(vars(load_board("sim_punch")), **ENABLES)
            self.port: Any = Rig(board_module).port
        elif chip == "esp":
            self.port = esp_bench.gpio_esp.EspPort(board_module)
        else:
            self.port = gpio.GpioPort(board_module)
        self.chip = chip
        self.port.add_pins(outputs=(21, 22), inputs=(26, 27))  # PUNCH_DOWN, PUNCH_UP
        self.port.rest(levels=2)  # levels when off, a bit per output: only PUNCH_UP is high

    def outputs(self) -> "dict[str, int]":
        """Return for each output its difference from off: 0 to 65535; on the simulator, the port's
        own values."""
        port = self.port
        if self.chip == "sim":
            names = ("spindle_on", "spindle_pwm", "spindle_dir", "flood", "mist")
            by_name = {name: int(getattr(port, name)) for name in names}
            return {**by_name, "down": port._direction > 0}  # the punch moves down
        by_name = {}
        for name, pin in {**OUTPUTS, "PUNCH_DOWN": 21}.items():
            by_name[name] = self.level(pin) ^ (0xFFFF if name in self.inverted else 0)
        return {**by_name, "PUNCH_UP": self.level(22) ^ 0xFFFF}  # the punch is up when off

    def level(self, number: int) -> int:
        """Return the output of a pin as a share of time, 0 to 65535."""
        if self.chip == "rp2":
            return machine.Pin(number).pad()
        pin = esp_bench.esp_machine.Pin(number)
        pwm = esp_bench.esp_machine.PWM.outputs.get(number)
        if not pwm:
            return 0xFFFF * int(pin.level)
        return int(pwm.duty) ^ (0xFFFF if pwm.invert else 0)


def let_pass(us: int) -> None:
    """Let microseconds pass on the stand-in of an RP2: its PWM outputs take over new values."""
    for output in machine.PWM.outputs.values():
        if us * output.frequency >= 1_000_000:  # at least a period
            output.wrap()


@pytest.fixture(autouse=True)
def new_chips(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Reset the stand-ins of both chips."""
    monkeypatch.setattr(gpio, "_is_rp2350", lambda: False)
    monkeypatch.setattr(machine.Pin, "pins", {})
    monkeypatch.setattr(machine.PWM, "outputs", {})
    monkeypatch.setattr(machine.mem32, "words", {})
    monkeypatch.setattr(gpio, "time", SimpleNamespace(sleep_us=let_pass))
    esp_bench.reset_stand_ins()
    yield
    esp_bench.reset_stand_ins()


def interrupted(
    work: "Callable[[], object]", index: int, interrupt: "Callable[[], object]"
) -> bool:
    """Do work with an interrupt before bytecode number `index`; return whether there is one."""
    count = 0

    def trace(frame: FrameType, event: str, _argument: object) -> Any:
        """Count bytecodes (a trace function of Python), and interrupt before the one wanted."""
        nonlocal count
        frame.f_trace_opcodes = True
        if event == "opcode":
            count += 1
            if count == index + 1:
                interrupt()
        return trace

    former_trace = sys.gettrace()
    sys.settrace(lambda frame, *_: trace(frame, "call", None))
    try:
        work()
    finally:
        sys.settrace(former_trace)
    return count > index


def work_named(what: str) -> "Callable[[Any], object]":
    """Return the work of that name, or for "pulse": pulses at an output of an extra."""
    return WORK[what] if what in WORK else lambda port: port.pulse(index=0, hz=5000, duty=30000)


def kill_everywhere(make_bench: "Callable[[], Bench]", work: "Callable[[Any], object]") -> int:
    """Interrupt work by kill() before each bytecode; return the number of bytecodes."""
    bytecode = 0
    while True:
        bench = make_bench()
        port = bench.port
        if not interrupted(lambda: work(port), bytecode, port.kill):  # noqa: B023
            let_pass(200)
            assert any(bench.outputs().values())  # not killed: it is on
            return bytecode
        assert not any(bench.outputs().values()), bytecode
        work(port)
        let_pass(200)
        assert not any(bench.outputs().values()), bytecode
        port.revive()  # allows outputs again, but switches none on
        assert not any(bench.outputs().values()), bytecode
        work(port)
        let_pass(200)
        assert any(bench.outputs().values()), bytecode
        bytecode += 1


@pytest.mark.parametrize("inverted", POLARITIES, ids=len)
@pytest.mark.parametrize("what", [*WORK, "pulse"])
@pytest.mark.parametrize("chip", ["rp2", "esp"])
def test_interrupted_work_never_switches_a_tool_on(
    chip: str, what: str, inverted: "tuple[str, ...]"
) -> None:
    # so many bytecodes were traced: else nothing was tested
    assert kill_everywhere(lambda: Bench(chip, inverted), work_named(what)) > 20


@pytest.mark.parametrize("what", WORK)
def test_interrupted_work_never_switches_a_tool_on_in_the_simulator(what: str) -> None:
    assert kill_everywhere(lambda: Bench("sim", ()), WORK[what]) > 10  # bytecodes traced


@pytest.mark.parametrize("chip", ["rp2", "esp", "sim"])
def test_revive_without_kill_changes_nothing(chip: str) -> None:
    """Homing calls revive, and a running spindle must continue."""
    bench = Bench(chip, ())
    bench.port.spindle(on=True, power=700)
    let_pass(200)
    before = bench.outputs()
    bench.port.revive()
    assert bench.outputs() == before and any(before.values())


@pytest.mark.parametrize("inverted", POLARITIES, ids=len)
@pytest.mark.parametrize("chip", ["rp2", "esp"])
def test_every_output_is_off_from_the_start(chip: str, inverted: "tuple[str, ...]") -> None:
    outputs = Bench(chip, inverted).outputs()
    del outputs["PUNCH_UP"]  # not set by the port: the module Punch raises it
    assert not any(outputs.values())


def test_punch_with_inverted_wiring_is_raised() -> None:
    """The level when off is that of rest(): here PUNCH_DOWN high, PUNCH_UP low."""
    bench = Bench("rp2", ())
    bench.port.drive(2)  # bits as in rest(): only the second output high, which moves the punch
    bench.port.rest(levels=1)
    bench.port.kill()
    assert (machine.Pin(21).pad(), machine.Pin(22).pad()) == (0xFFFF, 0)
    bench.port.revive()
    # GPIO21_CTRL.OUTOVER: 0, nothing forced
    assert machine.mem32[0x40014004 + 8 * 21] >> 8 & 3 == 0


def test_direction_pin_that_enables_nothing_is_unchanged() -> None:
    """Without SPINDLE_ENABLE_PIN, pin 17 is a mere direction: kill() leaves its level."""
    port = gpio.GpioPort(board())
    port.direction(1)
    port.kill()
    assert machine.Pin(17).pad() == 0xFFFF


@pytest.mark.parametrize(
    ("chip", "control", "shift"), [("RP2040", 0x40014004, 8), ("RP2350", 0x40028004, 12)]
)
def test_pads_are_forced_off_by_registers_of_the_chip(
    chip: str, control: int, shift: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """kill() sets GPIOn_CTRL.OUTOVER: 2 is low, 3 is high, whatever the pin's peripheral outputs.
    control: address of GPIO0_CTRL; shift: of OUTOVER in it."""
    monkeypatch.setattr(gpio, "_is_rp2350", lambda: chip == "RP2350")
    port = gpio.GpioPort(board(**OUTPUTS, INVERT=("FLOOD",)))
    before = {pin: machine.mem32[control + 8 * pin] for pin in range(30)}
    port.kill()
    for pin in range(30):
        forced = {16: 2, 18: 3, 19: 2, 20: 2}.get(pin, 0)  # 18, FLOOD, is inverted
        assert machine.mem32[control + 8 * pin] == before[pin] | forced << shift
    port.revive()
    assert {pin: machine.mem32[control + 8 * pin] for pin in range(30)} == before


def test_kill_holds_all_outputs_of_a_board_with_many() -> None:
    """Six outputs of extras: killed, all have the levels of rest(), whatever drive() sets."""
    port = gpio.GpioPort(board(**OUTPUTS))
    pins = (0, 1, 21, 22, 26, 27)
    port.add_pins(pins, ())
    port.rest(levels=0b000010)  # a bit per output: the second is high when off
    port.drive(0b111111)
    port.kill()
    assert [machine.Pin(pin).pad() for pin in pins] == [0, 0xFFFF, 0, 0, 0, 0]
    port.drive(0b111101)
    assert [machine.Pin(pin).pad() for pin in pins] == [0, 0xFFFF, 0, 0, 0, 0]


def test_slow_pulse_has_ended_when_its_output_is_revived() -> None:
    port = gpio.GpioPort(board(**OUTPUTS))
    port.add_pins(outputs=(21,), inputs=())
    port.rest(levels=0)
    port.pulse(index=0, hz=50, duty=30000)  # 30000 of 65535
    let_pass(20_000)  # a period in us: the pulse begins
    assert machine.Pin(21).pad() == 30000
    port.kill()
    port.revive()
    assert machine.Pin(21).pad() == 0


@pytest.mark.parametrize(
    ("pin", "other", "hz", "can_be"),
    [
        (20, 21, 50, True),  # both of slice 2
        (20, 21, 60, False),
        (20, 22, 60, True),
        (4, 20, 50, False),  # the same output of one slice
        (17, None, 50, False),  # the other output of the spindle's slice
        (17, None, 5000, True),
        (0, None, 5000, False),
    ],
)
def test_conflicting_pwm_pins_are_reported(
    pin: int, other: "int | None", hz: int, can_be: bool
) -> None:
    """Two pins of one PWM slice need one frequency; pins 16 apart are the same output of it.
    other: a pin with pulses of 50 Hz; the spindle on 16 has 5000 Hz."""
    port = gpio.GpioPort(board(SPINDLE_PWM=16, SPINDLE_DIR=None, FLOOD=None))
    port.add_pins(outputs=(pin,) if other is None else (pin, other), inputs=())
    port.rest(levels=0)
    if other is not None:
        port.pulse(index=1, hz=50, duty=100)
    if can_be:
        port.pulse(index=0, hz=hz, duty=200)
        port.pulse(index=0, hz=hz, duty=300)  # also to change it
    else:
        with pytest.raises(ValueError, match="shares a PWM slice with pin"):
            port.pulse(index=0, hz=hz, duty=200)


@pytest.mark.parametrize(
    ("pin", "other", "can_be"),
    [(36, 4, True), (34, 2, True), (33, 40, False), (33, 34, True), (32, 40, False)],
)
def test_pins_above_31_share_slices_only_with_each_other(
    pin: int, other: int, can_be: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On an RP2350B, 32 and 40 are one output of slice 8, 33 and 41 the other."""
    monkeypatch.setattr(sys.implementation, "_machine", "a board with RP2350", raising=False)
    port = gpio.GpioPort(board(SPINDLE_PWM=16, SPINDLE_DIR=None, FLOOD=None))
    port.add_pins(outputs=(pin, other), inputs=())
    port.rest(levels=0)
    # other: 50 Hz; then pin: 60 Hz, possible only in another slice
    port.pulse(index=1, hz=50, duty=100)
    if can_be:
        port.pulse(index=0, hz=60, duty=200)
    else:
        with pytest.raises(ValueError, match="shares a PWM slice with pin"):
            port.pulse(index=0, hz=60, duty=200)


def test_fast_inputs_must_be_pins_up_to_31(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys.implementation, "_machine", "a board with RP2350", raising=False)
    with pytest.raises(ValueError, match="pin 33: limits, probe, buttons must be on pins 0 to 31"):
        gpio.GpioPort(board(LIMIT=(9, 33, None)))


def test_slice_is_shared_when_the_chip_rounds_the_frequency() -> None:
    """The second pulse asks for 39999 Hz, the slice has 40000: no conflict."""
    port = gpio.GpioPort(board(SPINDLE_PWM=16, SPINDLE_DIR=None, FLOOD=None))
    port.add_pins(outputs=(20, 21), inputs=())
    port.rest(levels=0)
    for index in (0, 1, 0):
        port.pulse(index=index, hz=39_999, duty=100)
    assert machine.PWM.outputs[20].freq() == 40_000


# Callbacks that fail


def listener(callback: "Callable[..., Any]", on_fault: "Callable[[], Any]") -> Any:
    """Return a listener that calls `heard` for limits and for controls."""
    return SimpleNamespace(on_limits=callback, on_controls=callback, on_fault=on_fault)


def failing_port(chip: str) -> "tuple[Any, Any, list[str]]":
    """Return a port whose callbacks all fail, its pins, and the faults it has reported."""
    changes: "dict[str, Any]" = {**OUTPUTS, "ESTOP": 28}
    pins: Any = machine.Pin if chip == "rp2" else esp_bench.esp_machine.Pin
    port_class = gpio.GpioPort if chip == "rp2" else esp_bench.gpio_esp.EspPort
    port: Any = port_class(board(**changes))
    reported_faults: list[str] = []

    def fail(*_: int) -> None:
        raise MemoryError

    port.attach(listener(fail, lambda: reported_faults.append(port.fault)))
    port.enable_limits(True)
    port.add_pins(outputs=(21, 22), inputs=(26, 27))
    port.watch_pins(fail)
    return port, pins, reported_faults


@pytest.mark.parametrize("pin", [9, 13, 12, 26, 28])
@pytest.mark.parametrize("chip", ["rp2", "esp"])
def test_failing_callback_kills_the_tool_and_is_reported(chip: str, pin: int) -> None:
    """Pins: 9 limit, 13 control, 12 probe, 26 watched by an extra, 28 emergency stop."""
    port, pins, reported_faults = failing_port(chip)
    if pin == 12:
        port.watch_probe(lambda: 1 // 0, closed=True)
    port.spindle(on=True, power=700)
    pins(pin).drive(0)  # the input falls, and its callback fails
    assert reported_faults == ["A pin's callback has failed"]
    port.spindle(on=True, power=700)
    # the spindle stays off
    assert (machine.Pin(16).pad() if chip == "rp2" else port.pwm.duty) == 0


def test_failing_timer_callback_is_reported() -> None:
    """Timers read bouncing inputs once more; here only these readings call failing callbacks."""
    port, pins, reported_faults = failing_port("rp2")
    failing, on_fault = port._listener, port._listener.on_fault
    port._listener = listener(lambda *_: None, on_fault)
    pins(9).drive(0)  # limit; 13: control
    pins(13).drive(0)
    assert not reported_faults
    port._listener = failing
    pins(9).drive(1)
    pins(13).drive(1)
    port._look_timer.expire()
    assert reported_faults == ["A pin's callback has failed"]
    port._control_timer.expire()
    assert reported_faults == 2 * ["A pin's callback has failed"]


@pytest.mark.parametrize("pin", [9, 13])
def test_input_is_read_again_after_its_callback_failed(pin: int) -> None:
    """The failure must not leave the input ignored: after the timers, a new edge is reported."""
    port, pins, reported_faults = failing_port("rp2")
    pins(pin).drive(0)
    port._look_timer.expire()
    port._control_timer.expire()
    pins_heard: list[int] = []
    port._listener = listener(lambda *_: pins_heard.append(pin), port._listener.on_fault)
    pins(pin).drive(1)
    assert reported_faults and pins_heard == [pin]


def test_failing_stop_does_not_leave_the_interrupt() -> None:
    """on_fault() fails, too: no exception may leave an interrupt."""
    port = gpio.GpioPort(board())
    port.attach(listener(*2 * (lambda *_: 1 // 0,)))  # both callbacks raise
    port.enable_limits(True)
    machine.Pin(9).drive(0)
    assert port.fault.endswith("so did the stop after it: cut the power")
