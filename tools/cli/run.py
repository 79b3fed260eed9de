"""The command `ugrbl run`."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from ..draw import plot
from ..draw.job import from_file, job_of
from ..draw.motion_trace import MotionTrace, trace_program
from ..grbl.gcode_file import name_of, read_program
from ..grbl.messages import meaning
from ..grbl.settings_file import as_line
from ..run import machine
from ..run.program import Result, run_program
from ..run.recorder import Recorder
from .outputs import check_outputs, failed, save_json
from .screen import Screen, show_errors, show_problems, summary, totals_rows

EXAMPLES = (
    "Examples:  ugrbl run badge.nc   ·   ugrbl run badge.nc --check"
    "   ·   ugrbl run badge.nc --settings my.settings --set 110=6000 --plot badge.html"
)


_Runner = Callable[..., tuple[Result, Recorder]]


def command(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", readable=False, help="G-code program; - is stdin.")
    ],
    settings: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The machine's, of `ugrbl settings pull`."),
    ] = None,
    setting: Annotated[
        list[str] | None, typer.Option("--set", metavar="N=V", help="A setting: 110=6000.")
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="In check mode, nothing moves; errors make it exit 1.")
    ] = False,
    picture: Annotated[
        Path | None,
        typer.Option("--plot", metavar="FILE", help="Draw it: .html, .png or .svg; - is stdout."),
    ] = None,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write the result there; - is stdout."),
    ] = None,
    board: Annotated[
        str, typer.Option(metavar="NAME", help="Machine: a file of boards/, or a path.")
    ] = machine.DEFAULT_BOARD,
) -> None:
    """Run a program in virtual time and say how long it takes, how far it goes, what is wrong.

    Where the program pauses (M0, or a hold in its text) it is told to go on. The exit code is 0
    if it came to its end; with --check, only if there were no errors either.
    """
    console = Console(stderr="-" in (str(json_file), str(picture)))
    name = name_of(file)
    try:
        check_outputs(json_file, plot=picture, keep=(file, settings))
        lines = read_program(file)
        acting = show_problems(console, lines)
        chosen = from_file(settings) if settings else []
        chosen += [as_line(text) for text in setting or ()]
        begun = time.monotonic()
        with Screen(console, name, len(lines)) as screen:
            run: _Runner = trace_program if picture else run_program
            result, recorder = run(
                lines, board=board, settings=chosen, check=check, progress=screen.progress
            )
            screen.progress(result.lines)
        _tell(console, result, recorder, lines, time.monotonic() - begun)
        if picture and isinstance(recorder, MotionTrace):
            job = job_of("as it is", lines, chosen, board, result, recorder)
            plot.save([job], name, "", picture)
        if json_file:
            save_json(result.as_json(), json_file)
    except (ValueError, OSError) as error:
        raise failed(error) from error
    _judge(result, check, acting)


def _tell(
    console: Console, result: Result, recorder: Recorder, lines: Sequence[bytes], seconds: float
) -> None:
    """What came of it."""
    show_errors(console, result.errors, lines)
    for number in result.pauses:
        console.print(f"line {number}: paused; told to go on", highlight=False)
    speed = f"{seconds:.1f} s, {result.lines / seconds:.0f} lines/s"
    rows = [("lines", str(result.lines)), ("errors", str(len(result.errors)))]
    if recorder.marks:
        rows.append(("holes punched", str(len(recorder.marks))))
    rows += [*totals_rows(result.totals), ("ended in", result.final_state), ("computed in", speed)]
    console.print(summary(rows))


def _judge(result: Result, check: bool, acting: bool) -> None:
    """End with the exit code that is due. acting: bytes of the program act at once."""
    if result.stopped:
        reply = result.stopped.rpartition(" ")[2]
        why = meaning(reply) if reply.startswith(("ALARM:", "error:")) else ""
        raise failed(": ".join(filter(None, ["could not finish", result.stopped, why])))
    if result.resets:
        numbers = ", ".join(map(str, result.resets))
        raise failed(f"line {numbers}: Ctrl-X is a reset: what was planned before it is lost")
    if check and (result.errors or acting):
        raise typer.Exit(1)
