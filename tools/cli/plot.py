"""The command `ugrbl plot`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from ..draw import plot
from ..draw.job import Job, check_settings, describe, from_file, run_job, short, verdict
from ..grbl.gcode_file import name_of, read_program
from ..grbl.settings_file import as_line
from ..run import machine
from .custom_options import CustomFile, Inputs, around, why_stopped
from .outputs import check_outputs, examples, failed, save_json
from .screen import Screen, show_errors, show_foreign, show_zeros, summary

EXAMPLES = examples(
    "ugrbl plot badge.nc",
    "ugrbl plot badge.nc -o badge.png --settings my.settings",
    "ugrbl plot badge.nc --set 120=500 --set 121=500",
)
Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        "-o",
        metavar="FILE",
        help="Picture to write: .html, .png or .svg; - is stdout. [default: .html]",
    ),
]


def command(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", readable=False, help="G-code program; - is stdin.")
    ],
    out: Out = None,
    settings: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The machine's settings, from `ugrbl settings pull`."),
    ] = None,
    what_if: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="N=V", help="Also draw it with this setting, for comparison."
        ),
    ] = None,
    json_file: Annotated[
        Path | None,
        typer.Option(
            "--json", metavar="FILE", help="Write the numerical results to this file; - is stdout."
        ),
    ] = None,
    board: Annotated[str, typer.Option(metavar="NAME", help="Machine: a file of boards/.")] = (
        machine.DEFAULT_BOARD
    ),
    custom: CustomFile = None,
    inputs: Inputs = None,
) -> None:
    """Draw what a program will do.

    The path is coloured by speed; charts show speed, acceleration and step rates. With --set it is
    drawn a second time with those settings, and the time saved is shown. The exit code is 1 if
    lines are refused; the rest of the program is still drawn.
    """
    console = Console(stderr="-" in (str(json_file), str(out)))
    name = name_of(file)
    target = out or Path(Path(name).stem + ".html")
    try:
        check_outputs(json_file, plot=target, given=locals())
        if not out and target.is_file() and not plot.has_drawn(target):
            raise ValueError(f"{target} exists and was not drawn by plot: -o {target} replaces it")
        jobs = _jobs(console, file, settings, what_if or (), board, around(board, custom, inputs))
        comparison = ""
        if len(jobs) > 1:
            extra = describe([as_line(text) for text in what_if or ()])
            comparison = f"{extra}: {verdict(*jobs)}"
        console.print("Drawing …")
        plot.save(jobs, name, comparison, target)
        if json_file:
            save_json({"jobs": [job.as_json() for job in jobs], "verdict": comparison}, json_file)
    except (ValueError, OSError) as error:
        raise failed(error) from error
    _show(console, jobs, comparison, target)
    if jobs[0].result.errors:
        raise typer.Exit(1)


def _jobs(
    console: Console,
    file: Path,
    settings: Path | None,
    what_if: Sequence[str],
    board: str,
    around: machine.Around,
) -> list[Job]:
    """Run the program with the machine's settings, and again with those of --set. Errors and hints
    are shown. ValueError if it does not come to its end."""
    lines = read_program(file)
    base = from_file(settings) if settings else []
    show_zeros(console, base)
    extra = [as_line(text) for text in what_if]
    check_settings([*base, *extra], board, around)
    runs = [(settings.name if settings else "as it is", base)]
    if extra:
        runs.append((" ".join(extra), [*base, *extra]))
    jobs = []
    for name, chosen in runs:
        with Screen(console, f"{name_of(file)}, {name}", len(lines)) as screen:
            jobs.append(run_job(name, lines, chosen, board, screen.progress, around))
            screen.progress(jobs[-1].result.lines)
        if jobs[-1].result.stopped:
            raise ValueError(f"the program could not finish: {why_stopped(jobs[-1].result)}")
    show_errors(console, jobs[0].result.errors, lines)
    show_foreign(console, jobs[0].result.errors, lines)
    return jobs


def _show(console: Console, jobs: Sequence[Job], comparison: str, target: Path) -> None:
    """Show the time of each run, the picture's file, and the comparison; "" if there is none."""
    rows = [(job.name, short(job.seconds)) for job in jobs]
    console.print(summary([*rows, ("drawn in", str(target))]))
    if comparison:
        console.print(comparison, highlight=False)
