"""Judge positions after a stop: how far from Grbl's a replayed conversation may be, and until
when.

A stop at another moment leaves the axes that were moving a little away from where Grbl's stopped.
Relative moves keep this distance, the first absolute move ends it, and it is allowed nowhere else.
"""

import re
from typing import Any

from .differences import EXACT_STOP, HELD_CONTACT, IN_MOTION, STOPPED

Json = dict[str, Any]

_STOP = re.compile("[!\x84\x85]|G38")
_HOLD = re.compile("[!\x84]")
_ON_STEP = 0.05  # of a step
_RAPID_MM_MIN = 500.0  # of the recordings, unless they set another value
_STOP_MS = 10.0
_RESET_MS = 20.0  # a reset stops at once: a motion that began later ends earlier on its way
_DIGIT_MM = 0.001
_PER_MM = 250.0
_FEED = re.compile(r"F\s*(\d+\.?\d*)|\$1[12]\d=(\d+)|\$2[45]=(\d+)", re.IGNORECASE)
_SETTING = re.compile(r"\$10([0-5])=(\d+\.?\d*)|\$RST=[$*]", re.IGNORECASE)
_SLOW_REST = re.compile(r"(?<=[|])(Bf:\d+|FS:(\d|0\.\d))(?=,)")
_PLACES = re.compile(r"(?<=:)(-?\d+\.\d+(?:,-?\d+\.\d+)+)")


class Places:
    """Compares the positions of a case and its replay, by step of the case.

    offset: steps from Grbl's position to ours where the axis stopped. slack: allowed deviation
    during motion, in steps. wrong: moves that differ without a reason. names: the reasons. lasers:
    $32=1 was sent.
    """

    def __init__(self, setup: list[Any], steps: list[Json], got: list[Json]) -> None:
        self._steps = steps
        self._got = got
        self.axes = len(got[0]["moved"]) if got else 0
        self._per_mm = [_PER_MM] * self.axes
        self._fastest = _RAPID_MM_MIN
        self.offset: list[list[int]] = []
        self.slack: list[list[float]] = []
        self._doubt: list[list[bool]] = []  # a step; the part in motion is in no step of a case
        self.wrong: set[int] = set()
        self.names: dict[int, str] = {}
        self.lasers = False
        for item in setup:
            self._hear(item[0] if isinstance(item, list) else item["send"])
        self._walk()

    def _hear(self, sent: str) -> None:
        """Update speeds and step lengths from the sent lines."""
        feeds = [float(next(filter(None, found))) for found in _FEED.findall(sent)]
        self._fastest = max([self._fastest, *feeds])
        self.lasers = self.lasers or "$32=1" in sent
        for axis, steps in _SETTING.findall(sent):
            if not axis:
                self._per_mm = [_PER_MM] * self.axes
            elif int(axis) < self.axes:
                self._per_mm[int(axis)] = float(steps)

    def _walk(self) -> None:
        """Compare the moves of all steps, and fill the attributes.

        off: steps from Grbl's position to ours when motion last stopped. doubt: the axes for which
        that is not certain. busy: axes that have moved since then.
        """
        off, doubt = [0] * self.axes, [False] * self.axes
        apart = list(off)  # since motion last stopped
        first, busy = 0, [False] * self.axes
        restarts = _restarts(self._steps)
        for number, (step, mine) in enumerate(zip(self._steps, self._got, strict=False)):
            self._hear(step["send"])
            moved = padded(step.get("moved", []), self.axes)
            apart = [a + ours - theirs for a, ours, theirs in zip(apart, mine["moved"], moved)]
            busy = [was or bool(a or b) for was, a, b in zip(busy, mine["moved"], moved)]
            mm = self._fastest * self._stop_ms(first, number) / 60_000
            self.slack.append([mm * steps * on for steps, on in zip(self._per_mm, busy)])
            if not step.get("moving"):
                for axis in range(self.axes):
                    name = self._reason(
                        first, number, apart[axis], off[axis], self.slack[number][axis]
                    )
                    if number in restarts and apart[axis] == -moved[axis] != 0:
                        name = HELD_CONTACT[0]
                    if name is None:
                        self.wrong.add(number)
                    elif name:
                        self.names[number] = name
                doubt = [
                    bool(way) or (doubted and not (axis_off and axis_off == -axis_apart))
                    for way, doubted, axis_off, axis_apart in zip(
                        self.slack[number], doubt, off, apart
                    )
                ]
                off = [a + b for a, b in zip(off, apart)]
                apart, busy, first = [0] * self.axes, [False] * self.axes, number + 1
            if step.get("power"):
                off, doubt = [0] * self.axes, [False] * self.axes
            self.offset.append(off)
            self._doubt.append(doubt)

    def _reason(self, first: int, number: int, apart: int, off: int, slack: float) -> str | None:
        """Return why an axis may have moved so many steps more than recorded; "" if no reason is
        needed, None if it may not."""
        if apart in (0, -off):
            return ""
        if abs(apart) <= 1 and self._ends_on_step(first, number):
            return EXACT_STOP[0]
        return STOPPED[0] if min(abs(apart), abs(apart + off)) <= slack else None

    def _stop_ms(self, first: int, last: int) -> float:
        """Return the time in ms within which a hold, a jog cancel, a probe or an alarm ended a
        motion in these steps; 0 if nothing did."""
        before = [{}, *self._steps][first]
        for step in self._steps[first : last + 1]:
            moving = step.get("moving") or before.get("moving")
            if moving and ("\x18" in step["send"] or step.get("power")):
                return _RESET_MS
            if moving and (_STOP.search(step["send"]) or step.get("pins") or _alarms(step)):
                return _STOP_MS
            before = step
        return 0.0

    def _ends_on_step(self, first: int, last: int) -> bool:
        """Return whether a stop in these steps was exactly on a whole step."""
        stops = False
        for step, mine in zip(self._steps[first : last + 1], self._got[first:], strict=False):
            stops = stops or bool(_STOP.search(step["send"]) or step.get("pins"))
            if stops and mine.get("off_step", 1) < _ON_STEP:
                return True
        return False

    def are_explained(self, used: list[str]) -> bool:
        """Return whether all distances of the axes from Grbl's final position have reasons."""
        used += sorted(set(self.names.values()))
        return not self.wrong

    def same_reports(self, number: int, used: list[str]) -> bool:
        """Return whether the lines of a step are the recorded ones except for positions that are
        off."""
        expected, lines = self._steps[number]["expect"], self._got[number]["lines"]
        if len(expected) != len(lines):
            return False
        names: set[str | None] = set()
        for pair in zip(expected, lines, strict=True):
            # A hold that stops a step before the end of a block may still have that block, or not.
            holds = pair[0].startswith("<Hold")
            sides = [_SLOW_REST.sub("#", line) if holds else line for line in pair]
            theirs, ours = [_PLACES.split(line) for line in sides]
            if theirs[::2] != ours[::2]:
                return False
            runs = sides[0].startswith("<Run") and bool(self._steps[number].get("moving"))
            for places in zip(theirs[1::2], ours[1::2], strict=True):
                numbers = [place.split(",") for place in places]
                names |= {
                    self._reason_of(number, axis, float(ours) - float(theirs), runs)
                    for axis, (theirs, ours) in enumerate(zip(*numbers, strict=False))
                    if theirs != ours
                }
        used += sorted(filter(None, names))
        return None not in names

    def _reason_of(self, n: int, axis: int, mm: float, runs: bool) -> str | None:
        """Return why a report may have a position at that distance from Grbl's; None if it may
        not."""
        if axis >= self.axes:
            return None
        off, steps = self.offset[n][axis], mm * self._per_mm[axis]
        rounding = _DIGIT_MM * self._per_mm[axis]
        doubt = self._doubt[n][axis]
        if (off or doubt) and abs(abs(steps) - abs(off)) <= rounding + doubt:
            return EXACT_STOP[0] if abs(off) <= 1 else STOPPED[0]
        if runs and abs(steps) <= 1 + rounding:
            return IN_MOTION[0]
        return STOPPED[0] if abs(steps) <= self.slack[n][axis] else None


def _restarts(steps: list[Json]) -> set[int]:
    """Return the steps in which motion resumes after a probe was touched, by hand, during a
    hold."""
    restarts, held, touched = set(), False, False
    for number, step in enumerate(steps):
        held = held or bool(_HOLD.search(step["send"]))
        touched = touched or (held and "probe" in step.get("pins", {}))
        if "~" in step["send"]:
            if touched:
                restarts.add(number)
            held = touched = False
    return restarts


def _alarms(step: Json) -> bool:
    return any(line.startswith("ALARM:") for line in step["expect"])


def padded(values: list[int], length: int) -> list[int]:
    """Return the values, filled up with zeros."""
    return values + [0] * (length - len(values))
