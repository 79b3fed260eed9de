"""Test edges of step and direction pins on the emulated Pico: number, time, plan."""

from itertools import pairwise
from pathlib import Path

import emulated
import pytest
from emulated import DIR, ENABLE, STEP, Board, steps

pytestmark = pytest.mark.xdist_group("pico motion")

SETTINGS = (
    "$0=3",
    *("$100=80", "$101=80", "$102=400"),
    *("$110=6000", "$111=6000", "$112=600"),
    *("$120=500", "$121=500", "$122=200"),
)
PROGRAM = """
G91 G1 X3 Y-1.5 F4000
X1.5 Y1.5
G2 X1 Y1 I1 J0 F2400
G0 Z0.5
X-2 Y0.5
G1 X-2.5 Y-1 Z-0.5 F3000
""".split("\n")[1:-1]

_PULSE_US = 3
_TICK_US = 0.08
# The emulator records an edge up to a few instructions late.
_SEEN_US = 0.3
_SETUP_US = 5
_HOLD_US = 2


@pytest.fixture(scope="module")
def machine(uf2: Path) -> Board:
    """Return a machine, set up, its motor pins recorded.

    USER_MAIN adds commands: $BLOCK blocks the main loop for 200 ms, $COLLECT collects garbage for
    150 ms, $PRINT sends 200 messages.
    """
    made = Board(uf2, {"main.py": USER_MAIN}).boot().settled()
    for setting in SETTINGS:
        assert made.ask(setting).endswith("ok\r\n")
    made.pico.record([*STEP, *DIR, ENABLE])
    return made


# A user's slow Python code in main.py, where users may add such commands.
USER_MAIN = b"""
import gc
import time

from boot import power_up

from talk import commands
usual = commands.Commands.find_command


def find_command(self, line, length):
    what = bytes(line[1:length])
    if what == b"BLOCK":
        since = time.ticks_ms()
        while time.ticks_diff(time.ticks_ms(), since) < 200:
            pass
    elif what == b"COLLECT":
        since = time.ticks_ms()
        while time.ticks_diff(time.ticks_ms(), since) < 150:
            gc.collect()
    elif what == b"PRINT":
        for _ in range(200):
            self._report.message("x" * 60)
    else:
        return usual(self, line, length)
    return lambda line, length: None


commands.Commands.find_command = find_command
power_up.run_machine(power_up.build())
"""


def run_lines(machine: Board, lines: "list[str]") -> "list[list[tuple[float, int]]]":
    """Stream lines, wait until they are executed, and return the steps of every axis."""
    machine.until_idle()
    machine.pico.edges.clear()
    machine.clear_output()
    machine.send("".join(line + "\n" for line in lines))
    machine.pico.run_until(lambda: machine.output.count("ok\r\n") == len(lines), 10_000_000)
    assert machine.output.count("ok\r\n") == len(lines), machine.output
    machine.until_idle()
    return [steps(machine.pico.edges, axis) for axis in range(3)]


@pytest.fixture(scope="module")
def made(machine: Board) -> "list[list[tuple[float, int]]]":
    """Return the steps of the program, (us, sign) per axis, and leave its edges in
    machine.program_edges."""
    steps_of_axes = run_lines(machine, PROGRAM)
    machine.program_edges = list(machine.pico.edges)
    return steps_of_axes


@pytest.fixture(scope="module")
def planned() -> "list[list[tuple[float, int]]]":
    """Return the steps of the same program in the simulator."""
    return emulated.planned(PROGRAM, SETTINGS)


def test_program_makes_exactly_the_planned_steps(
    made: "list[list[tuple[float, int]]]", planned: "list[list[tuple[float, int]]]"
) -> None:
    for axis, (real, due) in enumerate(zip(made, planned, strict=True)):
        assert [sign for _, sign in real] == [sign for _, sign in due], f"axis {axis}"


def test_steps_come_at_their_planned_times(
    made: "list[list[tuple[float, int]]]", planned: "list[list[tuple[float, int]]]"
) -> None:
    # Segments begin at other times than in the simulator, so a speed change may come up to one
    # segment earlier or later.
    start = min(axis[0][0] for axis in made if axis)
    start_due = min(axis[0][0] for axis in planned if axis)
    for real, due in zip(made, planned, strict=True):
        late_us = [t - start - (d - start_due) for (t, _), (d, _) in zip(real, due, strict=True)]
        assert max(map(abs, late_us)) < 5_000


def test_pulse_length_and_direction_setup_and_hold_are_kept(
    made: "list[list[tuple[float, int]]]", machine: Board
) -> None:
    """Checked at each edge of both pins, with the time by which the emulator may be late."""
    assert made  # this fixture leaves the edges in machine.program_edges
    for axis in range(3):
        edges = [e for e in machine.program_edges if e.pin in (STEP[axis], DIR[axis])]
        last_rise_us = last_change_us = -1e9  # us: STEP's last rising edge, DIR's last change
        for edge in edges:
            us = edge.ns / 1000
            if edge.pin == DIR[axis]:
                assert us - last_rise_us >= _PULSE_US + _HOLD_US - _SEEN_US
                last_change_us = us
            elif edge.level:
                assert us - last_change_us >= _SETUP_US - _SEEN_US
                last_rise_us = us
            else:
                assert abs(us - last_rise_us - _PULSE_US) <= _SEEN_US


def _intervals(track: "list[tuple[float, int]]", skip: int) -> "list[float]":
    """Return the intervals between steps, without this number of steps at both ends."""
    times = [us for us, _ in track][skip:-skip]
    return [b - a for a, b in pairwise(times)]


@pytest.mark.parametrize("command", ["$BLOCK", "$COLLECT", "$PRINT"])
def test_motion_is_smooth_while_python_is_busy(machine: Board, command: str) -> None:
    """The command, which the fixture adds, keeps the main loop busy for 150 ms or more."""
    # At 40 mm/s, 3200 steps/s, for 0.26 s; acceleration and braking take 128 steps each.
    machine.pico.edges.clear()
    machine.ask("G91 G1 X12 F2400")
    machine.pico.run_us(60_000)
    assert steps(machine.pico.edges, 0)
    sent_us = machine.pico.us
    machine.ask(command)
    assert machine.pico.us - sent_us > 120_000  # it was busy
    machine.until_idle()
    gaps_us = _intervals(steps(machine.pico.edges, 0), 140)
    assert len(gaps_us) > 600
    # Each is within a tick, or 1 %, of the interval at 3200 steps/s.
    assert max(gaps_us) - min(gaps_us) <= 2 * max(_TICK_US, 0.01 * 1e6 / 3200)


def test_motors_are_powered_while_they_move_and_released_after(machine: Board) -> None:
    machine.ask("$1=25")  # ms until they are released
    run_lines(machine, ["G91 G0 X1"])
    machine.pico.run_us(60_000)
    levels = [edge.level for edge in machine.pico.edges if edge.pin == ENABLE]
    assert levels == [0, 1]  # 0: on


def test_slow_steps_are_even(machine: Board) -> None:
    # 250 mm/min * 80 steps/mm are 333 steps/s, 3000 us apart. Slower steps take too long here;
    # host_tests/pio/test_pio.py has them.
    tracks = run_lines(machine, ["G91 G1 X0.5 F250"])
    gaps_us = _intervals(tracks[0], 6)
    # 40 steps without 6 at each end have 27 intervals; each is within 1 %.
    assert len(gaps_us) == 27 and max(abs(gap - 3000) for gap in gaps_us) <= 30
