"""Preview a program for a page: its time, its path, and the lines that will be refused.

Run as a program, it previews one request: the posted body on stdin, the answer on stdout, the
board's name as argument. It runs in its own process, because a long program takes long and the
simulator has only one machine per process.
"""

import json
import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..draw.job import on_paper
from ..draw.motion_trace import Motion, trace_program
from ..draw.simplify import fitted
from ..grbl import gcode_file
from ..grbl.lines import split_lines
from ..grbl.messages import meaning, refused
from ..run import machine
from ..run.program import Result
from . import machine_state

PROGRAM_BYTES = 32 << 20
# At most so many rows of "times" and of "path".
MOST_TIMES = 2000
MOST_POINTS = 20_000
# The drawn path differs from the real one by at most this, while MOST_POINTS are enough.
_TOLERANCE_MM = 0.01
RAPID, FEED = 0, 1
_NUMBER = re.compile("[0-9]{1,3}")  # number of a setting
_TOO_LARGE = 3.4e38  # about the largest number in single precision
_DECIMALS = 4  # one more than Grbl prints
REFUSED = 3  # exit code: the answer is a sentence

Rows = NDArray[np.int64]


class Refused(ValueError):
    """Raised for a request that cannot be previewed; the text says why."""


def preview(request: Mapping[str, Any], board: str) -> dict[str, Any]:
    """Return the answer to a request for /api/look. Raises Refused for an invalid one.

    times: rows of line number and the time in s at which its motion ends. path: rows of X, Y, Z in
    mm (machine coordinates), kind of the segment that ends there, its line, and its mean speed in
    mm/min. The machine starts as machine_state.py reads it, or else at 0 without offsets.
    """
    name, lines = _program(request)
    settings = _settings(request.get("settings", {}))
    accepted = machine.taken(board, on_paper(settings))  # without those about switches
    result, trace = trace_program(
        [gcode_file.sanitize(line) for line in lines],
        board=board,
        settings=[*accepted, *machine_state.lines(request)],
        progress=_end_with_parent(),
    )
    if why := refused(result.stopped):
        raise Refused(f"the simulated machine refuses its settings: {result.stopped}: {why}")
    motion = trace.motion
    return {
        "name": name,
        "seconds": round(result.totals.time_s, 3),
        "problems": _problems(lines, result, machine_state.beyond(motion, settings, request)),
        "lines": len(lines),
        "times": _times(motion),
        "path": _path(motion),
    }


def _program(request: Mapping[str, Any]) -> tuple[str, list[bytes]]:
    """Return the program's name and lines."""
    name, text = request.get("name", ""), request.get("program")
    if not isinstance(text, str) or not isinstance(name, str):
        raise Refused(
            'the request has no program: it needs {"name": …, "program": …}, both as text'
        )
    data = text.encode("utf-8", "replace")
    if len(data) > PROGRAM_BYTES:
        raise Refused(f"{name or 'the program'} is larger than {PROGRAM_BYTES >> 20} MB")
    lines = split_lines(data.removeprefix(b"\xef\xbb\xbf"))
    gcode_file.check_text(lines, name or "the program")
    return name, [gcode_file.without_end(line) for line in lines]


def _settings(posted: Any) -> dict[int, str]:
    """Return the valid settings by number; the machine checks their values later."""
    if not isinstance(posted, dict):
        raise Refused('"settings" must be given by number: {"110": "500.000"}')
    return {
        int(number): f"{value:.{_DECIMALS}f}"
        for number, text in posted.items()
        if _NUMBER.fullmatch(number) and (value := _value(text)) is not None
    }


def _value(text: Any) -> float | None:
    """Return a number, or a text as a number, within single precision; else None."""
    try:
        value = float(text)
    except (TypeError, ValueError, OverflowError):
        return None
    return value if abs(value) < _TOO_LARGE else None


# Answers


def _problems(
    lines: Sequence[bytes], result: Result, beyond: Sequence[tuple[int, str]]
) -> list[dict[str, Any]]:
    """Return all problems, sorted by line.

    These are refused lines, wide arcs, realtime characters, travel violations, and the line at
    which the program ended.
    """
    problems = [
        _problem(number, f"{reply} - {meaning(reply, gcode_file.shown(lines[number - 1]))}")
        for number, reply in result.errors
    ]
    problems += [_problem(*row) for row in beyond]
    problems += [
        _problem(number, f"{text}: is this intended?") for number, text in result.wide_arcs
    ]
    problems += [
        _problem(problem.line, problem.text)
        for problem in gcode_file.problems(lines)
        if not problem.in_comment
    ]
    if result.stopped:
        # What ended it is its last output, of which [0] is the line.
        last = result.other_output[-1][0] if result.other_output else result.lines
        cause = f" - {meaning(result.stopped)}" if result.stopped.startswith("ALARM:") else ""
        problems.append(_problem(last, f"{result.stopped}{cause}"))
    return sorted(problems, key=lambda problem: int(problem["line"]))


def _problem(line: int, text: str) -> dict[str, Any]:
    """Return a problem; code: Grbl's number of an error or alarm, 0 if it has none."""
    kind, _, rest = text.partition(":")
    number = rest.partition(" ")[0]
    has_code = kind in ("error", "ALARM") and number.isdecimal()
    return {"line": line, "text": text, "code": int(number) if has_code else 0}


def _times(motion: Motion) -> list[list[float]]:
    """Return rows of line number and the time in s at which its motion ends; at most
    MOST_TIMES."""
    # Backwards, because np.unique() returns the first index of each line: here of its last row.
    numbers, last_rows = np.unique(motion.lines[::-1], return_index=True)
    seconds = np.frombuffer(motion.time_s)[::-1][last_rows]
    is_of_program = numbers > 0
    numbers = numbers[is_of_program]
    seconds = np.maximum.accumulate(seconds[is_of_program])  # never earlier than the line before
    rows = _spread(len(numbers), MOST_TIMES)
    return [[int(numbers[row]), round(float(seconds[row]), 3)] for row in rows]


def _spread(count: int, most: int) -> Rows:
    """Return at most `most` evenly spaced rows, including the last one."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.int64))


def _path(motion: Motion) -> list[list[float]]:
    """Return the corners of the path and the changes of line, at most MOST_POINTS; for the rows
    see preview()."""
    if not len(motion):
        return []
    is_moving = np.frombuffer(motion.block, np.int32) > 0
    # For each row, the last one in motion: a point at which the machine stands belongs to that.
    last_move = np.maximum.accumulate(np.where(is_moving, np.arange(len(motion)), 0))
    points, rapid, line = motion.points, motion.rapids[last_move], motion.lines[last_move]
    moving_s = np.cumsum(np.where(is_moving, motion.seconds, 0.0))  # without standstills
    lengths = np.sqrt((np.diff(points, axis=0, prepend=points[:1]) ** 2).sum(axis=1, dtype=float))
    rows = _corners(points, rapid, line)
    # Between two of these rows: length in mm, time in s, and mean speed in mm/min.
    mm, seconds = np.diff(np.cumsum(lengths)[rows], prepend=0), np.diff(moving_s[rows], prepend=0)
    speed = np.divide(60 * mm, seconds, out=np.zeros(len(rows)), where=seconds > 0)
    return [
        [*(round(float(x), 4) for x in points[row]), kind, int(line[row]), round(float(mm_min))]
        for row, kind, mm_min in zip(rows, np.where(rapid[rows], RAPID, FEED).tolist(), speed)
        if mm_min > 0 or row == rows[0]  # the first point, where no segment ends
    ]


def _corners(points: Any, rapid: Any, line: Any) -> Rows:
    """Return the rows that describe the path within the tolerance, at most MOST_POINTS.

    points, rapid, line: of each row. The rows before a change of line or between rapid and feed
    always stay, if they are at most half of MOST_POINTS; else only those between rapid and feed;
    if these are more too, none.
    """
    changes_kind = rapid[1:] != rapid[:-1]
    changes_line = line[1:] != line[:-1]
    choices: list[Rows] = [
        np.flatnonzero(changes_kind | changes_line),
        np.flatnonzero(changes_kind),
        np.empty(0, np.int64),
    ]
    keep = next(rows for rows in choices if len(rows) <= MOST_POINTS // 2)
    rows, _ = fitted(points, _TOLERANCE_MM, keep, MOST_POINTS - len(keep))
    return rows


# The process


def _end_with_parent() -> Callable[[int], None]:
    """Return a progress function, called now and then, that ends this process after its parent has
    ended."""
    parent = os.getppid()

    def progress(line: int) -> None:
        if os.getppid() != parent:
            raise KeyboardInterrupt("who has asked for it is gone")

    return progress


def main() -> None:
    """Preview the request on stdin at low priority."""
    if hasattr(os, "nice"):
        os.nice(10)
    out, sys.stdout = sys.stdout.buffer, sys.stderr  # only the answer goes to stdout
    try:
        answer = preview(_request(sys.stdin.buffer.read()), sys.argv[1])
    except (Refused, gcode_file.NotText) as error:
        out.write(str(error).encode())
        out.flush()
        sys.exit(REFUSED)
    out.write(json.dumps(answer, separators=(",", ":")).encode())


def _request(body: bytes) -> dict[str, Any]:
    """Return the posted request. Raises Refused if it is no JSON object."""
    try:
        request = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise Refused(f"the request is no JSON: {error}") from error
    if not isinstance(request, dict):
        raise Refused("the request is no JSON object")
    return request


if __name__ == "__main__":
    main()
