"""Our extras in pairs: a pair is refused with a message, or answers, moves and stops like one
alone.

_OPTIONS_OF: by an extra's module, the options of a board file that select it.
"""

import itertools
import re
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from boot import select_extras
from boot.options import Options
from machine import Pin
from ugrbl import paths
from ugrbl.boardfile.files import load, load_board
from ugrbl.sim.link import SimLink
from ugrbl.sim.network import RigLink
from ugrbl.sim.replay import factory_store
from ugrbl.sim.rig import Rig
from ugrbl.sim.sender import Sender

_BAD = re.compile(r"ALARM|error|\[MSG:.*Err")
_EXAMPLES = paths.EXAMPLES / "kinematics"
_PER_MM = 250  # steps, of each motor
_UP = 2  # a punch has a pull-up
_SLACK_MM, _SKEW = 0.04, 0.01  # $160; $780 as a fraction
_CUSTOM = "pairs_custom"
_PLOTTER = load(_EXAMPLES / "my_plotter.py")
_BRISK = {**dict.fromkeys((110, 111, 112), 2000.0), **dict.fromkeys((120, 121, 122), 500.0)}

_GOOD_PIN = 19  # closed: the supply is good
# A board file's options for each extra, by its module. axes: more letters; second: motors.
_OPTIONS_OF: "dict[str, dict[str, Any]]" = {
    "net.net_access": {"LINK": "wifi"},
    "dialects.dialect_09": {"DIALECT": "0.9j"},
    "dialects.dialect_hal": {"DIALECT": "hal"},
    "kinematics.nonlinear": {"KINEMATICS": "polar"},
    "kinematics.motor_matrix": {"MOVES": ("X+Z", "Y", "X-Z")},
    "motors.ganged": {"second": "Y"},
    "motors.backlash": {"BACKLASH": True, "defaults": {160: _SLACK_MM}},
    "kinematics.skew": {"SKEW": True, "defaults": {780: _SKEW * 1000}},
    "kinematics.rotary": {"ROTARY": "A", "axes": "A"},
    "kinematics.wire": {"XYUV": True, "axes": "A"},
    "motors.home_order": {"HOMING": ("Z", "XY")},
    "motors.shared_limits": {"shared": True},
    "motors.tmc2209": {"drivers": True},
    "motors.jerk": {"JERK": True, "defaults": {800: 5000.0, 801: 5000.0, 802: 5000.0}},
    "motors.arc_limit": {"ARC_ACCELERATION": True},
    "tools.laser": {"TOOL": "laser"},
    "tools.punch": {"TOOL": "punch"},
    "tools.clusters": {"TOOL": "laser", "CLUSTERS": True},
    "underruns": {"COUNT_DRAINS": True},
    "jobs.job_commands": {"JOBS": "jobs"},
    "power_fail": {"POWER_FAIL": _GOOD_PIN},
    "custom.user_modules": {"CUSTOM": _CUSTOM},
    "dialects.lenient": {"LENIENT": True},
}
_PUNCH = {
    "PUNCH_DOWN": 20,
    "PUNCH_UP": 21,
    "PUNCH_DOWN_SENSOR": 22,
    "PUNCH_UP_SENSOR": 23,
    "PUNCH_TIMEOUT_MS": 1000,
    "PUNCH_STROKE_MS": 40,
}


def _are_compatible(pair: "tuple[str, str]") -> bool:
    """Return whether no option needs two different values."""
    one, other = (_OPTIONS_OF[name] for name in pair)
    return all(one[word] == other[word] for word in one.keys() & other.keys() - {"defaults"})


_PAIRS = [pair for pair in itertools.combinations(_OPTIONS_OF, 2) if _are_compatible(pair)]


def board(*extras: str) -> ModuleType:
    """Return the simulator's board with these extras; DEFAULTS are merged.

    Words in lower case are no options: "axes" adds letters, "second" adds motors on axes that have
    one, "shared" lets Y and Z share a limit input, "drivers" gives every motor a TMC2209.
    """
    words: "dict[str, Any]" = {"defaults": dict(_BRISK)}
    for extra in extras:
        defaults = {**words["defaults"], **_OPTIONS_OF[extra].get("defaults", {})}
        words = {**words, **_OPTIONS_OF[extra], "defaults": defaults}
    motors = "XYZ" + words.pop("axes", "") + words.get("second", "")
    made = ModuleType("board")
    options = vars(made)
    options.update(vars(load_board("sim")), CUSTOM="")
    options["STEP"] = options["LIMIT"] = tuple(range(len(motors)))
    if words.pop("second", ""):
        options["MOTORS"] = motors
    if words.pop("shared", False):
        options["LIMIT"] = (0, 1, 1, *options["LIMIT"][3:])  # pins of X, Y, Z
    if words.pop("drivers", False):
        options.update(TMC2209=tuple(range(len(motors))), TMC_UART=(8, 9))
    if words.get("KINEMATICS"):
        words["defaults"] = {**_PLOTTER.DEFAULTS, 20: 0, 22: 0}  # no soft limits, no homing
    if words.get("TOOL") == "punch":
        options.update(_PUNCH)
    options["DEFAULTS"] = words.pop("defaults")
    options.update(words)
    return made


class Bench:
    """A machine with these extras, and the results of a short conversation."""

    def __init__(self, patch: pytest.MonkeyPatch, *extras: str) -> None:
        """Power the machine up, and have the conversation."""
        made = board(*extras)
        self.rig: Any = None
        # MicroPython's clock, which some extras read, is the machine's.
        patch.setattr(time, "ticks_ms", self._now_ms, raising=False)
        patch.setattr(time, "ticks_diff", lambda one, other: one - other, raising=False)
        Pin(_GOOD_PIN).drive(0)  # for the extra power_fail
        link = _on_network if "net.net_access" in extras else SimLink
        self.rig = Rig(made, factory_store(made), link)
        self.sender = Sender(self.rig)
        self.sender.allow(600_000)  # ms of the machine's time
        self.answers: "list[str]" = []  # lines received
        self.positions_mm: "list[list[float]]" = []  # reported, before and after moves
        self.moved_steps: "list[int]" = []  # steps of each motor
        self.outputs_when_off: "list[tuple[Any, ...]]" = []  # the tool must be off
        self.rig.run(self._talk())

    def _talk(self) -> "Iterator[Any]":
        """Move 1 mm in X, 2 in Y, half a mm back; switch the tool on and off; reset during a
        move."""
        yield from self._say("", "banner")
        if self.rig.controller.state.run:  # not idle: in an alarm until it is unlocked
            yield from self._say("$X\n", "ok")
        yield from self._say("G91\n", "ok")
        yield from self._place()
        before = self._motors()
        self.outputs_when_off.append(self._outputs())
        for line in ("G1X1F600\n", "G1Y2\n", "G1X-0.5\n"):
            yield from self._say(line, "ok")
            yield from self._say("", "idle")
        yield from self._place()
        self.moved_steps = [after - at for at, after in zip(before, self._motors(), strict=True)]
        yield from self._say("$$\n", "ok")
        yield from self._say("M3S500\n", "ok")
        yield from self._say("M5\n", "ok")
        self.outputs_when_off.append(self._outputs())
        yield from self._say("M3S700\n", "ok")
        self.rig.link.send(b"G1X5F300\n")
        yield self.rig.ms(200)  # the move lasts a second
        self.power_in_motion: int = self.rig.port.spindle_pwm
        self.before_reset = len(self.answers)
        yield from self._say("\x18", "banner")
        self.outputs_when_off.append(self._outputs())

    def _now_ms(self) -> int:
        return int(self.rig.now / self.rig.ticks_per_ms) if self.rig else 0

    def _say(self, text: str, until: str) -> "Iterator[Any]":
        yield from self.sender.wait(until, text)
        self.answers += self.sender.take()

    def _place(self) -> "Iterator[Any]":
        """Ask for a report, and add its position to positions_mm."""
        yield from self.sender.wait("report", "?")
        self.answers += self.sender.take()
        report = next(line for line in reversed(self.answers) if line.startswith("<"))
        match = re.search(r"MPos:([-\d.,]+)", report)
        assert match, report
        self.positions_mm.append([float(mm) for mm in match[1].strip(",").split(",")])

    def _motors(self) -> "list[int]":
        self.rig.engine.physical(self.rig.scratch)
        return list(self.rig.scratch)

    def _outputs(self) -> "tuple[Any, ...]":
        port: Any = self.rig.port
        return bool(port.spindle_on), port.spindle_pwm, port.own_outputs & ~_UP


def _on_network(rig: Rig) -> RigLink:
    return RigLink(rig, SimLink(rig), None)


def _steps(extras: "tuple[str, str]", motors: int) -> "list[int]":
    """Return each motor's steps for 1 mm along X, 2 mm along Y, and 0.5 mm of X back.

    Backlash: the motor makes up for it in the reversal. Skew: X depends on Y. motors: how many.
    """
    x, y, z = 0.5, 2.0, 0.0
    if "motors.backlash" in extras:
        x -= _SLACK_MM
    if "kinematics.skew" in extras:
        x -= _SKEW * y
    mm = [x, y, z]
    if "kinematics.motor_matrix" in extras:
        mm = [x + z, y, x - z]  # MOVES
    if "motors.ganged" in extras:
        mm += [0.0] * (motors - 1 - len(mm)) + [y]  # the last motor is a second one of Y
    return [round(each * _PER_MM) for each in mm + [0.0] * (motors - len(mm))]


def test_every_extra_is_tested_here() -> None:
    """_OPTIONS_OF has all modules that board options select, and two that have no such entry."""
    ours = {module for _, module in select_extras._ORDER if module}
    ours |= {
        module for words in select_extras.WORDS.values() for module in words.values() if module
    }
    assert {*_OPTIONS_OF} == {*ours, "custom.user_modules", "dialects.lenient"}


@pytest.fixture(autouse=True)
def place_of_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let custom modules and jobs be found in an empty folder, and kinematics in the examples."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(_EXAMPLES))
    monkeypatch.syspath_prepend(str(tmp_path))
    sys.modules.pop(_CUSTOM, None)
    # A custom module with M100.
    text = "from ugrbl import mcode\n\n@mcode(100)\ndef word(m):\n    m.say('here')\n"
    (tmp_path / f"{_CUSTOM}.py").write_text(text)
    (tmp_path / "jobs").mkdir()


@pytest.mark.sampled(12)
@pytest.mark.parametrize("pair", _PAIRS, ids=lambda pair: "-".join(n.split(".")[-1] for n in pair))
def test_two_extras_are_refused_with_a_message_or_work_together(
    pair: "tuple[str, str]", monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pair is refused by Options, with an option's name in the message; or Bench's talk
    succeeds."""
    try:
        Options(board(*pair))
    except ValueError as error:
        words = {word for extra in pair for word in (*_OPTIONS_OF[extra], "MOTORS", "LIMIT")}
        assert any(re.search(rf"\b{word}\b", str(error)) for word in words), error
        return
    bench = Bench(monkeypatch, *pair)
    assert [line for line in bench.answers[: bench.before_reset] if _BAD.match(line)] == []
    (x, y, *_), (new_x, new_y, *others) = bench.positions_mm
    assert (round(new_x - x, 2), round(new_y - y, 2)) == (0.5, 2.0)
    assert others == bench.positions_mm[0][2:]  # axes that have not moved
    if "kinematics.nonlinear" not in pair:
        assert bench.moved_steps == _steps(pair, len(bench.moved_steps))
    assert bench.power_in_motion > 0 or "tools.punch" in pair
    # Spindle off, power 0, no other output: at first, after M5, and after the reset.
    assert bench.outputs_when_off == [(False, 0, 0)] * 3
