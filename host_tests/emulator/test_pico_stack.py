"""Test the C stack of the RP2040: main loop and all interrupts share 8 kB; 2 kB stay free.

Two measures, both from outside. Watermark: free memory is painted, a scenario runs, and the lowest
changed word is found. This shows the depth that occurred, but the worst nesting is too rare for
it. So the deepest main loop, the deepest interrupt of the engine and the deepest one of a pin are
measured separately, by sampling the stack pointer. Their sum leaves the reserve even if all of
them occur together.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from chips import CHIP
from emulated import DIR, HOLD, LIMIT, PROBE, RESET, START, STEP, Board, steps

pytestmark = pytest.mark.xdist_group("pico stack")

TOP = CHIP.stack_top
STACK_BYTES = 8192
RESERVE_BYTES = 2048
_NESTED_RESERVE = 1792  # if the deepest of all occurred together, which was never observed
_PATTERN = 0x2A2A2A2A  # the pattern of firmware/pio/stack.py: both find the same paint
_GUARD = 64  # bytes below the stack pointer that are not painted

_IRQ = 16  # number of IRQ 0 in IPSR
TIMER, ENGINE, PIN = CHIP.irqs  # no other interrupt has a higher priority
_SAMPLE_US = 0.1  # a few instructions
_PIO0 = 0x50200000  # its low bits: running machines

ARCS = ("G2X1Y0I0.5J0", "G3X-1Y0I-0.5J0")
_RX_BYTES = 120


class Watched(Board):
    """A board that checks all output for the report of an interrupt without stack space."""

    def clear_output(self) -> None:
        assert "Uncaught" not in self.output, self.output[-300:]
        super().clear_output()


class Stack:
    """The chip's stack, measured from outside."""

    def __init__(self, board: Board) -> None:
        self._pico = board.pico
        self.main = {False: 0, True: 0}  # deepest, in bytes, by whether the engine runs
        self.starts = 0  # deepest of ENGINE when it starts the engine, with the code it interrupts
        self.irqs: dict[int, int] = {}  # deepest of each interrupt alone, by its IRQ
        self.marks: dict[str, int] = {}  # most_used() by scenario

    def start_measuring(self) -> None:
        """Fill the free stack with the pattern."""
        for address in range(TOP - STACK_BYTES, self._pico.stack()[0] - _GUARD, 4):
            self._pico.write_word(address, _PATTERN)

    def most_used(self) -> int:
        """Return the largest number of bytes used since start_measuring()."""
        for address in range(TOP - STACK_BYTES, TOP, 4):
            if self._pico.read_word(address) != _PATTERN:
                return TOP - address
        return 0

    def _runs(self) -> bool:
        return bool(self._pico.read_word(_PIO0) & 15)

    @contextmanager
    def sampled(self) -> "Iterator[None]":
        """Sample main, starts and irqs meanwhile, every _SAMPLE_US.

        irqs do not include the depth of interrupted code.
        """
        run_us = self._pico.run_us
        # (interrupt, stack pointer at its start, whether the engine was running)
        nested: list[tuple[int, int, bool]] = []
        before, _ = self._pico.stack()  # stack pointer at the last sample

        def sample(us: float) -> None:
            """Run for this time like run_us(), and sample the stack."""
            nonlocal before
            end = self._pico.us + us
            while self._pico.us < end:
                run_us(_SAMPLE_US)
                pointer, number = self._pico.stack()
                if not number:  # no interrupt: the main loop
                    nested.clear()
                    if TOP - pointer > min(self.main.values()):
                        runs = self._runs()
                        self.main[runs] = max(self.main[runs], TOP - pointer)
                else:
                    # Interrupts that were on top of this one have returned.
                    while any(n == number for n, _, _ in nested[:-1]):
                        nested.pop()
                    if not nested or nested[-1][0] != number:
                        nested.append((number, before, self._runs()))
                    depth = nested[-1][1] - pointer
                    self.irqs[number - _IRQ] = max(self.irqs.get(number - _IRQ, 0), depth)
                    if nested[-1][0] == ENGINE + _IRQ and not nested[-1][2]:
                        self.starts = max(self.starts, TOP - pointer)
                before = pointer

        self._pico.run_us = sample
        try:
            yield
        finally:
            self._pico.run_us = run_us


@pytest.fixture(scope="module")
def machine(uf2: Path) -> Board:
    """Return a board that is set up, with hard limits."""
    made = Watched(uf2).boot().settled()
    for setting in ("$110=9000", "$111=9000", "$112=3000", "$120=1000", "$121=1000", "$122=500"):
        made.ask(setting)
    made.ask("$21=1")
    return made


@pytest.fixture(scope="module")
def stack(machine: Board) -> "Iterator[Stack]":
    """Yield the measured stack; pytest -s shows the figures."""
    seen = Stack(machine)
    yield seen
    print("\nbytes used:", seen.marks, "main loop:", seen.main, "interrupts:", seen.irqs)


def stream(machine: Board, lines: "tuple[str, ...]", rounds: int, query_ms: float) -> None:
    """Stream the lines so many times, send "?" every query_ms, and wait until the machine is idle,
    at its start.

    Characters are counted as senders do: no more than _RX_BYTES are unanswered.
    """
    pico = machine.pico
    machine.ask("G91")
    start = machine.status()["MPos"]
    machine.clear_output()
    next_query_us = pico.us + query_ms * 1000
    to_send = [line + "\n" for line in lines * rounds]
    sent: list[str] = []
    while machine.output.count("ok\r\n") < len(lines) * rounds:
        unanswered = sent[machine.output.count("ok\r\n") :]
        while to_send and sum(map(len, unanswered)) + len(to_send[0]) <= _RX_BYTES:
            unanswered.append(to_send[0])
            sent.append(to_send[0])
            machine.send(to_send.pop(0))
        if pico.us >= next_query_us:
            machine.send("?")
            next_query_us += query_ms * 1000
        pico.run_us(500)
        assert "Uncaught" not in machine.output and "error" not in machine.output, machine.output
    machine.until_idle()
    assert machine.status()["MPos"] == start


def unlock(machine: Board) -> None:
    """Release the inputs and unlock the machine after an alarm."""
    for pin in (LIMIT[0], RESET, HOLD):
        machine.pico.drive(pin, 1)
    machine.pico.run_us(30_000)  # a button resets the machine itself
    machine.clear_output()
    machine.send("\x18")
    machine.wait_for("Grbl 1.1h")
    machine.pico.run_us(60_000)  # that may be the button's, half a second late
    machine.ask("$X")


# Scenarios


def talk(machine: Board) -> None:
    """Send system commands; the second $C ends check mode by a reset."""
    for line in ("$I+", "$$", "$#", "$G", "$N", "$N0=G54", "$N0=", "$130=300", "G10L2P2X1"):
        machine.ask(line)
    machine.ask("$RST=#")
    machine.ask("$C")
    machine.ask("G91G2X1Y0I0.5J0F500")
    machine.clear_output()
    machine.send("$C\n")
    machine.wait_for("Grbl 1.1h")
    machine.ask("$X")


def modes(machine: Board) -> None:
    """Stream lines that change modes, twice, with "?" every 17 ms."""
    stream(
        machine,
        ("G91G1X0.3F3000", "M3S100", "G4P0.001", "M8", "G90", "G91", "M9", "G1X-0.3F2000", "M5"),
        rounds=2,
        query_ms=17,
    )


def short_lines(machine: Board) -> None:
    stream(machine, ("G1X0.05F3000", "G1X-0.05"), rounds=12, query_ms=17)


def jogs(machine: Board) -> None:
    """Stream jogs, and cancel one in motion."""
    stream(machine, ("$J=X0.1F3000", "$J=X-0.1F3000"), rounds=5, query_ms=17)
    machine.clear_output()
    machine.send("$J=X5F3000\n")
    machine.pico.run_us(50_000)
    machine.send(b"\x85?")  # jog cancel
    machine.pico.run_us(20_000)
    machine.until_idle()


def feed_hold(machine: Board) -> None:
    """Hold in motion and resume, with requests for the status around both."""
    machine.ask("G91 G1 X3 F3000")
    machine.pico.run_us(30_000)
    machine.send("!?")
    machine.pico.run_us(80_000)
    machine.send("?~?")
    machine.pico.run_us(20_000)
    machine.until_idle()


def door(machine: Board) -> None:
    """Open the door in motion and resume: the spindle is restored first, which takes 4 s."""
    machine.ask("M3S500")
    machine.ask("G91 G1 X3 F3000")
    machine.pico.run_us(30_000)
    machine.send(b"\x84?")  # safety door
    machine.pico.run_us(100_000)
    machine.send("~")
    machine.pico.run_us(4_200_000)
    machine.until_idle()
    machine.ask("M5")


def probe(machine: Board) -> None:
    """Probe along X; the contact closes after 50 ms."""
    machine.clear_output()
    machine.send("G91 G38.3 X2 F900\n")
    machine.pico.run_us(40_000)
    machine.send("?")
    machine.pico.run_us(10_000)
    machine.pico.drive(PROBE, 0)
    machine.wait_for("PRB:")
    machine.pico.drive(PROBE, 1)
    machine.wait_for("ok")


def homing(machine: Board) -> None:
    """Home to switches 1 mm away on all axes, which follow the motors."""
    for setting in ("$23=0", "$24=300", "$25=1200", "$27=0.3", "$26=5", "$22=1"):
        machine.ask(setting)
    machine.ask("$X")
    machine.pico.record([*STEP, *DIR])
    is_homing = [True]  # empty afterwards

    def update_switches() -> None:
        """Set the switches for the motors' positions, every millisecond during homing."""
        for axis in range(3):
            at_steps = sum(sign for _, sign in steps(machine.pico.edges, axis))
            machine.pico.drive(LIMIT[axis], 0 if at_steps >= 250 else 1)
        if is_homing:
            machine.pico.at_us(1_000, update_switches)

    update_switches()
    machine.ask("$H", limit_us=12_000_000)
    is_homing.clear()
    machine.ask("$22=0")


def close_input_in_arcs(machine: Board, phase_ms: float, pin: int, answer: str) -> None:
    """Close an input for 3 ms in the middle of arcs, right after a request for the status.

    phase_ms: shifts both in time; answer: the text to wait for.
    """
    machine.ask("G91 F3000")
    machine.clear_output()
    machine.send("\n".join(ARCS * 2) + "\n")
    machine.pico.run_us(40_000 + phase_ms * 1000)
    machine.send("?")
    machine.pico.run_us(phase_ms * 100)
    machine.pico.drive(pin, 0)
    machine.pico.run_us(3_000)
    machine.pico.drive(pin, 1)
    machine.send("?")
    machine.wait_for(answer)


def stop_scenario(pin: int, answer: str) -> "Callable[[Board], None]":
    """Return the scenario of an input that stops the machine, at several phases."""

    def scenario(machine: Board) -> None:
        for phase_ms in (2.1, 5.3, 9.7):
            close_input_in_arcs(machine, phase_ms, pin, answer)
            unlock(machine)

    return scenario


def is_held(machine: Board) -> bool:
    return machine.status()["state"] == "Hold:0"


def hold_button(machine: Board) -> None:
    """Press the hold button in arcs, at several phases, and resume by the start button."""
    for phase_ms in (2.1, 5.3, 9.7):
        close_input_in_arcs(machine, phase_ms, HOLD, "<Hold")
        has_stopped = machine.pico.run_until(lambda: is_held(machine), 500_000, step_us=10_000)
        assert has_stopped, machine.output
        machine.pico.drive(START, 0)
        machine.pico.run_us(5_000)
        machine.pico.drive(START, 1)
        machine.until_idle(3_000_000)


SCENARIOS: "dict[str, Callable[[Board], None]]" = {
    "talk": talk,
    "modes": modes,
    "short lines": short_lines,
    "jogs": jogs,
    "feed hold": feed_hold,
    "probe": probe,
    "limit in arcs": stop_scenario(LIMIT[0], "Reset to continue"),
    "reset button in arcs": stop_scenario(RESET, "ALARM:3"),
    "hold button in arcs": hold_button,
    "door": door,
    "homing": homing,
}


@pytest.mark.parametrize("name", SCENARIOS)
def test_two_kilobytes_stay_free(machine: Board, stack: Stack, name: str) -> None:
    """By the watermark, in each scenario: a function above that drives the machine."""
    stack.start_measuring()
    SCENARIOS[name](machine)
    stack.marks[name] = stack.most_used()
    assert stack.marks[name] <= STACK_BYTES - RESERVE_BYTES


# These once used up the stack within half a second; each has another phase of events.
@pytest.mark.parametrize(
    ("feed", "query_ms"), [(3000, 100), (3000, 40), (3000, 23), (9000, 17), (9000, 17.3)]
)
def test_two_kilobytes_stay_free_in_streams_of_arcs(
    machine: Board, stack: Stack, feed: int, query_ms: float
) -> None:
    """feed: mm/min; query_ms: from one "?" to the next."""
    stack.start_measuring()
    stream(machine, (f"{ARCS[0]}F{feed}", ARCS[1]), rounds=3, query_ms=query_ms)
    stack.marks[f"F{feed} ? {query_ms}"] = stack.most_used()
    assert stack.most_used() <= STACK_BYTES - RESERVE_BYTES


def test_firmware_reports_the_stack_use_measured_from_outside(
    machine: Board, stack: Stack
) -> None:
    """Both find the same paint; $I+ itself may use a little more."""
    stack.start_measuring()
    stream(machine, (f"{ARCS[0]}F3000", ARCS[1]), rounds=1, query_ms=23)
    reported = machine.ask("$I+").partition("[MSG:Stack: ")[2]
    used_bytes = int(reported.partition(" of 8192 bytes used]")[0])
    assert abs(used_bytes - stack.most_used()) <= 64


def test_reserve_remains_if_the_deepest_of_all_are_nested(machine: Board, stack: Stack) -> None:
    """The sum of the depths that were sampled separately, in arcs, commands, a hold and stops."""
    with stack.sampled():
        stream(machine, (f"{ARCS[0]}F3000", ARCS[1]), rounds=1, query_ms=23)
        talk(machine)
        close_input_in_arcs(machine, phase_ms=3.1, pin=HOLD, answer="<Hold")
        machine.send("~")
        machine.pico.run_us(5_000)
        for pin, answer in ((LIMIT[0], "Reset to continue"), (RESET, "ALARM:3")):
            unlock(machine)
            close_input_in_arcs(machine, phase_ms=3.1, pin=pin, answer=answer)
    unlock(machine)
    irqs = dict(stack.irqs)
    assert {TIMER, ENGINE, PIN} <= irqs.keys()
    # Bytes: while the engine runs, while it does not, and the pin's interrupt on top of either.
    moving = stack.main[True] + irqs[ENGINE]
    idle = max(stack.main[False] + irqs[TIMER], stack.starts)
    deepest = max(moving, idle) + irqs[PIN]
    assert deepest <= STACK_BYTES - _NESTED_RESERVE, (moving, idle, irqs)
