"""Test the punch: a stroke after every motion, and motion only with the punch up.

The simulated machine checks this: it raises BrokenLaw at any step made while the punch is not
fully up, and at a stroke that begins during motion.

Bench.lines() sends lines that must be answered with ok. Bench.say(text, how) sends a text, waits
until motion has ended or as `how` says, and returns the output. Bench.wait_ms(ms) lets time pass
and returns the output. start_stroke() arms the punch, sends G0X1 and G0X2, and returns in the
middle of the first stroke. Bench.port is the simulated punch: its place() is from 0 (up) to 1
(down), `dead` is a mask of sensors that never respond, and if it is `stuck`, it does not move.
M3 and M4 arm the punch, M5 disarms it. A silent lower sensor is ALARM:32, an upper one ALARM:33.
"""

import math
import re
import runpy
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from base import state as st
from boot.options import Options
from hypothesis import given
from hypothesis import strategies as some
from ugrbl.boardfile.files import load_board
from ugrbl.draw import plot
from ugrbl.draw.job import run_job
from ugrbl.grbl.gcode_file import read_lines
from ugrbl.run.program import run_program
from ugrbl.sim.punch import DOWN, SENSOR_DOWN, SENSOR_UP, UP, BrokenLaw
from ugrbl.sim.replay import factory_store
from ugrbl.sim.rig import Rig
from ugrbl.sim.sender import Sender

pytestmark = pytest.mark.usefixtures("each_ms")

_EXAMPLES = Path(__file__).parents[2] / "examples"
_PROGRAM = _EXAMPLES / "punch.nc"
_PER_MM = 250  # steps
_FAST = ("$110=6000", "$111=6000", "$112=6000", "$120=500", "$121=500", "$122=500")
_NOT_DOWN = ["ALARM:32", "[MSG:Punch not down]"]
_NOT_UP = ["ALARM:33", "[MSG:Punch not up]"]
_BANNER = ["", "Grbl 1.1h ['$' for help]"]
_LOCKED = "[MSG:'$H'|'$X' to unlock]"


class Bench:
    """A punching machine and a sender."""

    def __init__(self, settings: Sequence[str] = _FAST, board: str = "sim_punch") -> None:
        """settings: stored lines of $n=value. board: name of a simulated board."""
        module = load_board(board)
        store = factory_store(module)
        store.files["settings_punch"] += settings
        self.rig = Rig(module, store)
        self.port: Any = self.rig.port
        self.sender = Sender(self.rig)
        self.sender.allow(3_600_000)  # ms; then waits fail

    def run(self, script: "Iterator[Any]") -> None:
        """Run a script, and raise its exception here: the firmware would catch it."""
        failed: list[BaseException] = []

        def guarded() -> Iterator[Any]:
            try:
                yield from script
            except Exception as error:
                failed.append(error)

        self.rig.run(guarded())
        if failed:
            raise failed[0]

    def say(self, text: str, how: str = "idle") -> "Iterator[Any]":
        """Send a text and wait; return the output."""
        yield from self.sender.wait(how, text)
        return self.sender.take()

    def lines(self, *lines: str) -> "Iterator[Any]":
        """Send lines, which must be accepted."""
        for line in lines:
            assert (yield from self.say(line + "\n")) == ["ok"]

    def wait_ms(self, milliseconds: float) -> "Iterator[Any]":
        """Let time pass; return the output meanwhile."""
        yield self.rig.ms(milliseconds)
        return self.sender.take()

    def until(self, condition: "Callable[[], bool]") -> "Iterator[Any]":
        """Wait for a condition, checked every 0.1 ms."""
        while not condition():
            yield self.rig.ms(0.1)

    def holes(self) -> "list[tuple[float, float]]":
        """Return the holes in mm."""
        return [(x / _PER_MM, y / _PER_MM) for x, y, _ in self.port.holes]


def play(script: "Callable[[Bench], Iterator[Any]]", *arguments: Any) -> Bench:
    """Run a script on a new bench after the banner; return the bench. Arguments: of Bench."""
    bench = Bench(*arguments)

    def whole() -> Iterator[Any]:
        yield from bench.say("", "banner")
        yield from script(bench)

    bench.run(whole())
    return bench


# Strokes


def test_every_line_of_motion_ends_with_a_stroke_while_armed() -> None:
    """M3 and M4 arm the punch, M5 disarms it. A change from M3 to M4 makes no stroke."""

    def script(bench: Bench) -> Iterator[Any]:
        yield from bench.lines(
            "G0X1", "M3", "X2", "G1X3Y1F600", "G2X5R1", "M4", "G0X7", "M5", "X9"
        )

    assert play(script).holes() == [(2, 0), (3, 1), (5, 1), (7, 1)]


def test_line_with_zero_length_makes_a_stroke() -> None:
    def script(bench: Bench) -> Iterator[Any]:
        yield from bench.lines("M3", "G0X0", "G0", "X0")  # the second G0 has no axis words

    assert play(script).holes() == [(0, 0), (0, 0)]


def test_other_lines_make_no_stroke() -> None:
    """While the punch is armed, only G0 to G3 of a program make strokes, and no other motion."""

    def script(bench: Bench) -> Iterator[Any]:
        yield from bench.lines("M3S1000", "G4P0.1", "G28", "G30X1", "G92X0", "G92.1", "$J=X3F600")
        yield from bench.lines("F100", "G1", "G80", "S200")
        yield from bench.say("G38.3X5\n")
        yield from bench.say("M30\n")

    assert play(script).holes() == []


def test_check_mode_makes_no_stroke() -> None:
    """$C is check mode; M3 arms the punch, and G0 would make a stroke."""

    def script(bench: Bench) -> Iterator[Any]:
        yield from bench.say("$C\n")
        yield from bench.lines("M3", "G0X1")

    bench = play(script)
    assert bench.holes() == []
    assert bench.port.place() == UP


def test_line_is_answered_after_its_stroke() -> None:
    """The ok comes only when the punch is up again."""

    def script(bench: Bench) -> Iterator[Any]:
        """Send a line; it is not answered while the punch is down."""
        yield from bench.lines("M3")
        bench.rig.link.send(b"G0X0\n")
        # No motion, but a stroke.
        yield from bench.until(lambda: bench.port.place() == DOWN)
        assert bench.sender.take() == []
        yield from bench.until(lambda: bench.port.place() == UP)
        assert (yield from bench.wait_ms(5)) == ["ok"]

    play(script)


@pytest.mark.parametrize("wiring", range(16))
def test_each_signal_may_be_inverted(wiring: int) -> None:
    """$30 to $33 invert the two actuators and two sensors, as each bit of the wiring does."""
    bench = Bench([*_FAST, *(f"${30 + bit}={wiring >> bit & 1}" for bit in range(4))])
    bench.port.wiring = wiring

    def script() -> Iterator[Any]:
        assert (yield from bench.say("", "banner")) == _BANNER
        yield from bench.lines("M3", "G0X1")

    bench.run(script())
    assert bench.holes() == [(1, 0)]


def test_report_shows_the_armed_punch() -> None:
    """The field A: has an S, as for a spindle that turns."""

    def script(bench: Bench) -> Iterator[Any]:
        yield from bench.lines("M3")
        # The first report has WCO: instead of the accessories (A:).
        yield from bench.say("?", "report")
        assert "|A:S>" in (yield from bench.say("?", "report"))[0]

    play(script)


# Silent sensors


def test_missing_lower_sensor_is_an_alarm_and_the_punch_goes_up() -> None:
    """The punch hits, but its lower sensor does not respond.

    The wait for it ends between 1 and 1.5 s, in alarm.
    """

    def script(bench: Bench) -> Iterator[Any]:
        """Make a stroke without the lower sensor; unlock when it works again."""
        yield from bench.lines("M3")
        bench.port.dead = SENSOR_DOWN
        bench.rig.link.send(b"G0X1\n")
        assert (yield from bench.wait_ms(1000)) == []
        output = yield from bench.wait_ms(500)
        assert output == [*_NOT_DOWN, "ok", *_BANNER, _LOCKED]
        assert bench.port.place() == UP
        assert (yield from bench.say("G0X2\n")) == ["error:9"]
        bench.port.dead = 0
        assert (yield from bench.say("$X\n"))[-1] == "ok"
        yield from bench.lines("G0X2")

    assert play(script).holes() == [(1, 0)]


def test_blocked_punch_goes_up_again() -> None:
    """The punch cannot reach its lower end, and the alarm raises it."""

    def script(bench: Bench) -> Iterator[Any]:
        """Make a stroke that ends at 0.7 of its way."""
        yield from bench.lines("M3")
        bench.port.lowest = 0.7  # of the stroke: something hard is below
        bench.rig.link.send(b"G0X1\n")
        assert (yield from bench.wait_ms(1500))[:2] == _NOT_DOWN
        assert bench.port.place() == UP

    play(script)


@pytest.mark.parametrize("fault", ["dead", "stuck"])
def test_nothing_moves_without_the_upper_sensor(fault: str) -> None:
    """The upper sensor fails while the punch is down, or the punch is stuck there.

    Until this is mended, no line or jog moves.
    """

    def script(bench: Bench) -> Iterator[Any]:
        """Let the fault begin at the lower end; try a line and a jog; mend it, and move."""
        yield from bench.lines("M3")
        bench.rig.link.send(b"G0X1\n")
        yield from bench.until(lambda: bench.port.place() == DOWN)
        setattr(bench.port, fault, SENSOR_UP)  # for `stuck`, it only counts as True
        output = yield from bench.wait_ms(2500)
        # Once for the line, and once more before the welcome.
        assert output[:3] == [*_NOT_UP, "ok"] and output.count("ALARM:33") == 2
        assert output[-3:] == [*_BANNER, _LOCKED]
        for line in ("G0X2\n", "$J=X2F100\n"):
            assert (yield from bench.say("$X\n"))[-1] == "ok"
            bench.rig.link.send(line.encode())
            output = yield from bench.wait_ms(2500)
            assert output[:3] in (["ok", *_NOT_UP], [*_NOT_UP, "ok"]) and output[-1] == _LOCKED
        bench.rig.engine.physical(bench.rig.scratch)
        assert list(bench.rig.scratch) == [_PER_MM, 0, 0]  # X1 of the line with the stroke
        setattr(bench.port, fault, 0)
        yield from bench.say("$X\n")
        yield from bench.lines("G0X2")

    play(script)


def test_homing_does_not_start_without_the_upper_sensor() -> None:
    """$22=1 enables homing; the engine must make no start."""

    def script(bench: Bench) -> Iterator[Any]:
        yield from bench.lines("$22=1")
        bench.port.dead = SENSOR_UP
        bench.rig.link.send(b"$H\n")
        assert (yield from bench.wait_ms(2500))[:2] == _NOT_UP

    bench = play(script)
    assert bench.rig.engine.starts == 0


def test_falling_punch_stops_the_machine() -> None:
    """The punch falls in the middle of motion: steps end at once, and the alarm raises it."""

    def script(bench: Bench) -> Iterator[Any]:
        """Let the punch fall 0.5 s after the start of a line."""
        bench.rig.link.send(b"G1X50F3000\n")
        yield from bench.wait_ms(500)
        assert bench.rig.moving()
        bench.port.fall()  # the upper sensor opens, an interrupt
        assert not bench.rig.moving()
        output = yield from bench.wait_ms(1000)
        assert output == ["ALARM:33", _NOT_UP[1], *_BANNER, _LOCKED]
        assert bench.port.place() == UP

    play(script)


# At power up


def test_punch_down_at_power_up_goes_up_first() -> None:
    """The punch is up before the welcome is sent."""
    bench = Bench()
    bench.port._position = DOWN

    def script() -> Iterator[Any]:
        """Wait for the first output: the punch is up then."""
        # The first bytes of the welcome arrive.
        yield from bench.until(lambda: bool(bench.sender.partial()))
        assert bench.port.place() == UP
        yield from bench.say("", "banner")
        yield from bench.lines("G0X1")

    bench.run(script())


def test_startup_lines_wait_for_the_punch() -> None:
    """G0X1 is a stored startup line ($N0). It is executed after the punch went up."""
    bench = Bench()
    bench.rig.store.files["startup"] = ["G0X1", ""]
    bench.port._position = DOWN

    def script() -> Iterator[Any]:
        assert (yield from bench.say("", "banner")) == [*_BANNER, ">G0X1:ok"]

    bench.run(script())


def test_inverted_sensor_is_an_alarm_at_once() -> None:
    """The upper sensor is wired inverted, but $33 is 0: the raised punch seems not to be up."""
    bench = Bench()
    bench.port.wiring = 8  # bit 3: the upper sensor

    def script() -> Iterator[Any]:
        assert (yield from bench.say("", "banner")) == [*_NOT_UP, *_BANNER, _LOCKED]
        assert (yield from bench.say("$33=1\n")) == ["ok"]
        assert (yield from bench.say("$X\n"))[-1] == "ok"
        yield from bench.lines("M3", "G0X1")

    bench.run(script())
    assert bench.holes() == [(1, 0)]


# In the middle of a stroke


def start_stroke(bench: Bench, place: float = 0.5) -> "Iterator[Any]":
    """Begin two lines with strokes; wait until the punch is beyond this place (0: up, 1: down)."""
    yield from bench.lines("M3")
    bench.rig.link.send(b"G0X1\nG0X2\n")
    yield from bench.until(lambda: bench.port.place() > place)


def test_hold_lets_the_stroke_end() -> None:
    """! in a stroke: it is completed and its line answered. The next line waits for ~."""

    def script(bench: Bench) -> Iterator[Any]:
        """Send a hold in a stroke, and ~ later."""
        yield from start_stroke(bench)
        bench.rig.link.send(b"!")
        output = yield from bench.wait_ms(500)
        assert output == ["ok"] and bench.port.place() == UP
        assert bench.rig.controller.state.run == st.HOLD
        assert bench.holes() == [(1, 0)]
        bench.rig.link.send(b"~")
        assert (yield from bench.wait_ms(2000)) == ["ok"]

    assert play(script).holes() == [(1, 0), (2, 0)]


def test_door_interrupts_the_stroke_which_is_made_later() -> None:
    """A door raises the punch at once. After ~ the stroke is made again."""

    def script(bench: Bench) -> Iterator[Any]:
        """Open the door (0x84) in a stroke, and resume."""
        yield from start_stroke(bench)
        bench.rig.link.send(b"\x84")  # door
        output = yield from bench.wait_ms(500)
        assert output == ["[MSG:Check Door]"] and bench.port.place() == UP
        assert bench.holes() == []
        bench.rig.link.send(b"~")
        assert (yield from bench.wait_ms(8000)) == ["ok", "ok"]  # both lines were unanswered

    assert play(script).holes() == [(1, 0), (2, 0)]


@pytest.mark.parametrize("place", [0.1, 0.5, 0.9])
def test_reset_raises_the_punch_before_the_welcome(place: float) -> None:
    """The punch is at `place` when the reset arrives: 0 is up, 1 is down."""

    def script(bench: Bench) -> Iterator[Any]:
        """Reset (0x18) in a stroke; the punch is up when the welcome is received."""
        yield from start_stroke(bench, place)
        bench.rig.link.send(b"\x18")
        yield from bench.until(lambda: b"Grbl" in bench.rig.link.received)
        assert bench.port.place() == UP
        assert "ALARM:3" not in (yield from bench.say("", "banner"))  # nothing moved
        yield from bench.lines("G0X2")

    assert play(script).holes() == []


def test_hard_limit_raises_the_punch() -> None:
    """$21=1 enables hard limits; the switch of X closes in a stroke."""

    def script(bench: Bench) -> Iterator[Any]:
        """Close the limit switch of X in a stroke."""
        yield from start_stroke(bench)
        bench.rig.port.push({"limit_x": True})
        output = yield from bench.wait_ms(1000)
        assert output == ["ALARM:1", "[MSG:Reset to continue]"]
        assert bench.port.place() == UP

    play(script, [*_FAST, "$21=1"])


_WORK = (
    "M3",
    "G0X1Y1",
    "G1X2F1200",
    "X2.5Y2",
    "G3X3Y3R2",
    "M5",
    "G0X1",
    "M3",
    "Y1",
    "G28",
    "X0Y0",
    "M5",
    "M30",
)
_EVENTS = some.lists(
    some.tuples(
        some.integers(0, 4000), some.sampled_from(["!", "~", "?", "\x18", "\x84", "\x9e", "fall"])
    ),
    max_size=6,
)


@pytest.mark.thorough
@given(
    _EVENTS,
    some.sampled_from([0, 0, 0, SENSOR_UP, SENSOR_DOWN]),
    some.integers(0, 4000),
    some.sampled_from(["sim_punch", "sim_punch_09"]),
)
def test_nothing_moves_while_the_punch_is_down(
    events: "list[tuple[int, str]]", dead: int, dead_from_ms: int, board: str
) -> None:
    """A program runs with random events, and with a dead sensor from some ms on.

    Events are real-time bytes and falls of the punch. BrokenLaw is raised if anything moves while
    it is down.
    """

    def script(bench: Bench) -> Iterator[Any]:
        """For 9 s send lines and the random events; unlock alarms, and resume holds."""
        rig = bench.rig
        waiting = deque(f"{line}\n".encode() for line in _WORK * 2)
        due = deque(sorted(events))
        start = rig.now
        while rig.now < start + 9000 * rig.ticks_per_ms:
            elapsed_ms = (rig.now - start) / rig.ticks_per_ms
            bench.port.dead = dead if elapsed_ms > dead_from_ms else 0
            while due and due[0][0] <= elapsed_ms:
                event = due.popleft()[1]
                if event == "fall":
                    bench.port.fall()
                else:
                    rig.link.send(event.encode("latin-1"))
            state = rig.controller.state.run
            if not due and state & (st.HOLD | st.DOOR):
                rig.link.send(b"~")
            elif state == st.ALARM:
                rig.link.send(b"$X\n")
            elif waiting:
                rig.link.send(waiting.popleft())
            bench.sender.take()
            yield rig.ms(37)

    play(script, _FAST, board)


def test_simulated_machine_detects_motion_with_the_punch_down() -> None:
    """Without the firmware's hooks, motion starts while the punch is down: this is detected."""

    def script(bench: Bench) -> Iterator[Any]:
        """Remove the punch's hooks, put it down, and send a move."""
        hooks = bench.rig.controller.state.hooks
        hooks.may_start = hooks.started = ()  # the hooks of the punch
        # Down from now on, unseen by the firmware, and not to be raised.
        bench.port.dead = SENSOR_UP
        bench.port._position, bench.port._up_until = DOWN, bench.rig.now
        bench.port.stuck = True
        bench.rig.link.send(b"G0X1\n")
        yield from bench.wait_ms(500)

    with pytest.raises(BrokenLaw):
        play(script)


# The board file


def test_board_without_punch_pins_is_refused_with_the_reason() -> None:
    """Two of the four pins are missing; then the tool is unknown."""
    board = SimpleNamespace(TOOL="punch", PUNCH_UP=3, PUNCH_DOWN=0)
    with pytest.raises(ValueError, match="no pin for PUNCH_DOWN_SENSOR, PUNCH_UP_SENSOR"):
        Options(board)
    with pytest.raises(ValueError, match="TOOL must be laser, punch or spindle, not saw"):
        Options(SimpleNamespace(TOOL="saw"))


def test_spindle_settings_are_not_used_for_a_punch() -> None:
    """A punch has its own file of settings: a spindle's $30 to $33 would invert its signals."""
    bench = Bench()
    bench.rig.store.files["settings"] = ["$30=1000", "$32=1"]

    def script() -> Iterator[Any]:
        assert (yield from bench.say("", "banner")) == _BANNER
        listed = yield from bench.say("$$\n", "ok")
        assert {"$30=0", "$31=0", "$32=0", "$33=0"} <= set(listed)

    bench.run(script())


def test_settings_are_those_of_the_document() -> None:
    """This board lists settings with descriptions, as Grbl 0.9 does."""

    def script(bench: Bench) -> Iterator[Any]:
        """Invert one signal, and list the settings."""
        assert (yield from bench.say("$30=1\n", "ok")) == ["ok"]
        listed = yield from bench.say("$$\n", "ok")
        assert [line for line in listed if line[:2] == "$3" and line[3:4] == "="] == [
            "$30=1 (punch actuator down invert, bool)",
            "$31=0 (punch actuator up invert, bool)",
            "$32=0 (punch sensor down invert, bool)",
            "$33=0 (punch sensor up invert, bool)",
        ]

    bench = Bench(_FAST, "sim_punch_09")

    def whole() -> Iterator[Any]:
        yield from bench.say("", "banner")
        yield from script(bench)

    bench.run(whole())


# The demonstration program


def expected_holes() -> "list[tuple[float, float]]":
    """Read the pattern from the program's text, without our code; in mm."""
    position = {"X": 0.0, "Y": 0.0}
    armed = False
    holes = []
    for line in _PROGRAM.read_text().splitlines():
        if line.startswith(("(", "G21")):
            continue
        if re.fullmatch("M[35]", line):
            armed = line == "M3"
        moves = re.findall(r"([XY])(\S+)", line)
        position.update({axis: float(value) for axis, value in moves})
        if moves and armed:
            holes.append((position["X"], position["Y"]))
    return holes


def test_generator_makes_the_committed_program() -> None:
    made = runpy.run_path(str(_EXAMPLES / "make_punch.py"))["grille"]()
    assert "\n".join(made) + "\n" == _PROGRAM.read_text()


@pytest.mark.sampled(1)
@pytest.mark.parametrize("board", ["sim_punch", "sim_punch_09"])
def test_demonstration_punches_its_pattern(board: str) -> None:
    """The holes of a simulated run are those that the text of the program describes."""
    result, recorder = run_program(read_lines(_PROGRAM), board=board)
    expected = expected_holes()
    assert not result.errors and not result.stopped
    assert len(recorder.marks) == len(expected) == 131
    for (x, y), hole in zip(expected, recorder.marks, strict=True):
        assert math.dist((x, y), hole[:2]) < 0.005


@pytest.mark.thorough
def test_holes_are_drawn(tmp_path: Path) -> None:
    """A picture with 131 holes has more than 10 kB."""
    job = run_job("as it is", read_lines(_PROGRAM), settings=[], board="sim_punch")
    assert len(job.marks) == 131
    for suffix in (".png", ".html"):
        plot.save([job], "punch", "", tmp_path / f"punch{suffix}")
        assert (tmp_path / f"punch{suffix}").stat().st_size > 10_000
