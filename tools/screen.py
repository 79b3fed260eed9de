"""What the commands show: a progress bar with the machine's state, tables, messages."""

import re
import signal
from collections.abc import Iterable, Sequence
from types import TracebackType

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from .messages import meaning
from .recorder import Totals

_PLACE = re.compile(r"\|([MW])Pos:([^|>]*)")
_MOST_ERRORS = 20


class Screen:
    """A View for send.Stream, and the bar of `ugrbl run`; use it as a context."""

    def __init__(self, console: Console, name: str, total: int) -> None:
        self._progress = Progress(
            TextColumn(escape(name)),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("lines"),
            TimeElapsedColumn(),
            TextColumn("[cyan]{task.fields[state]}"),
            console=console,
        )
        self._task = self._progress.add_task("", total=total, state="")

    def __enter__(self) -> "Screen":
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._progress.stop()

    def progress(self, answered: int, status: str = "") -> None:
        """So many lines are done."""
        self._progress.update(self._task, completed=answered, state=escape(brief(status)))

    def message(self, text: str) -> None:
        """A line above the bar."""
        self._progress.console.print(escape(text), highlight=False)

    def resume(self) -> bool:
        """Ask whether to go on. Ctrl-C, or no answer, means no."""
        self._progress.stop()
        before = signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            self._progress.console.print("The machine is held: [b]r[/b]esume or [b]a[/b]bort?")
            while (answer := input("> ").strip().lower()[:1]) not in ("r", "a"):
                pass
        except (EOFError, KeyboardInterrupt):
            answer = "a"
        finally:
            signal.signal(signal.SIGINT, before)
        self._progress.start()
        return answer == "r"


def brief(status: str) -> str:
    """The state and place of a status report: `Run 1.000 2.000 0.000`."""
    state = re.split("[|>]", status[1:])[0]
    place = _PLACE.search(status)
    return f"{state} {place[2].replace(',', ' ')}" if place else state


def show_errors(
    console: Console, errors: Sequence[tuple[int, str]], lines: Sequence[bytes]
) -> None:
    """Each error with its line and its meaning; the first of very many."""
    for number, reply in errors[:_MOST_ERRORS]:
        text = lines[number - 1].decode("latin-1").strip()
        console.print(
            f"line {number}: [b]{escape(text)}[/b]\n    {reply}: {escape(meaning(reply))}",
            highlight=False,
        )
    if len(errors) > _MOST_ERRORS:
        console.print(f"… and {len(errors) - _MOST_ERRORS} more errors")


def summary(rows: Iterable[tuple[str, str]]) -> Table:
    """A table of names and values."""
    table = Table(show_header=False)
    for name, value in rows:
        table.add_row(name, escape(value))
    return table


def totals_rows(totals: Totals) -> list[tuple[str, str]]:
    """What a machine has done, for a summary."""
    rows = [
        ("machining time", clock(totals.time_s)),
        ("distance", f"{totals.distance_mm:.1f} mm"),
    ]
    for axis, made in totals.steps_made.items():
        planned = totals.steps_planned[axis]
        sign = "=" if planned == made else "!="
        rows.append((f"steps {axis}", f"{planned} commanded {sign} {made} made"))
    for axis, (low, high) in totals.bounds_mm.items():
        rows.append((f"travel {axis}", f"{low:.3f} to {high:.3f} mm"))
    return rows


def clock(seconds: float) -> str:
    """Hours, minutes and seconds."""
    minutes, rest = divmod(seconds, 60)
    hours, minutes = divmod(int(minutes), 60)
    return f"{hours}:{minutes:02}:{rest:06.3f}"
