"""The command `ugrbl send`."""

from collections.abc import Sequence
from contextlib import nullcontext
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from .. import paths
from ..device.connection import BAUD, Connection, SendError
from ..device.from_line import CannotEnter
from ..device.send import Report
from ..grbl import gcode_file
from ..run.machine import DEFAULT_BOARD
from .custom_options import CustomFile, Inputs, around
from .outputs import examples, failed
from .ports import Baud, Port, choose
from .screen import Output, show_problems
from .send_job import Job, Options, Stopped

EXAMPLES = examples(
    "ugrbl send job.nc",
    "ugrbl send job.nc --port /dev/ttyACM0 --from-line 1200",
    "make-gcode | ugrbl send - --port COM3 --keep-going",
)


class Mode(str, Enum):
    """How a program is streamed."""

    COUNT = "count"
    LINE = "line"


_FromLine = Annotated[
    int,
    typer.Option(
        *("--from-line", "--from"),
        metavar="N",
        min=1,
        help="Begin at line N, with the modes and position that the earlier lines lead to.",
    ),
]


def command(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", readable=False, help="G-code program; - is stdin."),
    ],
    port: Port = None,
    baud: Baud = BAUD,
    mode: Annotated[
        Mode, typer.Option(help="count: keep Grbl's buffer full; line: one line at a time.")
    ] = Mode.COUNT,
    check_first: Annotated[
        bool,
        typer.Option(
            "--check/--no-check",
            help="Let the simulator look for errors first, with the machine's own settings.",
        ),
    ] = True,
    keep_going: Annotated[
        bool, typer.Option("--keep-going", help="Continue after refused lines.")
    ] = False,
    from_line: _FromLine = 1,
    board: Annotated[
        str | None, typer.Option(metavar="NAME", help="The simulator's board, for --check.")
    ] = None,
    custom: CustomFile = None,
    inputs: Inputs = None,
    yes: Annotated[
        bool, typer.Option("--yes", "-y", help="Do not ask for confirmation before it starts.")
    ] = False,
) -> None:
    """Stream a program to a Grbl.

    The simulator checks it first; with --custom it also knows your own words. If the machine
    refuses a line, it is held and you are asked; without a terminal the job ends. Ctrl-C, a closed
    terminal and SIGTERM hold the machine first. Keys: space holds, ~ resumes, + and - change the
    feed. The exit code is 0 if all lines were sent and none was refused.
    """
    options = Options(
        name=gcode_file.name_of(file),
        board=board,
        check=check_first,
        by_line=mode is Mode.LINE,
        keep_going=keep_going,
        from_line=from_line,
        yes=yes,
        custom=custom,
        inputs=tuple(inputs or ()),
    )
    report = _send(file, options, port, baud)
    if report.signal:
        raise typer.Exit(128 + report.signal)
    if not report.ok():
        raise typer.Exit(1)


def _send(file: Path, options: Options, port: str | None, baud: int) -> Report:
    """Send the file; returns the result. Ends the command if nothing can be sent."""
    console = Output()
    try:
        # Raises ValueError for wrong options before the machine is contacted.
        around(options.board or DEFAULT_BOARD, options.custom, list(options.inputs))
        # In a file the status would only be an empty line, which fails on a full disk.
        with console.status("reading …") if console.is_terminal else nullcontext():
            lines = _read(file, options, console)
        connection = Connection(choose(port), baud)
        try:
            return Job(lines, options, connection, console).run()
        finally:
            connection.close()
    except OSError as error:
        raise failed(f"the progress cannot be shown: {paths.why(error)}") from error
    except (SendError, Stopped, CannotEnter, ValueError) as error:
        raise failed(error) from error


def _read(file: Path, options: Options, console: Console) -> Sequence[bytes]:
    """Return the program; Stopped if it must not be sent."""
    try:
        lines = gcode_file.read_program(file)
    except OSError as error:
        raise Stopped(str(error)) from error
    if options.from_line > len(lines):
        raise Stopped(f"{options.name} has only {len(lines)} lines")
    if show_problems(console, lines):
        raise Stopped("nothing was sent")
    return lines
