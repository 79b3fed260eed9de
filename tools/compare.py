"""Judges replays of recordings by the rules of their FORMAT.md.

judge_case() for conversations, judge_motion() for motion records: both return
what is wrong, in words, and add the names of the differences they overlooked.
"""

import re
from typing import Any, NamedTuple

from .differences import (
    BROKEN_OFF,
    DIFFERENCES,
    EXACT_STOP,
    IDLE_DELAY,
    IN_MOTION,
    NO_SPEED,
    QUIRKS,
)
from .excuses import excuse, excuse_motion

Json = dict[str, Any]

_NUMBER = re.compile(r"-?\d+(\.\d+)?")
_SHAPED = re.compile(r"<.*>|\[PRB:.*\]")
_SETTING_STEPS = re.compile(r"\$10([0-5])=([\d.]+)")
_AXIS_WORD = re.compile(r"([XYZABC])\s*(-?\d*\.?\d+)", re.IGNORECASE)
_MM_PER_INCH = 25.4
_STOP = re.compile("[!\x84\x85]|G38")
_ON_STEP = 0.05
_STEP_MM = 0.0041  # recordings have 250 steps/mm
_SLOW_REST = re.compile(r"^(<Hold:0.*\|FS:)[1-5](?=,)")
_FEED = re.compile(r"F\s*(\d+\.?\d*)|\$1[12]\d=(\d+)|\$2[45]=(\d+)", re.IGNORECASE)
_RAPID_MM_MIN = 500.0  # of the recordings, where they do not say otherwise
_BROKEN_OFF_MS = 5.0
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


def _same_lines(expected: list[_Line], got: list[str], used: list[str]) -> bool:
    return len(expected) == len(got) and all(
        _same_line(line, mine, used) for line, mine in zip(expected, got, strict=True)
    )


def _expected_lines(step: Json) -> list[_Line]:
    shape = step.get("compare") == "shape"
    return [_Line(line, shape, step.get("send", "")) for line in step["expect"]]


def _judge_lines(steps: list[Json], got: list[Json], lenient: bool, used: list[str]) -> list[str]:
    wrong = []
    for number, (step, mine) in enumerate(zip(steps, got, strict=False)):
        if step.get("compare") == "info":
            continue
        if not _same_lines(_expected_lines(step), mine["lines"], used):
            if not _beside(steps[: number + 1], got[: number + 1], used):
                wrong.append(f"step {number}: lines")
        if "partial" in step and step["partial"] != mine["partial"]:
            wrong.append(f"step {number}: unfinished line")
    if wrong and (lenient or any(step["wait"].startswith("ms") for step in steps)):
        # What was still on the wire when a fixed time was over belongs to either step.
        required = [step for step in steps if step.get("compare") != "info"]
        if len(required) == len(steps) == len(got):
            expected = [line for step in steps for line in _expected_lines(step)]
            if _same_lines(expected, [line for mine in got for line in mine["lines"]], used):
                return []
    return wrong


def _beside(steps: list[Json], got: list[Json], used: list[str]) -> bool:
    """Reports in motion or after a stop that differ by the place of a step or so."""
    expected, lines = steps[-1]["expect"], got[-1]["lines"]
    off = _places_off(expected, lines)
    if off is None:
        return False
    if _broken_off(steps) and off <= _way_mm(steps):
        used.append(BROKEN_OFF[0])
        return True
    if off > _STEP_MM:
        return False
    if steps[-1].get("moving") and all(line.startswith("<Run") for line in expected):
        used.append(IN_MOTION[0])
        return True
    return _stopped_on_step(steps, got, used)


def _places_off(expected: list[str], lines: list[str]) -> float | None:
    """The largest difference of two places, in mm; None where anything else differs."""
    if len(expected) != len(lines):
        return None
    off = 0.0
    # A hold that rests a step before the end of a block may say that it is not quite at rest.
    sides = [[_SLOW_REST.sub(r"\g<1>0", line) for line in side] for side in (expected, lines)]
    for theirs, ours in zip(*sides, strict=True):
        if _PLACE.sub("#", theirs) != _PLACE.sub("#", ours):
            return None
        pairs = zip(_PLACE.findall(theirs), _PLACE.findall(ours), strict=True)
        off = max([off, *(abs(float(a) - float(b)) for a, b in pairs)])
    return off


def _broken_off(steps: list[Json]) -> bool:
    """An alarm has ended a motion."""
    return any(
        any(line.startswith("ALARM:") for line in step["expect"])
        and (step.get("moving") or before.get("moving"))
        for before, step in zip([{}, *steps], steps, strict=False)
    )


def _way_mm(steps: list[Json]) -> float:
    """How far motion may have gone before it was broken off a little earlier or later."""
    said = [
        float(next(filter(None, found))) for step in steps for found in _FEED.findall(step["send"])
    ]
    return max([_RAPID_MM_MIN, *said]) * _BROKEN_OFF_MS / 60_000


def _judge_moves(steps: list[Json], got: list[Json], used: list[str]) -> list[str]:
    wrong = []
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
        if not _same_outputs(steps, got, number, used):
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
    if _broken_off(steps) and off * _STEP_MM <= _way_mm(steps):
        used.append(BROKEN_OFF[0])
        return True
    return off <= 1 and _stopped_on_step(steps, got, used)


def _stopped_on_step(steps: list[Json], got: list[Json], used: list[str]) -> bool:
    stops = False
    for step, mine in zip(steps, got, strict=True):
        stops = stops or bool(_STOP.search(step["send"]) or step.get("pins"))
        if stops and mine.get("off_step", 1) < _ON_STEP:
            used.append(EXACT_STOP[0])
            return True
    return False


def _same_outputs(steps: list[Json], got: list[Json], number: int, used: list[str]) -> bool:
    """Outputs change as recorded; the motors' enable pin may be a step of the case late."""
    expected, mine = dict(steps[number].get("out", {})), dict(got[number]["out"])
    if expected == mine:
        return True
    if "spindle_on" in expected and "spindle_pwm" not in expected and "spindle_on" not in mine:
        del expected["spindle_on"]
        used.append(NO_SPEED[0])
        if expected == mine:
            return True
    expected.pop("enable_pin", None)
    mine.pop("enable_pin", None)
    if expected != mine:
        return False
    used.append(IDLE_DELAY[0])
    before = max(0, number - 1)
    after = number + 2
    changes = [
        step["out"]["enable_pin"]
        for step in steps[before:after]
        if "enable_pin" in step.get("out", {})
    ]
    ours = [step["out"]["enable_pin"] for step in got[before:after] if "enable_pin" in step["out"]]
    return bool(changes and ours) and (changes[0] == ours[0] or changes[-1] == ours[-1])


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
        if "expect" in step and not _same_lines(_expected_lines(step), mine["lines"], used):
            wrong.append(f"setup {item[0] if isinstance(item, list) else item}: {mine['lines']}")
    steps, got = case["steps"], observed.get("steps", [])
    if len(got) < len(steps):
        wrong.append(f"stopped in step {len(got) - 1} of {len(steps)}")
    wrong += _judge_lines(steps, got, lenient, used)
    if not lenient:
        wrong += _judge_moves(steps, got, used)
    return [] if wrong and excuse(case, observed, used) else wrong


def trouble(observed: Json) -> list[str]:
    wrong = []
    if "error" in observed:
        wrong.append(str(observed["error"]).strip())
    if observed.get("too_long"):
        wrong.append("a wait took too long")
    return wrong


# Comparing motion

_TIME_SHARE, _TIME_S = 0.01, 0.020
_RATE_SHARE = 0.02
_SLACK_MS = 15.0
_SLACK_STEPS = 2.0
_REST_MS = 50.0
_HALF_STEP_DOUBT = 0.001


def judge_motion(record: Json, observed: Json, used: list[str]) -> list[str]:
    """What is wrong with the replay of a motion record; nothing if it conforms."""
    wrong = trouble(observed)
    replies = [_Line(line, False, "") for line in record["replies"]]
    if any(line != "ok" for line in observed["settings"]):
        wrong.append(f"settings: {observed['settings']}")
    if not _same_lines(replies, observed["replies"], used):
        wrong.append(f"replies: {observed['replies']}, expected {record['replies']}")
    doubtful = _half_step_axes(record)
    if not doubtful and observed["final_report"] != record["final_report"]:
        wrong.append(f"final {observed['final_report']}, expected {record['final_report']}")
    for what in ("net_steps", "pulses"):
        for axis, count in record[what].items():
            mine = observed[what].get(axis, 0)
            if abs(mine - count) > (1 if axis in doubtful else 0):
                wrong.append(f"{what} {axis}: {mine}, expected {count}")
    late_or_far = _judge_times(record, observed)
    if late_or_far and _stopped_at_end(record, observed):
        used.append(EXACT_STOP[0])
    elif late_or_far and not excuse_motion(record, used):
        wrong += late_or_far
    return wrong


def _judge_times(record: Json, observed: Json) -> list[str]:
    wrong = []
    late = observed["duration_s"] - record["duration_s"]
    if abs(late) > max(_TIME_SHARE * record["duration_s"], _TIME_S):
        wrong.append(f"duration {observed['duration_s']:.4f} s, expected {record['duration_s']}")
    for axis, rate in record["peak_step_rate_hz"].items():
        mine_rate = observed["peak_step_rate_hz"].get(axis, 0.0)
        if abs(mine_rate - rate) > _RATE_SHARE * rate:
            wrong.append(f"peak rate {axis}: {mine_rate:.1f} Hz, expected {rate}")
    wrong += _judge_samples(record, observed)
    wrong += _judge_rests(record, observed)
    return wrong


def _stopped_at_end(record: Json, observed: Json) -> bool:
    """The last hold came to rest in the last step: one of the two goes on to make it."""
    resumes = [ms for ms, sent in record.get("events_ms_after_first_step", ()) if sent == "~"]
    ends = record["duration_s"] * 1000, observed["duration_s"] * 1000
    return any(
        min(ends) < ms < max(ends) < ms + _REST_MS
        and all(
            abs(record["samples"][axis][int(ms / record["samples"]["dt_ms"])] - count) <= 1
            for axis, count in zip("xyz", record["net_steps"].values(), strict=False)
        )
        for ms in resumes
    )


def _half_step_axes(record: Json) -> set[str]:
    """Axes with a target within 1/1000 of half a step: rounding may go either way."""
    per_mm = dict.fromkeys("XYZABC", 250.0)
    for line in record["settings"]:
        if found := _SETTING_STEPS.match(line):
            per_mm["XYZABC"[int(found[1])]] = float(found[2])
    doubtful = set()
    for line in record["program"]:
        for axis, number in _AXIS_WORD.findall(line):
            for unit in (1.0, _MM_PER_INCH):
                steps = float(number) * unit * per_mm[axis.upper()]
                if abs(abs(steps) % 1 - 0.5) < _HALF_STEP_DOUBT:
                    doubtful.add(axis.upper())
    return doubtful


def _judge_samples(record: Json, observed: Json) -> list[str]:
    samples, mine = record["samples"], observed["samples"]
    wrong = []
    for i, axis in enumerate("xyz"):
        track = samples[axis]
        worst, at = 0.0, 0
        for k in range(len(track)):
            place = mine[min(k, len(mine) - 1)][i] if mine else 0
            low, high = _envelope(track, k, samples["dt_ms"])
            slack = _SLACK_STEPS + _stop_slack(record, track, k)
            off = max(low - slack - place, place - high - slack)
            if off > worst:
                worst, at = off, k
        if worst:
            ms = at * samples["dt_ms"]
            wrong.append(f"{axis.upper()} at {ms} ms is {worst:.0f} steps outside what is allowed")
    return wrong


def _envelope(track: list[int], k: int, dt_ms: float) -> tuple[float, float]:
    """Lowest and highest place recorded within the slack in time around sample k."""
    reach = _SLACK_MS / dt_ms
    near = [_between(track, k - reach), _between(track, k + reach)]
    first, last = max(0, int(k - reach + 1)), min(len(track) - 1, int(k + reach))
    near += track[first : last + 1]
    return min(near), max(near)


def _between(track: list[int], k: float) -> float:
    k = min(max(k, 0.0), len(track) - 1.0)
    low = int(k)
    high = min(low + 1, len(track) - 1)
    return track[low] + (track[high] - track[low]) * (k - low)


def _stop_slack(record: Json, track: list[int], k: int) -> float:
    """Once stopped in motion, the place of rest is where the same lateness left it."""
    dt = float(record["samples"]["dt_ms"])
    for ms, sent in record.get("events_ms_after_first_step", ()):
        if sent in ("!", "\x85") and k * dt >= ms:
            before, after = _between(track, ms / dt - 1), _between(track, ms / dt + 1)
            return abs(after - before) * _SLACK_MS / float(2 * dt)
    return 0.0


def _judge_rests(record: Json, observed: Json) -> list[str]:
    """Before a resume the machine has come to rest, and it starts from that very place."""
    dt = record["samples"]["dt_ms"]
    for ms, sent in record.get("events_ms_after_first_step", ()):
        if sent == "~":
            rest = observed["samples"][int((ms - _REST_MS) / dt) : int(ms / dt)]
            if not rest or any(place != rest[0] for place in rest):
                return [f"not at rest before the resume at {ms} ms"]
    return []
