"""The command `ugrbl deploy`."""

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeElapsedColumn

from ..boardfile.files import BoardFileError, board_file
from ..compiling import build
from ..compiling.build import Build, BuildError
from ..device.connection import SendError
from ..device.deploy import DeployError, Result, deploy
from . import ports
from .outputs import Json, check_output, examples, save_json
from .screen import summary

EXAMPLES = examples(
    "ugrbl deploy --board rpi_pico",
    "ugrbl deploy --board my_router.py --port /dev/ttyACM0",
    "ugrbl deploy --board rpi_pico --port COM3 --json -",
)


class Bar:
    """A View: a bar of bytes; use it as a context."""

    def __init__(self, console: Console) -> None:
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            DownloadColumn(),
            TimeElapsedColumn(),
            console=console,
            transient=True,
        )
        self._task = self._progress.add_task("looking at the board", total=None)

    def __enter__(self) -> "Bar":
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._progress.stop()

    def begin(self, count: int, total: int) -> None:
        """Show that `count` files with `total` bytes will be written."""
        self._progress.update(self._task, total=max(total, 1))

    def file(self, path: str) -> None:
        """Show the next file."""
        self._progress.update(self._task, description=escape(path))

    def written(self, count: int) -> None:
        """Show that `count` more bytes are written."""
        self._progress.advance(self._task, count)


def command(
    board: Annotated[
        str,
        typer.Option(metavar="NAME", help="Board: a file of boards/, or a path: my_router.py."),
    ],
    port: Annotated[
        str | None, typer.Option(metavar="PORT", help="Serial port. [default: the only one]")
    ] = None,
    replace: Annotated[
        bool, typer.Option("--replace", help="Also replace a board.py or main.py of your own.")
    ] = False,
    json_file: Json = None,
) -> None:
    """Put the firmware on a board with MicroPython, and start it.

    Checks the board file, compiles what this board needs, copies changed files,
    removes files of an older deployment, and shows what the firmware reports.

    Your settings and files stay, also a board.py that was changed on the board:
    deploy refuses then. A machine in motion is not disturbed. The exit code is 1
    if the deployment failed.
    """
    check_output(json_file, given=locals())
    console = Console(stderr=str(json_file) == "-")
    try:
        file = board_file(board)
        made = build.for_board(file)
        where = ports.choose(port)
        console.print(f"{file.stem}: {len(made.files)} files, {made.bytes} bytes", highlight=False)
        result = _deploy(console, where, made, replace)
    except (BoardFileError, BuildError) as error:
        raise _failed(str(error).splitlines(), "nothing has been copied", json_file) from error
    except SendError as error:
        raise _failed([str(error)], "", json_file) from error
    except DeployError as error:
        raise _failed([str(error)], error.todo, json_file) from error
    except KeyboardInterrupt as error:
        todo = "deploy again; until then the board may start with MicroPython's prompt"
        raise _failed(["stopped half way"], todo, json_file) from error
    _show(console, result, where)
    if json_file:
        save_json({"port": where, "board": file.stem, **result.as_json()}, json_file)


def _deploy(console: Console, port: str, made: Build, replace: bool) -> Result:
    """Copy a build to the board at a port, with a progress bar."""
    from ..device.deploy_device import MpremoteDevice  # it needs a moment to be imported

    with Bar(console) as bar:
        device = MpremoteDevice(port)
        try:
            return deploy(device, made, bar, replace)
        finally:
            device.close()


def _show(console: Console, result: Result, port: str) -> None:
    """Show a table of what was copied, and what the board reports."""
    rows = [
        ("board", f"{result.micropython}, at {port}"),
        *_frozen(result),
        ("copied", f"{_files(len(result.copied))}, {result.bytes} bytes"),
        ("unchanged", _files(result.unchanged)),
    ]
    if result.removed:
        rows.append(("removed", " ".join(result.removed)))
    rows += [("says", result.banner), ("build", result.build)]
    if result.free_bytes is not None:
        rows.append(("free memory", f"{result.free_bytes} bytes, while it runs"))
    console.print(summary([*rows, ("took", f"{result.seconds:g} s")]))


def _frozen(result: Result) -> list[tuple[str, str]]:
    """Return a row that says which firmware runs, if one is frozen."""
    if not result.frozen:
        return []
    runs = (
        "runs"
        if result.runs_frozen
        else "does not run, because files on the board take priority over it"
    )
    return [("frozen", f"build {result.frozen}, which {runs}")]


def _files(count: int) -> str:
    return "1 file" if count == 1 else f"{count} files"


def _failed(why: Sequence[str], todo: str, json_file: Path | None) -> typer.Exit:
    """Show causes and the next step on stderr; returns the exception to raise."""
    console = Console(stderr=True)
    for problem in why:
        console.print(f"[red]{escape(problem)}", highlight=False, soft_wrap=True)
    if todo:
        console.print(f"  -> {escape(todo)}", highlight=False, soft_wrap=True)
    if json_file:
        save_json({"problems": list(why), "todo": todo}, json_file)
    return typer.Exit(1)
