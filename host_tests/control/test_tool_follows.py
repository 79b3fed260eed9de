"""Test that the tool does what was asked for and reported: overrides, holds, doors, settings.

Tool.play() does steps: it sends lines (text) and real-time bytes, and waits so many ms (numbers).
It returns state, speed and power at the PWM pin as shown after each step. settle: ms of silence at
the end of a wait.
"""

from collections.abc import Generator, Iterator
from types import ModuleType
from typing import Any, NamedTuple

import pytest
from rig_bench import Machine
from ugrbl.boardfile.files import load_board

_FAST = {110: 6000, 120: 500}
_DOWN_10, _UP_10, _TO_100 = b"\x9b", b"\x9a", b"\x99"  # spindle overrides; _TO_100: 100 %
_FULL = 255  # power at $30, 1000 rpm

# A step: a line, whose answer is awaited; real-time bytes; a wait in ms.
Step = str | bytes | int


class Shown(NamedTuple):
    """What a machine does: state and speed as reported, power at the pin."""

    state: str
    speed: float
    power: int


class Tool:
    """A machine that is asked for a status after each step; laser: $32; options: of the board."""

    def __init__(self, laser: int = 0, **options: Any) -> None:
        board = ModuleType("board")
        vars(board).update({**vars(load_board("sim")), **options})
        self.machine = Machine({**_FAST, 32: laser}, board, watched=False)
        self.states: list[Shown] = []

    def play(self, *steps: Step) -> "list[Shown]":
        """Do the steps; return what is shown after each of them."""

        def script() -> Iterator[Any]:
            yield from self.machine.start()
            for step in steps:
                yield from self.do_step(step)
                self.states.append((yield from self.read_status()))

        self.machine.run(script())
        return self.states

    def do_step(self, step: Step) -> Iterator[Any]:
        """Do a step, and wait for the answer of a line."""
        sender = self.machine.sender
        if isinstance(step, str):
            yield from sender.wait("ok", f"{step}\n", settle=1)
        elif isinstance(step, bytes):
            self.machine.rig.link.send(step)
        else:
            yield self.machine.rig.ms(step)

    def read_status(self) -> "Generator[Any, None, Shown]":
        """Return what a status report and the PWM pin show."""
        machine = self.machine
        machine.take()
        yield from machine.sender.wait("report", "?", settle=1)
        line = next(line for line in machine.take() if line.startswith("<"))
        speed = float(line.split("|FS:")[1].split("|")[0].split(",")[1].rstrip(">"))
        return Shown(line[1:].split("|")[0], speed, machine.rig.port.spindle_pwm)


_MOVES = ("G1F600", "M3S1000", "X4", "X8", "X12")  # five steps: 1.2 s of motion at 10 mm/s


@pytest.mark.parametrize("laser", [0, 1])
@pytest.mark.parametrize("when", ["open", "restored"])
def test_override_at_an_open_door_applies_to_the_motion_after_it(laser: int, when: str) -> None:
    """To 50 %, while the door is open, or 50 ms after `~`, while the spindle is restored."""
    change = _DOWN_10 * 5
    door = (b"\x84", 600, change, b"~") if when == "open" else (b"\x84", 600, b"~", 50, change)
    # 0x84 opens the door; then waits in ms, restoring takes 4 s
    before, *_, moving = Tool(laser).play(*_MOVES, 200, *door, 4500, 100)[5:]
    assert before == ("Run", 1000, _FULL)
    # 128 of 255: half; the moves may have ended already
    assert moving == ("Run" if moving.state == "Run" else "Idle", 500, 128)


def test_tool_stays_off_when_it_is_overridden_at_an_open_door() -> None:
    states = Tool().play(*_MOVES, 200, b"\x84", 600, _DOWN_10, 50)  # 0x84: the door opens; then ms
    assert states[-1] == ("Door:0", 0, 0)


@pytest.mark.parametrize("laser", [0, 1])
@pytest.mark.parametrize("after_ms", [0, 3, 40, 90, 150, 190, 260])
def test_override_at_the_end_of_motion_is_not_lost(laser: int, after_ms: int) -> None:
    """The last steps are under way, or the motors are still powered ($1)."""
    states = Tool(laser).play("$1=200", "M3S500G1F600", "X0.5", 30 + after_ms, _UP_10 * 10, 1000)
    assert states[-1] == ("Idle", 1000, _FULL)


def test_override_in_alarm_reaches_a_tool_that_is_on() -> None:
    """A probe without contact ends in ALARM:5, which leaves the tool on, as in Grbl."""
    states = Tool().play("M3S1000", "G38.2Z-0.2F100", 1000, _DOWN_10 * 5, 50, "$X", 50)
    # states[3]: after the override to 50 %
    assert states[3] == ("Alarm", 500, 128) and states[-1] == ("Idle", 500, 128)


@pytest.mark.parametrize("change", [_DOWN_10, b"\x9d", _TO_100])
def test_dark_laser_stays_dark_when_it_is_overridden(change: bytes) -> None:
    """M3 was given, but a G0 switches the laser off. 0x9d: down by 1 %."""
    states = Tool(laser=1).play("M3S500G1F600", "G0X1", 500, change, 50)
    assert states[-1] == ("Idle", 0, 0)


@pytest.mark.parametrize("in_hold", [(_UP_10, 50, b"\x9e"), (b"\x9e", 50, _UP_10)])
def test_dark_laser_stays_dark_when_it_is_overridden_and_restored_in_a_hold(
    in_hold: "tuple[Step, ...]",
) -> None:
    """G0 has switched it off. 0x9e toggles what the hold has stopped."""
    steps = ("M3S500", "G0X1", 500, b"!", 50, *in_hold, 50, b"~", 50)
    states = Tool(laser=1).play(*steps)
    assert all(each.power == 0 for each in states[2:]) and states[-1] == ("Idle", 0, 0)


@pytest.mark.parametrize("door_ms", range(360, 480, 10))
def test_laser_has_its_last_power_after_a_door_at_the_end_of_motion(door_ms: int) -> None:
    """The door opens in a block at S1000. Motion ends, at S100, while it slows down."""
    moves = ("G1F3000", "M3S0", "X20S1000", "X22S100")
    states = Tool(laser=1).play(*moves, door_ms, b"\x84", 1500, b"~", 1500)
    assert states[-1] == ("Idle", 100, 26)  # 26 of 255 for 100 of 1000 rpm


@pytest.mark.parametrize("laser", [0, 1])
@pytest.mark.parametrize("last_line", [b"", b"X4\n"])
def test_override_reaches_blocks_that_are_planned_and_not_started(
    laser: int, last_line: bytes
) -> None:
    lines = b"X2\nX3\n" + _DOWN_10 * 5 + b"X4\n"
    states = Tool(laser).play("M3S1000", "G1F1200", "X1", 500, lines, 60)
    assert states[-1] == ("Run", 500, 128)


@pytest.mark.parametrize(("laser", "stop"), [(1, b""), (0, b"\x9e")])
def test_stopped_tool_has_no_speed_when_it_is_overridden_in_a_hold(
    laser: int, stop: bytes
) -> None:
    """A hold stops a laser; 0x9e stops a spindle in a hold."""
    states = Tool(laser).play(*_MOVES, 200, b"!", 500, stop, 50, _UP_10, 50)
    assert states[-1] == ("Hold:0", 0, 0)


@pytest.mark.parametrize("moves", [("G1X10",), ()], ids=["motion ahead", "at rest"])
@pytest.mark.parametrize("gap_us", range(0, 2000, 200))
def test_held_laser_is_dark_after_a_start_that_a_hold_prevents(
    moves: "tuple[str, ...]", gap_us: int
) -> None:
    """One pass of the main loop restores the laser, the next would start the motion; `!` comes
    between the two, gap_us after `~`."""
    tool = Tool(laser=1)
    rig, link = tool.machine.rig, tool.machine.rig.link
    states: list[Shown] = []

    def script() -> Iterator[Any]:
        """Hold with the laser on, resume, and hold again gap_us later; record what is shown."""
        yield from tool.machine.start()
        steps: list[Step] = ["G1F600", "M3S1000", *moves, 100, b"!", 700]
        for step in steps:
            yield from tool.do_step(step)
        link.send(b"~")
        yield rig.ms(gap_us / 1000)
        link.send(b"!")
        for _ in range(3):
            yield rig.ms(400)  # until the machine has reacted
            states.append((yield from tool.read_status()))

    tool.machine.run(script())
    assert states[-1] == ("Hold:0", 0, 0)


@pytest.mark.parametrize("line", ["$30=2000", "$30=500", "$31=10"])
def test_setting_that_darkens_a_laser_leaves_it_dark_after_it_is_stored(line: str) -> None:
    """The laser is on before. A store that blocks interrupts switches it off meanwhile: after
    saving, it must not be switched on again."""
    tool = Tool(laser=1)
    states: list[Shown] = []

    def script() -> Iterator[Any]:
        """Switch the laser on, change a setting with a store like that of a board, and record."""
        yield from tool.machine.start()
        store: Any = tool.machine.rig.store
        before, after = tool.machine.rig.controller.around_saves(
            allow=lambda ms: None, written=None
        )
        save = store.save

        def around(name: str, lines: "list[str]") -> None:
            """Do as a board's store, which calls both functions around a write."""
            before()
            save(name, lines)
            after()

        store.save = around
        steps: list[Step] = ["G1F600", "M3S500", line, 50]
        for step in steps:
            yield from tool.do_step(step)
            states.append((yield from tool.read_status()))

    tool.machine.run(script())
    assert states[1].power == 128 and states[-1].power == 0  # states[1]: after M3S500, half of 255


@pytest.mark.parametrize("value", ["9" * 39, "9" * 60])
def test_speed_beyond_single_precision_is_no_fault(value: str) -> None:
    states = Tool().play(f"$31={value}", "M3S500", "G1X1F600", 50)
    assert states[-1].state in ("Run", "Idle")


def test_parking_stays_off_after_the_program_until_m56() -> None:
    """M56P0 switches parking off; M30 does not switch it on. [GC: is the answer to $G."""
    tool = Tool(PARKING=True, OVERRIDE_CONTROL=True)
    tool.play("M56P0", "M30", "$G", "M56", "$G")
    modes = [line for line in tool.machine.received if line.startswith("[GC:")]
    assert ["M56" in line for line in modes] == [False, True]
    controller: Any = tool.machine.rig.controller
    assert controller.state.override_control
