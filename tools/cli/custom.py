"""`ugrbl custom`: the user's own Python, checked and put on a board."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from ..run import custom_check, custom_try, machine, stubs
from ..run.custom_check import Verdict
from ..run.machine import Around
from ..run.own_python import OwnPython
from .custom_options import Inputs, around
from .outputs import Json, check_output, failed, save_json

app = typer.Typer(no_args_is_help=True, help="Your own Python on the board.")

File = Annotated[
    Path,
    typer.Argument(metavar="FILE", readable=False, help="A .py file, or a folder of them."),
]
Board = Annotated[
    str,
    typer.Option(
        metavar="NAME", help="Board file that names the pins: a file of boards/, or a path."
    ),
]
_EXAMPLE = "\n\nExample:  ugrbl custom {}"


@app.command(epilog=_EXAMPLE.format("check custom.py --board my_router.py"))
def check(
    file: File,
    board: Board = machine.DEFAULT_BOARD,
    inputs: Inputs = None,
    json_file: Json = None,
) -> None:
    """Check it for problems; run its handlers in the simulator.

    Checks words, letters and parameters, names of pins, imports, and compiles it with
    MicroPython's compiler. In the dry run letters are 1, and inputs change when they are waited
    for. The exit code is 1 if something is wrong, or if it needs what the simulator does not have.
    """
    check_output(json_file, given=locals())
    console = Console(stderr=str(json_file) == "-")
    try:
        surroundings = around(board, file, inputs)
        verdict = judge(console, board, surroundings)
    except (ValueError, OSError) as error:
        raise failed(error) from error
    if json_file:
        save_json(verdict.as_json(), json_file)
    if not verdict.is_good:
        raise typer.Exit(1)


@app.command(epilog=_EXAMPLE.format("types"))
def types(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="The folder of your programs.")
    ] = Path("."),
) -> None:
    """Write stubs: an editor then completes m.

    They describe what custom.py imports as ugrbl, and m as Machine: def vacuum(m: Machine, P).
    They go into the folder typings, where Pylance and Pyright look; the package ugrbl_motion is
    there as well.
    """
    files = {**stubs.custom(), **stubs.motion()}
    try:
        stubs.save(files, folder)
    except OSError as error:
        raise failed(error) from error
    Console().print(
        f"{len(files)} files in {folder / stubs.FOLDER}", highlight=False, soft_wrap=True
    )


def judge(console: Console, board: str, surroundings: Around) -> Verdict:
    """Check the user's Python and show the result."""
    own = _own(surroundings)
    with console.status(f"checking {own.path} …"):
        verdict, handlers = custom_check.check(own, board, surroundings)
        custom_try.try_all(handlers, board, surroundings, verdict)
    _show(console, own, verdict, board)
    return verdict


def _own(surroundings: Around) -> OwnPython:
    assert surroundings.custom
    return surroundings.custom


def _show(console: Console, own: OwnPython, verdict: Verdict, board: str) -> None:
    """Show problems, the handlers tried, notes, and a last line with the verdict."""

    def say(mark: str, text: str, end: str = "") -> None:  # mark, end: markup, printed as it is
        console.print(f"{mark}{escape(text)}{end}", highlight=False, soft_wrap=True)

    for problem in verdict.problems:
        say("[red]BAD [/] ", problem)
    for handler, result, is_good in verdict.tried:
        if is_good:
            say("[green]ok  [/] ", f"{handler}: {result}")
        else:
            say("[red]BAD [/] ", result)
    for lack in verdict.untried:
        say("[yellow]note[/] ", f"cannot be tried in the simulator: {lack}")
    for note in verdict.notes + _assumed_pins(own, board):
        say("[yellow]note[/] ", note)
    count = len(verdict.handlers)
    bad = len(verdict.problems) + sum(not is_good for _, _, is_good in verdict.tried)
    what = f"{own.path}: {count} handler{'s' * (count != 1)}, " if count else f"{own.path}: "
    if bad:
        outcome = f"{bad} wrong"
    else:
        outcome = "not tried" if verdict.untried else "all is well"
    say("[b]", what + outcome, "[/b]")


def _assumed_pins(own: OwnPython, board: str) -> list[str]:
    """Return a note about pins that only the simulator has."""
    from ..boardfile.files import load_board

    pins: dict[str, Any] = machine.assumed_pins(load_board(board), own)
    named = [name for names in pins.values() for name in names]
    if not named:
        return []
    return [f"not checked whether these pins exist: {', '.join(named)}; --board NAME checks them"]
