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
        name_on_board, data = jobs.name_of(name or file.name), with_line_feeds(read_utf8(file))
        check_text(split_lines(data), name_of(file))
    except (ValueError, OSError) as error:
        raise failed(error) from error
    console = Console()
    with connected(port, baud) as connection, Progress(console=console, transient=True) as bar:
        task = bar.add_task(name_on_board, total=len(data))
        jobs.push(connection, name_on_board, data, lambda done: bar.update(task, completed=done))
    how = f"`ugrbl job run {name_on_board}` runs it"
    _say(f"{name_on_board} is on the board: {len(data)} bytes; {how}")


@app.command("list", epilog=_EXAMPLE.format("list"))
def list_jobs(port: Port = None, baud: Baud = BAUD) -> None:
    """Show the programs on a board, and the free space."""
    with connected(port, baud) as connection:
        files, free_space = jobs.files(connection)
    if files:
        table = Table("name", "bytes", box=None, pad_edge=False)
        for one in files:
            table.add_row(one.name, str(one.size))
        Console().print(table)
    _say(free_space)


@app.command(epilog=_EXAMPLE.format("show PART.NC"))
def show(name: Name, port: Port = None, baud: Baud = BAUD) -> None:
    """Print a program that is on a board."""
    with connected(port, baud) as connection:
        print(jobs.show(connection, _name_on_board(name)), end="")


@app.command(epilog=_EXAMPLE.format("delete PART.NC"))
def delete(name: Name, port: Port = None, baud: Baud = BAUD, yes: Yes = False) -> None:
    """Remove a program from a board."""
    name_on_board = _name_on_board(name)
    with connected(port, baud) as connection:
        if not yes:
            jobs.check_there(connection, name_on_board)
            agree(f"Delete {name_on_board} from the board?", "nothing has been changed")
        jobs.delete(connection, name_on_board)
    _say(f"{name_on_board} is not on the board any more")


@app.command(epilog=_EXAMPLE.format("run PART.NC"))
def run(name: Name, port: Port = None, baud: Baud = BAUD) -> None:
    """Make a board run one of its programs.

    It continues without this computer. The machine's status reports show the progress. Any sender,
    and `ugrbl console`, can show them, hold the program and stop it.
    """
    with connected(port, baud) as connection:
        _say(jobs.start(connection, _name_on_board(name)))


@app.command(epilog=_EXAMPLE.format("resume PART.NC --line 1200"))
def resume(
    name: Annotated[
        str,
        typer.Argument(
            metavar="[NAME]", help="Name of the program. [default: the one that was interrupted]"
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
    name_on_board = _name_on_board(name) if name else ""
    what = (
        f"line {line} of {name_on_board}"
        if line
        else f"{name_on_board or 'the program'}, where it stopped"
    )
    with connected(port, baud) as connection:
        if not yes:
            jobs.check_there(connection, name_on_board)
            agree(f"The tool will move to {what}. Is it the right tool?", "nothing has moved")
        from_line = f"@{line or ''}"  # @ alone: where it was last held or stopped
        _say(jobs.start(connection, name_on_board, from_line))


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
    name_on_board = _name_on_board(name) if name else ""
    with connected(port, baud) as connection:
        jobs.button(connection, name_on_board)
    _say(f"the start button runs {name_on_board or 'no program'}")


def _name_on_board(name: str) -> str:
    """Return a job's name as the board has it. A name that it cannot have ends the command."""
    try:
        return jobs.name_of(name)
    except ValueError as error:
        raise failed(error) from error


def _say(words: str) -> None:
    Console().print(words, highlight=False, markup=False, soft_wrap=True)
