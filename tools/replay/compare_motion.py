"""Judge replays of motion records by the rules of their FORMAT.md: see compare.py."""

import math
import re
from collections.abc import Sequence
from itertools import pairwise

from .compare import Json, expected_lines, same_lines, trouble
from .differences import EXACT_STOP, SWITCH
from .known_differences import explain_motion

_SETTING_STEPS = re.compile(r"\$10([0-5])=([\d.]+)")
_AXIS_WORD = re.compile(r"([XYZABC])\s*(-?\d*\.?\d+)", re.IGNORECASE)
_MM_PER_INCH = 25.4
# Allowed differences: of the duration, a share or a time; of rates; of samples, time and steps.
_TIME_SHARE, _TIME_S = 0.01, 0.020
_RATE_SHARE = 0.02
_SLACK_MS = 15.0
_SLACK_STEPS = 2.0
_SWITCH_MS = 1.0  # Grbl reads a homing switch at most so often
_REST_MS = 50.0
_HALF_STEP_DOUBT = 0.001
_LOOK_AHEAD = 40  # samples


def judge_motion(record: Json, observed: Json, used: list[str]) -> list[str]:
    """Return what is wrong with the replay of a motion record; empty if it conforms."""
    wrong = trouble(observed)
    replies = expected_lines({"expect": record["replies"]})
    if any(line != "ok" for line in observed["settings"]):
        wrong.append(f"settings: {observed['settings']}")
    if not same_lines(replies, observed["replies"], used):
        wrong.append(f"replies: {observed['replies']}, expected {record['replies']}")
    doubtful = _half_step_axes(record)
    if not doubtful and observed["final_report"] != record["final_report"]:
        wrong.append(f"final {observed['final_report']}, expected {record['final_report']}")
    for what in ("net_steps", "pulses"):
        for axis, count in record[what].items():
            mine = observed[what].get(axis, 0)
            if abs(mine - count) > (1 if axis in doubtful else 0):
                wrong.append(f"{what} {axis}: {mine}, expected {count}")
    late_or_far = _judge_times(record, observed, used)
    if late_or_far and _stopped_at_end(record, observed):
        used.append(EXACT_STOP[0])
    elif late_or_far and not explain_motion(record, observed, used):
        wrong += late_or_far
    elif late_or_far:
        wrong += _judge_path(record, observed)
    return wrong


def _judge_times(record: Json, observed: Json, used: list[str]) -> list[str]:
    """Return what is wrong with duration, step rates, and positions over time."""
    wrong = []
    late = observed["duration_s"] - record["duration_s"]
    if abs(late) > max(_TIME_SHARE * record["duration_s"], _TIME_S):
        wrong.append(f"duration {observed['duration_s']:.4f} s, expected {record['duration_s']}")
    for axis, rate in record["peak_step_rate_hz"].items():
        mine_rate = observed["peak_step_rate_hz"].get(axis, 0.0)
        if abs(mine_rate - rate) > _RATE_SHARE * rate:
            wrong.append(f"peak rate {axis}: {mine_rate:.1f} Hz, expected {rate}")
    samples = _judge_samples(record, observed, _SLACK_STEPS)
    if samples and "$H" in record["program"]:
        late_steps = max(record["peak_step_rate_hz"].values()) * _SWITCH_MS / 1000
        samples = _judge_samples(record, observed, _SLACK_STEPS + late_steps)
        used.append(SWITCH[0])
    wrong += samples
    wrong += _judge_rests(record, observed)
    return wrong


def _stopped_at_end(record: Json, observed: Json) -> bool:
    """Return whether the last hold stopped within the last step, so that only one of the two makes
    it after the resume."""
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
    """Return axes with a target within 1/1000 of half a step: rounding may go either way."""
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


def _judge_samples(record: Json, observed: Json, steps: float) -> list[str]:
    """Check the positions of each axis at the recorded times. steps: the slack of a position."""
    samples, mine = record["samples"], observed["samples"]
    wrong = []
    for i, axis in enumerate("xyz"):
        track = samples[axis]
        worst, worst_sample = 0.0, 0
        for number in range(len(track)):
            place = mine[min(number, len(mine) - 1)][i] if mine else 0
            low, high = _envelope(track, number, samples["dt_ms"])
            slack = steps + _stop_slack(record, track, number)
            off = max(low - slack - place, place - high - slack)
            if off > worst:
                worst, worst_sample = off, number
        if worst:
            ms = worst_sample * samples["dt_ms"]
            wrong.append(f"{axis.upper()} at {ms} ms is {worst:.0f} steps outside what is allowed")
    return wrong


def _judge_path(record: Json, observed: Json) -> list[str]:
    """Check that the positions are on the recorded path, at whatever times."""
    samples, reached = record["samples"], 0  # reached: index of a part of the path
    track = list(zip(*(samples[axis] for axis in "xyz"), strict=True))
    parts = list(pairwise(track)) or [(track[0], track[0])]
    for k, place in enumerate(observed["samples"]):
        near = range(reached, min(reached + _LOOK_AHEAD, len(parts)))
        reached = min(near, key=lambda part: (_distance(place, *parts[part]), -part))
        # Between two samples the path may have a corner.
        slack = _SLACK_STEPS + math.dist(*parts[reached]) / 2
        if _distance(place, *parts[reached]) > slack:
            return [f"at {k * samples['dt_ms']} ms off the path: {place}"]
    if reached + _LOOK_AHEAD < len(parts):
        return [f"only {reached} of {len(parts)} parts of the path were executed"]
    return []


def _distance(place: Sequence[float], begin: Sequence[int], end: Sequence[int]) -> float:
    """Return the distance of a position from a line segment."""
    segment = [b - a for a, b in zip(begin, end, strict=True)]
    length_sqr = sum(x * x for x in segment)
    product = sum(x * (p - a) for x, p, a in zip(segment, place, begin, strict=True))
    part = min(max(product / (length_sqr or 1), 0.0), 1.0)  # of the segment, to the nearest point
    return math.dist(place, [a + part * x for a, x in zip(begin, segment, strict=True)])


def _envelope(track: list[int], k: int, dt_ms: float) -> tuple[float, float]:
    """Return the lowest and highest position recorded within the slack in time around sample k."""
    reach = _SLACK_MS / dt_ms
    near = [_between(track, k - reach), _between(track, k + reach)]
    first, last = max(0, int(k - reach + 1)), min(len(track) - 1, int(k + reach))
    near += track[first : last + 1]
    return min(near), max(near)


def _between(track: list[int], k: float) -> float:
    """Return the position at sample k, which may be between two samples."""
    k = min(max(k, 0.0), len(track) - 1.0)
    low = int(k)
    high = min(low + 1, len(track) - 1)
    return track[low] + (track[high] - track[low]) * (k - low)


def _stop_slack(record: Json, track: list[int], k: int) -> float:
    """Return the extra slack after a stop during motion: the final position depends on the same
    delay."""
    dt = float(record["samples"]["dt_ms"])
    for ms, sent in record.get("events_ms_after_first_step", ()):
        if sent in ("!", "\x85") and k * dt >= ms:
            before, after = _between(track, ms / dt - 1), _between(track, ms / dt + 1)
            return abs(after - before) * _SLACK_MS / float(2 * dt)
    return 0.0


def _judge_rests(record: Json, observed: Json) -> list[str]:
    """Check that the machine stands still before a resume, and continues from that position."""
    dt = record["samples"]["dt_ms"]
    for ms, sent in record.get("events_ms_after_first_step", ()):
        if sent == "~":
            rest = observed["samples"][int((ms - _REST_MS) / dt) : int(ms / dt)]
            if not rest or any(place != rest[0] for place in rest):
                return [f"not at rest before the resume at {ms} ms"]
    return []
