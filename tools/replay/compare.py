"""Judge replays of recordings by the rules of their FORMAT.md.

judge_case() is for conversations, compare_motion.judge_motion() for motion records. Both return
what is wrong, in words, and add to `used` the names of the known differences that they ignored.

A case has `setup` (lines with their answers) and `steps`. A recorded step has:
    send, wait, expect   characters sent, what ended the step, lines received in it
    moved, out           steps per axis, outputs that changed (name: level)
    compare              "shape": numbers in reports may differ; "info": nothing is compared
    moving               motors ran at its begin or end: moves and outputs are not compared
    moved_varies         only the sum of the moves of the whole case is compared
A step of the replay (`mine`, in `got`) has lines, partial (an unfinished line), moved and out.
`places`: the comparison of moves and positions of all steps, see compare_places.py.
"""

import re
from itertools import pairwise
from typing import Any, NamedTuple

from .compare_motors import judge_motors
from .compare_places import Places, padded
from .differences import (
    DIFFERENCES,
    LATE_ALARM,
    NO_SPEED,
    QUIRKS,
)
from .known_differences import explain_case

Json = dict[str, Any]

# If only the shape counts: any numbers, but equal overrides, and equal speed of a spindle.
_OVERRIDES = re.compile(r"Ov:[\d,]+")
_SPEED = re.compile(r"(?<=FS:)[\d.]+,(\d+)")
_NUMBER = re.compile(r"-?\d+(\.\d+)?")
_SHAPED = re.compile(r"<.*>|\[PRB:.*\]")


# Comparing a conversation


class _Line(NamedTuple):
    """An expected line, whether only its shape counts, what had been sent, and whether it is from
    a laser, whose reported speed changes from moment to moment."""

    text: str
    shape: bool
    sent: str
    lasers: bool


def _same_line(line: _Line, got: str, used: list[str]) -> bool:
    """Return whether a line was received as expected, or differs in a known way."""
    expected = line.text
    if expected == got:
        return True
    for difference in DIFFERENCES:  # rewrite() turns our line into Grbl's
        if difference.rewrite(got, expected, line.sent) == expected:
            used.append(difference.name)
            return True
    if line.shape and _SHAPED.fullmatch(expected) and _SHAPED.fullmatch(got):
        return _shape(line, expected) == _shape(line, got)
    return False


def _shape(line: _Line, text: str) -> tuple[str, list[str]]:
    """Return a text with # for each number, and the numbers that must be equal all the same."""
    exact = _OVERRIDES.findall(text) + ([] if line.lasers else _SPEED.findall(text))
    return _NUMBER.sub("#", text), exact


def same_lines(expected: list[_Line], got: list[str], used: list[str]) -> bool:
    """Return whether these lines were received, apart from known differences, whose names are
    added to `used`."""
    return len(expected) == len(got) and all(
        _same_line(line, mine, used) for line, mine in zip(expected, got, strict=True)
    )


def expected_lines(step: Json, lasers: bool = False) -> list[_Line]:
    """Return the lines that must answer a step."""
    shape = step.get("compare") == "shape"
    return [_Line(line, shape, step.get("send", ""), lasers) for line in step["expect"]]


def _judge_lines(
    steps: list[Json], got: list[Json], places: Places, lenient: bool, used: list[str]
) -> list[str]:
    """Return a message for each step whose lines differ. steps: as recorded; got: as replayed.

    lenient: a line may also come in any other step, as long as the order is the same.
    """
    wrong = []
    for number, (step, mine) in enumerate(zip(steps, got, strict=False)):
        if step.get("compare") == "info":
            continue
        if not same_lines(expected_lines(step, places.lasers), mine["lines"], used):
            if not places.same_reports(number, used):
                wrong.append(f"step {number}: lines")
        if "partial" in step and step["partial"] != mine["partial"]:
            wrong.append(f"step {number}: unfinished line")
    if wrong and _same_but_later(steps, got, places.lasers, lenient, used):
        return []
    return wrong


def _same_but_later(
    steps: list[Json], got: list[Json], lasers: bool, lenient: bool, used: list[str]
) -> bool:
    """Return whether all lines together are the same, and lines are only in other steps.

    A line may be one step earlier or later if the first of the two steps lasts a fixed time
    (wait "ms"), because a line that was on the wire at its end belongs to either. lenient: it may
    be in any step.
    """
    if len(steps) != len(got) or any(step.get("compare") == "info" for step in steps):
        return False
    theirs = [(line, n) for n, step in enumerate(steps) for line in expected_lines(step, lasers)]
    ours = [(line, n) for n, mine in enumerate(got) for line in mine["lines"]]
    if not same_lines([line for line, _ in theirs], [line for line, _ in ours], used):
        return False
    shifts = {
        (min(a, b), max(a, b)) for (_, a), (_, b) in zip(theirs, ours, strict=True) if a != b
    }
    return lenient or all(
        last == first + 1 and steps[first]["wait"].startswith("ms") for first, last in shifts
    )


def _with_late_alarms(steps: list[Json], got: list[Json], used: list[str]) -> list[Json]:
    """Return the replay, with each alarm that Grbl reported only in the next step moved there."""
    moved = [dict(mine) for mine in got]
    for (step, next_step), (mine, next_mine) in zip(
        pairwise(steps), pairwise(moved), strict=False
    ):
        surplus = mine["lines"][len(step["expect"]) :]
        is_alarm = len(surplus) == 1 and surplus[0].startswith("ALARM:")
        if is_alarm and surplus == next_step["expect"][:1]:
            mine["lines"] = mine["lines"][:-1]
            next_mine["lines"] = surplus + next_mine["lines"]
            used.append(LATE_ALARM[0])
    return moved


def _judge_moves(steps: list[Json], got: list[Json], places: Places, used: list[str]) -> list[str]:
    """Return a message for each step whose moves or outputs differ. If the moves of single steps
    may vary, their sum must be equal."""
    wrong = []
    axes = places.axes
    for number, (step, mine) in enumerate(zip(steps, got, strict=False)):
        if step.get("moving") or step.get("compare") == "info":
            continue
        if "compare" not in step and not step.get("moved_varies"):
            if number in places.wrong:
                wrong.append(f"step {number}: moved")
            elif number in places.reasons:
                used.append(places.reasons[number])
        if not _same_outputs(step, mine, used):
            wrong.append(f"step {number}: outputs")
    if any(step.get("moved_varies") for step in steps) and not _final_position_varies(steps):
        total = _total([padded(step.get("moved", []), axes) for step in steps])
        mine_total = _total([mine["moved"] for mine in got])
        if total != mine_total and not places.are_explained(used):
            wrong.append(f"moved in all: {total}, got {mine_total}")
    return wrong


def _same_outputs(step: Json, got: Json, used: list[str]) -> bool:
    """Return whether outputs change as recorded; the motors' enable pin is judged in
    compare_motors.py."""
    expected, mine = [
        {name: level for name, level in out.items() if name != "enable_pin"}
        for out in (step.get("out", {}), got["out"])
    ]
    if expected == mine:
        return True
    # M3 without a speed: Grbl 0.9 connects a PWM without power to the pin; we do not.
    if "spindle_on" in expected and "spindle_pwm" not in expected and "spindle_on" not in mine:
        del expected["spindle_on"]
        used.append(NO_SPEED[0])
    return expected == mine


def _total(moves: list[list[int]]) -> list[int]:
    """Return the sum of moves, per axis."""
    return [sum(steps) for steps in zip(*moves)]


def _final_position_varies(steps: list[Json]) -> bool:
    """Return whether, according to the recording itself, the final position depends on timing."""
    reports = [step for step in steps if any(line.startswith("<") for line in step["expect"])]
    return not reports or "compare" in reports[-1]


def judge_case(case: Json, observed: Json, used: list[str], lenient: bool = False) -> list[str]:
    """Return what is wrong with the replay of a transcript case; empty if it conforms.

    lenient: for a device with other timing: only the lines of the whole case are compared.
    """
    for quirk in QUIRKS if "quirk" in case.get("tags", ()) else ():
        quirk_begin = quirk.begins(case["steps"])
        if quirk_begin is not None:  # compare only the steps before it
            used.append(quirk.name)
            case = {**case, "steps": case["steps"][:quirk_begin]}
            observed = {**observed, "steps": observed.get("steps", [])[:quirk_begin]}
    wrong = trouble(observed)
    for item, mine in zip(case["setup"], observed.get("setup", ()), strict=False):
        # The short form of an item is a line with its answers.
        step = item if isinstance(item, dict) else {"expect": item[1]}
        if "expect" in step and not same_lines(expected_lines(step), mine["lines"], used):
            wrong.append(f"setup {item[0] if isinstance(item, list) else item}: {mine['lines']}")
    steps = case["steps"]
    got = _with_late_alarms(steps, observed.get("steps", []), used)
    if len(got) < len(steps):
        wrong.append(f"stopped in step {len(got) - 1} of {len(steps)}")
    places = Places(case["setup"], steps, got)
    wrong += _judge_lines(steps, got, places, lenient, used)
    if not lenient:
        wrong += _judge_moves(steps, got, places, used)
    if wrong and explain_case(case, observed, wrong, places.wrong, used):
        wrong = []
    return wrong if lenient else wrong + judge_motors(case, observed, used)


def trouble(observed: Json) -> list[str]:
    """Return why a replay is incomplete."""
    wrong = []
    if "error" in observed:
        wrong.append(str(observed["error"]).strip())
    if observed.get("too_long"):
        wrong.append("a wait took too long")
    return wrong
