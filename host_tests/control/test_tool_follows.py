"""Test that the tool does what was asked for and reported: overrides, holds, doors, settings.

Tool.play() does steps: it sends lines (text) and real-time bytes, waits so many ms (numbers), and
sets inputs (a dict). It returns state, speed and power at the PWM pin as shown after each step.
settle: ms of silence at the end of a wait.
"""

from collections.abc import Generator, Iterator
from types import ModuleType
from typing import Any, NamedTuple

import pytest
from base import state as st
from rig_bench import Machine
from test_homing_end import machine_with_switches
from ugrbl.boardfile.files import load_board

_FAST = {110: 6000, 120: 500}
_DOWN_10, _UP_10, _TO_100 = b"\x9b", b"\x9a", b"\x99"  # spindle overrides; _TO_100: 100 %
_FULL = 255  # power at $30, 1000 rpm

# A step: a line, whose answer is awaited; real-time bytes; a wait in ms; inputs and their states.
Step = str | bytes | int | dict[str, bool]


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
        elif isinstance(step, dict):
            self.machine.rig.port.push(step)
        else:
            yield self.machine.rig.ms(step)

    def do_steps(self, *steps: Step) -> Iterator[Any]:
        """Do several steps, without asking for a status."""
        for step in steps:
            yield from self.do_step(step)

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


@pytest.mark.parametrize("motion", ["G0X1", "G38.3Z-0.1"])
@pytest.mark.parametrize(("tool", "jog"), [("M3S500", "X5"), ("M3S500", "X0"), ("M4S500", "X5")])
def test_laser_stays_dark_in_and_after_a_jog_unless_the_program_cuts(
    tool: str, jog: str, motion: str
) -> None:
    """The motion before the jog, which takes 0.3 s or has no length, switches the laser off."""
    steps = (tool, "G1F1000X0.5", motion, 700, f"$J=G91{jog}F1000", 100, 1000)
    states = Tool(laser=1).play(*steps)[-4:]
    assert [(each.speed, each.power) for each in states] == [(0, 0)] * 4


@pytest.mark.parametrize("tool", ["M3S0", "M4S0"])
@pytest.mark.parametrize("setting", ["$30=0", "$31=1000", "$31=2000"])
def test_s0_is_dark_when_the_least_speed_is_not_below_the_greatest(
    setting: str, tool: str
) -> None:
    """$31 is the least, $30 the greatest, 1000 at first."""
    states = Tool(laser=1).play(setting, tool, "G1F600", "X1", 50, 500, "G38.3Z-0.2", 50, "G0X0")
    assert [(each.speed, each.power) for each in states[1:]] == [(0, 0)] * 8


@pytest.mark.parametrize(("word", "touches"), [("G38.2", True), ("G38.4", False)])
def test_laser_is_dark_after_a_probing_that_is_refused(word: str, touches: bool) -> None:
    """The probe touches already, or not yet: ALARM:4."""
    lit = ("M3S500", "G1F600X0.5", 500)
    tool = Tool(laser=1)
    states = tool.play(*lit, {"probe": touches}, word + "Z-1F100", 1000, "$X", 50)
    assert "ALARM:4" in tool.machine.received and states[2] == ("Idle", 500, 128)
    assert states[-3:] == [("Alarm", 0, 0), ("Idle", 0, 0), ("Idle", 0, 0)]


@pytest.mark.parametrize("opens", [b"\x84", {"hold": True}], ids=["0x84", "input"])
@pytest.mark.parametrize("on", ["M3S500", "M8"])
@pytest.mark.parametrize("ends", ["G38.2Z-0.2F300", "$C"], ids=["probing", "check mode"])
def test_door_switches_off_what_a_failed_probing_or_check_mode_leaves_on(
    ends: str, on: str, opens: Step
) -> None:
    """ALARM:5 leaves it on, as in Grbl. A reset follows."""
    tool = Tool(SAFETY_DOOR=True)
    port = tool.machine.rig.port

    def script() -> Iterator[Any]:
        yield from tool.machine.start()
        yield from tool.do_steps(on, ends, 1000)
        assert port.spindle_pwm or port.flood
        yield from tool.do_steps(opens, 1000)
        assert not (port.spindle_pwm or port.flood)
        assert any(line.startswith("Grbl") for line in tool.machine.take())

    tool.machine.run(script())


_DARK_BY_SETTING = ("M3S500", "$30=500")
_DARK_BY_G0 = ("$32=1", "M3S300", "G0X.1", 500, "$32=0")


@pytest.mark.parametrize("off", [_DARK_BY_SETTING, _DARK_BY_G0], ids=["$30", "laser"])
def test_hold_with_an_override_starts_no_spindle_that_is_off(off: "tuple[Step, ...]") -> None:
    states = Tool().play(*off, b"!", 50, _UP_10, 50)[len(off) - 1 :]
    assert states[-1].state == "Hold:0" and [each.power for each in states] == [0] * 5


def test_hold_starts_no_spindle_after_homing_with_an_override() -> None:
    """Homing has stopped it."""
    tool = Tool()
    tool.machine = machine_with_switches()
    states = tool.play("$X", "M3S800", b"$H\n", _UP_10, 5000, b"!", 100)
    assert [states[i].state for i in (3, 4)] == ["Home", "Idle"]
    assert states[4].power == 0 and states[-1] == ("Hold:0", 0, 0)


@pytest.mark.parametrize(
    ("lines", "shown"),
    [
        (b"G1X9F3000\nG0X0\n", ("Idle", 0, 0)),
        (b"G0X9\nG1X9.1F300\n", ("Idle", 0, 0)),
        (b"G1X9F3000\nX8S300\n", ("Idle", 300, 77)),
    ],
    ids=["cut and move", "move and cut", "two cuts"],
)
def test_laser_is_lit_after_a_jog_cancel_drops_blocks_only_where_it_cuts_and_was_lit(
    lines: bytes, shown: "tuple[str, float, int]"
) -> None:
    """0x85 cancels a jog in the first of the blocks before it; the second has set the modes."""
    jog = (lines + b"$J=X5F300\n", 60, b"\x85", 500)
    states = Tool(laser=1).play("M3S500", "G1F300", "G0X.1", 500, *jog, b"!", 100, b"~", 100)
    assert states[7] == states[-1] == shown


def test_laser_that_a_setting_has_darkened_stays_dark_after_a_hold() -> None:
    steps = ("M3S500", "G1F300X.1", 500, "$30=2000", 50, b"!", 100, b"~", 100)
    states = Tool(laser=1).play(*steps)
    assert states[2].power == 128 and states[-1] == ("Idle", 0, 0)


def test_hold_at_the_end_of_a_restore_does_not_retract_the_tool_again() -> None:
    """`!` comes between the end of the restore after a door and the cycle start that it posts."""
    tool = Tool(PARKING=True)
    rig = tool.machine.rig
    seen: set[tuple[int, int]] = set()  # Z in steps, power

    def script() -> Iterator[Any]:
        yield from tool.machine.start()
        yield from tool.do_steps("$22=1", "$112=6000", "$122=500", "G0Z-15", 500)
        yield from tool.do_steps("M3S1000G1F600X3", 50, b"\x84", 9000, b"~")
        state = rig.controller.state
        post = state.post

        def post_with_hold(event: int) -> None:
            """Post the cycle start at the end of the restore, and a hold with it."""
            post(event)
            if state.suspend & st.RESTORE_COMPLETE:
                post(st.FEED_HOLD)
                state.post = post

        state.post = post_with_hold
        yield lambda: state.post == post
        for _ in range(100):
            seen.add((tool.machine.physical()[2], rig.port.spindle_pwm))
            yield rig.ms(5)
        tool.states.append((yield from tool.read_status()))

    tool.machine.run(script())
    assert seen == {(-15 * 250, _FULL)} and tool.states == [("Idle", 1000, _FULL)]
