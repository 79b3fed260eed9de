"""Test the laser's pin on the emulated Pico.

S0:300:775:100 in a line divides it into four dots of these powers; S1000 is full power. Levels are
those of the PWM's compare register. M4 scales power with the speed and is off while idle.
"""

from bisect import bisect
from itertools import pairwise
from pathlib import Path

import pytest
from chips import CHIP
from emulated import (
    DIR,
    LIMIT,
    RESET,
    SPINDLE_PWM,
    STEP,
    Board,
    files_of,
    firmware,
    for_this_chip,
    steps,
)
from ugrbl.compiling import build
from ugrbl.paths import BOARDS

pytestmark = pytest.mark.xdist_group("pico laser")

_FULL = CHIP.mhz * 1_000_000 // 20_000  # the level of full power at $33=20000
_HALF = _FULL // 2
_DOTS = [_FULL * tenths // 10 for tenths in range(10, 4, -1)]


@pytest.fixture(scope="module")
def machine(uf2: Path) -> Board:
    """Return a board with a laser, whose pin is recorded."""
    made = Board(uf2, files_of("pico_laser")).boot().settled()
    made.pico.record([SPINDLE_PWM])
    made.ask("G1 F100")
    return made


def pulses(machine: Board, us: float) -> "list[tuple[float, float]]":
    """Return (period, length) of the pin's pulses, both in us, recorded for this time."""
    machine.pico.edges.clear()
    machine.pico.run_us(us)
    edges = [edge for edge in machine.pico.edges if edge.pin == SPINDLE_PWM]
    # The emulator's pin has a pulse of zero length when the compare register is written.
    highs = [(a.ns, b.ns - a.ns) for a, b in pairwise(edges) if a.level and b.ns > a.ns]
    return [((b - a) / 1000, high / 1000) for (a, high), (b, _) in pairwise(highs)]


@pytest.mark.parametrize("hz", [5_000, 50_000, 100_000, 20_000])
def test_pwm_frequency_changes_at_once_with_the_same_power(machine: Board, hz: int) -> None:
    """S250 is a quarter of the full power, S1000; the new frequency applies two periods later."""
    machine.ask("M3 S250")
    machine.ask(f"$33={hz}")
    period_us = 1e6 / hz
    machine.pico.run_us(2 * period_us)
    recorded = pulses(machine, 12 * period_us)
    assert len(recorded) >= 9
    for period, high in recorded:
        assert abs(period - period_us) < 0.1 and abs(high - period_us / 4) < 0.1
    machine.ask("M5")


def test_pwm_frequency_survives_a_power_cut(machine: Board, uf2: Path) -> None:
    """A second board starts with the first one's files: 40 kHz are periods of 25 us."""
    machine.ask("$33=40000")
    second = Board(uf2, files_of("pico_laser"))
    second.pico.put_file_system(machine.pico.flash_image())
    second.boot()
    assert "$33=40000\r\n" in second.ask("$$")
    second.pico.record([SPINDLE_PWM])
    second.ask("G1 F100 M3 S250")
    recorded = pulses(second, 300)
    assert len(recorded) >= 9 and all(abs(period - 25) < 0.1 for period, _ in recorded)


# Power in motion


class Beam:
    """Record writes to the compare register of the PWM, with the motors' edges."""

    def __init__(self, machine: Board) -> None:
        self.changes = machine.pico.watch_power(SPINDLE_PWM)  # us, level


@pytest.fixture(scope="module")
def beam(machine: Board) -> Beam:
    machine.pico.record([SPINDLE_PWM, *STEP, *DIR])
    for setting in ("$0=3", "$33=20000", "$110=6000", "$111=6000", "$120=5000", "$121=5000"):
        machine.ask(setting)
    return Beam(machine)


def power_changes(machine: Board, beam: Beam) -> "list[tuple[float, int]]":
    """Return (position, level) of each change of power.

    The position is in steps of X, with a fraction of the interval between two of them. Half a step
    is subtracted: a step stands for the middle of its distance.
    """
    times = [us for us, _ in steps(machine.pico.edges, 0)]
    changes = []
    for us, level in beam.changes:
        k = bisect(times, us)  # steps until then
        if 0 < k < len(times):
            changes.append((k - 0.5 + (us - times[k - 1]) / (times[k] - times[k - 1]), level))
    return changes


def send_when_idle(machine: Board, beam: Beam, *lines: str) -> None:
    """Send lines when the machine is idle, with all records emptied before."""
    machine.until_idle()
    machine.pico.edges.clear()
    beam.changes.clear()
    machine.clear_output()
    machine.send("".join(line + "\n" for line in lines))


@pytest.mark.parametrize("per_mm", [80, 250])
@pytest.mark.parametrize("mode", ["M3", "M4"])
def test_power_changes_at_its_step_at_100_mm_s(
    machine: Board, beam: Beam, per_mm: int, mode: str
) -> None:
    """Each change of power of a row of dots comes within 0.05 steps of its place:
    docs/laser.md."""
    check_power_places(machine, beam, per_mm, mode)


def check_power_places(
    machine: Board, beam: Beam, per_mm: int, mode: str, other_words: str = ""
) -> None:
    """Check the distance of power changes from their places; other_words: of other axes.

    Four clusters (lines with S0:300:...) of four dots each, 0.2 mm long, begin at X 2 mm.
    """
    machine.ask(f"$100={per_mm}")
    machine.clear_output()
    machine.send("\x18")
    machine.wait_for("for help]")
    for line in ("$X", f"G91 G1 F6000 {mode} S0"):
        machine.ask(line)
    lines = ["X2", *(f"X0.8S0:300:{875 - 100 * k}:100" for k in range(4)), "X0.8S1000", "X2S0"]
    lines = [other_words + line for line in lines]  # words of other axes come first
    send_when_idle(machine, beam, *lines)
    machine.pico.run_until(lambda: machine.output.count("ok\r\n") == len(lines), 5_000_000)
    assert machine.output.count("ok\r\n") == len(lines)
    machine.until_idle()
    # From shortly before the first cluster, at 2 mm, to the end of the line with S1000.
    changes = [c for c in power_changes(machine, beam) if 2 * per_mm - 9 < c[0] < 6.1 * per_mm]
    powers = [s for k in range(4) for s in (0, 300, 875 - 100 * k, 100)] + [1000]
    levels = [level for _, level in changes[:17]]  # 4 * 4 dots and S1000
    tolerance = 0 if mode == "M3" else 9  # M4 scales power with the speed
    assert levels == pytest.approx([_FULL * s // 1000 for s in powers], abs=tolerance)
    off_steps = [abs(at - (2 + 0.2 * k) * per_mm) for k, (at, _) in enumerate(changes[:17])]
    print(f"{per_mm} steps/mm, {mode}: {max(off_steps):.3f} steps from their places at the most")
    assert max(off_steps) < 0.05


_MORE_MOTORS = """
STEP += (19, 20, 21)[:%d]
DIR += (26, 27, 28)[:%d]
LIMIT = LIMIT + (None,) * (len(STEP) - 3)
"""


@pytest.mark.parametrize(("motors", "other_words"), [(4, "A-.3"), (6, "A.3B-.2C.1")])
def test_power_changes_at_its_step_with_four_and_six_motors(
    uf2: Path, motors: int, other_words: str
) -> None:
    """The beam's state machine is then one of PIO 1; with six motors it is the last free one.

    A reset switches the beam off for good; afterwards it works again.
    """
    file = for_this_chip(BOARDS / "pico_laser.py", _MORE_MOTORS % ((motors - 3,) * 2))
    # fromkeys(): None instead of each file of the common board.
    files = {**dict.fromkeys(firmware()), **build.for_board(file).files}
    machine = Board(uf2, files).boot().settled()
    machine.pico.record([SPINDLE_PWM, *STEP, *DIR])
    for axis in range(motors):
        for number, value in ((100, 250), (110, 6000), (120, 5000)):
            machine.ask(f"${number + axis}={value}")
    for setting in ("$0=3", "$33=20000"):
        machine.ask(setting)
    beam = Beam(machine)
    check_power_places(machine, beam, 250, "M3", other_words)
    start_dots(machine, beam, "M3")
    STOP_ACTIONS["reset"](machine)
    machine.pico.run_us(1_500)  # until the beam must be off
    machine.pico.edges.clear()
    machine.pico.run_us(60_000)
    assert not [edge for edge in machine.pico.edges if edge.pin == SPINDLE_PWM]
    assert machine.pico.level(SPINDLE_PWM) == 0
    machine.pico.run_us(700_000)  # more than the welcome takes
    machine.send("\x18")
    machine.pico.run_us(50_000)
    start_dots(machine, beam, "M3")


def start_dots(machine: Board, beam: Beam, mode: str) -> None:
    """Start four lines of six dots each, and wait until the beam burns in the middle of them."""
    machine.ask("$100=250")
    machine.clear_output()
    machine.send("\x18")
    machine.wait_for("for help]")
    for line in ("$X", f"G91 G1 F3000 {mode} S0"):
        machine.ask(line)
    send_when_idle(machine, beam, *["X1S1000:900:800:700:600:500"] * 4)
    machine.pico.run_us(45_000)
    last_level = beam.changes[-1][1]
    assert last_level >= 500  # of _FULL, which is 6250 or more


STOP_ACTIONS = {
    "reset": lambda machine: machine.send("\x18"),
    "limit": lambda machine: machine.pico.drive(LIMIT[0], 0),
    "button": lambda machine: machine.pico.drive(RESET, 0),
}


@pytest.mark.parametrize("mode", ["M3", "M4"])
@pytest.mark.parametrize("stop", STOP_ACTIONS)
def test_any_stop_switches_the_beam_off_for_good(
    machine: Board, beam: Beam, stop: str, mode: str
) -> None:
    """A reset, a limit switch or a reset button switches it off within 1.5 ms. After a reset the
    next job works as before."""
    machine.ask("$21=1")
    start_dots(machine, beam, mode)
    STOP_ACTIONS[stop](machine)
    machine.pico.run_us(1_500)
    machine.pico.edges.clear()
    machine.pico.run_us(60_000)
    assert not [edge for edge in machine.pico.edges if edge.pin == SPINDLE_PWM]
    assert machine.pico.level(SPINDLE_PWM) == 0
    machine.pico.drive(LIMIT[0], 1)
    machine.pico.drive(RESET, 1)
    machine.pico.run_us(700_000)  # a button's own reset is over
    machine.send("\x18")
    machine.pico.run_us(50_000)
    machine.ask("$21=0")
    # Afterwards dots are in step with motion again.
    start_dots(machine, beam, mode)
    machine.until_idle()
    # The last dot has S500; while idle, M4 is off and M3 stays on.
    assert beam.changes[-1][1] == (0 if mode == "M4" else _HALF)


@pytest.mark.parametrize("mode", ["M3", "M4"])
def test_hold_is_dark_and_dots_continue_after_it(machine: Board, beam: Beam, mode: str) -> None:
    """start_dots() sends four lines of 1 mm, each with six dots of levels _DOTS. After the hold
    all steps are made (250 per mm), and in M3 the last dots have their exact levels."""
    start_dots(machine, beam, mode)
    machine.send("!")
    machine.pico.run_us(300_000)
    assert machine.status()["state"] == "Hold:0"
    assert machine.pico.level(SPINDLE_PWM) == 0 and beam.changes[-1][1] == 0
    steps_until_hold = len(steps(machine.pico.edges, 0))
    machine.send("~")
    machine.until_idle()
    assert len(steps(machine.pico.edges, 0)) == 4 * 250 > steps_until_hold
    levels = [level for _, level in power_changes(machine, beam) if level in (0, *_DOTS)]
    if mode == "M3":
        assert levels[-7:] == (_DOTS * 2)[-7:]


@pytest.fixture(scope="module")
def board_and_beam(uf2: Path) -> "tuple[Board, Beam]":
    """Return a second machine, with two commands of MAIN_WITH_COMMANDS: $OUT switches the laser
    off, $DEAF blocks interrupts for 30 ms."""
    machine = (
        Board(uf2, {**files_of("pico_laser"), "main.py": MAIN_WITH_COMMANDS}).boot().settled()
    )
    machine.pico.record([SPINDLE_PWM, *STEP, *DIR])
    for setting in ("$0=3", "$110=6000", "$120=5000"):
        machine.ask(setting)
    return machine, Beam(machine)


def test_laser_switched_off_in_motion_is_dark_and_the_motion_continues(
    board_and_beam: "tuple[Board, Beam]",
) -> None:
    """By the command $OUT, which the fixture adds: it calls Laser.stop() without stopping motion.

    The firmware itself never does so, but the method must not depend on that.
    """
    machine, beam = board_and_beam
    start_dots(machine, beam, "M3")
    machine.ask("$OUT")
    machine.pico.run_us(200)
    machine.pico.edges.clear()
    changes = len(beam.changes)
    machine.pico.run_us(20_000)
    assert len(steps(machine.pico.edges, 0)) > 100 and len(beam.changes) == changes
    assert machine.pico.level(SPINDLE_PWM) == 0
    machine.until_idle()
    start_dots(machine, beam, "M3")
    machine.until_idle()


@pytest.mark.parametrize("mode", ["M3", "M4"])
def test_no_dot_is_lost_when_the_interrupt_is_late(
    board_and_beam: "tuple[Board, Beam]", mode: str
) -> None:
    """By the command $DEAF, which the fixture adds: it blocks interrupts for 30 ms. Motors and
    beam wait and continue together; M4 is dark while idle."""
    machine, beam = board_and_beam
    start_dots(machine, beam, mode)
    machine.ask("$DEAF")
    machine.until_idle()
    gaps_us = [b - a for (a, _), (b, _) in pairwise(steps(machine.pico.edges, 0))]
    assert max(gaps_us) > 10_000 and len(gaps_us) == 4 * 250 - 1  # 4 mm, 250 steps/mm
    levels = [level for _, level in beam.changes]
    if mode == "M3":
        assert levels == _DOTS * 4 + [_HALF]  # and, while idle, the last line's S500 again
    assert levels[-1] == (0 if mode == "M4" else _HALF)


MAIN_WITH_COMMANDS = b"""
import time

from boot import power_up
from extras.tools import laser
from machine import disable_irq, enable_irq


from talk import commands
usual = commands.Commands.find_command

usual_power = laser.Laser.set_power
seen = [None]


def set_power(self, power):
    seen[0] = self
    usual_power(self, power)


laser.Laser.set_power = set_power


def deaf():
    state = disable_irq()
    since = time.ticks_us()
    while time.ticks_diff(time.ticks_us(), since) < 30000:
        pass
    enable_irq(state)


def whose(self, line, length):
    what = bytes(line[1:length])
    if what == b"OUT":
        laser.Laser.stop(seen[0])
    elif what == b"DEAF":
        deaf()
    else:
        return usual(self, line, length)
    return lambda line, length: None


commands.Commands.find_command = whose
power_up.run_machine(power_up.build())
"""
