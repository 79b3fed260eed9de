"""Every setting by its effect: as shipped, after $n=, reset, power-up, $RST=$ and $RST=*.

A row of _EFFECTS gives the observation on the simulated machine, the result for the default, and
the result for another value. A row of the settings table without one is a failure.

An observation is a generator that sends lines as a sender and returns what it has measured; it
leaves the machine where it was. `yield from bench.say(text, wait)` sends, waits ("ok", "banner",
"ms 20"; by default until motion ends), and returns the lines received; bench.move(*lines) sends
lines and waits for the end of motion; bench.place() are the motors' steps. bench.rows: segments as
(start tick, row); ROW_TICKS, ROW_AXES: indices in a row, see motion/layout.py.
"""

import math
import re
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import accumulate
from types import SimpleNamespace
from typing import Any

import pytest
from base.settings import _TABLE, AXIS
from extras.dialects.dialect_09 import _SETTINGS as settings_09
from extras.tools.laser import _SETTINGS as laser_settings
from extras.tools.punch import _SETTINGS as punch_settings
from motion.layout import ROW_AXES, ROW_DIRS, ROW_STRIDE, ROW_TICKS
from ugrbl.boardfile.files import load_board
from ugrbl.sim.engine import Switch
from ugrbl.sim.rig import MemoryStore, Rig
from ugrbl.sim.sender import Sender

pytestmark = pytest.mark.usefixtures("each_ms")

_AXES = "XYZ"
_PER_MM = 250  # steps
_TICKS_PER_MS = 13_107.2  # of the simulated engine
_ENDS_STEPS = 500  # limit switches, from the position at power-up
# The board's defaults: Grbl's, except for shorter waits.
_BRISK = {120: 500, 121: 500, 122: 500, 130: 10, 131: 10, 132: 10}
_HOMED = {22: 1}

Look = Callable[["Bench"], Iterator[Any]]
Row = tuple[int, float, dict[int, float], Look, object, object]


class Bench:
    """A simulated machine with its own defaults, and a sender."""

    def __init__(
        self,
        defaults: "dict[int, float]",
        board: str = "sim",
        store: "MemoryStore | None" = None,
    ) -> None:
        """Make the machine. defaults: settings that differ from _BRISK, the board's defaults."""
        module = {**vars(load_board(board)), "DEFAULTS": {**_BRISK, **defaults}}
        self.rig = Rig(SimpleNamespace(**module), store)
        self.port: Any = self.rig.port
        self.sender = Sender(self.rig)
        self.sender.allow(3_600_000)  # ms
        self.handed: tuple[int, ...] = ()  # arguments of the engine's configure()
        self.rows: list[tuple[int, array[int]]] = []  # segments executed
        self.levels: tuple[int, ...] = ()  # of a punch's outputs
        self._drive = self.port.drive
        self.port.drive = self._note_levels
        self._configure = self.rig.engine.configure
        self.rig.engine.configure = self._hand  # type: ignore[method-assign]
        self.rig.engine.trace = lambda start, row: self.rows.append((start, row[:]))
        for axis, letter in enumerate("xyz"):  # a limit switch at each end of each axis
            for above in (True, False):
                place = _ENDS_STEPS if above else -_ENDS_STEPS
                self.rig.engine.switches.append(Switch(f"limit_{letter}", axis, above, place))

    def _hand(self, *masks: int) -> None:
        self.handed = masks
        self._configure(*masks)

    def _note_levels(self, levels: int) -> None:
        self.levels = (levels & 1, levels >> 1)
        self._drive(levels)

    def run(self, script: "Iterator[Any]") -> None:
        """Run the script; raise its exception here."""
        failed: list[BaseException] = []

        def guarded() -> Iterator[Any]:
            """Keep an exception until the machine has stopped: it must not end the rig's loop."""
            try:
                yield from self.say("", "banner")
                yield from script
            except Exception as error:
                failed.append(error)

        self.rig.run(guarded())
        if failed:
            raise failed[0]

    def say(self, text: str, how: str = "idle") -> "Iterator[Any]":
        """Send, wait, return what came back."""
        yield from self.sender.wait(how, text)
        return self.sender.take()

    def change(self, what: str) -> "Iterator[Any]":
        """Do what may change settings: send a line or "\\x18", or switch off and on ("power")."""
        if what == "power":
            self.handed = self.levels = ()
            self.rig.cycle_power()
            yield from self.say("", "banner")
        elif what.startswith("$RST") or what == "\x18":
            # Both reset the machine; a real-time byte has no line end.
            yield from self.say(what.rstrip() + "\n" * (what != "\x18"), "banner")
        else:
            assert (yield from self.say(what + "\n")) == ["ok"]

    def unlock(self) -> "Iterator[Any]":
        """Make the machine accept G-code."""
        assert (yield from self.say("$X\n"))[-1] == "ok"

    def recover(self) -> "Iterator[Any]":
        """Reset and unlock after an alarm."""
        yield self.rig.ms(600)  # an alarm ignores input for 500
        yield from self.say("\x18", "banner")
        yield from self.unlock()

    def report(self) -> "Iterator[Any]":
        """Return the fields of a status report, by name."""
        fields = (yield from self.say("?", "report"))[-1][1:-1].split("|")[1:]
        return dict(field.split(":") for field in fields)

    def place(self) -> "list[int]":
        """Return the motors' position, in steps."""
        self.rig.engine.physical(self.rig.scratch)
        return list(self.rig.scratch)

    def move(self, *lines: str) -> "Iterator[Any]":
        """Execute these lines, wait for the end of motion, and return the last line's answer.

        self.rows then has the segments.
        """
        self.rows.clear()
        for line in lines[:-1]:
            assert (yield from self.say(line + "\n", "ok")) == ["ok"]
        return (yield from self.say(lines[-1] + "\n"))

    def speed_mm_min(self, rows: "Sequence[tuple[int, array[int]]]", axis: int) -> int:
        """Return the speed that an axis has for most of the time, to 5 mm/min.

        It is the median of the segments' speeds, weighted with their durations.
        """
        base = ROW_AXES + ROW_STRIDE * axis
        rates = sorted(
            (row[base] / row[ROW_TICKS], row[ROW_TICKS]) for _, row in rows if row[ROW_TICKS]
        )
        half_ticks = sum(ticks for _, ticks in rates) / 2
        passed = accumulate(ticks for _, ticks in rates)
        per_tick = next(
            rate for (rate, _), ticks in zip(rates, passed, strict=True) if ticks >= half_ticks
        )
        return 5 * round(per_tick * _TICKS_PER_MS * 60_000 / _PER_MM / 5)

    def legs(self) -> "list[list[tuple[int, array[int]]]]":
        """Return the segments, split into lists where the machine stood still."""
        legs: list[list[tuple[int, array[int]]]] = []
        end_tick = -1
        for start, row in self.rows:
            if start != end_tick:
                legs.append([])
            legs[-1].append((start, row))
            end_tick = start + row[ROW_TICKS]
        return legs


# Observations of settings


def _configured(which: int) -> Look:
    """Return an observation: an argument of the engine's configure(), by its index.

    The effect at the pins is shown by the engine's own tests.
    """

    def observe(bench: Bench) -> Iterator[Any]:
        yield bench.rig.now
        return bench.handed[which]

    return observe


def _moved_steps(bench: Bench) -> Iterator[Any]:
    """Return the steps of a move of +0.1 mm in all axes: 25, or -25 where inverted."""
    before = bench.place()
    yield from bench.move("G91G0X0.1Y0.1Z0.1")
    moved = [now - then for now, then in zip(bench.place(), before, strict=True)]
    yield from bench.move("G91G0X-0.1Y-0.1Z-0.1")
    return moved


def _released_ms(bench: Bench) -> Iterator[Any]:
    """Return how long motors stay enabled after a motion, to 5 ms."""
    yield from bench.say("G91G0Z0.1\n", "ok")
    yield bench.rig.moving  # wait until this is true
    yield lambda: not bench.rig.moving()
    stopped = bench.rig.now
    yield lambda: bench.port.enable_pin == 1  # until they are disabled
    released = bench.rig.now
    yield from bench.say("G91G0Z-0.1\n")
    return 5 * round((released - stopped) / _TICKS_PER_MS / 5)


def _level_in_motion(bench: Bench) -> Iterator[Any]:
    """Return the level of the enable pin while the motors move."""
    yield from bench.say("G91G0Z0.1\n", "ok")
    yield bench.rig.moving
    level = bench.port.enable_pin
    yield from bench.say("G91G0Z-0.1\n")
    return level


def _pins(bench: Bench) -> Iterator[Any]:
    return (yield from bench.report()).get("Pn", "")


def _probing(bench: Bench) -> Iterator[Any]:
    """Probe 0.2 mm without contact; return (alarm or "", steps made).

    An input inverted by $6 counts as closed, and probing ends at once with an alarm.
    """
    before = bench.place()[2]
    lines = yield from bench.say("G91G38.3Z0.2F300\n")
    alarm = lines[0] if lines[0].startswith("ALARM") else ""
    moved = bench.place()[2] - before
    yield from bench.recover()
    if moved:
        yield from bench.say("G91G0Z-0.2\n")
    return alarm, moved


def _fields(bench: Bench) -> Iterator[Any]:
    """Return the fields of a status report, without occasional ones."""
    report = yield from bench.report()
    return " ".join(name for name in report if name not in ("WCO", "Ov"))


def _fields_09(bench: Bench) -> Iterator[Any]:
    report = (yield from bench.say("?", "report"))[-1]
    return " ".join(re.findall(r"(\w+):", report))


def _decimals(bench: Bench) -> Iterator[Any]:
    report = yield from bench.report()
    return len(report["MPos"].split(",")[0].split(".")[1])


def _corners_ms(bench: Bench) -> Iterator[Any]:
    """Return the duration of twelve moves with right angles in between, to 100 ms: see $11."""
    corners = ["G91G1X0.2F500", "Y0.2", "X-0.2", "Y-0.2"] * 3
    yield from bench.move(*corners)
    (start, _), (last, row) = bench.rows[0], bench.rows[-1]
    return 100 * round((last + row[ROW_TICKS] - start) / _TICKS_PER_MS / 100)


def _roundness_mm(bench: Bench) -> Iterator[Any]:
    """Return how near its centre, in mm, the chords of a circle of 1 mm radius come: see $12."""
    yield from bench.move("G91G2X0Y0I1F500")
    x = y = 0.0
    nearest = 1.0
    for _, row in bench.rows:
        x += _signed_steps(row, 0) / _PER_MM
        y += _signed_steps(row, 1) / _PER_MM
        nearest = min(nearest, math.hypot(x - 1, y))
    return round(nearest, 1)


def _signed_steps(row: "array[int]", axis: int) -> int:
    steps = row[ROW_AXES + ROW_STRIDE * axis]
    return -steps if row[ROW_DIRS] >> axis & 1 else steps


def _soft_limit(bench: Bench) -> Iterator[Any]:
    """Return the answer to a move-only line that leaves the machine's travel, X0.5.

    Other move-only lines, within it, go before: those of the last observation, and those here.
    """
    lines = yield from bench.say("X0.5\n", "ms 300")
    if lines[0].startswith("ALARM"):
        yield from bench.recover()
    yield from bench.move("G90G1X-0.1F500", "X-0.2", "X0")
    return lines[0]


def _hard_limit(bench: Bench) -> Iterator[Any]:
    """Return the alarm when a limit switch closes while idle; "" if there is none."""
    bench.port.push({"limit_x": True})
    lines = yield from bench.say("", "ms 20")
    bench.port.push({"limit_x": False})
    if lines:
        yield from bench.recover()
    return "".join(lines[:1])


def _homes(bench: Bench) -> Iterator[Any]:
    return (yield from bench.say("$H\n"))[-1]


def _homed_at(bench: Bench) -> Iterator[Any]:
    yield from bench.say("$H\n")
    return [float(x) for x in (yield from bench.report())["MPos"].split(",")]


def _homing_speed(leg: int) -> Look:
    """Return an observation: the speed of a leg of homing, in mm/min.

    leg: counted from the last one, 1: off the switch, 2: to it, 3: off, 4: to it …
    """

    def observe(bench: Bench) -> Iterator[Any]:
        yield from bench.move("$H")
        return bench.speed_mm_min(bench.legs()[-leg], 0)

    return observe


def _homing_rest_ms(bench: Bench) -> Iterator[Any]:
    """Return the pause between the last two legs of homing, to 10 ms."""
    yield from bench.move("$H")
    before, last = bench.legs()[-2:]
    start, row = before[-1]
    return 10 * round((last[0][0] - start - row[ROW_TICKS]) / _TICKS_PER_MS / 10)


def _power_of(line: str) -> Look:
    """Return an observation: the spindle's power (0 to 255) at rest after a line."""

    def observe(bench: Bench) -> Iterator[Any]:
        yield from bench.say(line + "\n")
        power = bench.port.spindle_pwm
        yield from bench.say("M5\n")
        return power

    return observe


def _steps_per_mm(axis: int) -> Look:
    """Return an observation: the steps that an axis makes for 1 mm."""

    def observe(bench: Bench) -> Iterator[Any]:
        before = bench.place()[axis]
        yield from bench.move(f"G91G0{_AXES[axis]}1")
        moved = bench.place()[axis] - before
        yield from bench.move(f"G91G0{_AXES[axis]}-1")
        return moved

    return observe


def _rapid_mm_min(axis: int) -> Look:
    """Return an observation: the speed of a rapid of 1 mm."""

    def observe(bench: Bench) -> Iterator[Any]:
        yield from bench.move(f"G91G0{_AXES[axis]}1")
        speed = bench.speed_mm_min(bench.rows, axis)
        yield from bench.move(f"G91G0{_AXES[axis]}-1")
        return speed

    return observe


def _rapid_ms(axis: int) -> Look:
    """Return an observation: the duration of a rapid of 0.5 mm, to 10 ms."""

    def observe(bench: Bench) -> Iterator[Any]:
        yield from bench.move(f"G91G0{_AXES[axis]}0.5")
        (start, _), (last, row) = bench.rows[0], bench.rows[-1]
        yield from bench.move(f"G91G0{_AXES[axis]}-0.5")
        return 10 * round((last + row[ROW_TICKS] - start) / _TICKS_PER_MS / 10)

    return observe


def _answer_beyond_travel(axis: int) -> Look:
    """Return an observation: the answer to a jog of 1.5 mm away from the axis' end."""

    def observe(bench: Bench) -> Iterator[Any]:
        """Jog away from the end, and back if that was accepted."""
        (answer,) = yield from bench.say(f"$J=G91{_AXES[axis]}-1.5F500\n")
        if answer == "ok":
            yield from bench.say(f"$J=G91{_AXES[axis]}1.5F500\n")
        return answer

    return observe


def _punch(bench: Bench) -> Iterator[Any]:
    yield bench.rig.ms(50)
    controller: Any = bench.rig.controller
    return (*bench.levels, controller.spindle.is_up())


def _pwm_hz(bench: Bench) -> Iterator[Any]:
    """Return the port's frequency: its own tests show the effect at the pin."""
    yield bench.rig.now
    return bench.port.pwm.freq()


_EFFECTS: "list[Row]" = [
    # number, other value, changed defaults, observation, result for the default, for the other
    # value
    (0, 7, {}, _configured(0), 10, 7),
    (1, 100, {}, _released_ms, 25, 100),
    (2, 3, {}, _configured(1), 0, 3),
    (3, 5, {}, _moved_steps, [25, 25, 25], [-25, 25, -25]),
    (4, 1, {}, _level_in_motion, 0, 1),
    (5, 1, {}, _pins, "", "XYZ"),
    (6, 1, {}, _probing, ("", 50), ("ALARM:4", 0)),
    (10, 2, {}, _fields, "MPos FS", "WPos Bf FS"),
    (11, 0.5, {120: 50, 121: 50}, _corners_ms, 1100, 500),
    (12, 0.2, {}, _roundness_mm, 1.0, 0.8),
    (13, 1, {}, _decimals, 3, 4),
    (20, 1, _HOMED, _soft_limit, "ok", "ALARM:2"),
    (21, 1, {}, _hard_limit, "", "ALARM:1"),
    (22, 1, {}, _homes, "error:5", "ok"),
    (23, 1, _HOMED, _homed_at, [-1, -1, -1], [-9, -1, -1]),
    (24, 60, _HOMED, _homing_speed(2), 25, 60),
    (25, 300, _HOMED, _homing_speed(1), 500, 300),
    (26, 100, _HOMED, _homing_rest_ms, 250, 100),
    (27, 2, _HOMED, _homed_at, [-1, -1, -1], [-2, -2, -2]),
    (30, 500, {}, _power_of("M3S250"), 64, 128),
    (31, 500, {}, _power_of("M3S100"), 26, 1),
    (32, 1, {}, _power_of("M4S500"), 128, 0),
]
for _axis in range(3):
    _EFFECTS += [
        (100 + _axis, 125, {}, _steps_per_mm(_axis), 250, 125),
        (110 + _axis, 300, {}, _rapid_mm_min(_axis), 500, 300),
        (120 + _axis, 20, {}, _rapid_ms(_axis), 80, 320),
        (
            130 + _axis,
            3,
            {**_HOMED, 20: 1, 130 + _axis: 1},
            _answer_beyond_travel(_axis),
            "error:15",
            "ok",
        ),
    ]


# A machine with a punch: levels of the actuators' pins at rest, and whether it is sensed up.
_PUNCH_EFFECTS: "list[Row]" = [
    (30, 1, {}, _punch, (0, 1, True), (1, 1, True)),
    (31, 1, {}, _punch, (0, 1, True), (0, 0, True)),
    (32, 1, {}, _punch, (0, 1, True), (0, 1, False)),
    (33, 1, {}, _punch, (0, 1, True), (0, 1, False)),
]

# A laser.
_LASER_EFFECTS: "list[Row]" = [(33, 20000, {}, _pwm_hz, 5000, 20000)]


def test_every_setting_has_an_observation() -> None:
    """Rows of the firmware's tables: (number, default, kind, …). AXIS is a setting of each
    axis."""
    table = [
        number + axis
        for number, _, kind, *_ in _TABLE
        for axis in range(len(_AXES) if kind == AXIS else 1)
    ]
    assert sorted(number for number, *_ in _EFFECTS) == table
    punch = [number for number, *_ in punch_settings]
    assert [number for number, *_ in _PUNCH_EFFECTS] == punch
    assert [row[0] for row in _LASER_EFFECTS] == [row[0] for row in laser_settings]


def _check_effect(bench: Bench, row: "Row") -> None:
    """Check a setting's effect after each kind of change.

    row: number, other value, changed defaults, observation, its result for the default, and for
    the other value.
    """
    number, value, _, observe, by_default, by_value = row
    change = f"${number}={value}"
    changes = [
        ("power", by_default),
        (change, by_value),
        ("\x18", by_value),  # a reset
        ("power", by_value),
        ("$RST=$", by_default),
        ("power", by_default),
        (change, by_value),
        ("$RST=*", by_default),
        ("\x18", by_default),
    ]

    def script() -> Iterator[Any]:
        for action, expected in changes:
            yield from bench.change(action)
            yield from bench.unlock()
            assert (yield from observe(bench)) == expected, f"after {action!r}"

    bench.run(script())


@pytest.mark.sampled(5)
@pytest.mark.parametrize("row", _EFFECTS, ids=[f"${row[0]}" for row in _EFFECTS])
def test_a_setting_has_its_effect_after_any_kind_of_change(row: "Row") -> None:
    _check_effect(Bench(row[2]), row)


@pytest.mark.parametrize("row", _PUNCH_EFFECTS, ids=[f"${row[0]}" for row in _PUNCH_EFFECTS])
def test_a_setting_of_a_punch_has_its_effect(row: "Row") -> None:
    _check_effect(Bench({}, "sim_punch"), row)


@pytest.mark.parametrize("row", _LASER_EFFECTS, ids=[f"${row[0]}" for row in _LASER_EFFECTS])
def test_a_setting_of_a_laser_has_its_effect(row: "Row") -> None:
    _check_effect(Bench({}, "sim_laser"), row)


def test_the_report_setting_of_grbl_09_has_its_effect() -> None:
    ((number, *_),) = settings_09
    _check_effect(Bench({}, "sim_09j"), (number, 6, {}, _fields_09, "MPos WPos", "WPos Buf"))


# Effects outside the table


class FullStore(MemoryStore):
    """A store that refuses to save when it is full."""

    full = False

    def save(self, name: str, lines: "Iterable[str]") -> None:
        if self.full:
            raise OSError(28)
        super().save(name, lines)


def test_an_unsaved_setting_has_its_effect_until_power_off() -> None:
    """The flash is full: $100 (steps/mm, 250) changes with an error, until the power is off."""
    store = FullStore()
    bench = Bench({}, store=store)
    steps_per_mm = _steps_per_mm(0)

    def script() -> Iterator[Any]:
        """Change $100 and restore it while flash is full; its effect follows, and ends with the
        power."""
        store.full = True  # writing to flash fails from now on
        not_saved = ["[MSG:Flash is full or worn: not saved]", "error:7"]
        assert (yield from bench.say("$100=125\n")) == not_saved
        assert (yield from steps_per_mm(bench)) == 125
        lines = yield from bench.say("$RST=$\n", "banner")
        assert lines[:3] == ["[MSG:Restoring defaults]", *not_saved]
        assert (yield from steps_per_mm(bench)) == 250
        yield from bench.say("$100=125\n")
        yield from bench.change("power")
        assert (yield from steps_per_mm(bench)) == 250

    bench.run(script())


@pytest.mark.parametrize("change", ["$100=80", "$110=100", "$110=50000", "$120=20", "$11=1"])
def test_planned_motion_is_not_changed_by_settings(change: str) -> None:
    """A setting sent right after two moves leaves the segments of these as they were planned."""

    def segments(text: str) -> "list[array[int]]":
        """Return the segments of these lines, from X0 Y0 to X3 Y1 (750 and 250 steps)."""
        bench = Bench({})

        def script() -> Iterator[Any]:
            yield from bench.say(text)

        bench.run(script())
        assert bench.place() == [750, 250, 0]
        return [row for _, row in bench.rows]

    moves = "G91G1X2Y1F300\nX1\n"
    assert segments(f"{moves}{change}\n") == segments(moves)


@pytest.mark.parametrize("change", ["$30=1000", "$31=0"])
def test_a_new_speed_range_stops_the_spindle(change: str) -> None:
    """$30 and $31 are the highest and lowest speed."""
    bench = Bench({})

    def script() -> Iterator[Any]:
        yield from bench.say("M3S500\n")
        assert bench.port.spindle_on
        yield from bench.change(change)
        assert not bench.port.spindle_on

    bench.run(script())


@pytest.mark.parametrize(("change", "is_reported"), [("$13=1", True), ("$10=3", False)])
def test_only_inches_cause_a_report_of_the_work_offset(change: str, is_reported: bool) -> None:
    """WCO is in the first report; later, $13 (inches) brings it at once, and $10 does not."""
    bench = Bench({})

    def script() -> Iterator[Any]:
        """Ask for reports until WCO is not due, change the setting, and look for WCO again."""
        for _ in range(2):  # with WCO and Ov
            yield from bench.report()
        assert "WCO" not in (yield from bench.report())
        yield from bench.change(change)
        assert ("WCO" in (yield from bench.report())) == is_reported

    bench.run(script())


def test_move_only_lines_do_nothing_in_check_mode() -> None:
    """After three moves of 0.1 mm (75 steps), $C switches check mode on."""
    bench = Bench({})

    def script() -> Iterator[Any]:
        """Move three times, and twice in check mode; compare the motor's steps."""
        yield from bench.move("G91G1X0.1F500", "X0.1", "X0.1")
        assert bench.place()[0] == 75
        yield from bench.say("$C\n")
        yield from bench.move("X0.1", "X0.1")
        assert bench.place()[0] == 75

    bench.run(script())


def test_permanently_enabled_motors_are_enabled_after_reset_and_power_up() -> None:
    """$1=255: motors are enabled from the next reset on. enable_pin is 0 while they are."""
    bench = Bench({})

    def script() -> Iterator[Any]:
        """Set $1=255, reset, switch off and on; read the enable pin (0: enabled)."""
        yield bench.rig.ms(100)
        yield from bench.change("$1=255")
        assert bench.port.enable_pin == 1  # still disabled; 0 is enabled
        yield from bench.change("\x18")
        assert bench.port.enable_pin == 0
        yield from bench.change("power")
        yield bench.rig.ms(500)
        assert bench.port.enable_pin == 0

    bench.run(script())
