"""Stops of all kinds at random instants, many of them in one life of the emulated Pico.

The machine is streaming, and at some instant a limit switch closes, the reset button is pressed,
a Ctrl-X arrives or the hold button is pressed. Behind a stop there is no edge on a step pin nor on
the spindle's later than the README says, and the reset that follows ends in a machine that works
and knows where it is, counted from the edges.

A trial costs up to 10 CPU seconds. A thousand of them (`make torture-board`):

    UGRBL_INJECTIONS=1000 .venv/bin/pytest -q host_tests/emulator/test_pico_injection.py
"""

import os
from collections.abc import Iterator
from pathlib import Path
from random import Random

import pytest
from emulated import DIR, HOLD, LIMIT, RESET, SPINDLE_PWM, STEP, Board, Odometer

pytestmark = pytest.mark.xdist_group("pico injection")

_COUNT = int(os.environ.get("UGRBL_INJECTIONS", "25"))

# What comes, and how long edges may come behind it.
LATENCY_US = {"limit": 300, "button": 300, "Ctrl-X": 10_000}
ACTS = (*LATENCY_US, "hold")
# What is sent once, and what is sent again and again: it ends where it begins.
PROGRAMS = (
    ("G91", ("G2X0.5Y0I0.25J0F3000", "G3X-0.5Y0I-0.25J0")),
    ("G91M3S300", ("G1X0.16Y0.08Z-0.04F3000", "X-0.16Y-0.08Z0.04")),
    ("G91M4S500", ("G1X0.2S900F3000", "Y0.1S200", "X-0.2S700", "Y-0.1S0")),
)
SETTINGS = (
    *("$0=3", "$21=1", "$32=1"),
    *("$110=3000", "$111=3000", "$112=3000"),
    *("$120=4000", "$121=4000", "$122=4000"),
)
STEPS_PER_MM = 250

_WITHIN_US = 90_000
_WATCHED_US = 15_000  # behind a stop
_SETTLED_US = 100_000
_IDLE_US = 1_500_000
_RX_BYTES = 64


class Trial:
    """One stop, or a hold, and what follows."""

    def __init__(self, machine: Board, odometer: Odometer, seed: int) -> None:
        self._machine = machine
        self._pico = machine.pico
        self._odometer = odometer
        random = Random(seed)
        self.act = ACTS[seed % len(ACTS)]
        self.program = PROGRAMS[seed // len(ACTS) % len(PROGRAMS)]
        self._limit = random.choice(LIMIT)
        self._delay_us = random.uniform(0, _WITHIN_US)
        self._injected_us = 0.0
        self._sent: list[str] = []
        self.latency_us = 0.0

    def run(self) -> None:
        """Play it, look whether the laws hold, and put the machine to work again."""
        begin, lines = self.program
        self._machine.ask(begin)
        before = self._odometer.read()
        self._pico.at_us(self._delay_us, self._inject)
        self._stream(lines)
        if self.act == "hold":
            self._check_hold(before)
        else:
            self._check_stop()
            self._recover()
        self._check_move()

    def end(self) -> None:
        """Whatever has come of it, the next one can begin."""
        self._pico.run_us(_SETTLED_US)
        self._recover()

    def _inject(self) -> None:
        self._injected_us = self._pico.us
        if self.act == "limit":
            self._pico.drive(self._limit, 0)
        elif self.act == "button":
            self._pico.drive(RESET, 0)
        elif self.act == "hold":
            self._pico.drive(HOLD, 0)
        elif self.act == "Ctrl-X":
            self._machine.send("\x18")

    def _stream(self, lines: "tuple[str, ...]") -> None:
        """Count characters as senders do; ends with the injection, a hold with a whole round."""
        self._machine.forget()
        while not self._injected_us or (self.act == "hold" and len(self._sent) % len(lines)):
            line = lines[len(self._sent) % len(lines)] + "\n"
            waiting = self._sent[self._machine.said.count("ok\r\n") :]
            if sum(map(len, waiting)) + len(line) <= _RX_BYTES:
                self._sent.append(line)
                self._machine.send(line)
            else:
                self._pico.run_us(200)

    def _check_stop(self) -> None:
        """No edge behind the time there is, all off; an alarm, where it was moving."""
        self._pico.run_us(_WATCHED_US)
        edges = [edge for edge in self._pico.edges if edge.pin not in DIR]
        last_us = max((edge.ns / 1000 for edge in edges), default=0.0)
        self.latency_us = max(0.0, last_us - self._injected_us)
        assert self.latency_us <= LATENCY_US.get(self.act, 0), "it moved on"
        assert not self._pico.mcu.gpio[SPINDLE_PWM].output_value, "the spindle's output is on"
        was_moving = any(edge.pin in STEP and edge.ns / 1000 < self._injected_us for edge in edges)
        if self.act == "limit" or was_moving:
            self._machine.wait_for("Reset to continue" if self.act == "limit" else "ALARM:3")
        if self.act != "limit":
            self._machine.wait_for("Grbl 1.1h")

    def _check_hold(self, before: "list[int]") -> None:
        """At rest it is at rest; told to go on, it makes what was left to the step."""
        self._pico.run_us(3_000)
        self._pico.drive(HOLD, 1)
        assert self._pico.run_until(self._is_held, 200_000), "it does not hold"
        self._odometer.read()
        self._pico.run_us(10_000)
        assert not self._pico.edges, "it moves or turns while held"
        self._machine.send("~")
        answered = self._pico.run_until(
            lambda: self._machine.said.count("ok\r\n") >= len(self._sent), 1_000_000
        )
        assert answered, self._machine.said
        self._machine.until_idle(_IDLE_US)
        assert self._odometer.read() == before, "steps were lost in a hold"

    def _is_held(self) -> bool:
        self._machine.send("?")
        self._pico.run_us(5_000)
        return "<Hold:0" in self._machine.said

    def _recover(self) -> None:
        for pin in (*LIMIT, RESET, HOLD):
            self._pico.drive(pin, 1)
        self._machine.forget()
        self._machine.send("\x18")
        self._machine.wait_for("Grbl 1.1h")
        self._machine.ask("$X")

    def _check_move(self) -> None:
        """A millimetre is a millimetre, and the machine is where its motors are."""
        before = self._odometer.read()
        self._machine.ask("G91G1X1F3000")
        self._machine.until_idle(_IDLE_US)
        made = self._odometer.read()
        moved = [now - was for now, was in zip(made, before, strict=True)]
        assert moved == [STEPS_PER_MM, 0, 0]
        told = [float(mm) * STEPS_PER_MM for mm in self._machine.status()["MPos"].split(",")]
        assert told == pytest.approx(made, abs=0.3)


@pytest.fixture(scope="module")
def machine(uf2: Path) -> Board:
    made = Board(uf2).boot().settled()
    for setting in SETTINGS:
        assert made.ask(setting) == "ok\r\n"
    made.pico.record([*STEP, *DIR, SPINDLE_PWM])
    return made


@pytest.fixture(scope="module")
def odometer(machine: Board) -> Odometer:
    return Odometer(machine.pico)


@pytest.fixture(scope="module")
def latencies() -> "Iterator[dict[str, float]]":
    """The longest of each kind; pytest -s shows them."""
    longest: dict[str, float] = {}
    yield longest
    print("\nus to the last edge at most:", {act: round(us) for act, us in longest.items()})


@pytest.mark.parametrize("seed", range(_COUNT))
def test_at_any_instant(
    machine: Board, odometer: Odometer, latencies: "dict[str, float]", seed: int
) -> None:
    trial = Trial(machine, odometer, seed)
    try:
        trial.run()
    except AssertionError:
        trial.end()  # that those behind begin with a machine that can be used
        raise
    latencies[trial.act] = max(latencies.get(trial.act, 0), trial.latency_us)


def test_a_stop_that_does_not_come_is_found(machine: Board, odometer: Odometer) -> None:
    """What this file is worth."""
    trial = Trial(machine, odometer, 2)
    trial.act = "nothing"
    with pytest.raises(AssertionError, match="it moved on"):
        trial.run()
    trial.end()
