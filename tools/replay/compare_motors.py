"""Judge the motors' enable pin in a replayed conversation: see compare.py.

The level at the end of each step counts. Imports nothing from compare.py.
"""

import re
from typing import Any

from .differences import HELD, IDLE_DELAY
from .known_differences import SLOW

Json = dict[str, Any]

_SETTING = re.compile(r"^\$(?:1=(\d+)|RST=[$*])", re.IGNORECASE | re.MULTILINE)
_DEFAULT_MS, _FOR_EVER = 25, 255
_ON, _OFF = 0, 1  # levels; inverted with $4=1


def judge_motors(case: Json, observed: Json, used: list[str]) -> list[str]:
    """Return what is wrong with the enable pin; adds the names of the differences it ignored."""
    steps, got = case["steps"], observed.get("steps", [])
    start = [_OFF, *_levels([step["out"] for step in observed.get("setup", [])], _OFF)][-1]
    ours = _levels([step["out"] for step in got], start)
    changes = [step.get("out", {}) for step in steps]
    first = next((change["enable_pin"] for change in changes if "enable_pin" in change), None)
    if first is not None:
        start = 1 - first
    theirs = _levels(changes, start)
    delays = _delays(case)
    wrong = [
        f"step {number}: moved without power"
        for number, step in enumerate(got)
        if step["unpowered"]
    ]
    for number, (step, level) in enumerate(zip(steps, ours, strict=False)):
        if level == theirs[number] or step.get("moving") or step.get("compare") == "info":
            continue
        is_last = number + 1 == len(ours)
        late = (
            level == [start, *theirs][number]
            if is_last
            else ours[number + 1] == theirs[number + 1]
        )
        if late and delays[number] != _FOR_EVER:
            used.append(IDLE_DELAY[0])
        elif (
            delays[number] == _FOR_EVER
            and level == _ON
            and _stopped_by_switch(steps[: number + 1])
        ):
            used.append(HELD[0])
        elif (
            level == _ON and got[number]["moving"] and SLOW.begins(steps[: number + 1]) is not None
        ):
            used.append(SLOW.name)
        else:
            wrong.append(f"step {number}: motors")
    return wrong


def _levels(changes: list[Json], level: int) -> list[int]:
    """Return the level after each of these changes."""
    levels = []
    for change in changes:
        level = change.get("enable_pin", level)
        levels.append(level)
    return levels


def _delays(case: Json) -> list[int]:
    """Return $1 at the end of each step."""
    delay, delays = _DEFAULT_MS, []
    for item in [*case["setup"], *case["steps"]]:
        sent = item[0] if isinstance(item, list) else item["send"]
        for found in _SETTING.finditer(sent):
            delay = int(found[1]) % 256 if found[1] else _DEFAULT_MS
        delays.append(delay)
    return delays[len(case["setup"]) :]


def _stopped_by_switch(steps: list[Json]) -> bool:
    """Return whether a limit switch has stopped the machine without a reset since."""
    lines = [line for step in steps for line in step["expect"]]
    banner = max([i for i, line in enumerate(lines) if line.startswith("Grbl")], default=-1)
    return "ALARM:1" in lines[banner + 1 :]
