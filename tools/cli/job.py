"""`ugrbl job`: programs that are stored on a board, and run without a computer."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from ..device import jobs
from ..device.connection import BAUD
from ..grbl.gcode_file import check_text, name_of, read_utf8
from ..grbl.lines import split_lines, with_line_feeds
from .outputs import agree, failed
from .ports import Baud, Port, connected

app = typer.Typer(no_args_is_help=True, help="Programs that are stored on a board: docs/jobs.md.")

Name = Annotated[
    str, typer.Argument(metavar="NAME", help="Name of the program, as `ugrbl job list` shows it.")
]
Yes = Annotated[bool, typer.Option("--yes", "-y", help="Do not ask for confirmation.")]
_EXAMPLE = "\n\nExample:  ugrbl job {} --port /dev/ttyACM0"


@app.command(epilog=_EXAMPLE.format("push part.nc"))
def push(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", readable=False, help="G-code file to store on the board."),
    ],
    port: Port = None,
    baud: Baud = BAUD,
    name: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Name on the board. [default: the file's name]"),
    ] = None,
) -> None:
    """Put a program on a board, over the line that senders use.

    A program of the same name is replaced when the new one is complete.
    """
    try:
        called, data = jobs.name_of(name or file.name), with_line_feeds(read_utf8(file))
        check_text(split_lines(data), name_of(file))
    except (ValueError, OSError) as error:
        raise failed(error) from error
    console = Console()
    with connected(port, baud) as connection, Progress(console=console, transient=True) as bar:
        task = bar.add_task(called, total=len(data))
        jobs.push(connection, called, data, lambda done: bar.update(task, completed=done))
    _say(f"{called} is on the board: {len(data)} bytes; `ugrbl job run {called}` runs it")


@app.command("list", epilog=_EXAMPLE.format("list"))
def list_jobs(port: Port = None, baud: Baud = BAUD) -> None:
    """Show the programs on a board, and the free space."""
    with connected(port, baud) as connection:
        files, room = jobs.files(connection)
    if files:
        table = Table("name", "bytes", box=None, pad_edge=False)
        for one in files:
            table.add_row(one.name, str(one.size))
        Console().print(table)
    _say(room)


@app.command(epilog=_EXAMPLE.format("show PART.NC"))
def show(name: Name, port: Port = None, baud: Baud = BAUD) -> None:
    """Print a program that is on a board."""
    with connected(port, baud) as connection:
        print(jobs.show(connection, _called(name)), end="")


@app.command(epilog=_EXAMPLE.format("delete PART.NC"))
def delete(name: Name, port: Port = None, baud: Baud = BAUD, yes: Yes = False) -> None:
    """Remove a program from a board."""
    called = _called(name)
    with connected(port, baud) as connection:
        if not yes:
            jobs.check_there(connection, called)
            agree(f"Delete {called} from the board?", "nothing has been changed")
        jobs.delete(connection, called)
    _say(f"{called} is not on the board any more")


@app.command(epilog=_EXAMPLE.format("run PART.NC"))
def run(name: Name, port: Port = None, baud: Baud = BAUD) -> None:
    """Make a board run one of its programs.

    It continues without this computer. The machine's status reports show the progress. Any sender,
    and `ugrbl console`, can show them, hold the program and stop it.
    """
    with connected(port, baud) as connection:
        _say(jobs.start(connection, _called(name)))


@app.command(epilog=_EXAMPLE.format("resume PART.NC --line 1200"))
def resume(
    name: Annotated[
        str,
        typer.Argument(
            metavar="[NAME]", help="Name of the program. [default: the one that has not ended]"
        ),
    ] = "",
    line: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=1,
            help="Line to begin at. [default: where it was last held or stopped]",
        ),
    ] = None,
    port: Port = None,
    baud: Baud = BAUD,
    yes: Yes = False,
) -> None:
    """Continue in the middle of a program that is on a board.

    Home the machine first. With the tool off it moves up and across to where the line begins.
    There the spindle starts, and the tool moves down at the feed rate.
    """
    if line and not name:
        raise failed("--line needs the name of the program")
    called = _called(name) if name else ""
    what = f"line {line} of {called}" if line else f"{called or 'the program'}, where it stopped"
    with connected(port, baud) as connection:
        if not yes:
            jobs.check_there(connection, called)
            agree(f"The tool will move to {what}. Is it the right tool?", "nothing has moved")
        _say(jobs.start(connection, called, f"@{line or ''}"))


@app.command(epilog=_EXAMPLE.format("button PART.NC"))
def button(
    name: Annotated[
        str,
        typer.Argument(metavar="[NAME]", help="Program that the button starts. [default: none]"),
    ] = "",
    port: Port = None,
    baud: Baud = BAUD,
) -> None:
    """Assign a program to the board's start button.

    When pressed, it runs that program if nothing else runs.
    """
    called = _called(name) if name else ""
    with connected(port, baud) as connection:
        jobs.button(connection, called)
    _say(f"the start button runs {called or 'no program'}")


def _called(name: str) -> str:
    """Return a job's name as the board has it. A name that it cannot have ends the command."""
    try:
        return jobs.name_of(name)
    except ValueError as error:
        raise failed(error) from error


def _say(words: str) -> None:
    Console().print(words, highlight=False, markup=False, soft_wrap=True)
