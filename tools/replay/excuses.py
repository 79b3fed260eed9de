"""Recordings of what nobody should copy: in such a case fewer things have to be equal.

A row says when it applies, and only a case that does not conform is looked up here. Of a
conversation every line still has to come, in order, apart from status reports; of a motion record
replies, the place at the end and the count of pulses.
"""

import math
import re
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any, NamedTuple

Json = dict[str, Any]

_AXIS = re.compile(r"([XYZ])\s*(-?\d*\.?\d+)", re.IGNORECASE)
_FEED = re.compile(r"F\s*(\d*\.?\d+)", re.IGNORECASE)
_END = "[MSG:Pgm End]"
_STARTUP_JOG = re.compile(r"\$N\d=\$J", re.IGNORECASE)
_REPEATED = re.compile("([\x90-\x9d]).*\\1")

_SLOWEST_HZ = 30.5
_STEPS_PER_MM = 250  # of the recordings
_BLOCKS = 15  # Grbl's planner holds
_STARVED_MS = 12.0  # a block of the AVR's, with its line on the wire


class Excuse(NamedTuple):
    """One row. applies: to a case or record; counted: the lines of it that have to be equal."""

    name: str
    reason: str
    applies: Callable[[Json], bool]
    counted: Callable[[list[str]], list[str]] = lambda lines: lines


def _sent(case: Json) -> list[str]:
    steps = case.get("steps", ())
    return case.get("program") or "".join(step["send"] for step in steps).split("\n")


def _blocks(lines: list[str]) -> Iterator[tuple[float, float]]:
    """(mm, mm/min) of each line that moves, as far as this needs to know G-code."""
    place = {"X": 0.0, "Y": 0.0, "Z": 0.0}
    feed, relative, inverse = 0.0, False, False
    for line in lines:
        text = line.upper()
        relative = "G91" in text or (relative and "G90" not in text)
        inverse = "G93" in text or (inverse and "G94" not in text)
        if found := _FEED.search(text):
            feed = float(found[1])
        before = dict(place)
        for axis, number in _AXIS.findall(text):
            place[axis] = float(number) + (place[axis] if relative else 0.0)
        way = math.dist(place.values(), before.values())
        if way and not text.startswith(("$", "G0")):
            yield way, feed * way if inverse else feed


def _slow(case: Json) -> bool:
    rates = [feed / 60 * _STEPS_PER_MM for _, feed in _blocks(_sent(case))]
    return any(0 < rate < _SLOWEST_HZ for rate in rates)


def _starved(record: Json) -> bool:
    ms = [way / feed * 60_000 for way, feed in _blocks(_sent(record)) if feed > 0]
    runs = [ms[i : i + _BLOCKS] for i in range(len(ms) - _BLOCKS)]
    return any(sum(run) < _BLOCKS * _STARVED_MS for run in runs)


def _burst(record: Json) -> bool:
    events = record.get("events_ms_after_first_step", ())
    return any(_REPEATED.search(sent) for _, sent in events)


def _expected(case: Json) -> list[str]:
    return [line for step in case["steps"] for line in step["expect"]]


def _in_pause(case: Json) -> bool:
    return "$H" in _sent(case) and "ALARM:8" in _expected(case)


def _one_alarm(lines: list[str]) -> list[str]:
    return ["ALARM:8" if line in ("ALARM:6", "ALARM:7") else line for line in lines]


def _startup_jog(case: Json) -> bool:
    return any(_STARTUP_JOG.match(line) for line in _sent(case))


def _end_after_reset(case: Json) -> bool:
    return ("ALARM:3", _END) in pairwise(_expected(case))


SLOW = Excuse(
    "slow motion",
    "Grbl makes no less than 30.5 steps/s; a feed below that is made as it was asked for, with "
    "motors on until it has ended.",
    _slow,
)

CASES = (
    SLOW,
    Excuse(
        "pause of homing",
        "A reset or the door between two moves of homing is ALARM:6 or 7, and nothing moves any "
        "more; Grbl begins the way back, finds the switch still closed, and says ALARM:8.",
        _in_pause,
        _one_alarm,
    ),
    Excuse(
        "jog as a startup line",
        "$N0=$J= is refused; Grbl keeps it, and moves at each start.",
        _startup_jog,
        lambda _lines: [],
    ),
    Excuse(
        "program end after a reset",
        "An M2 or M30 that a reset has cut short does not say that the program has ended.",
        _end_after_reset,
        lambda lines: [line for line in lines if line != _END],
    ),
)

MOTIONS = (
    SLOW,
    Excuse(
        "each override",
        "Each byte of a burst of overrides counts; Grbl may take two of a kind for one.",
        _burst,
    ),
    Excuse(
        "starved planner",
        "Blocks of a few milliseconds come faster than an AVR plans them, and slower than we do: "
        "with more blocks to look at the same path is faster.",
        _starved,
    ),
)


def excuse(case: Json, observed: Json, used: list[str]) -> bool:
    """Whether a case that does not conform has a reason in the table; adds its name to used."""
    ours = [line for step in observed.get("steps", ()) for line in step["lines"]]
    for row in CASES:
        if row.applies(case) and _same(row, _expected(case), ours):
            used.append(row.name)
            return True
    return False


def _same(row: Excuse, *sides: list[str]) -> bool:
    theirs, ours = [
        row.counted([line for line in lines if not line.startswith("<")]) for lines in sides
    ]
    return theirs == ours


def excuse_motion(record: Json, used: list[str]) -> bool:
    """Whether times and rates of this record are not to be compared; adds the name to used."""
    names = [row.name for row in MOTIONS if row.applies(record)]
    used += names[:1]
    return bool(names)
