"""A storm of edges on any interrupting pin starves nothing, and later edges still interrupt.

The pins are those for which Pin.irq() was called, on every board and with every extra that has
inputs: a new one is tested here automatically.

`made` is a Machine; made.cpu a model of the CPU in virtual time: cpu.run(us) advances it;
cpu.storm(pins, open_us, closed_us, us) sends edges to pins; cpu.calls are the times of their
interrupts, cpu.turns the turns of the main loop (on an ESP32: of the engine), and cpu.late_us the
longest delay of another interrupt. Pins have pull-ups: drive(1) opens, drive(0) closes.
"""

from array import array
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import esp_bench
import machine
import pytest
from base.controls import START
from pio import pins as gpio
from ports import supervisor
from storm_bench import Cpu, SoftCpu
from ugrbl.boardfile.files import boards, load_board
from ugrbl.paths import FIRMWARE
from ugrbl.sim.replay import factory_store
from ugrbl.sim.rig import Rig

# Many cases of each: the first ring runs a sample.
pytestmark = pytest.mark.sampled(5)

REAL = [name for name in boards() if hasattr(load_board(name), "DIR")]
CUSTOM = """
from ugrbl import on

@on.input("part")
def part(m, closed):
    pass
"""
ON_PICO = {"ENGINE": "pio", "MPY_ARCH": "armv6m", "STEP": (0, 1, 2), "ENABLE": 8}
EXTRAS: "dict[str, tuple[str, dict[str, Any]]]" = {
    "inputs": ("rpi_pico", {"INPUTS": {"part": 20, "door": 21}, "CUSTOM": "stormy"}),
    "inputs of an ESP32": ("esp32_s3", {"INPUTS": {"part": 40, "door": 41}, "CUSTOM": "stormy"}),
    "punch": ("sim_punch", ON_PICO),
    "debounced": ("rpi_pico", {"LIMIT_DEBOUNCE_MS": 3, "CONTROL_DEBOUNCE_MS": 20, "ESTOP": 20}),
    "shared": ("rpi_pico", {"LIMIT": (9, 9, 9), "HOMING": ("Z", "X", "Y")}),
}
# Duration of open and closed, in us. The last two are over before the handler reads the pin.
STORMS = ((5, 5), (20, 20), (25, 25), (50, 50), (17, 3), (47, 3))  # us open, us closed
STORM_US = 8_000  # its duration
PEACE_US = 2_000  # how long a pin must be quiet after a storm
_POWER_PIN = 22  # POWER_FAIL
# In STORM_US: turns of a Pico's main loop, 52 without a storm; of an ESP32's engine, 8.
FEWEST_TURNS = {"pio": 48, "i2s": 7, "rmt": 7}  # in STORM_US
# Interrupts of one pin. An ESP32's have eight places to wait in, and then all eight are called.
MOST_A_MS = {"pio": 4, "i2s": 10, "rmt": 10}  # interrupts


class Machine:
    """A whole machine on a board's own pins."""

    def __init__(self, board: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
        """Make a simulated machine, and give it a real port on stand-ins of the chip's
        hardware."""
        self.engine: str = board.ENGINE
        self.rig = Rig(board, factory_store(board))
        is_2350 = board.MPY_ARCH == "armv7emsp"
        monkeypatch.setattr(machine, "_is_rp2350", lambda: is_2350)
        monkeypatch.setattr(gpio, "_is_rp2350", lambda: is_2350)
        self.cpu: Any
        if self.engine == "pio":
            monkeypatch.setattr(machine.Pin, "pins", {})
            monkeypatch.setattr(machine.Pin, "latched", [])
            self.cpu = Cpu()
            timer = self.cpu.timer()
            monkeypatch.setattr(gpio, "Timer", timer)
            monkeypatch.setattr(supervisor, "Timer", timer)
            port: Any = gpio.GpioPort(board)
            self._pins: Any = machine.Pin.pins
        else:
            esp_bench.reset_stand_ins("esp32s3" if "s3" in board.__name__ else "esp32")
            self.cpu = SoftCpu()
            port = esp_bench.gpio_esp.EspPort(board, lambda level: None)
            self._pins = esp_bench.esp_machine.Pin.pins
        port.power_off = lambda: None
        self.port = self.rig.port = port
        # The port's time is that of the modelled CPU.
        ticks = {"ticks_ms": self._ticks_ms, "ticks_diff": lambda a, b: a - b}
        self._time = SimpleNamespace(**ticks, sleep_us=lambda us: None)
        monkeypatch.setitem(type(port).ticks_ms.__globals__, "time", self._time)
        monkeypatch.setattr(gpio, "time", self._time)
        self.contacts = 0  # of the probe

    def _ticks_ms(self) -> int:
        return int(self.rig.now / self.rig.ticks_per_ms)

    def run(self, act: "Callable[[], object]") -> None:
        """Power up, and call act after the welcome."""

        def script() -> Iterator[Any]:
            yield lambda: b"Grbl " in self.rig.link.received
            yield self.rig.ms(100)
            act()

        self.rig.run(script())

    def pins(self) -> "list[Any]":
        """Open all pins that interrupt, let 100 ms pass, and return them."""
        interrupting = [pin for pin in self._pins.values() if pin.handler]
        for pin in interrupting:
            pin.drive(1)
        self.cpu.run(100_000)
        return interrupting

    def touch(self) -> None:
        """Count a contact of the probe."""
        self.contacts += 1

    def listen(self) -> None:
        """Enable all optional interrupts."""
        self.port.enable_limits(True)
        self.port.watch_probe(self.touch, True)


def board_with(name: str, changes: "dict[str, Any]") -> ModuleType:
    board = ModuleType(name)
    vars(board).update({**vars(load_board(name)), **changes, "__name__": name})
    return board


@pytest.fixture(params=[*REAL, *EXTRAS])
def made(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Machine:
    """Return a machine on each board, and with each kind of inputs of extras."""
    (tmp_path / "stormy.py").write_text(CUSTOM)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return Machine(board_with(*EXTRAS.get(request.param, (request.param, {}))), monkeypatch)


def most_in_a_ms(calls: "list[int]") -> int:
    """Return the largest number of interrupts in any millisecond. calls: their times in us."""
    return max(
        (
            sum(begin_us <= us < begin_us + 1000 for us in calls[i:])
            for i, begin_us in enumerate(calls)
        ),
        default=0,
    )


def storm_effects(made: Machine, pin: Any, shape: "tuple[int, int]") -> "dict[str, Any]":
    """Run a storm on one pin, and 30 ms after it; return its effects. shape: open and closed
    us."""
    cpu = made.cpu
    made.listen()
    # A pin is armed if an edge interrupts. A probe's is not any more after its contact.
    armed, contacts = bool(pin.trigger), made.contacts
    cpu.calls.clear()
    cpu.late_us = cpu.turns = 0
    cpu.storm([pin], *shape, STORM_US)
    turns = cpu.turns
    effects = {"armed": armed, "heard": bool(cpu.calls), "most a ms": most_in_a_ms(cpu.calls)}
    cpu.run(30_000)
    effects["armed again"] = bool(pin.trigger) or made.contacts > contacts
    return effects | {"late us": cpu.late_us, "turns": turns}


def test_a_storm_on_any_interrupting_pin_starves_nothing(made: Machine) -> None:
    """Limits of interrupts in a ms, of delays, and of turns in a storm, from models of the
    chips."""
    results: list[Any] = []

    def act() -> None:
        for pin in made.pins():
            for shape in STORMS:
                results.append((pin.id, shape, storm_effects(made, pin, shape)))

    made.run(act)
    assert results
    for pin, shape, effects in results:
        assert effects["armed"] and effects["heard"] and effects["armed again"], (
            pin,
            shape,
            effects,
        )
        assert effects["most a ms"] <= MOST_A_MS[made.engine], (pin, shape, effects)
        # Another interrupt, of the engine or a timer, waits for 1.6 ms at most.
        assert effects["late us"] <= 1_600, (pin, shape, effects)
        assert effects["turns"] >= FEWEST_TURNS[made.engine], (pin, shape, effects)


@pytest.mark.parametrize("shape", [*STORMS, (3, 4_000)])  # the last: never open when it is read
def test_interference_on_power_fail_interrupts_once_a_turn_and_the_next_edge_again(
    shape: "tuple[int, int]", monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each turn of the main loop polls the pin and allows the next interrupt."""
    made = Machine(board_with("rpi_pico", {"POWER_FAIL": _POWER_PIN}), monkeypatch)
    pin = machine.Pin(_POWER_PIN)
    pin.drive(0)  # closed: the supply is good
    cpu, rig = made.cpu, made.rig

    def act() -> None:
        """Run a storm on the supply's input, then let the supply fail: that interrupts."""
        monkeypatch.setattr(rig, "pass_time", lambda *passed: None)  # messages take none here
        (cpu.turn,) = rig.controller.state.hooks.poll  # the only function that turns call
        cpu.storm([pin], *shape, STORM_US)
        pin.drive(0)
        assert 0 < len(cpu.calls) <= cpu.turns + 1
        assert cpu.late_us <= 1_600 and cpu.turns >= FEWEST_TURNS["pio"]
        cpu.run(30_000)  # us
        cpu.calls.clear()
        pin.drive(1)  # the supply fails
        cpu.run(50)
        assert cpu.calls, "no interrupt after the interference"

    made.run(act)


def test_pin_interrupts_are_set_up_in_one_place_only() -> None:
    """Other modules' interrupts would not be tested here.

    engine.py has the PIO's, not a pin's; the motion library has its own, without a machine.
    """
    modules = [path for path in FIRMWARE.rglob("*.py") if path.parent.name != "ugrbl_motion"]
    files_with_irq = {path.name for path in modules if ".irq(" in path.read_text()}
    assert files_with_irq == {"input_pins.py", "power_input.py", "engine.py"}


@pytest.fixture
def pico(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machine:
    """Return a Pico with all kinds of inputs."""
    (tmp_path / "stormy.py").write_text(CUSTOM)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return Machine(board_with(*EXTRAS["inputs"]), monkeypatch)


def test_the_supervisor_stops_a_main_loop_hanging_in_a_storm(
    pico: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The supervisor's timer stops the machine when the main loop has not returned for 250 ms.

    The main loop does not run here; the laser is on, and a storm of 260 ms is on one pin.
    """
    monkeypatch.setattr(supervisor, "sys", SimpleNamespace(platform="rp2"))
    stopped: dict[int, tuple[int, int, int]] = {}

    def hang(pin: Any) -> "tuple[int, int, int]":
        """Return how long the loop was away when stopped, in ms; the laser's output before and
        after."""
        link: Any = SimpleNamespace(shared=array("i", [0, 0, 0]), poll_reset=None)
        watch = supervisor.Supervisor(link, pico.rig.engine, pico.port, 250)  # ms
        watch.start(None, lambda alarm: None)
        pico.listen()
        pico.port.revive()  # outputs may be on again
        pico.port.spindle(True, 500)
        machine.PWM.outputs[16].wrap()  # pin 16 is the laser's: begin a new period
        laser_before = machine.Pin(16).pad()
        pico.cpu.storm([pin], 22, 3, 260_000)  # us: open, closed, duration
        watch.close()
        return link.shared[supervisor.STOP_CAUSE], laser_before, machine.Pin(16).pad()

    def act() -> None:
        for pin in {pin.handler: pin for pin in pico.pins()}.values():  # one of each kind
            stopped[pin.id] = hang(pin)

    pico.run(act)
    assert len(stopped) == 4  # limits, the probe, buttons, the inputs of an extra
    assert all(250 <= ms <= 260 and on and not off for ms, on, off in stopped.values()), stopped


class EventTimes:
    """Record the times of events of inputs."""

    def __init__(self, made: Machine) -> None:
        """Make empty lists of times in us; each is named after an input in PINS."""
        self._made = made
        self.limits: list[int] = []
        self.start: list[int] = []
        self.part: list[int] = []
        self.probe: list[int] = []

    def on_limits(self) -> None:
        if self._made.port.limits():
            self.limits.append(self._made.cpu.us)

    def on_controls(self, active: int) -> None:
        if active & START:
            self.start.append(self._made.cpu.us)

    def on_change(self) -> None:
        if not self._made.port.sense() & 1:
            self.part.append(self._made.cpu.us)

    def on_contact(self) -> None:
        self.probe.append(self._made.cpu.us)

    def on_fault(self) -> None:
        raise AssertionError(self._made.port.fault)


PINS = {"limits": (9, 10), "start": (15, 14), "part": (20, 21), "probe": (12, None)}


@pytest.mark.parametrize("name", PINS)
def test_a_lasting_change_is_reported_2_ms_after_a_storm_and_at_once_on_other_pins(
    pico: Machine, name: str
) -> None:
    """Delays from closing a pin to its event, begun 0 to 2.2 ms after storms on the pin itself
    (after_storm_us), and on another pin at the same time (after_other_us)."""
    event_times = EventTimes(pico)
    after_storm_us: list[int] = []
    after_other_us: list[int] = []
    pin, other = PINS[name]  # other: an input of another kind; None: none

    def close_and_measure_us() -> int:
        """Close the pin for 5 ms; return the delay between that and its event, in us."""
        events_us = getattr(event_times, name)
        events_us.clear()
        closed_us = pico.cpu.us
        machine.Pin(pin).drive(0)  # closed
        pico.cpu.run(5_000)
        machine.Pin(pin).drive(1)
        pico.cpu.run(5_000)
        return int(events_us[0]) - closed_us

    def act() -> None:
        """Measure after storms of 5 ms, which end 0, 0.2 … 2.2 ms before the pin closes."""
        pico.pins()
        pico.port.attach(event_times)
        pico.port.watch_pins(event_times.on_change)
        for after_us in range(0, 2_400, 200):
            # Both start anew: a probe is watched for one contact only.
            pico.port.enable_limits(True)
            pico.port.watch_probe(event_times.on_contact, True)
            pico.cpu.storm([machine.Pin(pin)], 17, 3, 5_000)  # us: open, closed, duration
            pico.cpu.run(after_us)
            after_storm_us.append(close_and_measure_us())
            if other:
                pico.cpu.storm([machine.Pin(other)], 17, 3, 5_000)
                after_other_us.append(close_and_measure_us())

    pico.run(act)
    assert len(after_storm_us) == 12 and max(after_storm_us) <= PEACE_US + 100, after_storm_us
    assert max(after_other_us, default=0) <= 50, after_other_us


def test_a_bouncing_contact_is_reported_at_its_first_lasting_touch(pico: Machine) -> None:
    """Three touches of 5 us are over before the probe is read; pin 12, the probe, then closes."""
    event_times = EventTimes(pico)

    def act() -> None:
        """Bounce three times, then close: watch_probe() reports the contact to event_times."""
        pico.pins()
        pico.port.watch_probe(event_times.on_contact, True)
        # Open for 60 us and closed for 5, three times.
        pico.cpu.storm([machine.Pin(12)], 60, 5, 3 * 65)
        event_times.probe.append(pico.cpu.us)  # the time of the lasting touch, before its event's
        machine.Pin(12).drive(0)
        pico.cpu.run(100)

    pico.run(act)
    closed_us, event_us = event_times.probe
    assert event_us - closed_us <= 50
