"""A job: a program as it runs with some settings, ready to be drawn; comparison of two jobs."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..boardfile.files import load_board
from ..grbl.messages import refused
from ..grbl.settings_file import SettingsError, meaning, read_settings
from ..run import machine
from ..run.program import Result, run_program
from .motion_trace import LETTERS, Motion, MotionTrace, trace_program

# A simulated machine without switches would start locked, or end in an alarm, with these.
_WITHOUT = frozenset({20, 21, 22})
# The first numbers of settings that each axis has.
_STEPS_PER_MM, _MAX_RATE, _ACCELERATION, _TRAVEL = 100, 110, 120, 130


@dataclass
class Job:
    """A program as it runs with some settings. name says which."""

    name: str
    result: Result
    motion: Motion
    # Per axis: max_rate in steps/s, acceleration in mm/s2, travel in mm.
    limits: dict[str, list[float]]
    program: Sequence[bytes] = ()
    marks: Sequence[Sequence[float]] = ()  # positions of a punch's holes, in mm

    @property
    def seconds(self) -> float:
        """Return its duration."""
        return self.result.totals.time_s

    def as_json(self) -> dict[str, Any]:
        """Return the job for `ugrbl plot --json`."""
        motion = self.motion
        return {
            "name": self.name,
            "time_s": self.seconds,
            "lines": self.result.lines,
            "errors": self.result.errors,
            "stopped": self.result.stopped,
            "distance_mm": self.result.totals.distance_mm,
            "fastest_mm_min": 60 * float(max(motion.speed_mm_s, default=0.0)),
            "fastest_step_hz": by_letter(
                float(motion.step_hz(axis).max(initial=0)) for axis in motion.axes()
            ),
            "final_position_mm": self.result.totals.final_position_mm,
        }


def by_letter(values: Iterable[float]) -> dict[str, float]:
    """Return values by the letter of their axis."""
    return dict(zip(LETTERS, values, strict=False))


def from_file(file: Path) -> list[str]:
    """Return the settings in a file of `ugrbl settings pull`, as lines for a machine without
    switches."""
    try:
        settings = read_settings(file)
    except SettingsError as error:
        raise ValueError(str(error)) from error
    return on_paper(settings.values)


def on_paper(values: Mapping[int, str]) -> list[str]:
    """Return settings by number as lines for a machine without switches."""
    kept = sorted(values.items())
    return [f"${number}={value}" for number, value in kept if number not in _WITHOUT]


def check_settings(settings: Sequence[str], board: str, around: machine.Around) -> None:
    """Raise ValueError if a setting is refused."""
    result, _ = run_program((), board=board, settings=settings, around=around)
    _check_accepted(result)


def _check_accepted(result: Result) -> None:
    """Raise ValueError if the program was not run because a setting was refused."""
    if why := refused(result.stopped):
        raise ValueError(f"{result.stopped}: {why}")


def run_job(
    name: str,
    lines: Sequence[bytes],
    settings: Sequence[str],
    board: str = machine.DEFAULT_BOARD,
    progress: Callable[[int], None] | None = None,
    around: machine.Around = machine.NOTHING,
) -> Job:
    """Run a program. ValueError if a setting is refused.

    lines: of the program. settings: lines `$110=500`, sent before it. progress: called with the
    number of lines done. around: see machine.Around.
    """
    result, trace = trace_program(
        lines, board=board, settings=settings, progress=progress, around=around
    )
    _check_accepted(result)
    return job_of(name, lines, settings, board, result, trace)


def job_of(
    name: str,
    lines: Sequence[bytes],
    settings: Sequence[str],
    board: str,
    result: Result,
    trace: MotionTrace,
) -> Job:
    """Return a traced program as a job."""
    limits = _limits(board, settings, len(trace.motion.axes()))
    return Job(name, result, trace.motion, limits, lines, trace.marks)


def _limits(board: str, settings: Sequence[str], axes: int) -> dict[str, list[float]]:
    """Return the limits of each axis with these settings: "step_hz" (steps per second at its
    highest rate), "acceleration" in mm/s2, and "travel" in mm."""
    values = _defaults(board)
    for line in settings:
        number, _, value = line.lstrip("$").partition("=")
        values[int(number)] = float(value)
    mm_s = [values[_MAX_RATE + axis] / 60 for axis in range(axes)]
    return {
        "step_hz": [mm_s[axis] * values[_STEPS_PER_MM + axis] for axis in range(axes)],
        "acceleration": [values[_ACCELERATION + axis] for axis in range(axes)],
        "travel": [values[_TRAVEL + axis] for axis in range(axes)],
    }


def _defaults(board: str) -> dict[int, float]:
    """Return the default settings of a board by number."""
    from base import settings

    given = getattr(load_board(board), "DEFAULTS", {})
    values = {}
    for first, _, kind, default, _ in settings._TABLE:
        count = len(LETTERS) if kind == settings.AXIS else 1  # numbers of this row
        for number in range(first, first + count):
            values[number] = float(given.get(number, default))
    return values


def describe(settings: Sequence[str]) -> str:
    """Return settings in words: `Acceleration X 500 mm/sec^2, …`."""
    words = []
    for line in settings:
        number, _, value = line.lstrip("$").partition("=")
        text = meaning(int(number))
        words.append(f"{text.name} {value} {text.unit}".strip())
    return ", ".join(words)


def verdict(before: Job, after: Job) -> str:
    """Return the difference in time in words: `41.2 s instead of 50.0 s: 8.8 s saved (18 %)`."""
    digits = 1 if before.seconds < 60 else 0  # as short() shows them, so that they add up
    saved = round(before.seconds, digits) - round(after.seconds, digits)
    times = f"{short(after.seconds)} instead of {short(before.seconds)}"
    if not before.seconds or abs(saved) < 0.005 * before.seconds:  # less than 0.5 %
        return f"{times}: next to no difference"
    share = 100 * abs(saved) / before.seconds
    what = "saved" if saved > 0 else "more"
    return f"{times}: {short(abs(saved))} {what} ({share:.0f} %)"


def short(seconds: float) -> str:
    """Return a duration as text: 0.25 s, 12.5 s, 3 min 20 s, 1 h 5 min."""
    if seconds < 1:
        return f"{seconds:.2f} s"
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"
