"""Every setting by its effect: as shipped, after $n=, reset, power-up, $RST=$ and $RST=*.

A row of _EFFECTS gives the observation on the simulated machine, the result for the default, and
the result for another value. A row of the settings table without one is a failure.
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
_PER_MM = 250
_TICKS_PER_MS = 13_107.2
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
        module = {**vars(load_board(board)), "DEFAULTS": {**_BRISK, **defaults}}
        self.rig = Rig(SimpleNamespace(**module), store)
        self.port: Any = self.rig.port
        self.sender = Sender(self.rig)
        self.sender.allow(3_600_000)
        self.handed: tuple[int, ...] = ()
        self.rows: list[tuple[int, array[int]]] = []
        self.levels: tuple[int, ...] = ()
        self._drive = self.port.drive
        self.port.drive = self._note_levels
        self._configure = self.rig.engine.configure
        self.rig.engine.configure = self._hand  # type: ignore[method-assign]
        self.rig.engine.trace = lambda start, row: self.rows.append((start, row[:]))
        for axis, letter in enumerate("xyz"):
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
        """Do what may change settings: a line, "\\x18", or "power"."""
        if what == "power":
            self.handed = self.levels = ()
            self.rig.cycle_power()
            yield from self.say("", "banner")
        elif what.startswith("$RST") or what == "\x18":
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
        """Make these moves and come to rest; self.rows then has their segments."""
        self.rows.clear()
        for line in lines[:-1]:
            assert (yield from self.say(line + "\n", "ok")) == ["ok"]
        return (yield from self.say(lines[-1] + "\n"))

    def speed_mm_min(self, rows: "Sequence[tuple[int, array[int]]]", axis: int) -> int:
        """Return the speed that an axis has for most of the time, to 5 mm/min."""
        base = ROW_AXES + ROW_STRIDE * axis
        rates = sorted(
            (row[base] / row[ROW_TICKS], row[ROW_TICKS]) for _, row in rows if row[ROW_TICKS]
        )
        half = sum(ticks for _, ticks in rates) / 2
        passed = accumulate(ticks for _, ticks in rates)
        per_tick = next(
            rate for (rate, _), ticks in zip(rates, passed, strict=True) if ticks >= half
        )
        return 5 * round(per_tick * _TICKS_PER_MS * 60_000 / _PER_MM / 5)

    def legs(self) -> "list[list[tuple[int, array[int]]]]":
        """Return the segments, split where the machine stood still."""
        legs: list[list[tuple[int, array[int]]]] = []
        end = -1
        for start, row in self.rows:
            if start != end:
                legs.append([])
            legs[-1].append((start, row))
            end = start + row[ROW_TICKS]
        return legs


# Observations of settings


def _handed(which: int) -> Look:
    """Return a value given to the engine: its own tests show the effect at the pins."""

    def look(bench: Bench) -> Iterator[Any]:
        yield bench.rig.now
        return bench.handed[which]

    return look


def _ways(bench: Bench) -> Iterator[Any]:
    """Return the motors' directions."""
    before = bench.place()
    yield from bench.move("G91G0X0.1Y0.1Z0.1")
    moved = [now - then for now, then in zip(bench.place(), before, strict=True)]
    yield from bench.move("G91G0X-0.1Y-0.1Z-0.1")
    return moved


def _released_ms(bench: Bench) -> Iterator[Any]:
    """Return how long motors stay enabled after a motion, to 5 ms."""
    yield from bench.say("G91G0Z0.1\n", "ok")
    yield bench.rig.moving
    yield lambda: not bench.rig.moving()
    since = bench.rig.now
    yield lambda: bench.port.enable_pin == 1
    released = bench.rig.now
    yield from bench.say("G91G0Z-0.1\n")
    return 5 * round((released - since) / _TICKS_PER_MS / 5)


def _level_in_motion(bench: Bench) -> Iterator[Any]:
    yield from bench.say("G91G0Z0.1\n", "ok")
    yield bench.rig.moving
    level = bench.port.enable_pin
    yield from bench.say("G91G0Z-0.1\n")
    return level


def _pins(bench: Bench) -> Iterator[Any]:
    return (yield from bench.report()).get("Pn", "")


def _probing(bench: Bench) -> Iterator[Any]:
    """Probe without contact; return the alarm and the steps made."""
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
    """Return the duration of a staircase, to 100 ms."""
    stairs = ["G91G1X0.2F500", "Y0.2", "X-0.2", "Y-0.2"] * 3
    yield from bench.move(*stairs)
    (start, _), (last, row) = bench.rows[0], bench.rows[-1]
    return 100 * round((last + row[ROW_TICKS] - start) / _TICKS_PER_MS / 100)


def _roundness_mm(bench: Bench) -> Iterator[Any]:
    """Return how near to its centre a circle of 1 mm comes."""
    yield from bench.move("G91G2X0Y0I1F500")
    x = y = 0.0
    nearest = 1.0
    for _, row in bench.rows:
        x += _made(row, 0) / _PER_MM
        y += _made(row, 1) / _PER_MM
        nearest = min(nearest, math.hypot(x - 1, y))
    return round(nearest, 1)


def _made(row: "array[int]", axis: int) -> int:
    steps = row[ROW_AXES + ROW_STRIDE * axis]
    return -steps if row[ROW_DIRS] >> axis & 1 else steps


def _soft_limit(bench: Bench) -> Iterator[Any]:
    """Return the answer to a short line out of the machine's travel, after others of its kind."""
    lines = yield from bench.say("X0.5\n", "ms 300")
    if lines[0].startswith("ALARM"):
        yield from bench.recover()
    yield from bench.move("G90G1X-0.1F500", "X-0.2", "X0")
    return lines[0]


def _hard_limit(bench: Bench) -> Iterator[Any]:
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


def _homing(leg: int) -> Look:
    """Return a homing leg's speed. leg: counted from the last one: off, to, off, to …"""

    def look(bench: Bench) -> Iterator[Any]:
        yield from bench.move("$H")
        return bench.speed_mm_min(bench.legs()[-leg], 0)

    return look


def _homing_rest_ms(bench: Bench) -> Iterator[Any]:
    """Return the pause between the last two legs of homing, to 10 ms."""
    yield from bench.move("$H")
    before, last = bench.legs()[-2:]
    start, row = before[-1]
    return 10 * round((last[0][0] - start - row[ROW_TICKS]) / _TICKS_PER_MS / 10)


def _power_of(line: str) -> Look:
    """Return the spindle's power at rest after a line."""

    def look(bench: Bench) -> Iterator[Any]:
        yield from bench.say(line + "\n")
        power = bench.port.spindle_pwm
        yield from bench.say("M5\n")
        return power

    return look


def _steps_per_mm(axis: int) -> Look:
    def look(bench: Bench) -> Iterator[Any]:
        before = bench.place()[axis]
        yield from bench.move(f"G91G0{_AXES[axis]}1")
        moved = bench.place()[axis] - before
        yield from bench.move(f"G91G0{_AXES[axis]}-1")
        return moved

    return look


def _rapid_mm_min(axis: int) -> Look:
    def look(bench: Bench) -> Iterator[Any]:
        yield from bench.move(f"G91G0{_AXES[axis]}1")
        speed = bench.speed_mm_min(bench.rows, axis)
        yield from bench.move(f"G91G0{_AXES[axis]}-1")
        return speed

    return look


def _rapid_ms(axis: int) -> Look:
    """Return the duration of a short move, to 10 ms."""

    def look(bench: Bench) -> Iterator[Any]:
        yield from bench.move(f"G91G0{_AXES[axis]}0.5")
        (start, _), (last, row) = bench.rows[0], bench.rows[-1]
        yield from bench.move(f"G91G0{_AXES[axis]}-0.5")
        return 10 * round((last + row[ROW_TICKS] - start) / _TICKS_PER_MS / 10)

    return look


def _reaches(axis: int) -> Look:
    """Return the answer to a jog of 1.5 mm into the travel."""

    def look(bench: Bench) -> Iterator[Any]:
        (answer,) = yield from bench.say(f"$J=G91{_AXES[axis]}-1.5F500\n")
        if answer == "ok":
            yield from bench.say(f"$J=G91{_AXES[axis]}1.5F500\n")
        return answer

    return look


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
    (0, 7, {}, _handed(0), 10, 7),
    (1, 100, {}, _released_ms, 25, 100),
    (2, 3, {}, _handed(1), 0, 3),
    (3, 5, {}, _ways, [25, 25, 25], [-25, 25, -25]),
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
    (24, 60, _HOMED, _homing(2), 25, 60),
    (25, 300, _HOMED, _homing(1), 500, 300),
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
        (130 + _axis, 3, {**_HOMED, 20: 1, 130 + _axis: 1}, _reaches(_axis), "error:15", "ok"),
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
    table = [
        number + axis
        for number, _, kind, *_ in _TABLE
        for axis in range(len(_AXES) if kind == AXIS else 1)
    ]
    assert sorted(number for number, *_ in _EFFECTS) == table
    punch = [number for number, *_ in punch_settings]
    assert [number for number, *_ in _PUNCH_EFFECTS] == punch
    assert [row[0] for row in _LASER_EFFECTS] == [row[0] for row in laser_settings]


def _tell(bench: Bench, row: "Row") -> None:
    """Check a setting's effect after each kind of change."""
    number, value, _, look, by_default, by_value = row
    change = f"${number}={value}"
    story = [
        ("power", by_default),
        (change, by_value),
        ("\x18", by_value),
        ("power", by_value),
        ("$RST=$", by_default),
        ("power", by_default),
        (change, by_value),
        ("$RST=*", by_default),
        ("\x18", by_default),
    ]

    def script() -> Iterator[Any]:
        for what, wanted in story:
            yield from bench.change(what)
            yield from bench.unlock()
            assert (yield from look(bench)) == wanted, f"after {what!r}"

    bench.run(script())


@pytest.mark.sampled(5)
@pytest.mark.parametrize("row", _EFFECTS, ids=[f"${row[0]}" for row in _EFFECTS])
def test_a_setting_has_its_effect_after_any_kind_of_change(row: "Row") -> None:
    _tell(Bench(row[2]), row)


@pytest.mark.parametrize("row", _PUNCH_EFFECTS, ids=[f"${row[0]}" for row in _PUNCH_EFFECTS])
def test_a_setting_of_a_punch_has_its_effect(row: "Row") -> None:
    _tell(Bench({}, "sim_punch"), row)


@pytest.mark.parametrize("row", _LASER_EFFECTS, ids=[f"${row[0]}" for row in _LASER_EFFECTS])
def test_a_setting_of_a_laser_has_its_effect(row: "Row") -> None:
    _tell(Bench({}, "sim_laser"), row)


def test_the_report_setting_of_grbl_09_has_its_effect() -> None:
    ((number, *_),) = settings_09
    _tell(Bench({}, "sim_09j"), (number, 6, {}, _fields_09, "MPos WPos", "WPos Buf"))


# Effects outside the table


class FullStore(MemoryStore):
    """A store that refuses to save when it is full."""

    full = False

    def save(self, name: str, lines: "Iterable[str]") -> None:
        if self.full:
            raise OSError(28)
        super().save(name, lines)


def test_an_unsaved_setting_has_its_effect_until_power_off() -> None:
    store = FullStore()
    bench = Bench({}, store=store)
    look = _steps_per_mm(0)

    def script() -> Iterator[Any]:
        store.full = True
        not_kept = ["[MSG:Flash is full or worn: not saved]", "error:7"]
        assert (yield from bench.say("$100=125\n")) == not_kept
        assert (yield from look(bench)) == 125
        said = yield from bench.say("$RST=$\n", "banner")
        assert said[:3] == ["[MSG:Restoring defaults]", *not_kept]
        assert (yield from look(bench)) == 250
        yield from bench.say("$100=125\n")
        yield from bench.change("power")
        assert (yield from look(bench)) == 250

    bench.run(script())


@pytest.mark.parametrize("change", ["$100=80", "$110=100", "$110=50000", "$120=20", "$11=1"])
def test_planned_motion_is_not_changed_by_settings(change: str) -> None:
    def segments(text: str) -> "list[array[int]]":
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
    bench = Bench({})

    def script() -> Iterator[Any]:
        yield from bench.say("M3S500\n")
        assert bench.port.spindle_on
        yield from bench.change(change)
        assert not bench.port.spindle_on

    bench.run(script())


@pytest.mark.parametrize(("change", "asks"), [("$13=1", True), ("$10=3", False)])
def test_only_inches_cause_a_report_of_the_work_offset(change: str, asks: bool) -> None:
    bench = Bench({})

    def script() -> Iterator[Any]:
        for _ in range(2):
            yield from bench.report()
        assert "WCO" not in (yield from bench.report())
        yield from bench.change(change)
        assert ("WCO" in (yield from bench.report())) == asks

    bench.run(script())


def test_move_only_lines_do_nothing_in_check_mode() -> None:
    bench = Bench({})

    def script() -> Iterator[Any]:
        yield from bench.move("G91G1X0.1F500", "X0.1", "X0.1")
        assert bench.place()[0] == 75
        yield from bench.say("$C\n")
        yield from bench.move("X0.1", "X0.1")
        assert bench.place()[0] == 75

    bench.run(script())


def test_permanently_enabled_motors_are_enabled_after_reset_and_power_up() -> None:
    bench = Bench({})

    def script() -> Iterator[Any]:
        yield bench.rig.ms(100)
        yield from bench.change("$1=255")
        assert bench.port.enable_pin == 1
        yield from bench.change("\x18")
        assert bench.port.enable_pin == 0
        yield from bench.change("power")
        yield bench.rig.ms(500)
        assert bench.port.enable_pin == 0

    bench.run(script())
