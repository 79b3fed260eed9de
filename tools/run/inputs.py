"""Inputs of a simulated machine: their names, and rules that close and open them.

`--input NAME=WHEN`: on, or off; Z-30: closed while the machine is at Z-30 or beyond; 2s: it
changes when a handler, or a probing motion, has waited for it for so long. closed: the input is
active.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..sim import motor_names
from ..sim.motor_names import AXIS_LETTERS

if TYPE_CHECKING:
    from ..sim.engine import Switch
    from ..sim.rig import Rig

PROBE = "probe"
DOOR = "door"
_PLACE = re.compile(rf"([{AXIS_LETTERS}])([<>]?)(-?\d+(?:\.\d*)?)", re.IGNORECASE)
_TIME = re.compile(r"(\d+(?:\.\d*)?)(ms|s)")
_WHEN = "on, off, a position (Z-30) or a time (2s)"


@dataclass(frozen=True)
class Rule:
    """When an input closes. axis: -1 if it does not depend on a position. wait_ms: None if it does
    not depend on waiting."""

    name: str
    closed: bool = False
    axis: int = -1
    mm: float = 0.0
    above: bool = False
    wait_ms: "int | None" = None


def rule(text: str) -> Rule:
    """Parse a rule of the command line. ValueError if it is not one."""
    name, equals, when = (part.strip() for part in text.partition("="))
    if not name or not equals:
        raise ValueError(f"--input {text}: write NAME=WHEN, WHEN being {_WHEN}")
    if when in ("on", "off"):
        return Rule(name, closed=when == "on")
    if match := _TIME.fullmatch(when):
        unit_ms = 1 if match[2] == "ms" else 1000
        return Rule(name, wait_ms=int(float(match[1]) * unit_ms))
    match = _PLACE.fullmatch(when)
    if not match:
        raise ValueError(f"--input {text}: WHEN is {_WHEN}")
    axis, side, mm = match[1], match[2], float(match[3])
    if not side and not mm:
        raise ValueError(
            f"--input {text}: say on which side of it the input closes: {axis}<0 or {axis}>0"
        )
    # Without < or > it is closed from there on away from 0.
    above = side == ">" if side else mm > 0  # closed above the position
    return Rule(name, axis=AXIS_LETTERS.index(axis.upper()), mm=mm, above=above)


def names(rig: "Rig") -> dict[str, str]:
    """Return the names of the inputs that can be pushed, each with the simulator's own name."""
    from ..sim import port

    found = {name: f"pin_{pin}" for name, pin in getattr(rig.board, "INPUTS", {}).items()}
    limits = filter(None, rig.port.limit_names)  # "" is a motor without a limit input
    for name in (PROBE, *limits, *port.CONTROLS):
        found.setdefault(name, name)
    if getattr(rig.board, "SAFETY_DOOR", False):
        # the door replaces the hold button, as on an Uno
        found.setdefault(DOOR, found.pop("hold"))
    if rig.port.estop:
        found.setdefault(port.ESTOP, port.ESTOP)
    return found


class Inputs:
    """The inputs of one rig, pushed by rules and by hand. ValueError for a name that does not
    exist.

    others_ms: inputs without a rule change after being waited for so long; None: never.
    """

    def __init__(self, rig: "Rig", rules: Iterable[Rule] = (), others_ms: "int | None" = None):
        self._rig = rig
        self.names = names(rig)
        self._wait_ms: dict[str, int] = {}  # by name: it changes after being waited for so long
        if others_ms is not None:
            self._wait_ms = dict.fromkeys(self.names, others_ms)
        self._changeable: set[str] = set(self._wait_ms)  # names of inputs that may change
        # What a handler waits for: name, level (closed), and since when in ms; None: nothing.
        self._awaited: "tuple[str, bool, int] | None" = None
        self._probing_since: "int | None" = None  # in ms; None: no probing motion
        # Rules with a position last (the others have axis -1), because they need a machine.
        for rule in sorted(rules, key=lambda rule: rule.axis):
            self._apply(rule)

    def _apply(self, added: Rule) -> None:
        """Apply a rule. It replaces the general rule for inputs without one."""
        if added.name not in self.names:
            raise ValueError(f"there is no input {added.name}; there are {', '.join(self.names)}")
        self._changeable.add(added.name)
        self._wait_ms.pop(added.name, None)
        if added.wait_ms is not None:
            self._wait_ms[added.name] = added.wait_ms
        elif added.axis >= 0:
            self._rig.engine.switches.append(self._switch(added))
        else:
            self.push(added.name, added.closed)

    def _switch(self, added: Rule) -> "Switch":
        """Return a switch at the rule's position. ValueError if no motor alone moves its axis."""
        from ..sim.switches import PlaceSwitch

        if added.axis >= motor_names.axes_of(self._rig.board):
            raise ValueError(f"{added.name}: this machine has no axis {AXIS_LETTERS[added.axis]}")
        together = motor_names.shared(self._rig.board)
        if AXIS_LETTERS[added.axis] in together:
            axes = " and ".join(together)
            raise ValueError(f"{added.name}: motors move {axes} together: take another axis")
        return PlaceSwitch(self._rig, self.names[added.name], added.axis, added.above, added.mm)

    # By hand

    def is_closed(self, name: str) -> bool:
        """Return whether the input is closed now."""
        return self._rig.port.is_closed(self.names[name])

    def push(self, name: str, closed: bool) -> None:
        """Close or open an input."""
        self._rig.port.push({self.names[name]: closed})

    # By waiting

    def await_(self, name: str, closed: bool) -> bool:
        """Note that a handler waits for an input. Returns whether the input may ever change."""
        self._awaited = name, closed, self._rig.port.ticks_ms()
        return name in self._changeable or name not in self.names

    def end_wait(self) -> None:
        """Note that the wait has ended."""
        self._awaited = None

    def advance(self) -> None:
        """Push inputs that have been waited for long enough. Called as time passes."""
        port = self._rig.port
        if self._awaited:
            name, closed, since = self._awaited
            if name in self._wait_ms and port.elapsed_ms(since) >= self._wait_ms[name]:
                self.push(name, closed)
        if PROBE in self._wait_ms:
            self._advance_probe()

    def _advance_probe(self) -> None:
        """Give the probe the level that a probing motion seeks, when this has lasted for the
        probe's waiting time, and open it after the motion."""
        port = self._rig.port
        level = port.awaits_probe()  # None: no probing motion
        if level is None or not self._rig.moving():
            if self._probing_since is not None:
                self._probing_since = None
                self.push(PROBE, False)
        elif self._probing_since is None:
            self._probing_since = port.ticks_ms()
        elif port.elapsed_ms(self._probing_since) >= self._wait_ms[PROBE]:
            self.push(PROBE, level)
