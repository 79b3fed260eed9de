"""Judge replays of motion records by the rules of their FORMAT.md: see compare.py.

A record, and likewise its replay (`observed`), has: settings and program (lines sent), replies,
final_report, net_steps and pulses (totals per axis), duration_s, peak_step_rate_hz, samples (the
position in steps every dt_ms from the first step on), and events_ms_after_first_step: real-time
commands, (ms, characters sent). The times and positions of a replay may differ within limits.
"""

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
_TIME_SHARE = 0.01  # allowed difference of the duration: this share, or _TIME_S if it is more
_TIME_S = 0.020
_RATE_SHARE = 0.02  # allowed difference of a step rate
_SLACK_MS = 15.0  # a position may be reached so much earlier or later
_SLACK_STEPS = 2.0  # a position may be off by so many steps
_SWITCH_MS = 1.0  # Grbl reads a homing switch at most so often
_STANDSTILL_MS = 50.0  # the machine stands still at least so long before a resume
_HALF_STEP_DOUBT = 0.001  # of a step
_LOOK_AHEAD = 40  # samples


def judge_motion(record: Json, observed: Json, used: list[str]) -> list[str]:
    """Return what is wrong with the replay of a motion record; empty if it conforms."""
    wrong = trouble(observed)
    replies = expected_lines({"expect": record["replies"]})
    if any(line != "ok" for line in observed["settings"]):
        wrong.append(f"settings: {observed['settings']}")
    if not same_lines(replies, observed["replies"], used):
        wrong.append(f"replies: {observed['replies']}, expected {record['replies']}")
    doubtful = _half_step_axes(record)  # they may end one step off
    if not doubtful and observed["final_report"] != record["final_report"]:
        wrong.append(f"final {observed['final_report']}, expected {record['final_report']}")
    for what in ("net_steps", "pulses"):
        for axis, count in record[what].items():
            mine = observed[what].get(axis, 0)
            if abs(mine - count) > (1 if axis in doubtful else 0):
                wrong.append(f"{what} {axis}: {mine}, expected {count}")
    wrong_times = _judge_times(record, observed, used)
    if not wrong_times:
        return wrong
    if _stopped_at_end(record, observed):
        used.append(EXACT_STOP[0])
    elif explain_motion(record, observed, used):  # then the path must be the same, at other times
        wrong += _judge_path(record, observed)
    else:
        wrong += wrong_times
    return wrong


def _judge_times(record: Json, observed: Json, used: list[str]) -> list[str]:
    """Return what is wrong with duration, step rates, and positions over time."""
    wrong = []
    late_s = observed["duration_s"] - record["duration_s"]
    if abs(late_s) > max(_TIME_SHARE * record["duration_s"], _TIME_S):
        wrong.append(f"duration {observed['duration_s']:.4f} s, expected {record['duration_s']}")
    for axis, rate in record["peak_step_rate_hz"].items():
        mine_rate = observed["peak_step_rate_hz"].get(axis, 0.0)
        if abs(mine_rate - rate) > _RATE_SHARE * rate:
            wrong.append(f"peak rate {axis}: {mine_rate:.1f} Hz, expected {rate}")
    wrong_samples = _judge_samples(record, observed, _SLACK_STEPS)
    if wrong_samples and "$H" in record["program"]:  # homing: Grbl notices a switch later
        late_steps = max(record["peak_step_rate_hz"].values()) * _SWITCH_MS / 1000
        wrong_samples = _judge_samples(record, observed, _SLACK_STEPS + late_steps)
        used.append(SWITCH[0])
    wrong += wrong_samples
    wrong += _judge_standstill(record, observed)
    return wrong


def _stopped_at_end(record: Json, observed: Json) -> bool:
    """Return whether the last hold stopped within the program's last step. Then either Grbl or we
    make that step after the resume, and the other before."""
    samples = record["samples"]
    resumes_ms = [ms for ms, sent in record.get("events_ms_after_first_step", ()) if sent == "~"]
    ends_ms = record["duration_s"] * 1000, observed["duration_s"] * 1000
    return any(
        # one ended before this resume, the other soon after it
        min(ends_ms) < ms < max(ends_ms) < ms + _STANDSTILL_MS
        and all(
            # After the last sample the axis stands still.
            abs(samples[axis][: int(ms / samples["dt_ms"]) + 1][-1] - end) <= 1
            for axis, end in zip("xyz", record["net_steps"].values(), strict=False)
        )
        for ms in resumes_ms
    )


def _half_step_axes(record: Json) -> set[str]:
    """Return axes with a target within 1/1000 of half a step: rounding may go either way. Each
    number is taken as mm and as inches, because modes are not parsed."""
    per_mm = dict.fromkeys("XYZABC", 250.0)  # steps/mm, unless the record sets them
    for line in record["settings"]:
        if found := _SETTING_STEPS.match(line):
            per_mm["XYZABC"[int(found[1])]] = float(found[2])
    doubtful = set()
    for line in record["program"]:
        for axis, number in _AXIS_WORD.findall(line):
            for unit_mm in (1.0, _MM_PER_INCH):
                steps = float(number) * unit_mm * per_mm[axis.upper()]
                if abs(abs(steps) % 1 - 0.5) < _HALF_STEP_DOUBT:
                    doubtful.add(axis.upper())
    return doubtful


def _judge_samples(record: Json, observed: Json, slack_steps: float) -> list[str]:
    """Check the positions of each axis at the recorded times. Returns a message per axis that is
    outside, about its worst sample. slack_steps: a position may be off by so much."""
    samples, mine = record["samples"], observed["samples"]
    wrong = []
    for i, axis in enumerate("xyz"):
        track = samples[axis]
        worst, worst_sample = 0.0, 0
        for number in range(len(track)):
            # A replay that ended earlier stays at its last position.
            position = mine[min(number, len(mine) - 1)][i] if mine else 0
            low, high = _envelope(track, number, samples["dt_ms"])
            slack = slack_steps + _stop_slack(record, track, number)
            outside = max(low - slack - position, position - high - slack)
            if outside > worst:
                worst, worst_sample = outside, number
        if worst:
            ms = worst_sample * samples["dt_ms"]
            wrong.append(f"{axis.upper()} at {ms} ms is {worst:.0f} steps outside what is allowed")
    return wrong


def _judge_path(record: Json, observed: Json) -> list[str]:
    """Check that the positions are on the recorded path, in its order, at whatever times."""
    samples = record["samples"]
    track = list(zip(*(samples[axis] for axis in "xyz"), strict=True))
    parts = list(pairwise(track)) or [(track[0], track[0])]  # line segments between two samples
    reached = 0  # index of the part that the replay has reached
    for k, position in enumerate(observed["samples"]):
        near = range(reached, min(reached + _LOOK_AHEAD, len(parts)))
        # The nearest part; of equally near ones the last.
        reached = min(near, key=lambda part: (_distance(position, *parts[part]), -part))
        # Between two samples the path may have a corner.
        slack = _SLACK_STEPS + math.dist(*parts[reached]) / 2
        if _distance(position, *parts[reached]) > slack:
            return [f"at {k * samples['dt_ms']} ms off the path: {position}"]
    if reached + _LOOK_AHEAD < len(parts):
        return [f"only {reached} of {len(parts)} parts of the path were executed"]
    return []


def _distance(position: Sequence[float], begin: Sequence[int], end: Sequence[int]) -> float:
    """Return the distance of a position from a line segment, in steps."""
    segment = [b - a for a, b in zip(begin, end, strict=True)]
    length_sqr = sum(x * x for x in segment)
    dot = sum(x * (p - a) for x, p, a in zip(segment, position, begin, strict=True))
    share = min(max(dot / (length_sqr or 1), 0.0), 1.0)  # of the segment, to the nearest point
    return math.dist(position, [a + share * x for a, x in zip(begin, segment, strict=True)])


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
    """Return the extra slack, in steps, of an axis at sample k: 0 before the first hold or jog
    cancel, then the way it moves within _SLACK_MS, because a later stop stops further away."""
    dt_ms = float(record["samples"]["dt_ms"])
    for ms, sent in record.get("events_ms_after_first_step", ()):
        if sent in ("!", "\x85") and k * dt_ms >= ms:
            before, after = _between(track, ms / dt_ms - 1), _between(track, ms / dt_ms + 1)
            return abs(after - before) * _SLACK_MS / float(2 * dt_ms)
    return 0.0


def _judge_standstill(record: Json, observed: Json) -> list[str]:
    """Check that the machine stands still for _STANDSTILL_MS before each resume."""
    dt_ms = record["samples"]["dt_ms"]
    for ms, sent in record.get("events_ms_after_first_step", ()):
        if sent == "~":
            held = observed["samples"][int((ms - _STANDSTILL_MS) / dt_ms) : int(ms / dt_ms)]
            if not held or any(position != held[0] for position in held):
                return [f"not at rest before the resume at {ms} ms"]
    return []
