"""Known differences: cases in which a recording is not copied, so fewer things must be equal.

Only a case that does not conform is looked up here. In a conversation, everything before the line
with the difference is as recorded; after it every answer, the number of status reports, outputs,
and positions at standstill. In a motion record, replies, final position, pulses and path are as
recorded; and the time is within the limits of the row. Cases and records: see compare.py and
compare_motion.py.
"""

import math
import re
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

Json = dict[str, Any]

_AXIS = re.compile(r"([XYZ])\s*(-?\d*\.?\d+)", re.IGNORECASE)
_FEED = re.compile(r"F\s*(\d*\.?\d+)", re.IGNORECASE)
_PER_MM = re.compile(r"\$10([0-2])=(\d+\.?\d*)")
_END = "[MSG:Pgm End]"
_STARTUP_JOG = re.compile(r"\$N\d=\$J", re.IGNORECASE)
_OF_STARTUP = re.compile(r"\$N\d=|>\$J")
_READS = re.compile(r"^\$[$#IN]$", re.MULTILINE | re.IGNORECASE)
_LISTED = re.compile(r"\$N?\d+=|\[(G\d\d:|TLO:|PRB:|VER:|OPT:|0\.9)")
_REFUSED = {"error:8", "error: Not idle"}
_STEP = re.compile(r"step (\d+): ")
_REPEATED = re.compile("([\x90-\x9d]).*\\1")

_SLOWEST_HZ = 30.5  # Grbl makes no fewer steps/s
_STEPS_PER_MM = 250.0  # of the recordings, unless they set another value
_BLOCKS = 15  # capacity of Grbl's planner
_STARVED_MS = 12.0  # time of the AVR for a block, with its line on the wire


class CaseDifference(NamedTuple):
    """A row. begins: returns the first step that it applies to, if any. counted: the lines of a
    step that must be equal. stands: the machine does not make the moves that Grbl makes."""

    name: str
    reason: str
    begins: Callable[[list[Json]], int | None]
    counted: Callable[[Json, list[str]], list[str]] = lambda _step, lines: lines
    stands: bool = False


class MotionDifference(NamedTuple):
    """A row for motion records. longest: returns the longest duration relative to Grbl's; 0 if the
    row does not apply. shortest: the shortest relative duration."""

    name: str
    reason: str
    longest: Callable[[Json], float]
    shortest: float


def _blocks(lines: list[str]) -> Iterator[tuple[int, float, float]]:
    """Yield (index, ms, steps/s of the axis with most steps) of each line that moves at a feed
    rate. Only the G-code of these cases is parsed."""
    position = {"X": 0.0, "Y": 0.0, "Z": 0.0}
    per_mm = dict.fromkeys(position, _STEPS_PER_MM)
    feed = 0.0  # in mm/min; in moves per minute after G93
    is_relative = is_inverse_time = False
    for number, line in enumerate(lines):
        text = line.upper()
        for axis, steps in _PER_MM.findall(text):
            per_mm["XYZ"[int(axis)]] = float(steps)
        is_relative = "G91" in text or (is_relative and "G90" not in text)
        is_inverse_time = "G93" in text or (is_inverse_time and "G94" not in text)
        if match := _FEED.search(text):
            feed = float(match[1])
        before = dict(position)
        for axis, mm in _AXIS.findall(text):
            position[axis] = float(mm) + (position[axis] if is_relative else 0.0)
        distance_mm = math.dist(position.values(), before.values())
        minutes = 0.0 if not feed else 1 / feed if is_inverse_time else distance_mm / feed
        if distance_mm and minutes and not text.startswith(("$", "G0")):
            steps = max(abs(position[axis] - before[axis]) * per_mm[axis] for axis in position)
            yield number, minutes * 60_000, steps / minutes / 60


def _slow_step(steps: list[Json]) -> int | None:
    """Return the step that sends the first motion slower than _SLOWEST_HZ; None if there is
    none."""
    lines = [
        (line, number) for number, step in enumerate(steps) for line in step["send"].split("\n")
    ]
    slow = (index for index, _, hz in _blocks([line for line, _ in lines]) if hz < _SLOWEST_HZ)
    return next((lines[index][1] for index in slow), None)


def _slow(record: Json) -> float:
    """Return how much longer a record with motion slower than _SLOWEST_HZ may take; 0 without."""
    rates = [hz for _, _, hz in _blocks(record["settings"] + record["program"])]
    slowest = min(rates, default=_SLOWEST_HZ)
    return 1.1 * _SLOWEST_HZ / slowest if slowest < _SLOWEST_HZ else 0.0


def _starved(record: Json) -> float:
    """Return the longest duration, relative to Grbl's, of a record with _BLOCKS blocks in a row
    that an AVR cannot plan in time; 0 for others."""
    ms = [ms for _, ms, _ in _blocks(record["program"])]
    in_planner = [ms[i : i + _BLOCKS] for i in range(len(ms) - _BLOCKS)]
    is_starved = any(sum(blocks_ms) < _BLOCKS * _STARVED_MS for blocks_ms in in_planner)
    return 1.01 if is_starved else 0.0  # not longer, with a tolerance of 1 %


def _burst(record: Json) -> float:
    """Return the longest duration, relative to Grbl's, of a record with several equal overrides at
    once; 0 for others."""
    events = record.get("events_ms_after_first_step", ())
    return 2.0 if any(_REPEATED.search(sent) for _, sent in events) else 0.0


def _pause_step(steps: list[Json]) -> int | None:
    """Return the step in which a reset or the door interrupts homing, and Grbl reports ALARM:8."""
    has_homed = False  # $H was sent
    for n, step in enumerate(steps):
        has_homed = has_homed or step["send"].startswith("$H")
        if has_homed and "ALARM:8" in step["expect"] and _pause_alarm(step):
            return n
    return None


def _pause_alarm(step: Json) -> str:
    """Return our alarm for such a step; "" for others."""
    if "\x18" in step["send"]:
        return "ALARM:6"
    return "ALARM:7" if "\x84" in step["send"] or step.get("pins") else ""


def _pause(step: Json, lines: list[str]) -> list[str]:
    """Return the lines with Grbl's alarm in place of ours."""
    return ["ALARM:8" if line == _pause_alarm(step) else line for line in lines]


def _startup_jog_step(steps: list[Json]) -> int | None:
    """Return the step that stores a jog as a startup line."""
    return next((n for n, step in enumerate(steps) if _STARTUP_JOG.match(step["send"])), None)


def _without_startup(step: Json, lines: list[str]) -> list[str]:
    """Return the lines without those of startup lines; any answer to storing one is right."""
    lines = [line for line in lines if not _OF_STARTUP.match(line)]
    return ["an answer", *lines[1:]] if lines and _STARTUP_JOG.match(step["send"]) else lines


def _cut_step(steps: list[Json]) -> int | None:
    """Return the step in which a reset cuts a program's end short."""
    cut = (n for n, step in enumerate(steps) if step["expect"][:2] == ["ALARM:3", _END])
    return next(cut, None)


def _without_end(_step: Json, lines: list[str]) -> list[str]:
    """Return the lines without Grbl's message that the program has ended."""
    return [lines[0], *lines[2:]] if lines[:2] == ["ALARM:3", _END] else lines


def _read_step(steps: list[Json]) -> int | None:
    """Return the step in which Grbl refuses, in motion, a command that only reads."""
    was_sent = False
    for number, step in enumerate(steps):
        was_sent = was_sent or bool(_READS.search(step["send"]))
        if was_sent and not _REFUSED.isdisjoint(step["expect"]):
            return number
    return None


def _without_listings(_step: Json, lines: list[str]) -> list[str]:
    """Return the lines with the word "refused" in place of each listing with its ok, and of each
    refusal, because both are right."""
    result: list[str] = []
    for line in lines:
        ends_listing = line == "ok" and result and _LISTED.match(result[-1])
        while ends_listing and result and _LISTED.match(result[-1]):
            result.pop()
        result.append("refused" if ends_listing or line in _REFUSED else line)
    return result


_SLOW = (
    "slow motion",
    "Grbl makes at least 30.5 steps/s; we run slower feeds as commanded, with motors on until the "
    "motion ends.",
)
SLOW = CaseDifference(*_SLOW, _slow_step)

CASES = (
    SLOW,
    CaseDifference(
        "pause of homing",
        "A reset or the door between two moves of homing is ALARM:6 or 7, and nothing moves any "
        "more; Grbl begins the way back, finds the switch still closed, and says ALARM:8.",
        _pause_step,
        _pause,
        stands=True,
    ),
    CaseDifference(
        "jog as a startup line",
        "$N0=$J= is refused; Grbl keeps it, and moves at each start.",
        _startup_jog_step,
        _without_startup,
        stands=True,
    ),
    CaseDifference(
        "read in motion",
        "$I, $$, $# and $N are answered in motion, for a sender that connects then; Grbl, which "
        "starts anew when its port is opened, says error:8.",
        _read_step,
        _without_listings,
    ),
    CaseDifference(
        "program end after a reset",
        "An M2 or M30 that a reset has cut short does not say that the program has ended.",
        _cut_step,
        _without_end,
    ),
)

MOTIONS = (
    MotionDifference(*_SLOW, _slow, 0.9),
    MotionDifference(
        "each override",
        "Each byte of a burst of overrides counts; Grbl may take two of a kind for one.",
        _burst,
        0.5,
    ),
    MotionDifference(
        "starved planner",
        "Blocks of a few milliseconds arrive faster than an AVR can plan them, but not faster "
        "than we can: with more blocks planned ahead, the same path is faster.",
        _starved,
        0.2,
    ),
)


def explain_case(
    case: Json, observed: Json, wrong: list[str], wrong_moves: set[int], used: list[str]
) -> bool:
    """Return whether a row of CASES explains everything wrong with a case; adds the row's name to
    `used`.

    wrong: messages, "step 3: …" if they are about a step. wrong_moves: the steps whose moves
    differ without a reason.
    """
    steps, got = case["steps"], observed.get("steps", [])
    in_steps = [_STEP.match(problem) for problem in wrong]  # None: not about a step
    if len(steps) != len(got):
        return False
    for row in CASES:
        first = row.begins(steps)
        if first is None or not all(match and int(match[1]) >= first for match in in_steps):
            continue
        theirs = _answers(row, steps, [step["expect"] for step in steps])
        ours = _answers(row, steps, [mine["lines"] for mine in got])
        if theirs != ours:
            continue
        moves_differ = any(number >= first for number in wrong_moves)
        if _ends_alike(row, steps[first:], got[first:], moves_differ):
            used.append(row.name)
            return True
    return False


def _answers(
    row: CaseDifference, steps: list[Json], lines_of_steps: list[list[str]]
) -> tuple[list[str], int]:
    """Return what must be equal of all output: the lines that count in this row, without status
    reports, and the number of these."""
    lines = [
        line
        for step, received in zip(steps, lines_of_steps, strict=True)
        for line in row.counted(step, received)
    ]
    reports = [line for line in lines if line.startswith("<")]
    return [line for line in lines if not line.startswith("<")], len(reports)


def _ends_alike(
    row: CaseDifference, steps: list[Json], got: list[Json], moves_differ: bool
) -> bool:
    """Return whether outputs end as recorded, and so do axes whose moves differ, if they stand
    still. If they still move, none is further than recorded."""
    their_levels: dict[str, int] = {}
    our_levels: dict[str, int] = {}
    for step, mine in zip(steps, got, strict=True):
        their_levels.update(step.get("out", {}))
        our_levels.update(mine["out"])
    for levels in (their_levels, our_levels):
        levels.pop("enable_pin", None)  # judged in compare_motors.py
    if their_levels != our_levels:
        return False
    if not moves_differ:
        return True
    axes = range(len(got[0]["moved"]))
    theirs = [sum((step.get("moved") or [0] * len(axes))[axis] for step in steps) for axis in axes]
    ours = [sum(mine["moved"][axis] for mine in got) for axis in axes]
    if row.stands:  # we must not move in the first step; later moves are not compared
        return not any(got[0]["moved"])
    if got[-1]["moving"] or steps[-1].get("moving"):
        return all(min(a, 0) <= b <= max(a, 0) for a, b in zip(theirs, ours, strict=True))
    return all(abs(a - b) <= 1 for a, b in zip(theirs, ours, strict=True))


def explain_motion(record: Json, observed: Json, used: list[str]) -> bool:
    """Return whether the table explains times and rates that differ from Grbl's, and they are
    within its limits; adds the name to `used`."""
    relative_duration = observed["duration_s"] / record["duration_s"]
    for row in MOTIONS:
        if row.shortest <= relative_duration <= row.longest(record):
            used.append(row.name)
            return True
    return False
