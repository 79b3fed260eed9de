"""`ugrbl plot`: what a job will do, drawn; and what it would do under other settings."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from . import machine
from .messages import meaning as reply_meaning
from .motion_trace import LETTERS, Motion, trace_program
from .picture import Stroke
from .run import Result
from .settings_file import Settings, SettingsError, meaning

FORMATS = (".html", ".png", ".svg")

# There are no switches on paper: with these, a job would begin locked, or end in an alarm.
_WITHOUT = frozenset({20, 21, 22})


@dataclass
class Job:
    """A program as it runs under some settings. name says which."""

    name: str
    result: Result
    motion: Motion
    limits: dict[str, list[float]]  # per axis, of max_rate in steps/s and acceleration in mm/s2

    @property
    def seconds(self) -> float:
        """How long it takes."""
        return self.result.totals.time_s

    def strokes(self) -> list[Stroke]:
        """Its path, as picture.py wants it."""
        motion = self.motion
        return [Stroke(*row) for row in zip(*motion.place, motion.seconds, strict=True)]

    def as_json(self) -> dict[str, Any]:
        """As `ugrbl plot --json` writes it."""
        motion = self.motion
        return {
            "name": self.name,
            "time_s": self.seconds,
            "lines": self.result.lines,
            "errors": self.result.errors,
            "stopped": self.result.stopped,
            "distance_mm": self.result.totals.distance_mm,
            "fastest_mm_min": 60 * max(motion.speed_mm_s, default=0.0),
            "fastest_step_hz": by_letter(max(c, default=0.0) for c in motion.step_hz),
        }


def by_letter(values: Iterable[float]) -> dict[str, float]:
    """Values by the letter of their axis."""
    return dict(zip(LETTERS, values, strict=False))


def from_file(file: Path) -> list[str]:
    """The settings in a file of `ugrbl settings pull`, as lines for a machine on paper."""
    try:
        settings = Settings.read(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, SettingsError) as error:
        raise ValueError(f"{file}: {error}") from error
    kept = sorted(settings.values.items())
    return [f"${number}={value}" for number, value in kept if number not in _WITHOUT]


def as_line(text: str) -> str:
    """`120=500` or `$120=500` as a line."""
    number, _, value = text.strip().lstrip("$").partition("=")
    if not number.isdigit() or not value:
        raise ValueError(f"{text} is no setting; write it as 120=500")
    return f"${number}={value}"


def run_job(
    name: str,
    lines: Sequence[bytes],
    settings: Sequence[str],
    board: str = machine.DEFAULT_BOARD,
    progress: Callable[[int], None] | None = None,
) -> Job:
    """Run it. ValueError where a setting is refused."""
    result, motion = trace_program(lines, board=board, settings=settings, progress=progress)
    if " was refused with " in result.stopped:
        reply = result.stopped.rpartition(" ")[2]
        raise ValueError(f"{result.stopped}: {reply_meaning(reply)}")
    return Job(name, result, motion, _limits(board, settings, len(motion.step_hz)))


def _limits(board: str, settings: Sequence[str], axes: int) -> dict[str, list[float]]:
    """What the settings allow each axis."""
    values = _defaults(board)
    for line in settings:
        number, _, value = line.lstrip("$").partition("=")
        values[int(number)] = float(value)
    hz = [values[110 + axis] / 60 * values[100 + axis] for axis in range(axes)]
    return {"step_hz": hz, "acceleration": [values[120 + axis] for axis in range(axes)]}


def _defaults(board: str) -> dict[int, float]:
    import settings

    given = getattr(machine.load_board(board), "DEFAULTS", {})
    values = {}
    for number, _, kind, default, _ in settings._TABLE:
        for axis in range(len(LETTERS) if kind == settings._AXIS else 1):
            values[number + axis] = float(given.get(number + axis, default))
    return values


def describe(settings: Sequence[str]) -> str:
    """Settings in words: `Acceleration X 500 mm/sec^2, …`."""
    words = []
    for line in settings:
        number, _, value = line.lstrip("$").partition("=")
        said = meaning(int(number))
        words.append(f"{said.name} {value} {said.unit}".strip())
    return ", ".join(words)


def verdict(before: Job, after: Job) -> str:
    """The difference in words."""
    digits = 1 if before.seconds < 60 else 0  # so that the times shown add up
    saved = round(before.seconds, digits) - round(after.seconds, digits)
    times = f"{short(after.seconds)} instead of {short(before.seconds)}"
    if not before.seconds or abs(saved) < 0.005 * before.seconds:
        return f"{times}: next to no difference"
    share = 100 * abs(saved) / before.seconds
    what = "saved" if saved > 0 else "more"
    return f"{times}: {short(abs(saved))} {what} ({share:.0f} %)"


def short(seconds: float) -> str:
    """A length of time as people say it."""
    if seconds < 1:
        return f"{seconds:.2f} s"
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"


def save(jobs: Sequence[Job], title: str, words: str, file: Path) -> None:
    """Draw the jobs beside each other; the suffix of the file says how."""
    file.parent.mkdir(parents=True, exist_ok=True)
    if file.suffix == ".html":
        from . import plot_page

        file.write_text(plot_page.page(jobs, title, words), encoding="utf-8")
    else:
        from . import plot_image

        plot_image.draw(jobs, title, words, file.suffix == ".svg").savefig(file)


def envelope(
    time_s: Sequence[float], values: Sequence[float], most: int
) -> tuple[list[float], list[float]]:
    """The same curve in no more than so many points: the least and the highest of each stretch."""
    count = len(time_s)
    if count <= most:
        return list(time_s), list(values)
    stretch = -(-count // (most // 2))
    times: list[float] = []
    kept: list[float] = []
    for begin in range(0, count, stretch):
        rows = range(begin, min(begin + stretch, count))
        low = min(rows, key=values.__getitem__)
        high = max(rows, key=values.__getitem__)
        for row in sorted({low, high}):
            times.append(time_s[row])
            kept.append(values[row])
    return times, kept
