"""Output of the commands: a progress bar with the machine's state, tables, messages."""

import errno
import os
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from datetime import timedelta
from types import TracebackType

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
)
from rich.table import Table
from rich.text import Text

from .. import paths
from ..device.connection import state_of
from ..device.send import Choice
from ..grbl.gcode_file import is_foreign, language_of, problems, shown
from ..grbl.messages import meaning
from ..grbl.settings_file import zeros
from ..run.recorder import Totals
from .keys import Keys

_PLACE = re.compile(r"[|,]([MW])Pos:(-?[\d.]+(?:,-?[\d.]+)*)")
# Of feed, rapids and spindle; not in every report.
_OVERRIDES = re.compile(r"\|Ov:(\d+,\d+,\d+)")
_MOST_NAMED = 5
_MOST_ERRORS = 20


class Output(Console):
    """stdout. A closed pipe raises OSError, as a full disk does; rich would end the command,
    whatever the machine does."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE))


class _Clock(ProgressColumn):
    """Elapsed time until the bar stops, because motion ends later than the last line is
    answered."""

    def render(self, task: Task) -> Text:
        return Text(str(timedelta(seconds=int(task.elapsed or 0))), style="progress.elapsed")


class Screen:
    """A View for send.Stream, and the bar of `ugrbl run`; use it as a context.

    seconds_left: returns the time left after so many lines, or None. listen: read keys.
    """

    def __init__(
        self,
        console: Console,
        name: str,
        total: int,
        seconds_left: Callable[[int], float | None] = lambda done: None,
        listen: bool = False,
    ) -> None:
        self._progress = Progress(
            TextColumn(escape(name)),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("lines"),
            _Clock(),
            TextColumn("[cyan]{task.fields[state]}"),
            console=console,
        )
        self._seconds_left = seconds_left
        self._overrides = ""
        self._keys = Keys(listen)
        self._task = self._progress.add_task("", total=total, state="")

    def __enter__(self) -> "Screen":
        self._keys.__enter__()
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._keys.__exit__(kind, error, trace)
        try:
            self._progress.stop()
        except OSError as failed:  # the result must still be shown if the disk is full
            why = f"the progress cannot be shown: {paths.why(failed)}"
            Console(stderr=True).print(why, highlight=False)

    def progress(self, answered: int, status: str = "") -> None:
        """Show that `answered` lines are done. status: a report with state and position, or ""."""
        seconds_left = self._seconds_left(answered)
        if found := _OVERRIDES.search(status):  # else those of the last report that had them
            self._overrides = "" if found[1] == "100,100,100" else f"  {found[1]} %"
        state = brief(status) + self._overrides
        if seconds_left is not None and state_of(status) != "Idle":
            without_ms = clock(seconds_left)[: -len(".000")]
            state += f"  {without_ms} left"
        self._progress.update(self._task, completed=answered, state=escape(state))

    def message(self, words: str) -> None:
        """Show a line above the bar."""
        self._progress.console.print(escape(words), highlight=False)

    def keys(self) -> bytes:
        """Return the real-time commands of pressed keys."""
        return self._keys.commands()

    def ask(self, why: str) -> Choice:
        """Ask how to continue. No answer, or no terminal, means abort."""
        if not sys.stdin.isatty():
            return Choice.ABORT
        self._progress.stop()
        self._keys.__exit__(None, None, None)  # the user types a line with Enter
        try:
            return self._choice(why)
        finally:
            self._keys.__enter__()
            self._progress.start()

    def _choice(self, why: str) -> Choice:
        """Return the answer to r, k or a; k is offered only after a refused line."""
        keep_going = "k to keep going whatever is refused, " if why.endswith("refused") else ""
        self.message(f"{why}; the machine is held")
        self.message(
            f"Type r to resume, {keep_going}or a to abort, then Enter; Ctrl-C aborts, too."
        )
        prompt, letters = ("r, k or a> ", "rka") if keep_going else ("r or a> ", "ra")
        try:
            # A tuple, because "" is in every str.
            while (answer := input(prompt).strip().lower()[:1]) not in tuple(letters):
                pass
        except EOFError:
            return Choice.ABORT
        return Choice(answer)


def brief(status: str) -> str:
    """Return state and position of a status report: `Run 1.000 2.000 0.000`."""
    state = state_of(status)
    place = _PLACE.search(status)
    return f"{state} {place[2].replace(',', ' ')}" if place else state


def show_errors(
    console: Console, errors: Sequence[tuple[int, str]], lines: Sequence[bytes]
) -> None:
    """Show each refused line with its meaning, at most _MOST_ERRORS."""
    for number, reply in errors[:_MOST_ERRORS]:
        line = shown(lines[number - 1])
        console.print(
            f"line {number}: [b]{escape(line)}[/b]\n    {reply}: {escape(meaning(reply, line))}",
            highlight=False,
            soft_wrap=True,
        )
    if len(errors) > _MOST_ERRORS:
        console.print(f"… and {len(errors) - _MOST_ERRORS} more errors")


def show_foreign(
    console: Console,
    errors: Sequence[tuple[int, str]],
    lines: Sequence[bytes],
    who: str = "such words are accepted by",
) -> None:
    """Show what helps with words of other controllers (docs/lenient.md), if some were refused.

    errors: (number of the line from 1, reply). who: begins the text that names what accepts such
    words; "" if LENIENT was in use, so that nothing more would.
    """
    refused = {number: lines[number - 1] for number, _ in errors}
    # By number, the controller for whose language a line was written.
    languages = {number: whose for number, line in refused.items() if (whose := language_of(line))}
    if languages:
        controller = next(iter(languages.values()))
        note = (
            f"{_where(list(languages))}: written for {controller}, whose "
            "language no Grbl understands: choose Grbl in the program that made it (its post "
            "processor)"
        )
    elif who and (foreign := [number for number, line in refused.items() if is_foreign(line)]):
        note = (
            f"{_where(foreign)}: written for another controller; {who} a board with "
            "LENIENT = True. For tool changes, write a handler of your own: --custom"
        )
    else:
        return
    console.print(note, highlight=False, markup=False, soft_wrap=True)


def _where(numbers: Sequence[int]) -> str:
    """Return numbers of lines as text, at most _MOST_NAMED of them."""
    named = ", ".join(map(str, numbers[:_MOST_NAMED])) + ", …" * (len(numbers) > _MOST_NAMED)
    return f"line{'s' * (len(numbers) > 1)} {named}"


def show_wide_arcs(console: Console, found: Sequence[tuple[int, str]]) -> None:
    """Show arcs that leave the part, at most _MOST_ERRORS."""
    for number, text in found[:_MOST_ERRORS]:
        console.print(f"line {number}: {text}. Is this intended?", highlight=False, soft_wrap=True)
    if len(found) > _MOST_ERRORS:
        console.print(f"… and {len(found) - _MOST_ERRORS} more such arcs")


def show_messages(console: Console, output: Sequence[tuple[int, str]]) -> None:
    """Show the machine's messages to its sender, by line."""
    for number, line in output:
        if line.startswith("[MSG:"):
            text = line.removeprefix("[MSG:").removesuffix("]")
            console.print(f"line {number}: {text}", highlight=False, markup=False)


def show_problems(console: Console, lines: Sequence[bytes]) -> bool:
    """Show bytes that act at once. Returns whether some are outside of comments."""
    all_problems = problems(lines)
    bad = [problem for problem in all_problems if not problem.in_comment]
    for problem in bad[:_MOST_ERRORS]:
        words = f"line {problem.line}: {problem.text} anywhere in a line: remove it"
        console.print(escape(words), highlight=False)
    if len(bad) > _MOST_ERRORS:
        console.print(f"… and {len(bad) - _MOST_ERRORS} more such lines")
    harmless = [problem for problem in all_problems if problem.in_comment]
    if harmless:
        first = f"line {harmless[0].line}: {harmless[0].text}"
        more = f", and {len(harmless) - 1} more" if len(harmless) > 1 else ""
        words = f"{first}{more}: `ugrbl send` makes them harmless, other senders may not"
        console.print(escape(words), highlight=False)
    return bool(bad)


def show_zeros(console: Console, settings: Iterable[str]) -> None:
    """Show settings, lines such as `$100=0`, with which an axis would not move."""
    for text in zeros(settings):
        console.print(f"[yellow]note[/]: {escape(text)}", highlight=False, soft_wrap=True)


def summary(rows: Iterable[tuple[str, str]]) -> Table:
    """Return a table of names and values."""
    table = Table(show_header=False)
    for name, value in rows:
        table.add_row(name, escape(value))
    return table


def totals_rows(totals: Totals) -> list[tuple[str, str]]:
    """Return the rows of a machine's totals for a summary."""
    rows = [
        ("machining time", clock(totals.time_s)),
        ("distance", f"{totals.distance_mm:.1f} mm"),
    ]
    for axis, made in totals.steps_made.items():
        planned = totals.steps_planned[axis]
        not_made = totals.steps_probed.get(axis, 0)  # because the probe touched before
        rows.append((f"steps {axis}", _steps(planned, made, probed=not_made)))
    for axis, (low, high) in totals.bounds_mm.items():
        unit = "degrees" if axis in totals.rotary else "mm"
        rows.append((f"travel {axis}", f"{low:.3f} to {high:.3f} {unit}"))
    return rows


def _steps(planned: int, made: int, probed: int) -> str:
    """Return planned and made steps as text. probed: not made, because the probe touched."""
    if probed and planned == made + probed:
        return f"{planned} commanded, {made} made: stopped by the probe"
    return f"{planned} commanded {'=' if planned == made else '!='} {made} made"


def clock(seconds: float) -> str:
    """Return hours, minutes and seconds."""
    minutes, rest = divmod(seconds, 60)
    hours, minutes = divmod(int(minutes), 60)
    return f"{hours}:{minutes:02}:{rest:06.3f}"
