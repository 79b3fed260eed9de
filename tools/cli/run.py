"""The command `ugrbl run`."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from ..draw import plot
from ..draw.job import check_settings, from_file, job_of
from ..draw.motion_trace import MotionTrace, trace_program
from ..grbl.gcode_file import name_of, read_program
from ..grbl.settings_file import as_line
from ..run import machine
from ..run.pace import Paced, Stretch
from ..run.program import Result, run_program
from .custom_options import CustomFile, Inputs, Lenient, around, why_stopped
from .outputs import Json, check_outputs, examples, failed, save_json
from .screen import (
    Screen,
    show_errors,
    show_foreign,
    show_messages,
    show_problems,
    show_wide_arcs,
    show_zeros,
    summary,
    totals_rows,
)

EXAMPLES = examples(
    "ugrbl run badge.nc",
    "ugrbl run badge.nc --check",
    "ugrbl run badge.nc --settings my.settings --set 110=6000 --plot a.html",
)


_Runner = Callable[..., tuple[Result, Paced]]
Picture = Annotated[
    Path | None,
    typer.Option(
        "--plot",
        metavar="FILE",
        help="Draw the tool's path: .html, .png or .svg; - is stdout.",
    ),
]


def command(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", readable=False, help="G-code program; - is stdin.")
    ],
    settings: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The machine's settings, from `ugrbl settings pull`."),
    ] = None,
    setting: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="N=V", help="A setting for this run: 110=6000."),
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Use check mode: nothing moves; exit code 1 on errors.")
    ] = False,
    picture: Picture = None,
    json_file: Json = None,
    board: Annotated[
        str, typer.Option(metavar="NAME", help="Machine: a file of boards/, or a path.")
    ] = machine.DEFAULT_BOARD,
    custom: CustomFile = None,
    inputs: Inputs = None,
    lenient: Lenient = False,
) -> None:
    """Run a program in virtual time, and show its problems.

    Shows its time and distance, and which lines would come too fast for a board. After a pause
    (M0, or a hold in its text) it is resumed. The exit code is 0 if the program was completed;
    with --check, only if no line was refused.
    """
    console = Console(stderr="-" in (str(json_file), str(picture)))
    try:
        check_outputs(json_file, plot=picture, given=locals())
        with console.status("reading …"):
            lines = read_program(file)
            surroundings = replace(around(board, custom, inputs), lenient=lenient)
            has_realtime_bytes = show_problems(console, lines)
        chosen = _chosen(console, settings, setting or ())
        check_settings(chosen, board, surroundings)
        begun = time.monotonic()
        run: _Runner = trace_program if picture else run_program
        conditions = {"board": board, "settings": chosen, "check": check, "around": surroundings}
        with Screen(console, name_of(file), len(lines)) as screen:
            result, recorder = run(lines, progress=screen.progress, **conditions)
            screen.progress(result.lines)
        seconds = time.monotonic() - begun
        late = _late(console, recorder, lines)
        _show(console, result, recorder, lines, late, seconds)
        who = "" if lenient else "--lenient accepts such words, as does"
        show_foreign(console, result.errors, lines, who)
        if picture and isinstance(recorder, MotionTrace):
            job = job_of("as it is", lines, chosen, board, result, recorder)
            plot.save([job], name_of(file), words="", file=picture)
        if json_file:
            _save(result, late, json_file)
    except (ValueError, OSError) as error:
        raise failed(error) from error
    _end(result, check, has_realtime_bytes)


def _chosen(console: Console, file: Path | None, more: Sequence[str]) -> list[str]:
    """Return the settings of a file, followed by those of options."""
    kept = from_file(file) if file else []
    show_zeros(console, kept)
    return kept + [as_line(text) for text in more]


def _late(console: Console, recorder: Paced, lines: Sequence[bytes]) -> list[Stretch]:
    """Return the stretches of the program whose lines come too fast, the worst first."""
    with console.status("checking whether lines come in time …"):
        return recorder.starves(lines)


def _save(result: Result, late: Sequence[Stretch], file: Path) -> None:
    too_fast = [stretch.as_json() for stretch in late]
    save_json({**result.as_json(), "too_fast": too_fast}, file)


def _show(
    console: Console,
    result: Result,
    recorder: Paced,
    lines: Sequence[bytes],
    late: Sequence[Stretch],
    seconds: float,
) -> None:
    """Show the result. late: see _late(). seconds: how long the computation took."""
    show_errors(console, result.errors, lines)
    show_wide_arcs(console, result.wide_arcs)
    show_messages(console, result.other_output)
    for number, output, on in result.switched:
        console.print(f"line {number}: {output} {'on' if on else 'off'}", highlight=False)
    for number in result.pauses:
        console.print(
            f"line {number}: the program paused; the simulator resumed it", highlight=False
        )
    whose = recorder.intake().whose  # the board whose speed was assumed: "a Pico"
    if late:
        console.print(_too_fast(late, whose), highlight=False, markup=False)
    speed = f"{seconds:.1f} s, {result.lines / seconds:.0f} lines/s"
    rows = [("lines", str(result.lines)), ("errors", str(len(result.errors)))]
    if recorder.marks:
        rows.append(("holes punched", str(len(recorder.marks))))
    rows += totals_rows(result.totals)
    if result.totals.time_s:
        rows.append(("lines in time", f"{'no' if late else 'yes'}, for {whose}"))
    rows += [("ended in", result.final_state), ("computed in", speed)]
    console.print(summary(rows))


# By the kind of lines (boardfile/rates.py): their name, and what helps besides a lower feed.
_KINDS = {
    "plain": ("short moves", "longer moves"),
    "power": ("moves with a new S each", "fewer pixels per mm"),
    "in_python_ms": ("arcs, or lines with an M word", "fewer and longer arcs"),
    "no_words_ms": ("comments and empty lines", "a program without them"),
    "chords": ("chords of arcs", "a coarser arc tolerance ($12)"),
}


def _too_fast(late: Sequence[Stretch], whose: str) -> str:
    """Return a text about the worst stretch of lines that come too fast, with the next step.
    whose: the board that cannot accept them as fast, in words."""
    worst = late[0]
    kind_name, remedy = _KINDS[worst.kind]
    more = len(late) - 1
    elsewhere = {0: "", 1: ", and at one more place"}.get(more, f", and at {more} more places")
    lost = sum(stretch.lost_s for stretch in late)
    return (
        f"lines {worst.first} to {worst.last} need {worst.needed:.0f} lines a second, mostly "
        f"{kind_name}, but {whose} accepts only {worst.taken:.0f} of these. Motion will stutter "
        f"there{elsewhere}, and take about {lost:.1f} s longer. "
        f"Lower the feed to {worst.feed} %, or use {remedy}."
    )


def _end(result: Result, check: bool, has_realtime_bytes: bool) -> None:
    """End with the right exit code. has_realtime_bytes: outside of comments, they act at once."""
    if result.stopped:
        raise failed(f"the program could not finish: {why_stopped(result)}")
    if result.resets:
        numbers = ", ".join(map(str, result.resets))
        raise failed(f"line {numbers}: Ctrl-X is a reset: motion planned before it is lost")
    if check and (result.errors or has_realtime_bytes):
        raise typer.Exit(1)
