"""Test storms of edges on inputs of the emulated Pico: steps are on time, the watch acts.

ask() sends a line and returns its answer, clear_output() forgets the output so far. Inputs are
closed at level 0. Steps are found in the edges recorded at the pins.
"""

from pathlib import Path

import pytest
from emulated import BOARD_FILE, DIR, LIMIT, PROBE, SPINDLE_PWM, START, STEP, Board, steps

pytestmark = pytest.mark.xdist_group("pico storm")

PART, DOOR = 20, 21  # of INPUTS
BOARD = BOARD_FILE.read_bytes() + b'INPUTS = {"part": 20, "door": 21}\n'
CUSTOM = b"""
import time
from ugrbl import mcode, on

@on.input("part")
@on.input("door")
def note(m, closed):
    pass

@mcode(100, sync=None)
def hang(m):
    time.sleep_ms(400)
"""
SETTINGS = (
    *("$0=3", "$100=80", "$101=80", "$102=80", "$110=3000", "$112=3000", "$120=400", "$122=400"),
    *("$1=0", "$10=1", "$30=1000", "$32=1"),
)
MOVE = "G91 G1 X3 F1800 S500"
STEPS = 240
STORM_US = 60_000


@pytest.fixture(scope="module")
def machine(uf2: Path) -> Board:
    """Return a board with two inputs for CUSTOM's functions; its M100 blocks for 400 ms."""
    made = Board(uf2, {"board.py": BOARD, "custom.py": CUSTOM})
    for pin in (PART, DOOR):
        made.pico.drive(pin, 1)
    made.boot().settled()
    for setting in SETTINGS:
        assert made.ask(setting) == "ok\r\n"
    made.pico.record([*STEP, *DIR, SPINDLE_PWM])
    return made


@pytest.fixture
def ready(machine: Board) -> Board:
    """Reset and unlock the machine, whatever its state was, and switch the beam on."""
    machine.clear_output()
    machine.send("\x18")
    machine.wait_for("Grbl 1.1h")
    for line in ("$X", "$21=0", "M4 S0"):
        machine.ask(line)
    machine.pico.edges.clear()
    return machine


class Storm:
    """Edges on pins of the board, all together: open and closed for these times, in us."""

    def __init__(
        self, board: Board, pins: "tuple[int, ...]", open_us: int, closed_us: int
    ) -> None:
        self._pico = board.pico
        self._pins = pins
        self._us_by_level = (closed_us, open_us)
        self._level = 1
        self._end_us = 0.0
        self.began_us = 0.0

    def start(self, delay_us: float, duration_us: float) -> None:
        """Begin after delay_us and continue for duration_us; the pins are open at the end."""
        self.began_us = self._pico.us + delay_us
        self._end_us = self.began_us + duration_us
        self._pico.at_us(delay_us, self._change_level)

    def _change_level(self) -> None:
        """Change the level of the pins, and plan the next change; 1 is open."""
        self._level = 1 if self._pico.us >= self._end_us else 1 - self._level
        for pin in self._pins:
            self._pico.drive(pin, self._level)
        if self._pico.us < self._end_us:
            self._pico.at_us(self._us_by_level[self._level], self._change_level)


def run_move(board: Board) -> "list[float]":
    """Run MOVE; return the times of its steps, relative to the first, in us."""
    board.ask(MOVE)
    board.until_idle()
    steps_us = [us for us, _ in steps(board.pico.edges, 0)]
    return [us - steps_us[0] for us in steps_us]


def beam_is_dark(board: Board) -> bool:
    """Return whether the beam has no pulses any more."""
    board.pico.edges.clear()
    board.pico.run_us(2_000)
    pulses = [edge for edge in board.pico.edges if edge.pin == SPINDLE_PWM]
    return not pulses and board.pico.level(SPINDLE_PWM) == 0


@pytest.fixture(scope="module")
def calm_steps_us(machine: Board) -> "list[float]":
    machine.ask("M4 S0")
    return run_move(machine)


STORMED = {"one": (PART,), "all": (PART, DOOR, START, *LIMIT, PROBE)}


@pytest.mark.parametrize("edges_us", [20, 25])
@pytest.mark.parametrize("pins", STORMED.values(), ids=STORMED)
def test_no_step_is_late_in_a_storm(
    ready: Board, calm_steps_us: "list[float]", pins: "tuple[int, ...]", edges_us: int
) -> None:
    """Within 2 us of the times without a storm, calm_steps_us. edges_us: from edge to edge."""
    Storm(ready, pins, open_us=edges_us, closed_us=edges_us).start(
        delay_us=40_000, duration_us=STORM_US
    )
    steps_us = run_move(ready)
    assert len(steps_us) == STEPS
    assert max(abs(a - b) for a, b in zip(steps_us, calm_steps_us)) < 2
    assert beam_is_dark(ready)


@pytest.mark.parametrize("pins", [(PART,), (PART, DOOR)])
def test_watch_acts_on_a_hanging_main_loop_in_a_storm(
    ready: Board, pins: "tuple[int, ...]"
) -> None:
    """M100 of CUSTOM blocks the main loop for 400 ms: after 250 ms motors and beam are stopped."""
    ready.ask("G91 G1 X20 F1800 S500")
    ready.pico.run_us(30_000)
    ready.clear_output()
    ready.send("M100\n")
    sent_us = ready.pico.us
    Storm(ready, pins, open_us=20, closed_us=20).start(delay_us=10_000, duration_us=260_000)
    ready.wait_for("ALARM:16")
    last_us = max(edge.ns / 1000 for edge in ready.pico.edges)  # steps, and pulses of the beam
    assert 240_000 <= last_us - sent_us <= 270_000
    assert beam_is_dark(ready)


def test_limit_in_a_storm_stops_at_its_first_edge(ready: Board) -> None:
    """No edge of motors or beam comes 300 us after the storm's first one."""
    ready.ask("$21=1")
    ready.ask("G91 G1 X20 F1800 S500")
    storm = Storm(ready, LIMIT[:1], open_us=20, closed_us=20)
    storm.start(delay_us=60_000, duration_us=STORM_US)
    ready.wait_for("Reset to continue")
    assert max(edge.ns / 1000 for edge in ready.pico.edges) - storm.began_us <= 300
    assert "ALARM:1\r\n" in ready.output and beam_is_dark(ready)


@pytest.mark.parametrize(("after_us", "late_us"), [(200, 2_500), (20_000, 0)])
def test_contact_after_pulses_too_short_to_be_seen_has_its_right_place(
    ready: Board, after_us: int, late_us: int
) -> None:
    """A storm of pulses of 3 us, then a contact after_us later.

    late_us: how long the probe may still be ignored after the storm.
    """
    contact_steps: list[int] = []
    start_z_mm = float(ready.status()["MPos"].split(",")[2])

    def touch() -> None:
        """Record Z's steps until now, and close the probe's contact."""
        contact_steps.append(len(steps(ready.pico.edges, 2)))  # all of them down
        ready.pico.drive(PROBE, 0)

    ready.pico.edges.clear()
    Storm(ready, (PROBE,), open_us=497, closed_us=3).start(delay_us=40_000, duration_us=STORM_US)
    ready.pico.at_us(40_000 + STORM_US + after_us, touch)
    said = ready.ask("G91 G38.2 Z-5 F600", limit_us=4_000_000)
    ready.pico.drive(PROBE, 1)
    probed_mm = float(said.partition("[PRB:")[2].split(":")[0].split(",")[2])
    too_low_mm = start_z_mm - contact_steps[0] / 80 - probed_mm
    # A step (1/80 mm) either way, and the way made in late_us at F600, 10 mm/s.
    assert 0 <= too_low_mm + 0.0126 <= 0.0252 + late_us * 10 / 1_000_000
