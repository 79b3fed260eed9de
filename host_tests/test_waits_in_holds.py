"""A hold in front of a command that waits for motion to end: the command waits for `~`, too.

Each kind of block is followed by each command, and `!` comes at an instant of the block's last
200 ms. Held, nothing of the command is done; afterwards everything is as it is without a hold:
pins, reports, modes, position, and what is stored. `UGRBL_TORTURE=1` takes every millisecond.
"""

import os
import random
import re
from collections.abc import Iterator, Sequence
from functools import lru_cache
from types import ModuleType
from typing import Any, NamedTuple

import pytest
from base import state as st
from rig_bench import Machine
from ugrbl.boardfile.files import load_board
from ugrbl.sim.engine import Switch

_EVERY = os.environ.get("UGRBL_TORTURE") is not None
_LAST_MS = 200
_AFTER_MS = 30  # motors stay powered for 25 ms: what stands still is called idle then
_FAST = {110: 6000, 111: 6000, 112: 6000, 120: 500, 121: 500, 122: 500, 22: 1, 23: 7}
_FAST |= {24: 600, 25: 3000, 26: 5, 27: 1}
_LASER = {32: 1}
_SWITCH_STEPS = -4000


class Block(NamedTuple):
    """What moves: lines before it, whose end is awaited, and the lines of the motion."""

    before: Sequence[str]
    lines: Sequence[str]
    settings: dict[int, float] = {}


BLOCKS = {
    "line": Block((), ("G1X2F3000",)),
    "long line": Block((), ("G1X20F6000",)),
    "slow line": Block((), ("G1X0.5F150",)),
    "one step": Block((), ("G1X0.004F100",)),
    "three axes": Block((), ("G1X3Y-2Z1F2000",)),
    "many lines": Block((), tuple(f"G1X{0.3 * i:.1f}Y{i % 2}F3000" for i in range(1, 11))),
    "corner": Block((), ("G1X3F4000", "G1Y3")),
    "rapid": Block((), ("G0X12Y4",)),
    "arc": Block((), ("G2X4Y0I2J0F1500",)),
    "helix": Block((), ("G3X0Y0Z-2I3J0F3000",)),
    "inverse time": Block((), ("G93G1X3F120",)),
    "incremental inches": Block((), ("G91G20G1X0.1F80",)),
    "machine coordinates": Block((), ("G53G0X-6",)),
    "G28": Block((), ("G28X3",)),
    "G30": Block((), ("G30Z2",)),
    "tool": Block((), ("T3G1X2F2000",)),
    "probing": Block((), ("G38.3Z-1F900",)),
    "jog": Block((), ("$J=G91X4F4000",)),
    "speed in motion": Block(("M3S300",), ("G1X1F2000", "S600X2", "S900X3")),
    "laser M3": Block(("M3S300",), ("G1X2F3000S500",), _LASER),
    "laser M4": Block(("M4S300",), ("G1X2F3000S500",), _LASER),
    "laser in the dark": Block(("M3S300",), ("G1X1F3000", "G0X3"), _LASER),
    "laser arc": Block(("M3S300",), ("G1F3000", "G2X4Y0I2J0S700"), _LASER),
    "laser off": Block((), ("G1X2F3000S500",), _LASER),
}

COMMANDS = (
    "M3S700",
    "M4S200",
    "M5",
    "M5G1X3F3000",
    "S100",
    "M7",
    "M8",
    "M9",
    "M5M9",
    "M0",
    "M5\nM0",
    "M2",
    "M30",
    "G4P0.1",
    "$1=50",
    "$100=200",
    "$N0=G21",
    "$I=ABC",
    "$RST=#",
    "$C",
    "$H",
    "G10L2P1X1",
    "G10L20P1Y3",
    "G28.1",
    "G28.1G2X5Y0I2J1F3000",
    "G30.1",
    "G92X7",
    "G92.1",
    "G43.1Z1",
    "G49",
    "G55",
    "M56P0",
    "G38.3Z-2F900",
)


@lru_cache
def _board() -> ModuleType:
    board = ModuleType("board")
    options = {"MIST": True, "OVERRIDE_CONTROL": True}
    vars(board).update(vars(load_board("sim")), **options)
    return board


class Trial:
    """A block and what follows it on one machine. hold_ms: when `!` comes; None: it does not."""

    def __init__(self, block: Block, command: str = "", hold_ms: "float | None" = None) -> None:
        self._block = block
        self._command = command
        self._hold_ms = hold_ms
        self.machine = Machine({**_FAST, **block.settings}, _board(), watched=False)
        self.rig = self.machine.rig
        self.rig.engine.switches += [
            Switch(f"limit_{name}", i, False, _SWITCH_STEPS) for i, name in enumerate("xyz")
        ]
        self.moved_ms = 0.0  # how long motion has taken
        self.held: "dict[str, Any]" = {}
        self.at_last: "dict[str, Any]" = {}

    def run(self) -> "Trial":
        self.machine.run(self._script())
        return self

    def _script(self) -> Iterator[Any]:
        machine, rig = self.machine, self.rig
        yield from machine.start()
        machine.sender.allow(12_000)
        for line in ("$X", "M8", *self._block.before):
            yield from machine.sender.wait("idle", line + "\n", 1)
        machine.take()
        self.before = self._now()
        begin = rig.now
        lines = [*self._block.lines, *filter(None, self._command.split("\n"))]
        rig.link.send("".join(line + "\n" for line in lines).encode())
        if self._hold_ms is None:
            yield lambda: rig.moving()
            yield lambda: not rig.moving()
            self.moved_ms = (rig.now - begin) / rig.ticks_per_ms
        else:
            yield begin + int(self._hold_ms * rig.ticks_per_ms)
            rig.link.send(b"!")
            yield rig.ms(3)
            until = rig.ms(3000)
            while not machine.sender.at_rest() and rig.now < until:
                yield rig.ms(5)
            yield rig.ms(40)
            yield from self._see(self.held)
            rig.link.send(b"~")
        yield from machine.rest()
        yield rig.ms(200)
        yield from machine.rest()
        yield from self._see(self.at_last)

    def _now(self) -> "dict[str, Any]":
        machine = self.rig.controller
        port = self.rig.port
        return {
            "stored": {name: list(lines) for name, lines in self.rig.store.files.items()},
            "steps": self.machine.physical(),
            "modes": machine.commands.modes(),
            "pins": (port.spindle_on, port.spindle_pwm, port.spindle_dir, port.flood, port.mist),
            "run": machine.state.run,
        }

    def _see(self, seen: "dict[str, Any]") -> Iterator[Any]:
        """What it says, and what is so."""
        machine = self.machine
        seen.update(self._now())
        yield from machine.sender.wait("report", "?")
        report = next(line for line in machine.take() if line.startswith("<"))
        seen["report"] = report
        fields = dict(field.split(":", 1) for field in report[1:-1].split("|") if ":" in field)
        seen["MPos"] = fields["MPos"]
        seen["FS"] = fields["FS"]


def _steps(trial: Trial, seen: "dict[str, Any]") -> "list[int]":
    per_mm = trial.rig.controller.settings.steps_per_mm
    return [round(float(mm) * per) for mm, per in zip(seen["MPos"].split(","), per_mm)]


@lru_cache(maxsize=None)
def alone(name: str, command: str) -> Trial:
    return Trial(BLOCKS[name], command).run()


def check(name: str, command: str, hold_ms: float) -> "list[str]":
    wrong = []
    trial = Trial(BLOCKS[name], command, hold_ms).run()
    reference = alone(name, command)
    end = alone(name, "")
    held, last, expected = trial.held, trial.at_last, reference.at_last
    if held["run"] == st.HOLD and held["steps"] != end.at_last["steps"] and name != "jog":
        for key in ("stored",):
            if held[key] != trial.before[key]:
                wrong.append(f"held {key}: {held[key]} was {trial.before[key]}")
        for word in ("M[345]", "M[789]"):
            a = re.findall(word + r"\b", held["modes"]); b = re.findall(word + r"\b", trial.before["modes"])
            if a != b:
                wrong.append(f"held modes {a} was {b}")
    if _steps(trial, held) != held["steps"] and command != "$H":
        wrong.append(f"held place {held['MPos']} {held['steps']}")
    same = ["stored", "modes", "pins", "FS"] if name != "jog" else ["stored", "modes", "pins", "FS"]
    if name != "jog":
        same += ["steps", "MPos"]
    for key in same:
        if last[key] != expected[key]:
            wrong.append(f"{key}: {last[key]} without {expected[key]}")
    return [f"{name!r} {command!r} at {hold_ms:.1f} of {end.moved_ms:.1f}: {w}" for w in wrong]


if __name__ == "__main__":
    pass
