"""After a stop at any moment nothing moves and no output is on.

A scenario is played again and again on the simulated machine; each time, at another bytecode of
the tested functions, a switch closes, a button is pressed, or a reset arrives. `make torture`
takes every bytecode, `make test` a sample.

A Scenario has a name, lines, and the functions that are interrupted. An event, `act`, is an input
pin's name ("limit_x", "reset", "hold", "probe") or a real-time byte ("!", Ctrl-X as "\\x18").
"""

import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from types import CodeType, FrameType
from typing import Any

import pytest
from base.settings import Settings
from control.canon import Canon
from control.coolant import Coolant
from control.homing_probing import HomingProbing
from control.motor_control import MotorControl
from control.realtime import Realtime
from control.spindle import Spindle
from control.suspension import Suspension
from motion import segment_kernel
from motion.planner import Planner
from rig_bench import Machine
from talk.controller import Controller
from ugrbl.sim.engine import SimEngine, Switch
from ugrbl.sim.port import SimPort

# Many cases of each: the first ring runs a sample.
pytestmark = [pytest.mark.sampled(2), pytest.mark.usefixtures("each_ms")]

_EVERY = os.environ.get("UGRBL_TORTURE") is not None  # bytecode, not samples
_SAMPLES = 40  # about so many bytecodes of a scenario
_SCENARIO_MS = 600  # how long a scenario may take
_PINS = ("limit_x", "reset", "hold", "probe")  # events at input pins; others are bytes
_STOPS = ("limit_x", "reset", "\x18")  # events after which nothing may move
_FAST = {110: 3000, 111: 3000, 112: 3000, 120: 500, 121: 500, 122: 500}


class Injector:
    """Call action at this bytecode of these functions; only count the bytecodes if it is -1."""

    def __init__(
        self,
        functions: "tuple[Any, ...]",
        at_bytecode: int = -1,
        action: Callable[[], None] = lambda: None,
    ) -> None:
        """functions: those whose bytecodes are counted; at_bytecode, action: see the class."""
        # The code objects, by which a trace function recognises the functions' frames.
        self._codes: set[CodeType] = {function.__code__ for function in functions}
        self._at = at_bytecode
        self._action = action
        self.count = 0  # bytecodes executed so far

    def __enter__(self) -> "Injector":
        sys.settrace(self._on_call)
        return self

    def __exit__(self, *_: object) -> None:
        sys.settrace(None)

    def _on_call(self, frame: FrameType, _event: str, _argument: object) -> Any:
        """Trace a new frame by bytecodes if it belongs to one of the functions (see
        sys.settrace)."""
        if frame.f_code not in self._codes:
            return None
        frame.f_trace_opcodes = True
        frame.f_trace_lines = False
        return self._on_opcode

    def _on_opcode(self, _frame: FrameType, event: str, _argument: object) -> Any:
        """Count a bytecode, and call the action before the chosen one is executed."""
        if event == "opcode":
            if self.count == self._at:
                self._action()
            self.count += 1
        return self._on_opcode


@dataclass
class Scenario:
    """Lines to send, and the functions that are interrupted meanwhile."""

    name: str
    lines: str
    functions: "tuple[Any, ...]"
    settings: "dict[int, float]" = field(default_factory=dict)
    byte: str = ""  # a real-time byte in the middle
    homes: bool = False


SCENARIOS = (
    Scenario(
        "start",
        "M8 G91 G1X4F900",
        (
            MotorControl.start,
            MotorControl.power,
            Realtime._cycle_start,
            SimEngine.start,
            SimPort.enable,
        ),
    ),
    Scenario(
        "set_power",
        "M3S500 G91 G1X1F900 G1X1S900",
        (Spindle.set_power, Spindle.set_speed, Spindle.power, SimPort.spindle, Canon.spin),
        {32: 1},
    ),
    Scenario(
        "turn",
        "M4S300 M8 M3S800 M9 M8 G91G1X2F900 M5",
        (Spindle.set_speed, Spindle.stop, Coolant.set, SimPort.coolant, Canon.cool),
    ),
    Scenario(
        "refill",
        "M3S400 M8 G91 G1X0.3F900 G1Y0.2 G1X-0.3",
        (
            segment_kernel.fill,
            Spindle.set_power,
            Spindle.on_motion_end,
            Canon.finish,
            Planner.line,
        ),
    ),
    Scenario(
        "hold",
        "M3S400 M8 G91 G1X6F1500",
        (Realtime._holds, Realtime._slow_down, Realtime._cycle_stop, Suspension.start),
        byte="!",
    ),
    Scenario(
        "reset",
        "M3S400 M8 G91 G1X6F1500",
        (MotorControl.reset, Controller._reset, Controller._greet, MotorControl.arm),
        byte="\x18",
    ),
    Scenario(
        "probing",
        "M3S400 M8 G91 G38.3X3F900",
        (HomingProbing.probe, HomingProbing._on_contact, HomingProbing._report_probe),
    ),
    Scenario(
        "saving",
        "M3S400 M8 $110=2900 G10L2P1X1 $N0=G54",
        (Settings.set, Settings.save, Spindle.configure, Controller.configure),
    ),
    Scenario(
        "homing",
        "$H",
        (
            HomingProbing.home,
            HomingProbing.find_switches,
            HomingProbing.home_phase,
            HomingProbing._failed,
        ),
        {22: 1, 23: 7, 24: 600, 25: 1500, 26: 5, 27: 1},
        homes=True,
    ),
)


class Trial:
    """One run of a scenario, with an event at a bytecode of its functions."""

    def __init__(self, scenario: Scenario, at_bytecode: int, event: str) -> None:
        """at_bytecode: its number, -1: no event; event: a pin of _PINS, or a byte."""
        self._scenario = scenario
        self._event = event
        # $21=1: hard limits. watched: the machine's check of all laws of motion, not needed here.
        self.machine = Machine({**_FAST, 21: 1, **scenario.settings}, watched=False)
        self._injector = Injector(scenario.functions, at_bytecode, self._inject)
        self.bytecodes = 0  # executed in the scenario
        self.steps_at_event: "list[int] | None" = (
            None  # motors' steps at the event; None: no event
        )
        self._outputs: "list[str]" = []  # those that were on just after the event

    def run(self) -> None:
        """Run the scenario, check the laws, and check that the machine works again."""
        self.machine.run(self._script())

    def _inject(self) -> None:
        """Act as an interrupt would, and note position and outputs just after it."""
        rig = self.machine.rig
        if self._event in _PINS:
            rig.port.push({self._event: True})
        else:
            rig.controller.realtime.post(ord(self._event))
        self.steps_at_event = self.machine.physical()
        self._outputs = self._outputs_on()

    def _outputs_on(self) -> "list[str]":
        """Return the outputs that are on."""
        port = self.machine.rig.port
        names = ("spindle_on", "spindle_pwm", "flood", "mist")
        return [name for name in names if getattr(port, name)]

    def _script(self) -> Iterator[Any]:
        """Play the scenario with the event in it; then check the stop, or resume and wait for the
        end."""
        machine, scenario = self.machine, self._scenario
        rig = machine.rig
        yield from machine.start()
        if scenario.homes:
            # Limit switches that close at -900 steps.
            rig.engine.switches += [
                Switch(f"limit_{n}", i, False, -900) for i, n in enumerate("xyz")
            ]
            yield from self._ask("$X")
        with self._injector:
            for line in scenario.lines.split():
                # Not after a stop: lines after a reset would be executed.
                if self.steps_at_event is None or self._event not in _STOPS:
                    rig.link.send(line.encode() + b"\n")
                yield rig.ms(20)
            if scenario.byte:
                rig.link.send(scenario.byte.encode("latin-1"))
            # Wait for the event, and 30 ms more for its effects.
            until = rig.ms(_SCENARIO_MS * (10 if scenario.homes else 1))
            while rig.now < until and self.steps_at_event is None:
                yield rig.ms(2)
            yield rig.ms(30)
        self.bytecodes = self._injector.count
        if self._event in _STOPS and self.steps_at_event is not None:
            yield from self._check()
        else:
            rig.port.push({"hold": False, "probe": False})  # open
            yield from machine.rest()  # resumes after a hold

    def _check(self) -> Iterator[Any]:
        """Check that no further step is made, all outputs are off, and a reset makes it work."""
        machine = self.machine
        rig, port = machine.rig, machine.rig.port
        yield rig.ms(600)  # an alarm ignores input for 500
        where = f"{self._scenario.name}, {self._event}, bytecode {self._injector.count}"
        assert machine.physical() == self.steps_at_event, f"it moved on: {where}"
        # Off at once, and still off now.
        assert not self._outputs, f"outputs are on: {where}"
        assert not self._outputs_on(), f"outputs are on again: {where}"
        rig.engine.switches.clear()
        port.push({"limit_x": False, "reset": False})
        yield from self._ask("\x18", "Grbl 1.1h")
        yield from self._ask("$X")
        assert not rig.moving(), where
        before = machine.physical()
        yield from self._ask("G1F900M3S700")
        assert port.spindle_on, f"the spindle is dead: {where}"
        yield from self._ask("G91G21G94G1X1F900")  # 1 mm: 250 steps
        yield from machine.rest()
        moved = [after - was for after, was in zip(machine.physical(), before, strict=True)]
        assert moved == [250, 0, 0], f"the motors are dead: {where}"
        assert port.spindle_on, f"the spindle has stopped: {where}"

    def _ask(self, line: str, answer: str = "ok") -> Iterator[Any]:
        """Send a line (a reset without line end), and wait up to 2 s for a line with this
        beginning."""
        rig, machine = self.machine.rig, self.machine
        machine.take()  # lines from before do not count
        rig.link.send(line.encode("latin-1") + (b"" if line == "\x18" else b"\n"))
        until = rig.ms(2000)
        received: list[str] = []
        while not any(text.startswith(answer) for text in received):
            assert rig.now < until, f"{line!r} is answered by {received} in {self._scenario.name}"
            yield rig.ms(5)
            received += machine.take()


def sample_bytecodes(total: int, phase: int) -> range:
    """Return the numbers of the bytecodes to try, of `total`.

    They are every n-th one from `phase` on. It differs per test, so that together they cover more.
    """
    assert total > _SAMPLES, "the functions are not called"
    step = 1 if _EVERY else max(1, total // _SAMPLES)
    return range(0 if _EVERY else phase % step, total, step)


def count_bytecodes(scenario: Scenario) -> int:
    """Return the number of bytecodes of a scenario's functions."""
    trial = Trial(scenario, -1, "")
    trial.run()
    return trial.bytecodes


@pytest.mark.sampled(2, 9)
@pytest.mark.parametrize("event", ["limit_x", "reset", "\x18"], ids=["limit", "button", "Ctrl-X"])
@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.name)
def test_nothing_moves_or_turns_after_a_stop(scenario: Scenario, event: str) -> None:
    if scenario.homes and event == "limit_x":
        pytest.skip("homing uses the switches itself")
    for at_bytecode in sample_bytecodes(
        count_bytecodes(scenario), phase=len(scenario.name) + len(event)
    ):
        Trial(scenario, at_bytecode, event).run()


@pytest.mark.sampled(1)
@pytest.mark.parametrize("event", ["!", "hold"], ids=["!", "button"])
@pytest.mark.parametrize("name", ["start", "turn", "refill", "hold"])
def test_a_hold_at_any_moment_costs_no_step(name: str, event: str) -> None:
    """The motors end where they do without an event; Trial resumes after the hold."""
    scenario = next(scenario for scenario in SCENARIOS if scenario.name == name)
    undisturbed = Trial(scenario, at_bytecode=-1, event="")  # -1: no event, bytecodes are counted
    undisturbed.run()
    for at_bytecode in sample_bytecodes(undisturbed.bytecodes, phase=len(name) + len(event)):
        trial = Trial(scenario, at_bytecode, event)
        trial.run()
        assert trial.machine.physical() == undisturbed.machine.physical(), (
            f"bytecode {at_bytecode}"
        )


def test_a_probe_contact_at_any_moment_is_recorded_to_the_step() -> None:
    """[PRB:x,y,z:1] has the position in mm of the contact; the motors' at the event is the same.

    An event before or after the probing leads to an alarm, to [PRB:…:0], or is not reached.
    """
    scenario = next(scenario for scenario in SCENARIOS if scenario.name == "probing")
    for at_bytecode in sample_bytecodes(count_bytecodes(scenario), phase=3):
        trial = Trial(scenario, at_bytecode, "probe")
        trial.run()
        lines = trial.machine.received
        results = [line for line in lines if line.startswith("[PRB:")]
        if results and trial.steps_at_event and results[0].endswith(":1]"):
            position_mm = results[0][5:-3].split(",")
            position_steps = [round(float(mm) * 250) for mm in position_mm]
            assert position_steps == trial.steps_at_event, f"bytecode {at_bytecode}: {results}"
        else:
            assert "ALARM:4" in lines or results or trial.steps_at_event is None, (
                f"bytecode {at_bytecode}: {lines}"
            )


def test_a_stop_without_effect_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Proof that the check works, with the fault of an earlier version: a start undid a stop."""
    start = SimEngine.start

    def start_anyway(engine: SimEngine) -> None:
        engine.arm()  # allows motion again after a stop
        start(engine)

    monkeypatch.setattr(SimEngine, "start", start_anyway)
    with pytest.raises(AssertionError, match="it moved on"):
        for at_bytecode in range(40):
            Trial(SCENARIOS[0], at_bytecode, "limit_x").run()


def test_a_tool_that_stays_on_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Proof that the check works: kill(), which switches all outputs off, does nothing here."""
    monkeypatch.setattr(SimPort, "kill", lambda _port: None)
    scenario = SCENARIOS[1]  # with the spindle on
    with pytest.raises(AssertionError, match="outputs are on"):
        for at_bytecode in range(0, count_bytecodes(scenario), 5):
            Trial(scenario, at_bytecode, "limit_x").run()
