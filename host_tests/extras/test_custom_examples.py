"""Test examples/custom/: each is read as on a board, and the machine's actions are checked.

The simulated machine begins at 0, the upper end of its Z; 250 steps are a millimetre.

shop("NAME") is a machine with this example. cnc.say() powers it up, sends lines and returns their
answers. In a script, cnc.send(line) waits for the answer, and cnc.send(text, "ms 500") for 500 ms;
cnc.start(line) waits for a hold or another state, as cnc.until(state) does. cnc.close() closes an
input; cnc.switch() and Solid() let the probe touch in a region. Results are cnc.position_mm(),
cnc.messages (texts of [MSG:…]), cnc.answers (with alarms) and cnc.output_changes: name, level and
position in mm of each change.
"""

import itertools
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from extras.custom.machine_api import STATES
from ugrbl.boardfile.files import load_board
from ugrbl.sim.engine import Switch
from ugrbl.sim.replay import factory_store
from ugrbl.sim.rig import Rig
from ugrbl.sim.sender import Sender, is_answer

# Many cases: the first ring runs a sample of them.
pytestmark = pytest.mark.sampled(1)

_EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "custom"
_STEPS = 250  # per mm
_FAST = {110: 6000, 111: 6000, 112: 6000, 120: 500, 121: 500, 122: 500, 1: 255}
_LONGEST = {"rack": 120}


class Solid(Switch):
    """A body that the probe touches; `touched` says whether it does at a place."""

    def __init__(self, shop: "Shop", touched: "Callable[[float, float, float], bool]") -> None:
        super().__init__("probe", 0, True, 0)
        self._shop = shop
        self._touched = touched

    def closed(self, steps: int) -> bool:
        return self._touched(*self._shop.position_mm()[:3])

    def crossing(self, start: int, end: int) -> int:
        return 0  # it is checked every 10 ms


class Shop:
    """A machine with one of the examples, a sender, and a record of its actions.

    The record has changes of outputs and contacts of the probe, each with the place in mm.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, name: str, **options: Any) -> None:
        """Power up a board with this example as CUSTOM. options: of the board file; `settings`
        are by $-number."""
        monkeypatch.chdir(_EXAMPLES)
        monkeypatch.syspath_prepend(str(_EXAMPLES))
        monkeypatch.setattr(sys, "dont_write_bytecode", True)
        defaults = {**_FAST, **options.pop("settings", {})}
        plain = ModuleType("plain")  # for the store: without the example
        vars(plain).update(vars(load_board("sim")), DEFAULTS=defaults)
        self.board = ModuleType("board")
        vars(self.board).update(vars(plain), CUSTOM=name, **options)
        self.outputs = list(getattr(self.board, "OUTPUTS", {}))
        self.output_changes: "list[tuple[Any, ...]]" = []  # of outputs: name, level, place in mm
        self.messages: "list[str]" = []
        self.answers: "list[str]" = []  # all of them
        self.power_up(factory_store(plain))

    def power_up(self, store: Any) -> None:
        """Start a machine with this store."""
        self.rig = Rig(self.board, store)
        self.sender = Sender(self.rig)
        self.sender.allow(600_000)  # ms for all waits
        self.rig.port.drive = self._watched(self.rig.port.drive)  # type: ignore[method-assign]

    def _watched(self, drive: "Callable[[int], None]") -> "Callable[[int], None]":
        """Return the port's drive(levels), which also records changed outputs; a bit each."""

        def driven(levels: int) -> None:
            """Set the outputs to levels, a bit each, and record those that have changed."""
            was = self.rig.port.own_outputs
            drive(levels)
            for bit, name in enumerate(self.outputs):
                if (was ^ self.rig.port.own_outputs) >> bit & 1:
                    self.output_changes.append((name, bool(levels >> bit & 1), self.position_mm()))

        return driven

    def is_on(self, name: str) -> bool:
        """Return whether the output is on."""
        return bool(self.rig.port.own_outputs >> self.outputs.index(name) & 1)

    def position_mm(self) -> "tuple[float, ...]":
        """Return the motors' position, mm."""
        self.rig.engine.physical(self.rig.scratch)
        return tuple(round(steps / _STEPS, 3) for steps in self.rig.scratch)

    def close(self, name: str, closed: bool = True) -> None:
        """Close or open an input by its name in the board file."""
        self.rig.port.push({"pin_%d" % self.board.INPUTS[name]: closed})

    def switch(self, axis: int, above: bool, mm: float) -> Switch:
        """Let the probe touch above (or below) a place of an axis; 0 is X."""
        contact = Switch("probe", axis, above, round(mm * _STEPS))
        self.rig.engine.switches.append(contact)
        return contact

    def run(self, script: "Iterator[Any]") -> None:
        """Run a script after the welcome."""

        faults: "list[Exception]" = []  # of the script: no handler may catch them

        def whole() -> "Iterator[Any]":
            """Wait for welcome and 50 ms of silence, then run the script; store its exception."""
            try:
                yield from self.sender.wait("banner", "")
                yield from self.sender.silence(self.rig.now, 50)
                yield from script
            except Exception as fault:
                faults.append(fault)

        self.rig.run(whole())
        for fault in faults:
            raise fault

    def send(self, text: str, how: str = "ok") -> "Iterator[Any]":
        """Send a text; return the replies without messages, which are stored.

        how: "ok" adds a line end and waits for the answer; "ms 500" waits only for 500 ms.
        """
        yield from self.sender.wait(how, text if how != "ok" else text + "\n")
        return self.take_replies()

    def start(self, line: str, how: str = "Hold") -> "Iterator[Any]":
        """Send a line and wait for a state, but not for the answer."""
        yield from self.send(line if line == "~" else line + "\n", "ms 10")
        yield from self.until(how)

    def take_replies(self) -> "list[str]":
        """Return the lines received since the last call; store messages, answers and alarms."""
        received = self.sender.take()
        self.messages += [line[5:-1] for line in received if line.startswith("[MSG:")]
        self.answers += [line for line in received if is_answer(line) or line.startswith("ALARM")]
        return [line for line in received if line and not line.startswith(("[MSG:", "Grbl "))]

    def state(self) -> str:
        """Return the state as in a status report."""
        return STATES[self.rig.controller.state.run]

    def until(self, state: str) -> "Iterator[Any]":
        """Wait until the machine stays in a state; in a hold it must have stopped."""
        since = self.rig.now  # tick; it has stayed after 100 ms
        while self.rig.now - since < self.rig.ticks_per_ms * 100:
            is_so = self.state() == state and (state != "Hold" or self.sender.at_rest())
            if not is_so:
                since = self.rig.now
            assert self.rig.now < self.sender.deadline, self.state()
            yield self.rig.ms(10)
        self.take_replies()

    def wait_for_answers(self, count: int) -> "Iterator[Any]":
        """Wait for this number of answers."""
        while len(self.answers) < count:
            yield self.rig.ms(20)
            self.take_replies()

    def reports(self) -> "Iterator[Any]":
        replies = yield from self.send("?", "report")
        return [line for line in replies if line.startswith("<")]

    def reply_to(self, line: str) -> "list[str]":
        """Return the reply to a line."""
        replies: "list[str]" = []

        def script() -> "Iterator[Any]":
            """Send the line, and store the replies."""
            replies.extend((yield from self.send(line)))

        self.run(script())
        return replies

    def say(self, *lines: str) -> "list[str]":
        """Power up, send lines, wait until the machine stops, and return their answers."""
        answers: "list[str]" = []

        def script() -> "Iterator[Any]":
            """Send line by line, and store the answers."""
            for line in lines:
                replies = yield from self.send(line)
                answers.extend([text for text in replies if is_answer(text)])
            yield from self.sender.until(self.sender.at_rest)

        self.run(script())
        return answers


def offset(shop: Shop, name: str) -> "tuple[float, ...]":
    """Return the stored offset of a coordinate system, such as "G54", in mm."""
    for line in shop.rig.store.files["coords"]:
        if line.startswith(name + "="):
            return tuple(float(mm) for mm in line.partition("=")[2].split(","))
    raise AssertionError(name)


@pytest.fixture
def shop(monkeypatch: pytest.MonkeyPatch) -> "Callable[..., Shop]":
    return lambda name, **options: Shop(monkeypatch, name, **options)


Make = Callable[..., Shop]


def test_every_example_is_short_and_has_its_test() -> None:
    """At most 40 lines of code each, or as _LONGEST says; this module uses each of them."""
    here = Path(__file__).read_text(encoding="utf-8")
    for file in _EXAMPLES.glob("*.py"):
        code = file.read_text(encoding="utf-8").split('"""', 2)[2]  # after its docstring
        lines = [line for line in code.splitlines() if line.strip()]
        assert len(lines) <= _LONGEST.get(file.stem, 40), file.name
        assert f'shop("{file.stem}"' in here, file.name


# Tool change with length measuring


def with_tool_sensor(shop: Make, **more: Any) -> Shop:
    """Return a machine whose sensor is touched 35 mm down."""
    cnc = shop("tool_length", **more)
    cnc.switch(axis=2, above=False, mm=-35)
    return cnc


def test_tool_is_changed_with_everything_off_and_measured(shop: Make) -> None:
    """M6 T2 moves to X3 Y60 for the user's hands, then measures at X3 Y139.

    Inches and relative distances (G20 G91) of the program do not affect it, and stay.
    """
    cnc = with_tool_sensor(shop)
    seen: dict[str, Any] = {}

    def script() -> "Iterator[Any]":
        """Change to tool 2; look at the machine while it waits for the user."""
        yield from cnc.send("G20 G91 M3 S1000 M8")
        yield from cnc.start("T2 M6")  # waits for the hold
        port = cnc.rig.port
        seen["off"] = (port.spindle_on, port.flood, cnc.position_mm())
        yield from cnc.start("~", "Idle")  # cycle start: it measures
        seen["modes"] = yield from cnc.send("$G")
        seen["offsets"] = yield from cnc.send("$#")

    cnc.run(script())
    assert seen["off"] == (False, 0, (3.0, 60.0, -1.0))
    assert "Put in tool 2, then cycle start" in cnc.messages
    assert "G20 G91" in seen["modes"][0]
    assert "[TLO:-35.000]" in seen["offsets"]
    assert cnc.position_mm() == (3.0, 139.0, -1.0)


def test_length_is_restored_after_a_reset_and_power_off(shop: Make) -> None:
    """The length of -35 mm (see with_tool_sensor()) is in $# after both."""
    cnc = with_tool_sensor(shop)
    offsets: list[Any] = []

    def script() -> "Iterator[Any]":
        """Measure a tool; reset while idle; read the offsets."""
        yield from cnc.start("T2 M6")
        yield from cnc.start("~", "Idle")  # the tool is in; it is measured
        yield from cnc.send("\x18", "banner")
        offsets.extend((yield from cnc.send("$#")))
        yield from cnc.sender.silence(cnc.rig.now, 500)  # ms without output, before power-off

    cnc.run(script())
    assert "[TLO:-35.000]" in offsets
    cnc.power_up(cnc.rig.store)
    assert "[TLO:-35.000]" in cnc.reply_to("$#")


def test_pressed_sensor_is_reported_and_nothing_moves(shop: Make) -> None:
    """The PROBE input is the sensor: it is closed before T2 M6, which is refused."""
    cnc = shop("tool_length")
    cnc.rig.port.push({"probe": True})
    assert cnc.say("M3 S1000", "T2 M6") == ["ok", "error:3"]
    assert cnc.messages == ["The tool sensor is pressed: nothing has moved"]
    assert cnc.position_mm() == (0, 0, 0)


def test_tool_that_does_not_touch_has_no_length(shop: Make) -> None:
    """Without a sensor the measurement fails (alarm 5) at Z-60; the old length of -20 is gone."""
    cnc = shop("tool_length")
    replies: list[Any] = []

    def script() -> "Iterator[Any]":
        """Change to tool 2; its measurement touches nothing; unlock, and read the offsets."""
        yield from cnc.send("G43.1 Z-20")
        yield from cnc.start("T2 M6")
        yield from cnc.start("~", "Alarm")
        replies.extend((yield from cnc.send("$X")))
        replies.extend((yield from cnc.send("$#")))

    cnc.run(script())
    assert "ALARM:5" in cnc.answers and "[TLO:0.000]" in replies
    assert cnc.position_mm()[2] == -60


def test_tool_selected_long_before_is_requested(shop: Make) -> None:
    """M6 without T, some lines after T7."""
    cnc = with_tool_sensor(shop)

    def script() -> "Iterator[Any]":
        yield from cnc.send("T7")
        yield from cnc.send("G1 X1 F1000")
        yield from cnc.start("M6")

    cnc.run(script())
    assert "Put in tool 7, then cycle start" in cnc.messages


def test_reset_during_the_measurement_stops_and_leaves_no_length(shop: Make) -> None:
    """The machine is on its way to the sensor: alarm 3, because a moving one may lose steps."""
    cnc = with_tool_sensor(shop)
    seen: list[Any] = []

    def script() -> "Iterator[Any]":
        """Reset in the middle of the measurement. Note the place at once and 0.5 s later."""
        yield from cnc.start("T2 M6")
        yield from cnc.start("~", "Run")
        yield cnc.rig.ms(1500)  # it has left the place of the change, X3 Y60
        yield from cnc.send("\x18", "banner")
        seen.append(cnc.position_mm())
        yield cnc.rig.ms(500)  # it would have moved on by now
        seen.append(cnc.position_mm())
        yield from cnc.send("$X")
        seen.extend((yield from cnc.send("$#")))

    cnc.run(script())
    place_at_reset, place_later, *offsets = seen
    assert place_at_reset == place_later and place_at_reset != (3.0, 60.0, -1.0)
    assert "ALARM:3" in cnc.answers and "[TLO:0.000]" in offsets


# Touch plate


def with_touch_plate(shop: Make) -> Shop:
    """Return a machine whose work has its corner 10 mm left, 5 mm in front and 15 mm below."""
    cnc = shop("touch_plate")
    cnc.rig.engine.switches.append(Solid(cnc, _on_plate))
    return cnc


def _on_plate(x: float, y: float, z: float) -> bool:
    """The plate is 12 mm thick on the work and 8 mm at its sides; the tool is 6 mm thick."""
    return x + 3 >= -10 - 8 and y + 3 >= -5 - 8 and z <= -15 + 12


def test_touch_plate_finds_the_top_of_the_work(shop: Make) -> None:
    """M110 touches the plate, at Z-3 with its 12 mm on the work at Z-15. G20 must not matter."""
    cnc = with_touch_plate(shop)
    assert cnc.say("G20", "M110") == ["ok", "ok"]
    assert offset(cnc, "G54") == pytest.approx((0, 0, -15), abs=0.02)
    assert cnc.position_mm()[2] == pytest.approx(-3 + 3, abs=0.2)  # 3 mm above the plate


@pytest.mark.parametrize("lines", [("M110 D6",), ("G20 G91", "M110 D0.23622")])
def test_touch_plate_finds_the_corner(shop: Make, lines: "tuple[str, ...]") -> None:
    """The corner is at X-10 Y-5, for D of 6 mm or 0.23622 inches. A tool length of 0.5 mm is
    active, which Z includes."""
    cnc = with_touch_plate(shop)
    assert set(cnc.say("G43.1 Z0.5", *lines)) == {"ok"}, cnc.messages
    assert offset(cnc, "G54")[:2] == pytest.approx((-10, -5), abs=0.02)
    assert offset(cnc, "G54")[2] == pytest.approx(-15 - 0.5, abs=0.02)


def test_touch_plate_stops_at_an_obstacle_on_the_way(shop: Make) -> None:
    """A clamp at X-24 is in the way of the 30 mm that the tool moves to the plate's left side."""
    cnc = with_touch_plate(shop)
    clamp = Solid(cnc, lambda x, y, z: x <= -24)
    cnc.rig.engine.switches.append(clamp)
    assert cnc.say("M110 D6") == ["error:3"]
    assert cnc.messages == ["The tool has touched something on its way, X-30"]
    assert cnc.position_mm()[0] == pytest.approx(-24, abs=1)
    assert offset(cnc, "G54") == (0, 0, 0)


def test_touch_plate_is_not_used_with_a_turning_spindle(shop: Make) -> None:
    cnc = with_touch_plate(shop)
    assert cnc.say("M3 S1000", "M110") == ["ok", "error:3"]
    assert cnc.position_mm() == (0, 0, 0) and cnc.messages == ["The spindle turns: M5 first"]


def test_touch_plate_is_not_used_while_it_touches(shop: Make) -> None:
    cnc = with_touch_plate(shop)
    cnc.rig.port.push({"probe": True})
    assert cnc.say("M110") == ["error:3"] and "clip off" in cnc.messages[-1]


def test_missing_touch_plate_is_an_alarm_and_changes_no_offset(shop: Make) -> None:
    cnc = shop("touch_plate")
    cnc.say("M110")
    assert cnc.answers[:1] == ["ALARM:5"] and offset(cnc, "G54") == (0, 0, 0)
    assert cnc.position_mm() == (0, 0, -20)


# The middle of a pocket


def test_middle_of_a_pocket_is_found_and_reported(shop: Make) -> None:
    """The pocket is 32 by 24 mm about X4 Y-4; its middle becomes zero of G55. R: no wall is
    further away than this, here 1.5 inches."""
    cnc = shop("pocket")
    cnc.rig.engine.switches.append(Solid(cnc, lambda x, y, z: not (-12 < x < 20 and -16 < y < 8)))
    assert cnc.say("G20 G55", "M112 R1.5") == ["ok", "ok"], cnc.messages
    assert offset(cnc, "G55")[:2] == pytest.approx((4, -4), abs=0.02)
    assert offset(cnc, "G54") == (0, 0, 0)
    assert cnc.position_mm()[:2] == pytest.approx((4, -4), abs=0.02)
    assert "X 32.0" in cnc.messages[-1] and "Y 24.0" in cnc.messages[-1]


def test_middle_of_a_hole_is_found_from_its_edge(shop: Make) -> None:
    """A hole with a diameter of 30 mm about X5 Y-9; the probe begins at X0 Y0, near its edge."""
    cnc = shop("pocket")
    cnc.rig.engine.switches.append(
        Solid(cnc, lambda x, y, z: (x - 5) ** 2 + (y + 9) ** 2 >= 15**2)
    )
    assert cnc.say("M112 R30") == ["ok"], cnc.messages
    assert cnc.position_mm()[:2] == pytest.approx((5, -9), abs=0.05)
    assert "X 30.0" in cnc.messages[-1]


@pytest.mark.parametrize(
    ("before", "line"), [("M3 S500", "M112 R30"), ("M5", "M112 R0"), ("M5", "M112 R-3")]
)
def test_impossible_pocket_is_refused_with_the_reason(shop: Make, before: str, line: str) -> None:
    cnc = shop("pocket")
    assert cnc.say(before, line) == ["ok", "error:3"]
    assert cnc.messages[-1].startswith("M112") and cnc.position_mm() == (0, 0, 0)


def test_pocket_without_a_wall_is_an_alarm(shop: Make) -> None:
    cnc = shop("pocket")
    cnc.say("M112 R10")
    assert cnc.answers[0] == "ALARM:5" and offset(cnc, "G54") == (0, 0, 0)
    assert cnc.position_mm() == (-10, 0, 0)


# Vacuum and air

_VACUUM = {"OUTPUTS": {"vacuum": 20, "air": 21}}


def test_vacuum_follows_the_spindle_and_runs_on(shop: Make) -> None:
    """M3 switches both on and takes 2 s, for the spindle.

    M5 ends the air; the vacuum runs for another 5 s.
    """
    cnc = shop("vacuum", **_VACUUM)
    seen: list[Any] = []

    def note_outputs(ms: int) -> "Iterator[Any]":
        """After so many ms, note whether vacuum and air are on."""
        yield cnc.rig.ms(ms)
        seen.append((cnc.is_on("vacuum"), cnc.is_on("air")))

    def script() -> "Iterator[Any]":
        """M3 at X5 and M5 at X10; look at the outputs 0.1, 4.6 and 5.6 s after M5."""
        yield from cnc.send("G1 X5 F1500")
        since = cnc.rig.now
        yield from cnc.send("M3 S1000")
        seen.append((cnc.rig.now - since) / cnc.rig.ticks_per_ms > 2000)  # ms
        yield from note_outputs(0)
        yield from cnc.send("G1 X10")
        yield from cnc.send("M5")
        yield from note_outputs(100)
        yield from note_outputs(4500)
        yield from note_outputs(1000)

    cnc.run(script())
    # M3 took 2 s; then (vacuum, air) after M3 and 0.1, 4.6 and 5.6 s after M5.
    assert seen == [True, (True, True), (True, False), (True, False), (False, False)]
    # X in mm where an output changed: both on, air off, vacuum off.
    assert [place[0] for _, _, place in cnc.output_changes] == [5, 5, 10, 10]


@pytest.mark.parametrize("end", ["M2", "\x18"])
def test_end_of_a_program_ends_the_air_blast(shop: Make, end: str) -> None:
    """After M2 the vacuum runs on; a reset stops both at once."""
    cnc = shop("vacuum", **_VACUUM)
    air_and_vacuum: list[bool] = []

    def script() -> "Iterator[Any]":
        yield from cnc.send("M3 S1000")
        yield from cnc.send("G1 X50 F1000", "ms 50")
        yield from cnc.send(end, "ok" if end == "M2" else "banner")
        air_and_vacuum.extend([cnc.is_on("air"), cnc.is_on("vacuum")])

    cnc.run(script())
    assert air_and_vacuum == [False, end == "M2"]


def test_laser_is_not_waited_for(shop: Make) -> None:
    cnc = shop("vacuum", settings={32: 1}, **_VACUUM)
    since = cnc.rig.now
    cnc.say("M4 S100")
    assert cnc.is_on("air") and (cnc.rig.now - since) / cnc.rig.ticks_per_ms < 500


# Stack light

_LIGHT = {"OUTPUTS": {"green": 18, "yellow": 19, "well": 20, "buzzer": 21}}


def test_stack_light_shows_the_state(shop: Make) -> None:
    """lamps: first letters of those that are on.

    They are green (it moves), yellow (it waits), and "well" (no alarm).
    """
    cnc = shop("stack_light", **_LIGHT)
    lamps: list[Any] = []

    def send_and_note_lamps(text: str, how: str) -> "Iterator[Any]":
        """Send a text and wait as given, then note the lamps."""
        yield from cnc.send(text, how)
        yield cnc.rig.ms(100)  # the lamps are set
        lamps.append("".join([n[0] for n in cnc.outputs[:3] if cnc.is_on(n)]))

    def script() -> "Iterator[Any]":
        """Look at the lamps while idle, in motion, in a hold, resumed, after a reset, unlocked."""
        yield from send_and_note_lamps("", "ms 1")  # idle
        yield from send_and_note_lamps("G1 X50 F600\n", "ms 500")
        yield from send_and_note_lamps("!", "ms 500")
        yield from send_and_note_lamps("~", "ms 100")
        yield from send_and_note_lamps("\x18", "banner")  # during motion: alarm
        yield from send_and_note_lamps("$X\n", "ms 50")

    cnc.run(script())
    assert lamps == ["w", "gw", "yw", "gw", "", "w"]


def test_buzzer_beeps_twice_in_alarm_and_again_later(shop: Make) -> None:
    """With homing ($22=1) the machine is in alarm from power-up; $X ends it."""
    cnc = shop("stack_light", settings={22: 1}, **_LIGHT)

    def script() -> "Iterator[Any]":
        yield cnc.rig.ms(21_000)  # beeps at 0, 10 and 20 s
        assert not cnc.is_on("well")
        yield from cnc.send("$X")
        yield cnc.rig.ms(11_000)  # longer than the 10 s between beeps

    cnc.run(script())
    beeps = [on for name, on, _ in cnc.output_changes if name == "buzzer"]
    # Two at 0, 10 and 20 s.
    assert beeps.count(True) == 6 and not cnc.is_on("buzzer")


# Counter


def test_parts_are_counted_over_power_off(shop: Make) -> None:
    """Two of three parts are made before power-off. The third M2 asks the user to empty the box.

    Reports have |Pn:made,wanted; M120 sets the number wanted, M121 starts again at 0.
    """
    cnc = shop("counter")

    def script() -> "Iterator[Any]":
        """M120 sets 3 parts as the number wanted; two programs end with M30."""
        yield from cnc.send("M120 Q3")
        for _ in range(2):
            yield from cnc.send("G1 X1 F1000")
            yield from cnc.send("M30")
        yield cnc.rig.ms(100)  # the numbers are written while the machine is idle

    cnc.run(script())
    cnc.power_up(cnc.rig.store)
    seen: list[str] = []

    def next_day() -> "Iterator[Any]":
        """Read the counter after power-up; M2 ends the third part; M121 starts again at 0."""
        yield from cnc.reports()  # only a second report is sure to have the field
        seen.extend((yield from cnc.reports()))
        yield from cnc.start("M2")
        seen.append(cnc.messages[-1])
        yield from cnc.start("~", "Idle")  # the box is empty
        yield from cnc.send("M121")
        yield from cnc.reports()
        seen.extend((yield from cnc.reports()))

    cnc.run(next_day())
    report, message, report_after_m121 = seen
    assert report.endswith("|Pn:2,3>") and report_after_m121.endswith("|Pn:0,3>")
    assert message == "3 parts are made: empty the box, then cycle start"


def test_fractional_number_of_parts_is_refused(shop: Make) -> None:
    cnc = shop("counter")
    assert cnc.say("M120 Q-1", "M120 Q1.5", "M120") == ["error:3", "error:3", "error:28"]
    assert cnc.messages[0] == "M120: Q is a number of parts, not -1"


# A guard for a probe


@pytest.mark.parametrize("line", ["G0 X50", "G1 X50 F1500", "$J=G91 X50 F1500"])
def test_guarded_probe_stops_at_an_obstacle(shop: Make, line: str) -> None:
    """M114 P1 switches the guard on. The probe touches at X20: alarm 34; no step is lost."""
    cnc = shop("guard", settings={110: 1500})
    cnc.switch(axis=0, above=True, mm=20)
    seen: list[Any] = []

    def script() -> "Iterator[Any]":
        """M114 P1 guards the probe; it touches during a move; unlock, and jog away."""
        yield from cnc.send("M114 P1")
        yield from cnc.send(line + "\n", "ms 1")
        if line[0] == "G":  # lines after it, which are not executed
            yield from cnc.send("G1 Y50 F1500\n" * 30, "ms 1")
        yield from cnc.until("Alarm")
        seen.append(cnc.position_mm())
        yield cnc.rig.ms(2000)  # it would have moved on by now
        seen.append(cnc.position_mm())
        yield from cnc.send("$X")
        seen.extend((yield from cnc.reports()))
        yield from cnc.send("$J=G91 X-30 F1000")
        yield from cnc.until("Idle")
        seen.append(cnc.position_mm())

    cnc.run(script())
    stopped_at, later_at, report, jogged_to = seen
    assert stopped_at == later_at and 20 <= stopped_at[0] < 25 and stopped_at[1] == 0
    assert "MPos:%.3f," % stopped_at[0] in report
    assert jogged_to[0] == pytest.approx(stopped_at[0] - 30)
    assert cnc.messages[0].startswith("The probe has run into something at (20.")
    assert "ALARM:34" in cnc.answers


def test_guarded_probe_can_probe_and_be_pulled_back(shop: Make) -> None:
    """Probing moves may touch, and so may the moves away from the contact at X20.

    M114 P0 switches the guard off: then X30 is reached.
    """
    cnc = shop("guard")
    cnc.switch(axis=0, above=True, mm=20)
    lines = ("M114 P1", "G0 X10", "G38.2 X50 F300", "G0 X5", "G38.2 X50 F300", "G0 X0", "M114 P0")
    assert cnc.say(*lines, "G0 X30") == ["ok"] * 8
    assert cnc.position_mm()[0] == 30 and "ALARM:34" not in cnc.answers


def test_rapid_before_a_probing_move_is_guarded(shop: Make) -> None:
    """The probing line is read while the rapid before it is still executed."""
    cnc = shop("guard", settings={110: 1500})
    cnc.switch(axis=0, above=True, mm=20)

    def script() -> "Iterator[Any]":
        yield from cnc.send("M114 P1")
        yield from cnc.send("G0 X50\nG38.2 Z-10 F100\n", "ms 1")
        yield from cnc.until("Alarm")

    cnc.run(script())
    assert (
        "ALARM:34" in cnc.answers and 20 <= cnc.position_mm()[0] < 25 and cnc.position_mm()[2] == 0
    )


def test_spindle_does_not_turn_with_a_probe_in_it(shop: Make) -> None:
    cnc = shop("guard")
    assert cnc.say("M3 S100", "M114 P1", "M5", "M114 P1", "M3") == ["ok", "error:3"] + ["ok"] * 3
    assert cnc.answers[-1] == "ok" and "ALARM:34" in cnc.answers
    assert not cnc.rig.port.spindle_on


# Feeder

_FEEDER = {"OUTPUTS": {"feeder": 20}, "INPUTS": {"part": 21, "jam": 22}}


def test_feeder_runs_until_a_part_lies_still(shop: Make) -> None:
    """M115 runs the feeder at X10, until the sensor "part" is closed. Then the job goes on."""
    cnc = shop("feeder", **_FEEDER)
    feeder_is_on: list[bool] = []

    def script() -> "Iterator[Any]":
        """M115 runs the feeder until the input "part" closes."""
        yield from cnc.send("G1 X10 F1000")
        yield from cnc.send("M115\nG1 X20\n", "ms 2000")  # X10 is reached, no part has come
        feeder_is_on.append(cnc.is_on("feeder"))
        cnc.close("part")
        yield cnc.rig.ms(100)  # the handler sees the part
        feeder_is_on.append(cnc.is_on("feeder"))
        yield from cnc.until("Run")
        yield from cnc.until("Idle")

    cnc.run(script())
    assert feeder_is_on == [True, False] and cnc.position_mm()[0] == 20
    assert [place[0] for _, _, place in cnc.output_changes] == [
        10,
        10,
    ]  # X where it switched on and off


def test_job_holds_without_a_part_until_the_user_resumes(shop: Make) -> None:
    """M115 Q2 waits 2 s for a part, then holds. M115 is answered after a part has come."""
    cnc = shop("feeder", **_FEEDER)

    def script() -> "Iterator[Any]":
        """M115 holds, because no part comes within Q2 = 2 s; a part and cycle start end it."""
        yield from cnc.start("M115 Q2")  # waits for the hold
        assert not cnc.is_on("feeder") and cnc.answers == []
        cnc.close("part")
        yield from cnc.start("~", "Idle")
        yield from cnc.wait_for_answers(1)

    cnc.run(script())
    assert cnc.messages[0].startswith("No part within 2 s") and cnc.answers == ["ok"]


def test_reset_stops_the_feeder_and_a_jam_is_reported(shop: Make) -> None:
    cnc = shop("feeder", **_FEEDER)

    def script() -> "Iterator[Any]":
        """Reset while M115 feeds; then M115 with the input "jam" closed, and with a wrong Q."""
        yield from cnc.send("M115\n", "ms 500")
        assert cnc.is_on("feeder")
        yield from cnc.send("\x18", "banner")
        assert not cnc.is_on("feeder")
        cnc.close("jam")
        assert "error:3" in (yield from cnc.send("M115"))
        assert "error:3" in (yield from cnc.send("M115 Q0"))

    cnc.run(script())
    assert cnc.messages == ["M115: the feeder is jammed", "M115: Q is seconds, up to 120, not 0"]


# Pick and place

_PICK = {"OUTPUTS": {"vacuum": 20, "blow": 21}, "INPUTS": {"gripped": 22}}


def test_part_is_picked_and_placed(shop: Make) -> None:
    """M116 picks at Z-0.5 inches, M117 places at Z-0.25; both return to the height before."""
    cnc = shop("pick", **_PICK)

    def script() -> "Iterator[Any]":
        """Pick with M116 at X1 inch, place with M117 at X2 inches."""
        yield from cnc.send("G20 G0 X1")
        # 12.7 mm down at 600 mm/min take 1.3 s. Then it waits up to 0.8 s for the vacuum sensor.
        yield from cnc.send("M116 Z-0.5\n", "ms 1900")
        assert cnc.position_mm()[2] == pytest.approx(-12.7, abs=0.01)
        cnc.close("gripped")
        yield from cnc.wait_for_answers(2)  # G0 and M116
        assert cnc.position_mm()[2] == 0
        yield from cnc.send("G0 X2")
        yield from cnc.send("M117 Z-0.25\n", "ms 1500")  # long enough for the part's release
        cnc.close("gripped", closed=False)
        yield from cnc.wait_for_answers(4)

    cnc.run(script())
    assert cnc.answers == ["ok"] * 4
    assert [(name, on) for name, on, _ in cnc.output_changes] == [
        ("vacuum", True),
        ("vacuum", False),
        ("blow", True),
        ("blow", False),
    ]
    release_place = cnc.output_changes[1][2]
    assert release_place == pytest.approx((50.8, 0, -6.35), abs=0.01)  # 2 and -0.25 inches
    assert cnc.position_mm() == pytest.approx((50.8, 0, 0), abs=0.01) and cnc.messages == []


def test_missing_and_lost_parts_hold_the_job(shop: Make) -> None:
    """M116 holds without a part; a part that the vacuum sensor loses holds the next move."""
    cnc = shop("pick", **_PICK)

    def script() -> "Iterator[Any]":
        """Pick without a part, then with one; lose it during a move; resume with it."""
        yield from cnc.start("M116 Z-5")  # waits for the hold
        assert cnc.position_mm() == (0, 0, 0) and cnc.messages[0].startswith(
            "No part at the sucker"
        )
        cnc.close("gripped")
        yield from cnc.start("~", "Idle")
        yield from cnc.send("G1 X50 F1000\n", "ms 1000")
        cnc.close("gripped", closed=False)
        yield from cnc.until("Hold")
        assert 0 < cnc.position_mm()[0] < 25  # 1 s at 1000 mm/min, and the way to stop
        cnc.close("gripped")
        yield from cnc.start("~", "Idle")

    cnc.run(script())
    assert cnc.messages[-1].startswith("The part is lost") and cnc.position_mm()[0] == 50
    assert cnc.is_on("vacuum")


# Pen


def test_pen_is_down_before_the_machine_moves(shop: Make) -> None:
    """M3 is answered after the servo's travel time of 150 ms. A reset lifts the pen.

    pulses_us: width of the servo's pulses, 1000 us up and 1600 us down.
    """
    from machine import PWM

    cnc = shop("pen")
    pulses_us: list[Any] = []

    def us() -> int:
        # Pin 15: periods of 20000 us; duty 65535 is all of it.
        return round(PWM.outputs[15].duty * 20000 / 65535)

    def script() -> "Iterator[Any]":
        """M3 puts the pen down; a reset during a move lifts it. Note the pulses, and the wait."""
        pulses_us.append(us())
        since = cnc.rig.now
        yield from cnc.send("M3 S1")
        pulses_us.append((us(), (cnc.rig.now - since) / cnc.rig.ticks_per_ms >= 150))
        yield from cnc.send("G1 X50 F1000\n", "ms 200")
        yield from cnc.send("\x18", "banner")
        yield cnc.rig.ms(20)  # the handler has run
        pulses_us.append(us())

    cnc.run(script())
    assert pulses_us == [1000, (1600, True), 1000]


# Pendant

_WHEEL = {"wheel_a": 10, "wheel_b": 11}
_PENDANT = {"INPUTS": {**_WHEEL, "z": 12, "y": 13, "plus": 14, "minus": 15, "coarse": 16}}


def turn_wheel(cnc: Shop, edges: int) -> "Iterator[Any]":
    """Switch both contacts of the wheel as an encoder does, with edges of wheel_a.

    Negative edges turn it the other way. A contact changes every 3 ms.
    """
    a = b = False
    for _ in range(abs(edges)):
        for _ in range(2):
            if (a == b) == (edges > 0):
                a = not a
                cnc.close("wheel_a", a)
            else:
                b = not b
                cnc.close("wheel_b", b)
            yield cnc.rig.ms(3)


@pytest.mark.usefixtures("each_ms")  # polls each ms: a contact changes every 3 ms
@pytest.mark.parametrize(("edges", "coarse", "mm"), [(10, False, 0.1), (-10, True, -1.0)])
def test_wheel_jogs_by_its_edges(shop: Make, edges: int, coarse: bool, mm: float) -> None:
    """0.01 mm per edge, or 0.1 mm with the switch "coarse"; the switch "y" chooses the axis."""
    cnc = shop("pendant", **_PENDANT)

    def script() -> "Iterator[Any]":
        """Choose axis Y, turn the wheel of the pendant, and wait for the end of the jog."""
        cnc.close("y")
        cnc.close("coarse", coarse)
        yield from turn_wheel(cnc, edges)
        yield cnc.rig.ms(200)  # the edges are handled
        yield from cnc.until("Idle")

    cnc.run(script())
    assert cnc.position_mm() == pytest.approx((0, mm, 0), abs=0.005)


def test_button_jogs_while_it_is_held(shop: Make) -> None:
    """3 s at 1200 mm/min are 60 mm; after the release it stops within 2.5 mm."""
    cnc = shop("pendant", **_PENDANT)
    seen: list[Any] = []

    def script() -> "Iterator[Any]":
        """Hold the pendant's button "minus" for 3 s."""
        cnc.close("minus")
        yield cnc.rig.ms(3000)
        seen.append(cnc.position_mm()[0])
        seen.extend((yield from cnc.reports()))
        cnc.close("minus", closed=False)
        yield from cnc.until("Idle")
        seen.append(cnc.position_mm()[0])

    cnc.run(script())
    x_after_3_s, report, x_at_end = seen
    assert x_after_3_s == pytest.approx(-60, abs=3) and "<Jog" in report
    assert -2.5 < x_at_end - x_after_3_s < 0


def test_pendant_does_not_disturb_a_program(shop: Make) -> None:
    """A button and the wheel are used within a move, whose end must not change."""
    cnc = shop("pendant", **_PENDANT)

    def script() -> "Iterator[Any]":
        """Use the button "minus" and the wheel of the pendant during a move."""
        yield from cnc.send("G1 X20 F1000\n", "ms 100")
        cnc.close("minus")
        yield cnc.rig.ms(300)  # a jog would have begun
        yield from turn_wheel(cnc, 10)
        cnc.close("minus", closed=False)
        yield from cnc.until("Idle")

    cnc.run(script())
    assert cnc.position_mm() == (20, 0, 0)


# A pendant on a serial line


class Wire:
    """Stand in for machine.UART with the pendant's end."""

    last: "Wire"

    def __init__(self, number: int, baudrate: int, tx: Any, rx: Any) -> None:
        assert (number, baudrate) == (1, 115200)
        self.sent = b""  # by the pendant, not yet read by the example
        Wire.last = self

    def read(self) -> "bytes | None":
        sent, self.sent = self.sent, b""
        return sent or None


_ENABLE, _PLUS, _HOLD = 1, 2, 8  # bits of the pendant's buttons


def frame(axis: int = 0, clicks: int = 0, percent: int = 100, buttons: int = _ENABLE) -> bytes:
    """Return a frame of the pendant. buttons: those that are held."""
    data = bytes((0xA5, axis, clicks & 255, 10, percent, buttons))  # 10: 0.1 mm per click
    return data + bytes((sum(data) & 255,))


@pytest.fixture
def pendant(monkeypatch: pytest.MonkeyPatch, shop: Make) -> Shop:
    import machine

    monkeypatch.setattr(machine, "UART", Wire, raising=False)
    return shop("pendant_serial")


def repeated(cnc: Shop, data: bytes, times: int) -> "Iterator[Any]":
    """Send data so many times, every 20 ms."""
    for _ in range(times):
        Wire.last.sent += data
        yield cnc.rig.ms(20)


def test_clicks_of_the_serial_pendant_jog_and_wrong_frames_do_not(pendant: Shop) -> None:
    """Of all frames sent, only -12 clicks of Y and 5 of X count, 0.1 mm each."""
    wrong = bytearray(frame(axis=0, clicks=50))
    wrong[2] ^= 4  # the checksum no longer fits the clicks

    def script() -> "Iterator[Any]":
        """Send frames of the pendant: right, damaged, cut off, not enabled, for no axis."""
        yield from repeated(pendant, frame(axis=1, clicks=-3), 4)
        yield from repeated(pendant, bytes(wrong), 3)
        # The first of these two begins in its middle.
        yield from repeated(pendant, frame(axis=2, clicks=-2)[3:] + frame(axis=0, clicks=5), 1)
        yield pendant.rig.ms(150)  # frames so far are handled
        yield from repeated(pendant, frame(axis=0, clicks=9, buttons=0), 3)  # not enabled
        yield from repeated(pendant, frame(axis=7, clicks=9), 1)  # there is no such axis
        yield from pendant.until("Idle")

    pendant.run(script())
    assert pendant.position_mm() == pytest.approx((0.5, -1.2, 0), abs=0.005)


@pytest.mark.parametrize("end", ["the line is cut", "enabling button released", "button released"])
def test_jog_of_the_serial_pendant_ends(pendant: Shop, end: str) -> None:
    """The button plus is held for 2 s at 50 % of 3000 mm/min: 50 mm. Then the jog must end."""
    seen: list[Any] = []

    def script() -> "Iterator[Any]":
        """Hold "plus" for 100 frames (2 s); then end in the way that the parameter `end` says."""
        yield from repeated(pendant, frame(0, percent=50, buttons=_ENABLE | _PLUS), 100)
        seen.append(pendant.position_mm()[0])
        seen.extend((yield from pendant.reports()))
        still_held = {"enabling button released": _PLUS, "button released": _ENABLE}
        if end in still_held:
            yield from repeated(pendant, frame(0, percent=50, buttons=still_held[end]), 40)
        yield pendant.rig.ms(800)  # longer than the jog needs to end
        seen.append(pendant.position_mm()[0])
        yield from pendant.until("Idle")

    pendant.run(script())
    x_after_2_s, report, x_after_last_frame = seen
    assert x_after_2_s == pytest.approx(50, abs=3) and "<Jog" in report
    # mm; a cut line is noticed only after 0.24 s, which are 6 mm.
    assert 0 < pendant.position_mm()[0] - x_after_2_s < (8 if end == "the line is cut" else 2.5)
    assert pendant.position_mm()[0] == x_after_last_frame


def test_hold_of_the_serial_pendant_acts_once_in_a_program(pendant: Shop) -> None:
    """Wheel and plus do nothing in a program. The held hold button must not hold it again."""

    def script() -> "Iterator[Any]":
        """In a program: clicks with "plus", then the hold button; ~, and the button again."""
        yield from pendant.send("G1 X20 F1000\n", "ms 100")
        yield from repeated(pendant, frame(1, clicks=9, buttons=_ENABLE | _PLUS), 5)
        yield from repeated(pendant, frame(buttons=_ENABLE | _HOLD), 20)
        assert "<Hold" in (yield from pendant.reports())[0]
        yield from pendant.send("~", "ms 100")
        yield from repeated(pendant, frame(buttons=_ENABLE | _HOLD), 5)
        yield from pendant.until("Idle")

    pendant.run(script())
    assert pendant.position_mm() == (20, 0, 0)


# A tool rack

_RACK = {
    "OUTPUTS": {"drawbar": 20, "blow": 21},
    "INPUTS": {"tool_in": 10, "open": 11, "air": 12},
}


class Rack:
    """Model pockets with tools, a cone and a drawbar.

    stuck: the drawbar does not move; lengths: Z in mm at which each tool touches.
    """

    def __init__(self, shop: Shop) -> None:
        """Fill all pockets; follow each change of the outputs."""
        self.shop = shop
        self.pockets = set(range(1, 9))  # that have their tool
        self.tool = 0  # in the cone; 0: none
        self.stuck = False
        self.lengths = {tool: -30.0 - tool for tool in range(1, 9)}
        self.changes: "list[str]" = []  # "+3": tool 3 was taken, "-3": put away
        shop.close("air")  # the input "air": there is pressure
        shop.rig.engine.switches.append(Solid(shop, self._touches))
        shop.rig.port.drive = self._around(shop.rig.port.drive)  # type: ignore[method-assign]

    def _touches(self, x: float, y: float, z: float) -> bool:
        return bool(self.tool) and (x, y) == (360, 300) and z <= self.lengths[self.tool]

    def _around(self, drive: "Callable[[int], None]") -> "Callable[[int], None]":
        """Return the port's drive(levels), which also updates the tool."""

        def driven(levels: int) -> None:
            drive(levels)
            self.update_tool()

        return driven

    def pocket(self) -> int:
        """Return the pocket in which the cone is, or 0."""
        x, y, z = self.shop.position_mm()
        return round((x - 20) / 40) + 1 if y == 300 and z == -80 else 0

    def update_tool(self) -> None:
        """Update tool, pockets and sensors from the drawbar and the place of the cone."""
        is_open = self.shop.is_on("drawbar") and not self.stuck
        pocket = self.pocket()
        if is_open and self.tool and pocket:
            assert pocket not in self.pockets, "two tools in a pocket"
            self.pockets.add(pocket)
            self.changes.append("-%d" % self.tool)
            self.tool = 0
        elif is_open and self.tool:
            raise AssertionError("a tool has fallen")
        elif not is_open and not self.tool and pocket in self.pockets:
            self.pockets.remove(pocket)
            self.tool = pocket
            self.changes.append("+%d" % pocket)
        for name, closed in (("open", is_open), ("tool_in", self.tool > 0)):
            pushed = self.shop.rig.port._pushed
            if pushed.get("pin_%d" % _RACK["INPUTS"][name], False) != closed:
                self.shop.close(name, closed)


def test_tools_return_to_their_pockets_and_are_measured(shop: Make) -> None:
    """T3, T8 (a line before M6, and M6 twice), and T0, which puts the tool away.

    The program has inches and relative distances, which stay.
    """
    cnc = shop("rack", **_RACK)
    rack = Rack(cnc)
    seen: list[Any] = []

    def script() -> "Iterator[Any]":
        """Change tools as given; note spindle and Z after the lines that are only M6."""
        for line in ("G20 G91", "T3 M6", "M3 S500", "G0 Y-1", "T8", "G0 Y-1", "M6", "M6", "T0 M6"):
            yield from cnc.send(line)
            if line == "M6":
                seen.append((cnc.rig.port.spindle_on, cnc.position_mm()[2]))
        seen.extend((yield from cnc.send("$G"))[:1])

    cnc.run(script())
    assert cnc.messages == [] and set(cnc.answers) == {"ok"}
    # + taken, - put away
    assert rack.changes == ["+3", "-3", "+8", "-8"] and rack.pockets == set(range(1, 9))
    assert seen[0] == (False, -1) and "G20 G91" in seen[-1]  # spindle off, Z-1 mm
    # It opened and closed for each of the four changes.
    assert [name for name, _, _ in cnc.output_changes].count("drawbar") == 8


def test_impossible_tool_change_is_refused_before_anything_moves(shop: Make) -> None:
    """Each line has one reason for its refusal; `words` are from the messages, in this order."""
    cnc = shop("rack", **_RACK)
    Rack(cnc)

    def script() -> "Iterator[Any]":
        """Cause each refusal in turn, by inputs; M61 Q says which tool is in the cone."""
        yield from cnc.send("T9 M6")
        cnc.close("air", closed=False)
        yield from cnc.send("T1 M6")
        cnc.close("air")
        cnc.close("open")
        yield from cnc.send("T1 M6")
        cnc.close("open", closed=False)
        cnc.close("tool_in")
        yield from cnc.send("T1 M6")
        yield from cnc.send("M61 Q9")
        yield from cnc.send("M61 Q0")
        cnc.rig.port.push({"probe": True})
        yield from cnc.send("M61 Q4")  # right: a tool is in the cone
        yield from cnc.send("T1 M6")

    cnc.run(script())
    assert cnc.answers == ["error:3"] * 6 + ["ok", "error:3"]
    words = ("1 to 8", "no air", "stands open", "has a tool", "M61 Q9", "M61 Q0", "is pressed")
    assert all(word in message for word, message in zip(words, cnc.messages, strict=True))
    assert cnc.position_mm() == (0, 0, 0) and cnc.output_changes == []


def test_stuck_drawbar_stops_the_change(shop: Make) -> None:
    """The change T2 to T5 stops in pocket 2 (Z-80); the tool is still in the cone."""
    cnc = shop("rack", **_RACK)
    rack = Rack(cnc)

    def script() -> "Iterator[Any]":
        """Take tool 2; then the drawbar does not open when it is to be put away."""
        yield from cnc.send("T2 M6")
        rack.stuck = True
        yield from cnc.send("T5 M6\n", "ms 1")
        yield from cnc.until("Alarm")
        yield cnc.rig.ms(1500)  # nothing more may happen in this time

    cnc.run(script())
    assert cnc.messages[0] == "The drawbar does not open" and "ALARM:34" in cnc.answers
    assert rack.changes == ["+2"] and not cnc.is_on("drawbar") and cnc.position_mm()[2] == -80


def test_empty_pocket_and_broken_tool_are_reported(shop: Make) -> None:
    """Tool 2 breaks by 3 mm between two changes. Tool 7 is missing in its pocket."""
    cnc = shop("rack", **_RACK)
    rack = Rack(cnc)

    def script() -> "Iterator[Any]":
        """Shorten tool 2 by 3 mm between two changes; later remove tool 7 from its pocket."""
        yield from cnc.send("T2 M6")
        yield from cnc.send("T0 M6")
        rack.lengths[2] -= 3
        yield from cnc.start("T2 M6")  # waits for the hold
        yield from cnc.start("~", "Idle")
        yield from cnc.send("T0 M6")
        rack.pockets.remove(7)
        yield from cnc.send("T7 M6\n", "ms 1")
        yield from cnc.until("Alarm")

    cnc.run(script())
    assert cnc.messages[0].startswith("Tool 2 is 3.00 mm shorter")
    assert cnc.messages[1] == "No tool in pocket 7" and not cnc.is_on("drawbar")


@pytest.mark.thorough
def test_reset_at_any_time_of_a_change_drops_no_tool(shop: Make) -> None:
    """After each reset M61 says which tool is in the cone, and the next change succeeds."""
    for ms in range(200, 17_000, 1200):
        cnc = shop("rack", **_RACK)
        rack = Rack(cnc)

        def script(cnc: Shop = cnc, rack: Rack = rack, ms: int = ms) -> "Iterator[Any]":
            """Reset `ms` after the start of the change from tool 2 to 5; then change to tool 1."""
            yield from cnc.send("T2 M6")
            yield from cnc.send("T5 M6\n", "ms %d" % ms)
            yield from cnc.send("\x18", "banner")
            rack.update_tool()  # a reset switches outputs off without drive()
            assert not cnc.is_on("drawbar") and not cnc.rig.port.own_outputs
            yield cnc.rig.ms(700)  # until the motors have stopped and handlers have ended
            yield from cnc.send("$X")
            yield from cnc.send("M61 Q%d" % rack.tool)
            yield from cnc.send("$J=G91 Z20 F3000")  # off the sensor, if it is there
            yield from cnc.until("Idle")
            yield from cnc.send("T1 M6")

        cnc.run(script())
        assert cnc.answers[-2:] == ["ok", "ok"], (ms, cnc.messages)
        assert rack.tool == 1 and rack.pockets == set(range(2, 9)), (ms, rack.changes)


def test_spindle_without_a_tool_does_not_turn(shop: Make) -> None:
    cnc = shop("rack", **_RACK)
    Rack(cnc)
    cnc.say("M3 S100")
    assert "M3 without a tool" in cnc.messages and "ALARM:34" in cnc.answers
    assert not cnc.rig.port.spindle_on


# A frequency inverter


class Inverter:
    """Stand in for machine.UART with an inverter: its speed changes by up to 240 rpm a telegram.

    dumb: it does not answer; slow: it does not reach its speed.
    """

    dumb = slow = False

    def __init__(self, number: int, baudrate: int, tx: Any, rx: Any) -> None:
        assert (number, baudrate) == (1, 19200)
        self.answer: "bytes | None" = None  # to the last telegram
        self.hz = 0.0  # of the motor with two poles: rpm / 60
        self.asked_hz = 0.0
        self.word = 1  # last command: 0x12 M3, 0x22 M4, 1 stop
        Inverter.last = self

    last: "Inverter"

    def read(self) -> "bytes | None":
        answer, self.answer = self.answer, None
        return answer

    def write(self, frame: bytes) -> None:
        """Execute a Modbus telegram: address, function (3 read, 6 write), register, value, CRC.

        Register 0x2000 is the command, 0x2001 the wanted frequency in 0.01 Hz.
        """
        assert crc(frame[:-2]) == frame[-2:] and frame[0] == 1
        function, register, value = frame[1], frame[2] << 8 | frame[3], frame[4] << 8 | frame[5]
        if (function, register) == (6, 0x2000):
            self.word = value
        elif (function, register) == (6, 0x2001):
            self.asked_hz = value / 100
        target = self.asked_hz if self.word != 1 else 0
        change_hz = min(max(target - self.hz, -4), 4)
        self.hz += 0 if Inverter.slow and change_hz > 0 else change_hz
        if not Inverter.dumb:
            # A write is answered by its repetition, a read by the motor's frequency.
            value = round(self.hz * 100)
            body = frame[:6] if function == 6 else bytes((1, 3, 2, value >> 8, value & 255))
            self.answer = body + crc(body)


def crc(frame: bytes) -> bytes:
    """Return the Modbus CRC, from its definition: the polynomial 0x8005, reflected."""
    value = 0xFFFF
    for byte in frame:
        for bit in range(8):
            odd = (value ^ byte >> bit) & 1
            value = value >> 1 ^ 0xA001 * odd
    return value.to_bytes(2, "little")


@pytest.fixture
def inverter(monkeypatch: pytest.MonkeyPatch, shop: Make) -> Shop:
    """Return a machine with the example and a sound inverter; 24000 is the largest S."""
    import machine

    assert crc(bytes.fromhex("010300000001")) == bytes.fromhex("840a")  # the standard's example
    monkeypatch.setattr(machine, "UART", Inverter, raising=False)
    monkeypatch.setattr(Inverter, "dumb", False)
    monkeypatch.setattr(Inverter, "slow", False)
    return shop("inverter", settings={30: 24000})


def test_machine_waits_for_the_inverters_speed(inverter: Shop) -> None:
    """Each word is answered only at its speed. seen: command and rpm after each line."""
    seen: list[float] = []

    def script() -> "Iterator[Any]":
        for line in ("M3 S12000", "M5", "M4 S6000", "M2"):
            yield from inverter.send(line)
            seen.extend([Inverter.last.word, round(Inverter.last.hz * 60)])

    inverter.run(script())
    m3, rpm_m3, m5, rpm_m5, m4, rpm_m4, m2, _ = seen
    assert m3 == 0x12 and rpm_m3 == pytest.approx(12000, abs=300)
    assert m5 == 1 and rpm_m5 <= 30
    assert m4 == 0x22 and rpm_m4 == pytest.approx(6000, abs=150) and m2 == 1


def test_silent_inverter_stops_the_machine(inverter: Shop) -> None:
    """It no longer answers during a move: alarm 34 within some telegrams, and a stop command."""

    def script() -> "Iterator[Any]":
        """The inverter no longer answers 0.5 s after the begin of a move."""
        yield from inverter.send("M3 S12000")
        yield from inverter.send("G1 X100 F1000\n", "ms 500")
        Inverter.dumb = True
        yield from inverter.until("Alarm")
        yield inverter.rig.ms(1500)  # until the stop command is sent

    inverter.run(script())
    assert "The inverter does not answer" in inverter.messages
    assert "ALARM:34" in inverter.answers and inverter.position_mm()[0] < 30
    assert not inverter.rig.port.spindle_on
    assert Inverter.last.word == 1, (inverter.messages, inverter.answers)


def test_spindle_that_does_not_reach_its_speed_stops_the_job(inverter: Shop) -> None:
    """The inverter does not speed up (slow): alarm; the move after M3 has not begun."""

    def script() -> "Iterator[Any]":
        Inverter.slow = True
        yield from inverter.send("M3 S12000\nG1 X100 F1000\n", "ms 1")
        yield from inverter.until("Alarm")

    inverter.run(script())
    assert inverter.messages[0] == "The spindle has 0 rpm and should have 12000"
    assert inverter.position_mm() == (0, 0, 0)


def test_reset_stops_the_inverter(inverter: Shop) -> None:
    """Within 200 ms after a reset the example has sent the stop command, 1."""

    def script() -> "Iterator[Any]":
        yield from inverter.send("M3 S12000")
        yield from inverter.send("\x18", "banner")
        yield inverter.rig.ms(200)  # until the stop command is sent

    inverter.run(script())
    assert Inverter.last.word == 1


# A tangential knife


_TURNING: "dict[str, Any]" = {"STEP": (0, 1, 2, 3), "settings": {113: 6000, 123: 500}}


def cut_lines(cnc: Shop, *lines: str) -> "tuple[Shop, list[tuple[float, ...]]]":
    """Run lines; return the machine and its position at the end of each segment."""
    places: "list[tuple[float, ...]]" = []
    cnc.rig.engine.trace = lambda start, row: places.append(cnc.position_mm())
    assert cnc.say(*lines) == ["ok"] * len(lines), cnc.messages
    return cnc, places


def knife(shop: Make, *lines: str) -> "tuple[Shop, list[tuple[float, ...]]]":
    return cut_lines(shop("knife", **_TURNING), *lines)


def test_blade_turns_along_its_cut_and_lifts_at_corners(shop: Make) -> None:
    """Three sides of a square, at Z-1.5. A: 0 degrees along X, 90 along Y, 180 back along X.

    Between the sides the blade turns at Z2 or above.
    """
    _, places = knife(shop, "G0 Z5", "G101 X20 Y0", "G101 Y20", "G101 X0", "G100")
    down = [place for place in places if place[2] < 1.9]
    for (x, y, z, a), (x1, y1, z1, a1) in itertools.pairwise(down):
        if (x, y) != (x1, y1) and z == z1 == -1.5:
            assert a == a1 and a == pytest.approx(0 if y1 == y == 0 else 90 if x1 == x else 180)
    assert {round(place[3]) for place in down} == {0, 90, 180}
    assert places[-1] == pytest.approx((0, 20, 2, 180), abs=0.01)
    turning = [p for p, q in itertools.pairwise(places) if p[3] != q[3]]
    assert turning and all(place[2] >= 1.9 for place in turning)


def test_curve_is_cut_without_stops_and_lifts(shop: Make) -> None:
    """Eight lines along a parabola, with small angles between them."""
    lines = ["G101 X%d Y%.3f" % (10 * i, i * i / 4) for i in range(1, 9)]
    cnc, places = knife(shop, "G0 Z5", *lines)
    # All places from the first one at full depth on.
    cutting = places[next(i for i, place in enumerate(places) if place[2] == -1.5) :]
    # The step engine started for the moves before the cut, and once for all of the cut.
    assert all(place[2] == -1.5 for place in cutting) and cnc.rig.engine.starts <= 3
    # Direction of the last line: atan((64 - 49) / 4 / 10) in degrees.
    assert cnc.position_mm()[3] == pytest.approx(20.56, abs=0.01)


def test_knife_reads_inches_and_refuses_relative_places(shop: Make) -> None:
    cnc, _ = knife(shop, "G20", "G101 X1", "G100")
    assert cnc.position_mm()[0] == pytest.approx(25.4, abs=0.01)
    assert cnc.say("G91", "G101 X1") == ["ok", "error:3"]


# An oscillating blade


def oscillating(shop: Make, *lines: str) -> "tuple[Shop, list[tuple[float, ...]]]":
    return cut_lines(shop("oscillating", OUTPUTS={"blade": 18}, **_TURNING), *lines)


def test_blade_cuts_corners_completely_and_is_out_while_it_turns(shop: Make) -> None:
    """From X5 Y5 to X25, then to Y15, at Z-4; the blade turns at Z3 or above.

    Each cut begins 0.6 mm before its line and ends 0.6 mm after it.
    """
    cnc, places = oscillating(shop, "G0 Z5", "G0 X5 Y5", "G111 X25", "G111 Y15", "G110")
    down = [place for place in places if place[2] == -4]
    first_x = [x for x, y, z, a in down if a == 0]
    second_y = [y for x, y, z, a in down if round(a) == 90]
    assert (min(first_x), max(first_x)) == pytest.approx((4.4, 25.6), abs=0.01)
    assert (min(second_y), max(second_y)) == pytest.approx((4.4, 15.6), abs=0.01)
    turning = [p for p, q in itertools.pairwise(places) if p[3] != q[3]]
    assert turning and all(place[2] >= 2.99 for place in turning)
    assert places[-1] == pytest.approx((25, 15.6, 3, 90), abs=0.01)
    # The output of the blade: on at Z5, before it goes in; off at Z3.
    (_, first_level, on_place), (_, second_level, off_place) = cnc.output_changes
    assert (first_level, second_level) == (True, False)
    assert on_place[2] == 5 and off_place[2] == 3


def test_straight_sequence_of_lines_lifts_no_blade(shop: Make) -> None:
    """Five lines in one direction are one cut at Z-4; a reset stops the blade."""
    lines = ["G111 X%d Y%.2f" % (10 * i, 0.2 * i) for i in range(1, 6)]
    cnc, places = oscillating(shop, "G0 Z5", *lines)
    # All places from the first one at full depth on.
    cutting = places[next(i for i, place in enumerate(places) if place[2] == -4) :]
    assert all(place[2] == -4 for place in cutting) and cnc.is_on("blade")
    assert cnc.say("\x18", "$X") and not cnc.is_on("blade")


def test_blade_refuses_relative_places(shop: Make) -> None:
    cnc, _ = oscillating(shop, "G90")
    assert cnc.say("G91", "G111 X1") == ["ok", "error:3"] and not cnc.is_on("blade")


# Outputs and inputs by number

_NUMBERED = {
    "OUTPUTS": {"air": 18, "lamp": 19, "fan": 20},
    "INPUTS": {"part": 21, "door": 22},
}


def test_outputs_switch_with_or_after_the_motion_before_them(shop: Make) -> None:
    """M62 and M63 switch output P during motion, M64 and M65 after it has ended."""
    cnc = shop("digital_io", **_NUMBERED)
    lines = ("G1 X5 F1500", "M62 P0", "X10", "M63 P0", "X15", "M64 P1", "X20", "M65 P1")
    assert cnc.say(*lines) == ["ok"] * 8
    assert [(name, on) for name, on, _ in cnc.output_changes] == [
        ("air", True),
        ("air", False),
        ("lamp", True),
        ("lamp", False),
    ]
    x_mm = [place[0] for _, _, place in cnc.output_changes]
    assert x_mm[2:] == [15, 20], "they wait"
    late_mm = [x - wanted for wanted, x in zip((5, 10), x_mm)]
    # Up to 10 ms late, at 1500 mm/min = 25 mm/s.
    assert all(0 <= mm <= 0.01 * 25 for mm in late_mm), "motion goes on"


def test_input_is_waited_for_by_its_number(shop: Make) -> None:
    """P0 is "part", P1 is "door". Q is the longest wait in seconds."""
    cnc = shop("digital_io", **_NUMBERED)

    def script() -> "Iterator[Any]":
        """Wait with M66 for inputs by number, and let them change."""
        # L3 waits until it is closed. It closes after 500 ms, and the answer comes then.
        yield from cnc.send("M66 P0 L3 Q2\n", "ms 500")
        assert cnc.answers == []
        cnc.close("part")
        yield from cnc.wait_for_answers(1)
        # L1 waits for the moment of closing. It is closed already, so it must open first.
        yield from cnc.send("M66 P0 L1 Q1\n", "ms 100")
        cnc.close("part", closed=False)
        yield cnc.rig.ms(100)  # M66 sees it open
        assert cnc.answers == ["ok"]
        cnc.close("part")
        yield from cnc.wait_for_answers(2)
        yield from cnc.send("M66 P1")  # L0, the default, does not wait
        yield from cnc.send("M66 P1 L3 Q0.5")  # it stays open for longer than Q

    cnc.run(script())
    assert cnc.answers == ["ok"] * 4
    assert cnc.messages == ["M66 P0: 1", "M66 P0: 1", "M66 P1: 0", "M66 P1: nothing for 0.5 s"]


def test_analog_input_is_reported(shop: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    """M66 E1 reads an ADC, a fake here, at a quarter of its range of 65536."""
    cnc = shop("digital_io", **_NUMBERED)
    read: list[object] = []  # pins of the ADCs used

    class Adc:
        def __init__(self, pin: object) -> None:
            read.append(pin)

        def read_u16(self) -> int:
            return 0x4000

    monkeypatch.setattr("machine.ADC", Adc)
    assert cnc.say("M66 E1 L0") == ["ok"]
    assert cnc.messages == ["M66 E1: 0.250"] and len(read) == 1
    assert cnc.say("M66 E2", "M66 E0 P0", "M66 E0 L3 Q1", "M66") == ["error:3"] * 4
    assert cnc.messages[1:] == ["P and E go from 0 to 1", *["M66: P, or E with L0"] * 3]


def test_pulse_widths_are_set_and_unknown_numbers_refused(shop: Make) -> None:
    """M68 E2 Q0.25 sets output 2 to a duty of 0.25: 16384 of 65536, at 1000 Hz."""
    cnc = shop("digital_io", **_NUMBERED)
    assert cnc.say("M68 E2 Q0.25") == ["ok"]
    assert cnc.rig.port.own_pulses == {2: (1000, 16384)}
    assert cnc.say("M64 P3", "M66 P0 L3", "M66 P2", "M64 P0.5") == ["error:3"] * 4
    assert cnc.messages[0] == "P and E go from 0 to 2"


# A tool table


def test_tool_lengths_are_entered_used_and_stored(shop: Make) -> None:
    """G10 L1 enters -12.5 mm and -1 inch. They are valid after power-off; G43 H applies them."""
    cnc = shop("tool_table")
    assert cnc.say("G10 L1 P2 Z-12.5", "G20", "G10 L1 P3 Z-1", "G21", "G4 P0.1") == ["ok"] * 5
    cnc.power_up(cnc.rig.store)
    assert cnc.say("G43 H3", "G0 Z0") == ["ok"] * 2 and cnc.position_mm()[2] == -25.4
    cnc.power_up(cnc.rig.store)
    assert cnc.say("G43 H2 Z-5") == ["ok"] and cnc.position_mm()[2] == -17.5
    refused = ("G43 H4", "G43", "G10 L1 P0 Z1", "G10 L1 P2", "G10 L3 P1 Z0")
    assert cnc.say("G49", *refused, "G10 L20 P1 Z0") == (
        ["ok"] + ["error:3"] * 3 + ["error:28", "error:20", "ok"]
    )
    assert cnc.messages[0] == "tool 4 has no length: G10 L1 P4 Z and the length"


def test_tool_is_changed_once_and_its_length_is_used(shop: Make) -> None:
    """T2 M6 twice asks once. T3 has no length: its change is refused, and tool 2 stays."""
    cnc = shop("tool_table")
    offsets: "list[str]" = []  # replies to $#

    def script() -> "Iterator[Any]":
        """Change to tool 2, again to it, and to tool 3, which has no length."""
        yield from cnc.send("G10 L1 P2 Z-12.5")
        yield from cnc.send("M3 S100")
        yield from cnc.start("T2 M6")
        # It holds at the place of the change, with the spindle off.
        assert cnc.position_mm() == (3, 3, -1) and cnc.rig.port.spindle_pwm == 0
        yield from cnc.send("~", "ms 100")
        yield from cnc.send("T2 M6")  # it is in the spindle already
        yield from cnc.send("G53 G0 Z-3")
        yield from cnc.send("T3 M6")
        offsets.extend((yield from cnc.send("$#")))

    cnc.run(script())
    # Answers to both T2 M6, G53, T3 M6 and $#.
    assert cnc.answers[-5:] == ["ok"] * 3 + ["error:3", "ok"] and cnc.position_mm()[2] == -3
    assert cnc.messages == [
        "put in tool 2",
        "tool 3 has no length: G10 L1 P3 Z and the length",
    ]
    assert "[TLO:-12.500]" in offsets


# A height map


def wavy(x: float, y: float) -> float:
    """Return the height of the work: a tilted and twisted plane, which a grid fits exactly."""
    return -6 + 0.02 * x - 0.03 * y + 0.001 * x * y


def test_cut_follows_the_map_even_after_power_off(shop: Make) -> None:
    """M118 probes 40 by 20 mm every 10 mm, in inches here. G102 then cuts 0.1 mm into the work."""
    cnc = shop("height_map")
    cnc.rig.engine.switches.append(Solid(cnc, lambda x, y, z: z <= wavy(x, y)))
    assert cnc.say("G20", "M118 X1.5748 Y0.7874 Q0.3937") == ["ok", "ok"], cnc.messages
    assert offset(cnc, "G54")[2] == pytest.approx(-6, abs=0.03)
    cnc.power_up(cnc.rig.store)
    places: "list[tuple[float, ...]]" = []  # at the end of each segment
    cnc.rig.engine.trace = lambda start, row: places.append(cnc.position_mm())
    assert cnc.say("G102 Z-0.1 F300", "G102 X40 Y20 F3000", "G102 X0 F3000") == ["ok"] * 3
    # All places from where X has left 0 on.
    cutting = places[next(i for i, place in enumerate(places) if place[0] > 0.1) :]
    assert len(cutting) > 50 and cnc.position_mm()[:2] == (0, 20)
    for x, y, z in cutting:
        assert z == pytest.approx(wavy(x, y) - 0.1, abs=0.06)


def test_impossible_map_is_refused_with_the_reason(shop: Make) -> None:
    cnc = shop("height_map")
    lines = ("M118 X10 Y10 Q0", "M118 X10 Y10 Q20", "M118 X90 Y90 Q1", "G102 X5 F100")
    assert cnc.say(*lines, "M3 S100", "M118 X10 Y10 Q5") == ["error:3"] * 4 + ["ok", "error:3"]
    assert cnc.position_mm() == (0, 0, 0) and len(cnc.messages) == 5
