"""`ugrbl custom` for a board: push, pull, edit and remove."""

import os
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from .. import paths
from ..device import custom_files
from ..device.connection import SendError
from ..device.custom_files import CustomFiles
from ..device.deploy import DeployError
from ..run import custom_check, machine
from ..run.own_python import OwnPython, OwnPythonError
from . import ports
from .custom import Board, File, app, judge
from .custom_options import Inputs, around
from .deploy import Bar
from .outputs import agree, failed
from .ports import Port

__all__ = ["app"]  # includes the commands that need no board

Anyway = Annotated[
    bool, typer.Option("--anyway", help="Push the files even if the dry run fails.")
]
Yes = Annotated[bool, typer.Option("--yes", "-y", help="Do not ask for confirmation.")]
_EXAMPLE = "\n\nExample:  ugrbl custom {}"
# Messages of the firmware after its start.
_RUNS = "Custom: "  # and the names of the handlers
_LEFT_OUT = "Custom left out: "  # and the reason
_NEW = '''"""My own words for the machine: see docs/custom.md of ugrbl."""

from ugrbl import mcode


@mcode(100)
def hello(m):
    m.message("hello, I am at %s" % m.position())
'''


@app.command(epilog=_EXAMPLE.format("push custom.py --port /dev/ttyACM0"))
def push(
    file: File,
    port: Port = None,
    board: Board = machine.DEFAULT_BOARD,
    inputs: Inputs = None,
    anyway: Anyway = False,
) -> None:
    """Check it, and put it on the board in place of the old one.

    The board restarts. The machine must stand still (Idle or Alarm); it starts as after power-up:
    home it, or set its zero again. If anything interrupts this, the board has either the old file
    or the new one.
    """
    console = Console()
    with _with_messages():
        own = _checked(console, file, board, inputs, anyway)
        where = ports.choose(port)
        _push(console, where, own)


def _checked(
    console: Console, file: Path, board: str, inputs: "list[str] | None", anyway: bool
) -> OwnPython:
    """Return the user's Python after the check. Ends the command if the check fails."""
    surroundings = around(board, file, inputs)
    verdict = judge(console, board, surroundings)
    if verdict.problems or not (verdict.is_good or anyway):  # anyway: only problems count
        todo = "" if verdict.problems else "; --anyway pushes even if the dry run fails"
        raise failed(f"nothing has been put on a board{todo}")
    assert surroundings.custom
    return surroundings.custom


def _push(console: Console, port: str, own: OwnPython) -> None:
    """Put the files on the board, restart it, and show what the firmware reports."""
    with _board_files(port) as on_board:
        options = on_board.options()
        name = custom_files.name_of(options)
        files = renamed(own, name)
        missing_pins = custom_check.unknown_pins(own, options["OUTPUTS"], options["INPUTS"])
        if missing_pins:
            on_board.restart()
            raise DeployError(
                "\n".join(missing_pins),
                "add these pins to the board file, and deploy it; nothing was pushed",
            )
        with Bar(console) as bar:
            bar.begin(len(files), sum(map(len, files.values())))
            custom_files.push(on_board, name, files, bar.written)
        on_board.restart()
        _show_start(console, f"{', '.join(files)} at {port}", on_board.told)


def renamed(own: OwnPython, name: str) -> dict[str, bytes]:
    """Return the files of the user's Python by path, under the name that this board reads (its
    option CUSTOM). DeployError if one imports its own folder by another name."""
    old = own.name
    if own.is_folder and name != old:
        referring = [str(m.file) for m in own.modules.values() if f"{old}.".encode() in m.source]
        if referring:
            raise DeployError(
                f"this board reads the folder {name}, but {referring[0]} refers to {old}",
                f"write {name} in that file, or check and push with --board and the file of this "
                "board",
            )
    return {path.replace(old, name, 1): content for path, content in own.files.items()}


def _show_start(console: Console, what: str, messages: "list[str]") -> None:
    """Show what the firmware reports about it. Ends the command if it was left out.

    what: the files and the port. messages: those of the start, without [MSG:].
    """
    for text in messages:
        if text.startswith(_RUNS):
            console.print(
                f"[green]ok  [/] {escape(what)}: {escape(text.removeprefix(_RUNS))}",
                highlight=False,
                soft_wrap=True,
            )
            return
        if text.startswith(_LEFT_OUT):
            raise DeployError(
                f"{what}: it is on the board, but was not loaded: {text.removeprefix(_LEFT_OUT)}",
                "correct it and push it again, or remove it: ugrbl custom remove",
            )
    raise DeployError(
        f"{what}: it is on the board, but the firmware there is too old for it",
        "update the firmware: ugrbl deploy",
    )


@app.command(epilog=_EXAMPLE.format("pull mine.py --port /dev/ttyACM0"))
def pull(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Where to write: a .py file, or a folder.")
    ],
    port: Port = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace an existing file or folder.")
    ] = False,
) -> None:
    """Fetch the files from the board, and restart the board."""
    with _with_messages():
        if file.exists() and not force:
            raise DeployError(f"{file} exists already", "--force replaces it")
        paths.check_writable(file / "one" if file.is_dir() else file)  # "one": any name in it
        where = ports.choose(port)
        files = _fetch(where)
        if not files:
            raise DeployError(
                f"the board at {where} has no Python of yours",
                "put it there: ugrbl custom push FILE",
            )
        path = keep(files, file)
        Console().print(
            f"{path} now has the files of the board at {where}", highlight=False, soft_wrap=True
        )


def _fetch(port: str) -> dict[str, bytes]:
    """Return the user's files that are on the board, by path, and restart the board."""
    with _board_files(port) as on_board:
        name = custom_files.name_of(on_board.options())
        files = custom_files.pull(on_board, name)
        on_board.restart()
        return files


def keep(found: Mapping[str, bytes], file: Path) -> Path:
    """Write the files of a board, by their paths there: one to a file, or a folder of them to a
    folder. Returns the path of the file or folder that was written."""
    first_path, first_content = next(iter(found.items()))
    if len(found) == 1 and "/" not in first_path:  # a single file, not a folder
        if file.is_dir():
            file /= first_path
        paths.write(file, first_content)
        return file
    if file.suffix == ".py":
        raise DeployError(
            f"the board has a folder of files, which cannot be written to the single file {file}",
            "name a folder",
        )
    for path, content in found.items():
        paths.write(file / path.rpartition("/")[2], content)
    return file


@app.command(epilog=_EXAMPLE.format("edit --port /dev/ttyACM0"))
def edit(
    port: Port = None,
    board: Board = machine.DEFAULT_BOARD,
    inputs: Inputs = None,
    anyway: Anyway = False,
) -> None:
    """Open it in $EDITOR, and push it if you have changed it.

    If the board has none, you start with an example.
    """
    with _with_messages():
        editor = _editor()
        where = ports.choose(port)
        files = _fetch(where) or {"custom.py": _NEW.encode()}
        folder = Path(tempfile.mkdtemp(prefix="ugrbl-custom-"))
        is_single = all("/" not in path for path in files)
        copy = keep(files, folder / ("custom.py" if is_single else "custom"))
        try:
            was_changed = _edit(Console(), editor, copy, where, board, inputs, anyway)
        except (typer.Exit, Exception):
            text = f"your edited copy is {copy}: correct it, then push it"
            Console(stderr=True).print(text, highlight=False, soft_wrap=True)
            raise
        shutil.rmtree(folder)
        if not was_changed:
            Console().print("nothing was changed", highlight=False)


def _editor() -> list[str]:
    """Return the words of $VISUAL or $EDITOR. DeployError if neither is set."""
    command = os.environ.get("VISUAL") or os.environ.get("EDITOR") or ""
    todo = "choose one: export EDITOR=nano"
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise DeployError(f"$VISUAL or $EDITOR is no command: {command}", todo) from error
    if not words:
        raise DeployError("no editor is set in $EDITOR", todo)
    return words


def _edit(
    console: Console,
    editor: "list[str]",
    copy: Path,
    port: str,
    board: str,
    inputs: "list[str] | None",
    anyway: bool,
) -> bool:
    """Let the user edit a copy, and push it. Returns whether it was changed."""
    before = _contents(copy)
    try:
        subprocess.run([*editor, str(copy)], check=True)
    except OSError as error:
        why = f"the editor {editor[0]} cannot be run; nothing was pushed"
        raise DeployError(why, "choose another: export EDITOR=nano") from error
    except subprocess.CalledProcessError as error:
        why = f"the editor {editor[0]} ended with exit code {error.returncode}; nothing was pushed"
        raise DeployError(why, "edit your copy, and push it: ugrbl custom push") from error
    if _contents(copy) == before:
        return False
    _push(console, port, _checked(console, copy, board, inputs, anyway))
    return True


def _contents(copy: Path) -> dict[str, bytes]:
    """Return the content of each file, so that a change is seen."""
    files = [copy] if copy.is_file() else sorted(copy.rglob("*.py"))
    return {str(file): file.read_bytes() for file in files}


@app.command(epilog=_EXAMPLE.format("remove --port /dev/ttyACM0"))
def remove(port: Port = None, yes: Yes = False) -> None:
    """Remove it from the board, and restart the machine without it."""
    with _with_messages():
        where = ports.choose(port)
        if not yes:
            agree(f"Remove your Python from the board at {where}?", "nothing has been changed")
        with _board_files(where) as on_board:
            was_there = custom_files.remove(on_board, custom_files.name_of(on_board.options()))
            on_board.restart()
        text = "was removed from the board" if was_there else "was not on the board"
        Console().print(f"custom.py {text} at {where}", highlight=False, soft_wrap=True)


@contextmanager
def _board_files(port: str) -> "Iterator[CustomFiles]":
    """Yield the user's files on a board, which is at its MicroPython prompt."""
    from ..device.deploy_device import MpremoteDevice  # it needs a moment to be imported

    on_board: Any = MpremoteDevice(port)
    try:
        on_board.enter()
        yield on_board
    finally:
        on_board.close()


@contextmanager
def _with_messages() -> "Iterator[None]":
    """End the command with a message, with cause and next step, if the body fails."""
    try:
        yield
    except DeployError as error:
        raise _failed(str(error), error.todo) from error
    except (SendError, OwnPythonError, ValueError, OSError) as error:
        raise failed(error) from error
    except KeyboardInterrupt as error:
        todo = "see what is on the board: ugrbl custom pull; unplug it if nothing answers"
        raise _failed("stopped half way", todo) from error


def _failed(why: str, todo: str) -> typer.Exit:
    """Show a cause and the next step on stderr; returns the exception to raise."""
    console = Console(stderr=True)
    console.print(f"[red]{escape(why)}", highlight=False, soft_wrap=True)
    if todo:
        console.print(f"  -> {escape(todo)}", highlight=False, soft_wrap=True)
    return typer.Exit(1)
