"""Test the punch: a stroke after every motion, and motion only with the punch up.

The simulated machine checks this: it raises BrokenLaw at any step made while the punch is not
fully up, and at a stroke that begins during motion.
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
_PER_MM = 250
_FAST = ("$110=6000", "$111=6000", "$112=6000", "$120=500", "$121=500", "$122=500")
_NOT_DOWN = ["ALARM:32", "[MSG:Punch not down]"]
_NOT_UP = ["ALARM:33", "[MSG:Punch not up]"]
_BANNER = ["", "Grbl 1.1h ['$' for help]"]
_LOCKED = "[MSG:'$H'|'$X' to unlock]"


class Bench:
    """A punching machine and a sender."""

    def __init__(self, settings: Sequence[str] = _FAST, board: str = "sim_punch") -> None:
        module = load_board(board)
        store = factory_store(module)
        store.files["settings_punch"] += settings
        self.rig = Rig(module, store)
        self.port: Any = self.rig.port
        self.sender = Sender(self.rig)
        self.sender.allow(3_600_000)

    def run(self, script: "Iterator[Any]") -> None:
        """Run a script; its exceptions are raised here."""
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

    def passes(self, milliseconds: float) -> "Iterator[Any]":
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
    """Run a script on a new bench after the banner."""
    bench = Bench(*arguments)

    def whole() -> Iterator[Any]:
        yield from bench.say("", "banner")
        yield from script(bench)

    bench.run(whole())
    return bench


# Strokes


def test_every_line_of_motion_ends_with_a_stroke_while_armed() -> None:
    def script(bench: Bench) -> Iterator[Any]:
        yield from bench.lines(
            "G0X1", "M3", "X2", "G1X3Y1F600", "G2X5R1", "M4", "G0X7", "M5", "X9"
        )

    assert play(script).holes() == [(2, 0), (3, 1), (5, 1), (7, 1)]


def test_line_with_zero_length_makes_a_stroke() -> None:
    def script(bench: Bench) -> Iterator[Any]:
        yield from bench.lines("M3", "G0X0", "G0", "X0")

    assert play(script).holes() == [(0, 0), (0, 0)]


def test_other_lines_make_no_stroke() -> None:
    def script(bench: Bench) -> Iterator[Any]:
        yield from bench.lines("M3S1000", "G4P0.1", "G28", "G30X1", "G92X0", "G92.1", "$J=X3F600")
        yield from bench.lines("F100", "G1", "G80", "S200")
        yield from bench.say("G38.3X5\n")
        yield from bench.say("M30\n")

    assert play(script).holes() == []


def test_check_mode_makes_no_stroke() -> None:
    def script(bench: Bench) -> Iterator[Any]:
        yield from bench.say("$C\n")
        yield from bench.lines("M3", "G0X1")

    bench = play(script)
    assert bench.holes() == []
    assert bench.port.place() == UP


def test_line_is_answered_after_its_stroke() -> None:
    def script(bench: Bench) -> Iterator[Any]:
        yield from bench.lines("M3")
        bench.rig.link.send(b"G0X0\n")
        yield from bench.until(lambda: bench.port.place() == DOWN)
        assert bench.sender.take() == []
        yield from bench.until(lambda: bench.port.place() == UP)
        assert (yield from bench.passes(5)) == ["ok"]

    play(script)


@pytest.mark.parametrize("wiring", range(16))
def test_each_signal_may_be_inverted(wiring: int) -> None:
    bench = Bench([*_FAST, *(f"${30 + bit}={wiring >> bit & 1}" for bit in range(4))])
    bench.port.wiring = wiring

    def script() -> Iterator[Any]:
        assert (yield from bench.say("", "banner")) == _BANNER
        yield from bench.lines("M3", "G0X1")

    bench.run(script())
    assert bench.holes() == [(1, 0)]


def test_report_shows_the_armed_punch() -> None:
    def script(bench: Bench) -> Iterator[Any]:
        yield from bench.lines("M3")
        yield from bench.say("?", "report")
        assert "|A:S>" in (yield from bench.say("?", "report"))[0]

    play(script)


# Silent sensors


def test_missing_lower_sensor_is_an_alarm_and_the_punch_goes_up() -> None:
    def script(bench: Bench) -> Iterator[Any]:
        yield from bench.lines("M3")
        bench.port.dead = SENSOR_DOWN
        bench.rig.link.send(b"G0X1\n")
        assert (yield from bench.passes(1000)) == []
        came = yield from bench.passes(500)
        assert came == [*_NOT_DOWN, "ok", *_BANNER, _LOCKED]
        assert bench.port.place() == UP
        assert (yield from bench.say("G0X2\n")) == ["error:9"]
        bench.port.dead = 0
        assert (yield from bench.say("$X\n"))[-1] == "ok"
        yield from bench.lines("G0X2")

    assert play(script).holes() == [(1, 0)]


def test_blocked_punch_goes_up_again() -> None:
    def script(bench: Bench) -> Iterator[Any]:
        yield from bench.lines("M3")
        bench.port.lowest = 0.7
        bench.rig.link.send(b"G0X1\n")
        assert (yield from bench.passes(1500))[:2] == _NOT_DOWN
        assert bench.port.place() == UP

    play(script)


@pytest.mark.parametrize("fault", ["dead", "stuck"])
def test_nothing_moves_without_the_upper_sensor(fault: str) -> None:
    def script(bench: Bench) -> Iterator[Any]:
        yield from bench.lines("M3")
        bench.rig.link.send(b"G0X1\n")
        yield from bench.until(lambda: bench.port.place() == DOWN)
        setattr(bench.port, fault, SENSOR_UP)
        came = yield from bench.passes(2500)
        assert came[:3] == [*_NOT_UP, "ok"] and came.count("ALARM:33") == 2
        assert came[-3:] == [*_BANNER, _LOCKED]
        for line in ("G0X2\n", "$J=X2F100\n"):
            assert (yield from bench.say("$X\n"))[-1] == "ok"
            bench.rig.link.send(line.encode())
            came = yield from bench.passes(2500)
            assert came[:3] in (["ok", *_NOT_UP], [*_NOT_UP, "ok"]) and came[-1] == _LOCKED
        bench.rig.engine.physical(bench.rig.scratch)
        assert list(bench.rig.scratch) == [_PER_MM, 0, 0]
        setattr(bench.port, fault, 0)
        yield from bench.say("$X\n")
        yield from bench.lines("G0X2")

    play(script)


def test_homing_does_not_start_without_the_upper_sensor() -> None:
    def script(bench: Bench) -> Iterator[Any]:
        yield from bench.lines("$22=1")
        bench.port.dead = SENSOR_UP
        bench.rig.link.send(b"$H\n")
        assert (yield from bench.passes(2500))[:2] == _NOT_UP

    bench = play(script)
    assert bench.rig.engine.starts == 0


def test_falling_punch_stops_the_machine() -> None:
    def script(bench: Bench) -> Iterator[Any]:
        bench.rig.link.send(b"G1X50F3000\n")
        yield from bench.passes(500)
        assert bench.rig.moving()
        bench.port.fall()
        assert not bench.rig.moving()
        came = yield from bench.passes(1000)
        assert came == ["ALARM:33", _NOT_UP[1], *_BANNER, _LOCKED]
        assert bench.port.place() == UP

    play(script)


# At power up


def test_punch_down_at_power_up_goes_up_first() -> None:
    bench = Bench()
    bench.port._position = DOWN

    def script() -> Iterator[Any]:
        yield from bench.until(lambda: bool(bench.sender.partial()))
        assert bench.port.place() == UP
        yield from bench.say("", "banner")
        yield from bench.lines("G0X1")

    bench.run(script())


def test_startup_lines_wait_for_the_punch() -> None:
    bench = Bench()
    bench.rig.store.files["startup"] = ["G0X1", ""]
    bench.port._position = DOWN

    def script() -> Iterator[Any]:
        assert (yield from bench.say("", "banner")) == [*_BANNER, ">G0X1:ok"]

    bench.run(script())


def test_inverted_sensor_is_an_alarm_at_once() -> None:
    bench = Bench()
    bench.port.wiring = 8

    def script() -> Iterator[Any]:
        assert (yield from bench.say("", "banner")) == [*_NOT_UP, *_BANNER, _LOCKED]
        assert (yield from bench.say("$33=1\n")) == ["ok"]
        assert (yield from bench.say("$X\n"))[-1] == "ok"
        yield from bench.lines("M3", "G0X1")

    bench.run(script())
    assert bench.holes() == [(1, 0)]


# In the middle of a stroke


def in_stroke(bench: Bench, place: float = 0.5) -> "Iterator[Any]":
    yield from bench.lines("M3")
    bench.rig.link.send(b"G0X1\nG0X2\n")
    yield from bench.until(lambda: bench.port.place() > place)


def test_hold_lets_the_stroke_end() -> None:
    def script(bench: Bench) -> Iterator[Any]:
        yield from in_stroke(bench)
        bench.rig.link.send(b"!")
        came = yield from bench.passes(500)
        assert came == ["ok"] and bench.port.place() == UP
        assert bench.rig.controller.state.run == st.HOLD
        assert bench.holes() == [(1, 0)]
        bench.rig.link.send(b"~")
        assert (yield from bench.passes(2000)) == ["ok"]

    assert play(script).holes() == [(1, 0), (2, 0)]


def test_door_interrupts_the_stroke_which_is_made_later() -> None:
    def script(bench: Bench) -> Iterator[Any]:
        yield from in_stroke(bench)
        bench.rig.link.send(b"\x84")
        came = yield from bench.passes(500)
        assert came == ["[MSG:Check Door]"] and bench.port.place() == UP
        assert bench.holes() == []
        bench.rig.link.send(b"~")
        assert (yield from bench.passes(8000)) == ["ok", "ok"]

    assert play(script).holes() == [(1, 0), (2, 0)]


@pytest.mark.parametrize("place", [0.1, 0.5, 0.9])
def test_reset_raises_the_punch_before_the_welcome(place: float) -> None:
    def script(bench: Bench) -> Iterator[Any]:
        yield from in_stroke(bench, place)
        bench.rig.link.send(b"\x18")
        yield from bench.until(lambda: b"Grbl" in bench.rig.link.received)
        assert bench.port.place() == UP
        assert "ALARM:3" not in (yield from bench.say("", "banner"))
        yield from bench.lines("G0X2")

    assert play(script).holes() == []


def test_hard_limit_raises_the_punch() -> None:
    def script(bench: Bench) -> Iterator[Any]:
        yield from in_stroke(bench)
        bench.rig.port.push({"limit_x": True})
        came = yield from bench.passes(1000)
        assert came == ["ALARM:1", "[MSG:Reset to continue]"]
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
    events: "list[tuple[int, str]]", dead: int, dies: int, board: str
) -> None:
    def script(bench: Bench) -> Iterator[Any]:
        rig = bench.rig
        waiting = deque(f"{line}\n".encode() for line in _WORK * 2)
        due = deque(sorted(events))
        start = rig.now
        while rig.now < start + 9000 * rig.ticks_per_ms:
            past = (rig.now - start) / rig.ticks_per_ms
            bench.port.dead = dead if past > dies else 0
            while due and due[0][0] <= past:
                what = due.popleft()[1]
                if what == "fall":
                    bench.port.fall()
                else:
                    rig.link.send(what.encode("latin-1"))
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
    def script(bench: Bench) -> Iterator[Any]:
        hooks = bench.rig.controller.state.hooks
        hooks.may_start = hooks.started = ()  # the hooks of the punch
        bench.port.dead = SENSOR_UP
        bench.port._position, bench.port._up_until = DOWN, bench.rig.now
        bench.port.stuck = True
        bench.rig.link.send(b"G0X1\n")
        yield from bench.passes(500)

    with pytest.raises(BrokenLaw):
        play(script)


# The board file


def test_board_without_punch_pins_is_refused_with_the_reason() -> None:
    board = SimpleNamespace(TOOL="punch", PUNCH_UP=3, PUNCH_DOWN=0)
    with pytest.raises(ValueError, match="no pin for PUNCH_DOWN_SENSOR, PUNCH_UP_SENSOR"):
        Options(board)
    with pytest.raises(ValueError, match="TOOL must be laser, punch or spindle, not saw"):
        Options(SimpleNamespace(TOOL="saw"))


def test_spindle_settings_are_not_used_for_a_punch() -> None:
    bench = Bench()
    bench.rig.store.files["settings"] = ["$30=1000", "$32=1"]

    def script() -> Iterator[Any]:
        assert (yield from bench.say("", "banner")) == _BANNER
        shown = yield from bench.say("$$\n", "ok")
        assert {"$30=0", "$31=0", "$32=0", "$33=0"} <= set(shown)

    bench.run(script())


def test_settings_are_those_of_the_document() -> None:
    def script(bench: Bench) -> Iterator[Any]:
        assert (yield from bench.say("$30=1\n", "ok")) == ["ok"]
        shown = yield from bench.say("$$\n", "ok")
        assert [line for line in shown if line[:2] == "$3" and line[3:4] == "="] == [
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
    """Read the pattern from the program's text, without our code."""
    place = {"X": 0.0, "Y": 0.0}
    armed = False
    holes = []
    for line in _PROGRAM.read_text().splitlines():
        if line.startswith(("(", "G21")):
            continue
        if re.fullmatch("M[35]", line):
            armed = line == "M3"
        moves = re.findall(r"([XY])(\S+)", line)
        place.update({axis: float(value) for axis, value in moves})
        if moves and armed:
            holes.append((place["X"], place["Y"]))
    return holes


def test_generator_makes_the_committed_program() -> None:
    made = runpy.run_path(str(_EXAMPLES / "make_punch.py"))["grille"]()
    assert "\n".join(made) + "\n" == _PROGRAM.read_text()


@pytest.mark.sampled(1)
@pytest.mark.parametrize("board", ["sim_punch", "sim_punch_09"])
def test_demonstration_punches_its_pattern(board: str) -> None:
    result, recorder = run_program(read_lines(_PROGRAM), board=board)
    wanted = expected_holes()
    assert not result.errors and not result.stopped
    assert len(recorder.marks) == len(wanted) == 131
    for (x, y), mark in zip(wanted, recorder.marks, strict=True):
        assert math.dist((x, y), mark[:2]) < 0.005


@pytest.mark.thorough
def test_holes_are_drawn(tmp_path: Path) -> None:
    job = run_job("as it is", read_lines(_PROGRAM), [], "sim_punch")
    assert len(job.marks) == 131
    for suffix in (".png", ".html"):
        plot.save([job], "punch", "", tmp_path / f"punch{suffix}")
        assert (tmp_path / f"punch{suffix}").stat().st_size > 10_000
