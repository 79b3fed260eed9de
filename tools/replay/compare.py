"""Judges replays of recordings by the rules of their FORMAT.md.

judge_case() for conversations, compare_motion.judge_motion() for motion records: both return
what is wrong, in words, and add the names of the differences they overlooked.
"""

import re
from itertools import pairwise
from typing import Any, NamedTuple

from .compare_motors import judge_motors
from .differences import (
    DIFFERENCES,
    EXACT_STOP,
    HELD_CONTACT,
    IN_MOTION,
    LATE_ALARM,
    NO_SPEED,
    QUIRKS,
    STOPPED,
)
from .excuses import excuse

Json = dict[str, Any]

_NUMBER = re.compile(r"-?\d+(\.\d+)?")
_SHAPED = re.compile(r"<.*>|\[PRB:.*\]")
_STOP = re.compile("[!\x84\x85]|G38")
_HOLD = re.compile("[!\x84]")
_ON_STEP = 0.05
_STEP_MM = 0.0041  # recordings have 250 steps/mm
_SLOW_REST = re.compile(r"(?<=[|])(Bf:\d+|FS:(\d|0\.\d))(?=,)")
_FEED = re.compile(r"F\s*(\d+\.?\d*)|\$1[12]\d=(\d+)|\$2[45]=(\d+)", re.IGNORECASE)
_RAPID_MM_MIN = 500.0  # of the recordings, where they do not say otherwise
_STOP_MS = 10.0
_PLACE = re.compile(r"(?<=[:,])-?\d+\.\d+")


# Comparing a conversation


class _Line(NamedTuple):
    """A line expected, whether only its shape counts, and what had been sent."""

    text: str
    shape: bool
    sent: str


def _same_line(line: _Line, got: str, used: list[str]) -> bool:
    expected = line.text
    if expected == got:
        return True
    for difference in DIFFERENCES:
        if difference.rewrite(got, expected, line.sent) == expected:
            used.append(difference.name)
            return True
    if line.shape and _SHAPED.fullmatch(expected) and _SHAPED.fullmatch(got):
        return _NUMBER.sub("#", expected) == _NUMBER.sub("#", got)
    return False


def same_lines(expected: list[_Line], got: list[str], used: list[str]) -> bool:
    """Whether these lines came, but for differences, whose names are added to used."""
    return len(expected) == len(got) and all(
        _same_line(line, mine, used) for line, mine in zip(expected, got, strict=True)
    )


def expected_lines(step: Json) -> list[_Line]:
    """What a step has to be answered by."""
    shape = step.get("compare") == "shape"
    return [_Line(line, shape, step.get("send", "")) for line in step["expect"]]


def _judge_lines(steps: list[Json], got: list[Json], lenient: bool, used: list[str]) -> list[str]:
    wrong = []
    for number, (step, mine) in enumerate(zip(steps, got, strict=False)):
        if step.get("compare") == "info":
            continue
        if not same_lines(expected_lines(step), mine["lines"], used):
            if not _beside(steps[: number + 1], got[: number + 1], used):
                wrong.append(f"step {number}: lines")
        if "partial" in step and step["partial"] != mine["partial"]:
            wrong.append(f"step {number}: unfinished line")
    if wrong and (lenient or any(step["wait"].startswith("ms") for step in steps)):
        # What was still on the wire when a fixed time was over belongs to either step.
        required = [step for step in steps if step.get("compare") != "info"]
        if len(required) == len(steps) == len(got):
            expected = [line for step in steps for line in expected_lines(step)]
            if same_lines(expected, [line for mine in got for line in mine["lines"]], used):
                return []
    return wrong


def _with_late_alarms(steps: list[Json], got: list[Json], used: list[str]) -> list[Json]:
    """The replay, where an alarm at the end of a step begins the next one, as it was recorded."""
    late = [dict(mine) for mine in got]
    for (step, then), (mine, next_one) in zip(pairwise(steps), pairwise(late), strict=False):
        early = mine["lines"][len(step["expect"]) :]
        if len(early) == 1 and early[0].startswith("ALARM:") and early == then["expect"][:1]:
            mine["lines"], next_one["lines"] = mine["lines"][:-1], early + next_one["lines"]
            used.append(LATE_ALARM[0])
    return late


def _beside(steps: list[Json], got: list[Json], used: list[str]) -> bool:
    """Reports in motion or after a stop that differ by the place of a step or so."""
    expected, lines = steps[-1]["expect"], got[-1]["lines"]
    off = _places_off(expected, lines)
    if off is None:
        return False
    if off > _STEP_MM:
        return _stopped_beside(steps, off, used)
    if steps[-1].get("moving") and all(line.startswith("<Run") for line in expected):
        used.append(IN_MOTION[0])
        return True
    return _stopped_on_step(steps, got, used) or _stopped_beside(steps, off, used)


def _places_off(expected: list[str], lines: list[str]) -> float | None:
    """The largest difference of two places, in mm; None where anything else differs."""
    if len(expected) != len(lines):
        return None
    off = 0.0
    # A hold that rests a step before the end of a block has that block still, or has not.
    sides = [
        [_SLOW_REST.sub("#", line) if line.startswith("<Hold") else line for line in side]
        for side in (expected, lines)
    ]
    for theirs, ours in zip(*sides, strict=True):
        if _PLACE.sub("#", theirs) != _PLACE.sub("#", ours):
            return None
        pairs = zip(_PLACE.findall(theirs), _PLACE.findall(ours), strict=True)
        off = max([off, *(abs(float(a) - float(b)) for a, b in pairs)])
    return off


def _stopped_in_motion(steps: list[Json]) -> bool:
    """A hold, a jog cancel or an alarm has ended a motion before its end."""
    return any(
        (_STOP.search(step["send"]) or any(line.startswith("ALARM:") for line in step["expect"]))
        and (step.get("moving") or before.get("moving"))
        for before, step in zip([{}, *steps], steps, strict=False)
    )


def _way_mm(steps: list[Json]) -> float:
    """How far motion goes in the time that a stop may be earlier or later."""
    said = [
        float(next(filter(None, found))) for step in steps for found in _FEED.findall(step["send"])
    ]
    return max([_RAPID_MM_MIN, *said]) * _STOP_MS / 60_000


def _without_restarts(steps: list[Json], used: list[str]) -> list[Json]:
    """The recording, without the steps of a probe that has touched, by hand, while it was held."""
    still, held, touched = [], False, False
    for step in steps:
        held = held or bool(_HOLD.search(step["send"]))
        touched = touched or (held and "probe" in step.get("pins", {}))
        resumes = "~" in step["send"]
        if resumes and touched:
            used.append(HELD_CONTACT[0])
            still.append({**step, "moved": [0] * len(step.get("moved", ()))})
        else:
            still.append(step)
        if resumes:
            held = touched = False
    return still


def _judge_moves(steps: list[Json], got: list[Json], used: list[str]) -> list[str]:
    wrong = []
    steps = _without_restarts(steps, used)
    axes = len(got[0]["moved"]) if got else 0
    none = [0] * axes
    for number, (step, mine) in enumerate(zip(steps, got, strict=False)):
        if step.get("moving") or step.get("compare") == "info":
            continue
        moved = _padded(step.get("moved", none), axes)
        if "compare" not in step and not step.get("moved_varies"):
            if moved != mine["moved"] and not _exact_stop(
                steps[: number + 1], got[: number + 1], moved, used
            ):
                wrong.append(f"step {number}: moved")
        if not _same_outputs(step, mine, used):
            wrong.append(f"step {number}: outputs")
    if any(step.get("moved_varies") for step in steps) and not _rest_varies(steps):
        total = _total([_padded(step.get("moved", none), axes) for step in steps])
        mine_total = _total([mine["moved"] for mine in got])
        if total != mine_total:
            wrong.append(f"moved in all: {total}, got {mine_total}")
    return wrong


def _exact_stop(steps: list[Json], got: list[Json], moved: list[int], used: list[str]) -> bool:
    """Motion was stopped before its end, and what follows begins a step or so beside Grbl's."""
    off = max(abs(a - b) for a, b in zip(moved, got[-1]["moved"], strict=True))
    on_step = off <= 1 and _stopped_on_step(steps, got, used)
    return on_step or _stopped_beside(steps, off * _STEP_MM, used)


def _stopped_beside(steps: list[Json], off_mm: float, used: list[str]) -> bool:
    """Motion was stopped, and rests no further from Grbl's place than it may."""
    if _stopped_in_motion(steps) and off_mm <= _way_mm(steps):
        used.append(STOPPED[0])
        return True
    return False


def _stopped_on_step(steps: list[Json], got: list[Json], used: list[str]) -> bool:
    stops = False
    for step, mine in zip(steps, got, strict=True):
        stops = stops or bool(_STOP.search(step["send"]) or step.get("pins"))
        if stops and mine.get("off_step", 1) < _ON_STEP:
            used.append(EXACT_STOP[0])
            return True
    return False


def _same_outputs(step: Json, got: Json, used: list[str]) -> bool:
    """Outputs change as recorded; of the motors' enable pin see compare_motors.py."""
    expected, mine = [
        {name: level for name, level in out.items() if name != "enable_pin"}
        for out in (step.get("out", {}), got["out"])
    ]
    if expected == mine:
        return True
    if "spindle_on" in expected and "spindle_pwm" not in expected and "spindle_on" not in mine:
        del expected["spindle_on"]
        used.append(NO_SPEED[0])
    return expected == mine


def _total(moves: list[list[int]]) -> list[int]:
    return [sum(steps) for steps in zip(*moves)]


def _rest_varies(steps: list[Json]) -> bool:
    """Whether the recording itself says that the place where motion ends depends on timing."""
    reports = [step for step in steps if any(line.startswith("<") for line in step["expect"])]
    return not reports or "compare" in reports[-1]


def _padded(values: list[int], length: int) -> list[int]:
    return values + [0] * (length - len(values))


def judge_case(case: Json, observed: Json, used: list[str], lenient: bool = False) -> list[str]:
    """What is wrong with the replay of a transcript case; nothing if it conforms."""
    for quirk in QUIRKS:
        if quirk.case == case["name"] and "quirk" in case.get("tags", ()):
            used.append(quirk.name)
            return []
    wrong = trouble(observed)
    for item, mine in zip(case["setup"], observed.get("setup", ()), strict=False):
        step = item if isinstance(item, dict) else {"expect": item[1]}
        if "expect" in step and not same_lines(expected_lines(step), mine["lines"], used):
            wrong.append(f"setup {item[0] if isinstance(item, list) else item}: {mine['lines']}")
    steps = case["steps"]
    got = _with_late_alarms(steps, observed.get("steps", []), used)
    if len(got) < len(steps):
        wrong.append(f"stopped in step {len(got) - 1} of {len(steps)}")
    wrong += _judge_lines(steps, got, lenient, used)
    if not lenient:
        wrong += _judge_moves(steps, got, used)
    if wrong and excuse(case, observed, used):
        wrong = []
    return wrong if lenient else wrong + judge_motors(case, observed, used)


def trouble(observed: Json) -> list[str]:
    """Why a replay is not one at all."""
    wrong = []
    if "error" in observed:
        wrong.append(str(observed["error"]).strip())
    if observed.get("too_long"):
        wrong.append("a wait took too long")
    return wrong
