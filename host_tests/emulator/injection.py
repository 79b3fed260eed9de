"""Stop or hold the emulated Pico at a random instant, and check the result.

A life is a program streamed from rest. A trial is a stop or a hold at one instant of it, and the
check of its result. Numbers determine lives and trials, so they can be repeated.
"""

from random import Random
from typing import NamedTuple

import pytest
from emulated import DIR, HOLD, LIMIT, RESET, SPINDLE_PWM, STEP, Board, Odometer

# Longest time from a stop to the last edge, us: docs/faults.md. All buttons are read before one of
# them acts. A hold slows down first, and is checked in another way.
LATENCY_US = {"limit": 200, "button": 400, "Ctrl-X": 7_000}
ACTS = (*LATENCY_US, "hold button", "!")
# Lines sent once, and lines sent in a loop that ends where it begins.
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
# Half a second of silence after an alarm would cost more than the rest of a trial.
SILENCE = ("_DEAF_MS = const(500)", "_DEAF_MS = const(20)")
STEPS_PER_MM = 250
TRIALS_PER_LIFE = 15

_START_DELAY_US = 10_000  # at most; varies the phase of the timers at every start
_WITHIN_US = 90_000
_SENDER_US = 200  # between two checks of the sender for answers
_WATCHED_US = 15_000  # after a stop
_SETTLED_US = 600_000
_IDLE_US = 1_500_000  # 64 blocks that each begin and end at rest
_RX_BYTES = 64


class Outcome(NamedTuple):
    """Result of a trial; trouble is empty if all laws hold."""

    seed: int
    act: str
    latency_us: float
    trouble: str


class Life:
    """A machine that streams a program from rest, with all edges since the start."""

    def __init__(self, machine: Board, odometer: Odometer, number: int) -> None:
        self.machine = machine
        self.odometer = odometer
        self.setup_line, self._lines = PROGRAMS[number % len(PROGRAMS)]
        self._start_delay_us = Random(number).uniform(0, _START_DELAY_US)
        self._sent: list[str] = []

    def start(self) -> None:
        """Start from rest, and discard the earlier records."""
        pico = self.machine.pico
        pico.run_us(self._start_delay_us)
        self.machine.ask(self.setup_line)
        self.machine.clear_output()
        self.start_steps = self.odometer.read()
        self._start_us = self._due_us = pico.us

    def run_to(self, after_us: float) -> None:
        """Stream until this time after the start, counting characters as most senders do."""
        pico = self.machine.pico
        while pico.us < self._start_us + after_us:
            if pico.us >= self._due_us:
                self._due_us += _SENDER_US
                self._send_what_fits()
            pico.run_us(min(self._due_us, self._start_us + after_us) - pico.us)

    def end_round(self, limit_us: float) -> None:
        """Send the rest of a round, which ends where it began, and wait for all answers."""
        rounds = -(-len(self._sent) // len(self._lines))
        lines = rounds * len(self._lines)

        def is_answered() -> bool:
            self._send_what_fits(lines)
            return self._answers() >= lines

        answered = self.machine.pico.run_until(is_answered, limit_us)
        assert answered, f"no answer to all lines: {self.machine.output}"

    def _answers(self) -> int:
        return self.machine.output.count("ok\r\n")

    def _send_what_fits(self, most_lines: "int | None" = None) -> None:
        while most_lines is None or len(self._sent) < most_lines:
            line = self._lines[len(self._sent) % len(self._lines)] + "\n"
            waiting = self._sent[self._answers() :]
            if sum(map(len, waiting)) + len(line) > _RX_BYTES:
                return
            self._sent.append(line)
            self.machine.send(line)


class Trial:
    """One stop, or one hold."""

    def __init__(self, seed: int) -> None:
        random = Random(seed)
        self.seed = seed
        self.act = ACTS[seed % len(ACTS)]
        self._limit = random.choice(LIMIT)
        self.at_us = random.uniform(0, _WITHIN_US)
        self.latency_us = 0.0

    def outcome(self, life: Life) -> Outcome:
        """Run the trial now, and check the laws."""
        trouble = ""
        try:
            self.play(life)
        except AssertionError as reason:
            at_ms = self.at_us / 1000
            trouble = (
                f"seed {self.seed}, {self.act} at {at_ms:.3f} ms of {life.setup_line}: {reason}"
            )
        return Outcome(self.seed, self.act, self.latency_us, trouble)

    def play(self, life: Life) -> None:
        """Run the trial; raise AssertionError. Afterwards the machine is idle and can be used."""
        self._life = life
        self._machine, self._pico = life.machine, life.machine.pico
        self._injected_us = self._pico.us
        self._inject()
        if self.act in LATENCY_US:
            self._check_stop()
        else:
            self._check_hold()
        self._check_move()

    def make_usable(self, machine: Board) -> None:
        """Prepare the machine for the next trial, whatever the result was."""
        machine.pico.run_us(_SETTLED_US)
        self._release(machine)
        machine.clear_output()
        machine.send("\x18")
        machine.wait_for("Grbl 1.1h")
        machine.ask("$X")

    def _inject(self) -> None:
        if self.act == "limit":
            self._pico.drive(self._limit, 0)
        elif self.act == "button":
            self._pico.drive(RESET, 0)
        elif self.act == "hold button":
            self._pico.drive(HOLD, 0)
        else:
            self._machine.send({"Ctrl-X": "\x18", "!": "!"}[self.act])

    def _release(self, machine: Board) -> None:
        for pin in (*LIMIT, RESET, HOLD):
            machine.pico.drive(pin, 1)

    # A stop

    def _check_stop(self) -> None:
        """Check the last edge, all outputs off, the alarm if it moved, and the reset."""
        self._pico.run_us(_WATCHED_US)
        edges = [edge for edge in self._pico.edges if edge.pin not in DIR]
        self.latency_us = self._since_injected_us(max((edge.ns for edge in edges), default=0.0))
        assert self.latency_us <= LATENCY_US[self.act], f"it moved on for {self.latency_us:.0f} us"
        assert self._pico.level(SPINDLE_PWM) == 0, "the spindle's output is on"
        moved = any(edge.pin in STEP and edge.ns < self._injected_us * 1000 for edge in edges)
        self._check_reset(moved)
        edges_during_reset = [edge for edge in self._pico.edges if edge.pin not in DIR][
            len(edges) :
        ]
        assert not edges_during_reset, f"edges during the reset: {edges_during_reset[:3]}"

    def _check_reset(self, moved: bool) -> None:
        """Check the messages, and the reset, which must be sent after a limit."""
        if self.act == "limit":
            self._machine.wait_for("ALARM:1\r\n")
            self._machine.wait_for("Reset to continue")
        elif moved:
            self._machine.wait_for("ALARM:3\r\n")
        self._release(self._machine)
        if self.act == "limit":
            self._machine.clear_output()
            self._machine.send("\x18")
        self._machine.wait_for("Grbl 1.1h")
        self._machine.ask("$X")

    def _since_injected_us(self, ns: float) -> float:
        return max(0.0, ns / 1000 - self._injected_us)

    # A hold

    def _check_hold(self) -> None:
        """Check that it stops, stays stopped, and after `~` makes the remaining steps."""
        self._pico.run_us(3_000)
        self._release(self._machine)
        assert self._pico.run_until(self._is_held, 200_000), "it does not hold"
        step_times_ns = [edge.ns for edge in self._pico.edges if edge.pin in STEP]
        self.latency_us = self._since_injected_us(max(step_times_ns, default=0.0))
        self._life.odometer.read()
        self._pico.run_us(10_000)
        assert not self._pico.edges, "an output moves during a hold"
        self._machine.send("~")
        self._life.end_round(_IDLE_US)
        self._machine.until_idle(_IDLE_US)
        assert self._life.odometer.read() == self._life.start_steps, "steps were lost in a hold"

    def _is_held(self) -> bool:
        self._machine.send("?")
        self._pico.run_us(3_000)
        return "<Hold:0" in self._machine.output

    # Both

    def _check_move(self) -> None:
        """Check that all motors work, and that the reported position is that of the motors."""
        machine, odometer = self._machine, self._life.odometer
        before = odometer.read()
        machine.ask("G91G1X0.1Y-0.08Z0.04F3000")
        self._pico.run_us(15_000)
        machine.until_idle(_IDLE_US)
        motor_steps = odometer.read()
        moved_mm = [
            (now - was) / STEPS_PER_MM for now, was in zip(motor_steps, before, strict=True)
        ]
        assert moved_mm == [0.1, -0.08, 0.04], f"the next move is {moved_mm}"
        reported_steps = [float(mm) * STEPS_PER_MM for mm in machine.status()["MPos"].split(",")]
        assert reported_steps == pytest.approx(motor_steps, abs=0.3), (
            f"reported {reported_steps} steps, made {motor_steps}"
        )
