"""Judge positions after a stop: how far from Grbl's a replayed conversation may be, and until
when.

A stop at another moment leaves the axes that were moving a little away from where Grbl's stopped.
Relative moves keep this offset, the first absolute move ends it, and it is allowed nowhere else.
Steps of a case are described in compare.py. Counts of steps are ours minus Grbl's.
"""

import re
from typing import Any

from .differences import EXACT_STOP, HELD_CONTACT, IN_MOTION, STOPPED

Json = dict[str, Any]

_STOP = re.compile("[!\x84\x85]|G38")
_HOLD = re.compile("[!\x84]")
_ON_STEP = 0.05  # of a step: a position closer to a whole step is taken as on it
_RAPID_MM_MIN = 500.0  # of the recordings, unless they set another value
_STOP_MS = 10.0  # a hold, jog cancel, probe or alarm may act so much earlier or later
_RESET_MS = 20.0  # a reset stops at once: a motion that began later ends earlier on its way
_DIGIT_MM = 0.001  # the last digit of a reported position
_PER_MM = 250.0  # steps/mm of the recordings, unless they set another value
_FEED = re.compile(r"F\s*(\d+\.?\d*)|\$1[12]\d=(\d+)|\$2[45]=(\d+)", re.IGNORECASE)
_SETTING = re.compile(r"\$10([0-5])=(\d+\.?\d*)|\$RST=[$*]", re.IGNORECASE)
_FREE_BLOCKS_OR_SLOW = re.compile(r"(?<=[|])(Bf:\d+|FS:(\d|0\.\d))(?=,)")
_PLACES = re.compile(r"(?<=:)(-?\d+\.\d+(?:,-?\d+\.\d+)+)")


class Places:
    """Compares the positions of a case and its replay, by step of the case.

    offset: steps from Grbl's position to ours when the axes last stood still. slack: steps that a
    position may be off because motion was stopped. Both per step of the case and axis. wrong: the
    steps whose moves differ without a reason. reasons: names of differences, by step. lasers:
    $32=1 was sent.
    """

    def __init__(self, setup: list[Any], steps: list[Json], got: list[Json]) -> None:
        self._steps = steps
        self._got = got
        self.axes = len(got[0]["moved"]) if got else 0
        self._per_mm = [_PER_MM] * self.axes
        self._fastest_mm_min = _RAPID_MM_MIN  # the highest speed up to a step
        self.offset: list[list[int]] = []
        self.slack: list[list[float]] = []
        # By step and axis: the offset may be one step more or less.
        self._is_uncertain: list[list[bool]] = []
        self.wrong: set[int] = set()
        self.reasons: dict[int, str] = {}
        self.lasers = False
        for item in setup:  # a line with its answers, or a step
            self._read_settings(item[0] if isinstance(item, list) else item["send"])
        self._compare_moves()

    def _read_settings(self, sent: str) -> None:
        """Update the highest speed, steps/mm and `lasers` from sent lines."""
        # F, $110 to $122, $24, $25: each match has one of three groups.
        feeds = [float(next(filter(None, groups))) for groups in _FEED.findall(sent)]
        self._fastest_mm_min = max([self._fastest_mm_min, *feeds])
        self.lasers = self.lasers or "$32=1" in sent
        for axis, steps in _SETTING.findall(sent):
            if not axis:  # $RST restores them all
                self._per_mm = [_PER_MM] * self.axes
            elif int(axis) < self.axes:
                self._per_mm[int(axis)] = float(steps)

    def _compare_moves(self) -> None:
        """Compare the moves of all steps, and fill the attributes.

        Moves are added up over a span of steps, which ends with a step at whose end nothing moves.
        first: its first step. deviation: steps that we moved more than Grbl in the span, by axis.
        """
        offset, is_uncertain = [0] * self.axes, [False] * self.axes
        first, deviation, has_moved = 0, [0] * self.axes, [False] * self.axes
        resumed = _resumed_after_contact(self._steps)
        for number, (step, mine) in enumerate(zip(self._steps, self._got, strict=False)):
            self._read_settings(step["send"])
            grbl_moved = padded(step.get("moved", []), self.axes)
            moves = list(zip(mine["moved"], grbl_moved))
            deviation = [sum_ + a - b for sum_, (a, b) in zip(deviation, moves)]
            has_moved = [has or bool(a or b) for has, (a, b) in zip(has_moved, moves)]
            slack_mm = self._fastest_mm_min * self._stop_ms(first, number) / 60_000
            slack = [slack_mm * steps * has for steps, has in zip(self._per_mm, has_moved)]
            self.slack.append(slack)
            if not step.get("moving"):
                for axis in range(self.axes):
                    reason = self._reason(
                        first, number, deviation[axis], offset[axis], slack[axis]
                    )
                    if number in resumed and deviation[axis] == -grbl_moved[axis] != 0:
                        reason = HELD_CONTACT[0]  # only Grbl has moved
                    if reason is None:
                        self.wrong.add(number)
                    elif reason:
                        self.reasons[number] = reason
                # A stop makes the offset uncertain, until a move cancels it exactly.
                cancels = [a != 0 and b == -a for a, b in zip(offset, deviation)]
                is_uncertain = [
                    bool(slack[axis]) or (is_uncertain[axis] and not cancels[axis])
                    for axis in range(self.axes)
                ]
                offset = [a + b for a, b in zip(offset, deviation)]
                first, deviation, has_moved = number + 1, [0] * self.axes, [False] * self.axes
            if step.get("power"):  # Grbl and we start at 0 again
                offset, is_uncertain = [0] * self.axes, [False] * self.axes
            self.offset.append(offset)
            self._is_uncertain.append(is_uncertain)

    def _reason(
        self, first: int, last: int, deviation: int, offset: int, slack: float
    ) -> str | None:
        """Return why an axis may have moved `deviation` steps more than Grbl's in the steps first
        to last; "" if no reason is needed, None if it may not. offset: before these steps."""
        if deviation in (0, -offset):  # a relative move, or an absolute one, to Grbl's position
            return ""
        if abs(deviation) <= 1 and self._ends_on_step(first, last):
            return EXACT_STOP[0]
        return STOPPED[0] if min(abs(deviation), abs(deviation + offset)) <= slack else None

    def _stop_ms(self, first: int, last: int) -> float:
        """Return by how many ms a stop in these steps (reset, hold, jog cancel, probe, alarm) may
        differ from Grbl's; 0 if nothing stopped a motion."""
        before = [{}, *self._steps][first]  # the step before the first one; {} if there is none
        for step in self._steps[first : last + 1]:
            moving = step.get("moving") or before.get("moving")
            if moving and ("\x18" in step["send"] or step.get("power")):
                return _RESET_MS
            if moving and (_STOP.search(step["send"]) or step.get("pins") or _alarms(step)):
                return _STOP_MS
            before = step
        return 0.0

    def _ends_on_step(self, first: int, last: int) -> bool:
        """Return whether a stop in these steps was exactly on a whole step, so that rounding
        decides whether this step is made."""
        is_stopped = False
        for step, mine in zip(self._steps[first : last + 1], self._got[first:], strict=False):
            is_stopped = is_stopped or bool(_STOP.search(step["send"]) or step.get("pins"))
            # off_step: the exact position's distance from a whole step, 0 to 0.5
            if is_stopped and mine.get("off_step", 1) < _ON_STEP:
                return True
        return False

    def are_explained(self, used: list[str]) -> bool:
        """Return whether all moves that differ have reasons; adds these to `used`."""
        used += sorted(set(self.reasons.values()))
        return not self.wrong

    def same_reports(self, number: int, used: list[str]) -> bool:
        """Return whether the lines of a step are the recorded ones, except for positions that may
        be off; adds the reasons to `used`."""
        expected, lines = self._steps[number]["expect"], self._got[number]["lines"]
        if len(expected) != len(lines):
            return False
        reasons: set[str | None] = set()
        for pair in zip(expected, lines, strict=True):
            # A hold that stops a step before the end of a block may still have that block, or not:
            # free blocks, and a speed of one digit, are not compared.
            is_hold = pair[0].startswith("<Hold")
            texts = [_FREE_BLOCKS_OR_SLOW.sub("#", line) if is_hold else line for line in pair]
            # split() alternates: text, positions, text, …
            theirs, ours = [_PLACES.split(text) for text in texts]
            if theirs[::2] != ours[::2]:
                return False
            is_running = texts[0].startswith("<Run") and bool(self._steps[number].get("moving"))
            for positions in zip(theirs[1::2], ours[1::2], strict=True):
                numbers = [position.split(",") for position in positions]
                reasons |= {
                    self._reason_of_report(number, axis, float(our) - float(grbls), is_running)
                    for axis, (grbls, our) in enumerate(zip(*numbers, strict=False))
                    if grbls != our
                }
        used += sorted(filter(None, reasons))
        return None not in reasons

    def _reason_of_report(self, number: int, axis: int, mm: float, is_running: bool) -> str | None:
        """Return why a step's report may have a position at that distance from Grbl's; None if it
        may not."""
        if axis >= self.axes:
            return None
        offset, steps = self.offset[number][axis], mm * self._per_mm[axis]
        rounding = _DIGIT_MM * self._per_mm[axis]  # in steps
        uncertain = 1 if self._is_uncertain[number][axis] else 0  # in steps
        # Of either sign, because work positions subtract an offset that may differ, too.
        if (offset or uncertain) and abs(abs(steps) - abs(offset)) <= rounding + uncertain:
            return EXACT_STOP[0] if abs(offset) <= 1 else STOPPED[0]
        if is_running and abs(steps) <= 1 + rounding:
            return IN_MOTION[0]
        return STOPPED[0] if abs(steps) <= self.slack[number][axis] else None


def _resumed_after_contact(steps: list[Json]) -> set[int]:
    """Return the steps in which motion resumes (~) after the probe's input was changed during a
    hold."""
    resumed, held, touched = set(), False, False
    for number, step in enumerate(steps):
        held = held or bool(_HOLD.search(step["send"]))
        touched = touched or (held and "probe" in step.get("pins", {}))
        if "~" in step["send"]:
            if touched:
                resumed.add(number)
            held = touched = False
    return resumed


def _alarms(step: Json) -> bool:
    return any(line.startswith("ALARM:") for line in step["expect"])


def padded(values: list[int], length: int) -> list[int]:
    """Return the values, filled up with zeros."""
    return values + [0] * (length - len(values))
