"""Judge the motors' enable pin in a replayed conversation: see compare.py.

The level at the end of each step counts. A motor may be released one step later than Grbl does
(IDLE_DELAY), and stays on in some known cases (HELD, SLOW). Imports nothing from compare.py.
"""

import re
from typing import Any

from .differences import HELD, IDLE_DELAY
from .known_differences import SLOW

Json = dict[str, Any]

_SETTING = re.compile(r"^\$(?:1=(\d+)|RST=[$*])", re.IGNORECASE | re.MULTILINE)
_DEFAULT_MS = 25  # $1
_FOR_EVER = 255  # value of $1 with which motors stay on
_ON = 0  # level of the enable pin
_OFF = 1


def judge_motors(case: Json, observed: Json, used: list[str]) -> list[str]:
    """Return what is wrong with the enable pin; adds to `used` the names of the differences it
    ignored."""
    steps, got = case["steps"], observed.get("steps", [])
    start = [_OFF, *_levels([step["out"] for step in observed.get("setup", [])], _OFF)][-1]
    ours = _levels([step["out"] for step in got], start)
    changes = [step.get("out", {}) for step in steps]
    first = next((change["enable_pin"] for change in changes if "enable_pin" in change), None)
    if first is not None:  # before its first change, Grbl's level was the other one
        start = 1 - first
    theirs = _levels(changes, start)
    delays_ms = _delays_ms(case)
    wrong = [
        f"step {number}: moved without power"
        for number, step in enumerate(got)
        if step["unpowered"]
    ]
    for number, (step, level) in enumerate(zip(steps, ours, strict=False)):
        if level == theirs[number] or step.get("moving") or step.get("compare") == "info":
            continue
        is_last = number + 1 == len(ours)
        if is_last:  # the level that Grbl had before this step
            is_one_step_late = level == [start, *theirs][number]
        else:
            is_one_step_late = ours[number + 1] == theirs[number + 1]
        stays_on = delays_ms[number] == _FOR_EVER
        steps_so_far = steps[: number + 1]
        if is_one_step_late and not stays_on:
            used.append(IDLE_DELAY[0])
        elif stays_on and level == _ON and _stopped_by_switch(steps_so_far):
            used.append(HELD[0])
        elif level == _ON and got[number]["moving"] and SLOW.begins(steps_so_far) is not None:
            used.append(SLOW.name)
        else:
            wrong.append(f"step {number}: motors")
    return wrong


def _levels(changes: list[Json], level: int) -> list[int]:
    """Return the enable pin's level after each of these changes of outputs. level: before them."""
    levels = []
    for change in changes:
        level = change.get("enable_pin", level)
        levels.append(level)
    return levels


def _delays_ms(case: Json) -> list[int]:
    """Return $1 at the end of each step: the delay before motors are released, or _FOR_EVER."""
    delay, delays = _DEFAULT_MS, []
    for item in [*case["setup"], *case["steps"]]:
        sent = item[0] if isinstance(item, list) else item["send"]
        for found in _SETTING.finditer(sent):
            # Grbl stores a byte. Without a number it is $RST, which restores the default.
            delay = int(found[1]) % 256 if found[1] else _DEFAULT_MS
        delays.append(delay)
    return delays[len(case["setup"]) :]


def _stopped_by_switch(steps: list[Json]) -> bool:
    """Return whether a limit switch has stopped the machine without a reset since."""
    lines = [line for step in steps for line in step["expect"]]
    banner = max([i for i, line in enumerate(lines) if line.startswith("Grbl")], default=-1)
    return "ALARM:1" in lines[banner + 1 :]
