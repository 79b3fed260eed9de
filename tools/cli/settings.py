"""`ugrbl settings`: a machine's settings as a file, and back."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from shlex import quote
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ..device import settings_sync as sync
from ..device.connection import BAUD, Connection
from ..grbl.gcode_file import STDIN
from ..grbl.messages import meaning as reply_meaning
from ..grbl.settings_file import (
    Change,
    Settings,
    SettingsError,
    changes,
    check_fit,
    meaning,
    read_settings,
)
from .outputs import Json, agree, check_output, failed, save_json, save_text
from .ports import Baud, Port, connected
from .screen import show_zeros

app = typer.Typer(no_args_is_help=True, help="Pull, compare, push and restore settings.")

File = Annotated[
    Path,
    typer.Argument(
        metavar="FILE",
        allow_dash=True,
        readable=False,
        help="Settings file, lines of $n=v; - is stdin or stdout.",
    ),
]
Yes = Annotated[bool, typer.Option("--yes", "-y", help="Do not ask for confirmation.")]
AnyVersion = Annotated[
    bool,
    typer.Option("--any-version", help="Accept a file for another Grbl, or without a version."),
]
_EXAMPLE = "\n\nExample:  ugrbl settings {} --port /dev/ttyACM0"


@app.command(epilog=_EXAMPLE.format("pull router.settings"))
def pull(
    file: File,
    port: Port = None,
    baud: Baud = BAUD,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Write a machine's settings to a file, each with its meaning."""
    to_stdout = str(file) == STDIN
    if not to_stdout:
        check_output(file)
        if file.exists() and not force:
            raise failed(f"{file} exists already; --force replaces it")
    with _machine(port, baud) as connection:
        settings = sync.pull(connection)
    _keep(settings, file, "as pulled")
    words = f"{len(settings.values)} settings of {settings.firmware} are in {file}"
    if not to_stdout:
        Console().print(words, highlight=False, soft_wrap=True)


@app.command(epilog=_EXAMPLE.format("diff router.settings"))
def diff(
    file: File,
    port: Port = None,
    baud: Baud = BAUD,
    any_version: AnyVersion = False,
    json_file: Json = None,
) -> None:
    """Show what a push of the file would change.

    The exit code is 1 if it would change anything.
    """
    wanted = _read(file)
    check_output(json_file, given=locals())
    with _machine(port, baud) as connection:
        machine = sync.pull(connection)
        check_fit(wanted, machine, any_version, complete=False)
        todo = changes(machine.values, wanted.values)
    _report(machine, todo, json_file)
    if todo:
        raise typer.Exit(1)


@app.command(epilog=_EXAMPLE.format("push router.settings"))
def push(
    file: File,
    port: Port = None,
    baud: Baud = BAUD,
    yes: Yes = False,
    any_version: AnyVersion = False,
    json_file: Json = None,
) -> None:
    """Write the settings of a file to the machine.

    Settings that the file does not contain stay. The changes are shown first. The old settings are
    saved in FILE.before.
    """
    _write(file, port, baud, yes, any_version, json_file, complete=False)


@app.command(epilog=_EXAMPLE.format("restore router.settings.before"))
def restore(
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="FILE", readable=False, help="A complete settings file, as pulled; - is stdin."
        ),
    ] = None,
    port: Port = None,
    baud: Baud = BAUD,
    factory: Annotated[
        bool,
        typer.Option(
            "--factory", help="Restore the settings the firmware was built with ($RST=$)."
        ),
    ] = False,
    yes: Yes = False,
    any_version: AnyVersion = False,
    json_file: Json = None,
) -> None:
    """Restore a machine's settings from a file, or the factory's.

    Afterwards it has exactly those settings. To undo a push: restore FILE.before.
    """
    if (file is None) != factory:  # none of both, or both
        raise failed("give either a file that was pulled, or --factory")
    check_output(Path("factory.before") if factory else None, json_file)
    if file:
        _write(file, port, baud, yes, any_version, json_file, complete=True)
        return
    with _machine(port, baud) as connection:
        before = sync.pull(connection)
        if not yes:
            agree("Restore the factory's settings?", "nothing has been changed")
        backup = Path("factory.before")
        _keep(before, backup, "before a restore of the factory settings")
        sync.factory(connection)
        done = changes(before.values, sync.pull(connection).values)
    _report(before, done, json_file)
    Console(stderr=True).print(f"the old settings are in {backup}", highlight=False)


def _write(
    file: Path,
    port: str | None,
    baud: int,
    yes: bool,
    any_version: bool,
    json_file: Path | None,
    complete: bool,
) -> None:
    """Write the settings of a file to the machine, after a question; save the old ones.

    complete: the file must have all settings of the machine. The exit code is 1 if the machine
    refuses one.
    """
    wanted = _read(file)
    from_stdin = str(file) == STDIN
    if from_stdin and not yes:
        raise failed("with settings from stdin no question can be asked: use --yes")
    backup = Path("settings.before") if from_stdin else file.with_name(file.name + ".before")
    check_output(backup, json_file, given=locals())
    console = Console(stderr=True)
    with _machine(port, baud) as connection:
        machine = sync.pull(connection)
        check_fit(wanted, machine, any_version, complete)
        todo = changes(machine.values, wanted.values)
        if not (json_file and str(json_file) == "-"):
            _show(machine, todo)
        if todo and not yes:
            agree(f"Change {_count(todo)}?", "nothing has been changed")
        refusals: Sequence[tuple[Change, str]] = ()
        if todo:
            _keep(machine, backup, "before a push")
            console.print(f"the present settings are saved in {backup}", highlight=False)
            refusals = _push(connection, todo, console, backup)
    _save_json(machine, todo, json_file, refusals)
    for change, reply in refusals:
        words = (
            reply_meaning(reply) if reply.startswith("error") else "the machine did not accept it"
        )
        console.print(f"[red]${change.number}={change.after}: {reply}: {escape(words)}")
    if refusals:
        raise typer.Exit(1)


def _push(
    connection: Connection, todo: Sequence[Change], console: Console, backup: Path
) -> Sequence[tuple[Change, str]]:
    """Write the changes; returns those refused, each with the reply. If not all were accepted,
    also because of an exception, it shows how many. backup: the file with the old settings."""
    accepted: set[int] = set()

    def progress(change: Change) -> None:
        accepted.add(change.number)
        console.print(f"${change.number}={change.after}", highlight=False)

    refusals: Sequence[tuple[Change, str]] = ()
    try:
        sync.push(connection, todo, progress)
    except sync.Refused as refused:
        refusals = refused.refusals
        accepted -= {change.number for change, _ in refusals}
    finally:
        if len(accepted) < len(todo):
            back = f"; to undo: ugrbl settings restore {quote(str(backup))}" if accepted else ""
            words = f"{len(accepted)} of {_count(todo)} changed{back}"
            console.print(words, highlight=False, markup=False, soft_wrap=True)
    return refusals


def _read(file: Path) -> Settings:
    """Return the settings of a file. A bad file ends the command with a message."""
    try:
        return read_settings(file)
    except SettingsError as error:
        raise failed(error) from error


def _keep(settings: Settings, file: Path, why: str) -> None:
    """Write settings to a file, with a first line that says why and when."""
    when = datetime.now().strftime("%Y-%m-%d %H:%M")
    save_text(settings.text(f"{why}, {when}"), file)


def _count(todo: Sequence[Change]) -> str:
    return "1 setting" if len(todo) == 1 else f"{len(todo)} settings"


def _show(machine: Settings, todo: Sequence[Change]) -> None:
    """Show a table of the changes, and a note for values of 0 that stop an axis."""
    console = Console()
    if not todo:
        console.print(
            f"nothing would change: {machine.firmware} already has these settings", highlight=False
        )
        return
    table = Table("", "now", "then", "unit", "what it is", box=None, pad_edge=False)
    for change in todo:
        text = meaning(change.number)
        table.add_row(f"${change.number}", change.before, change.after, text.unit, text.name)
    console.print(table)
    show_zeros(console, (f"${change.number}={change.after}" for change in todo))


def _report(machine: Settings, todo: Sequence[Change], json_file: Path | None) -> None:
    if not (json_file and str(json_file) == "-"):
        _show(machine, todo)
    _save_json(machine, todo, json_file)


def _save_json(
    machine: Settings,
    todo: Sequence[Change],
    json_file: Path | None,
    refusals: Sequence[tuple[Change, str]] = (),
) -> None:
    """Write the changes and the refused ones to a file, if one is named."""
    if json_file is None:
        return
    refused = [{**change.as_json(), "reply": reply} for change, reply in refusals]
    result: dict[str, Any] = {
        "firmware": vars(machine.firmware),
        "changes": [change.as_json() for change in todo],
        "refused": refused,
    }
    save_json(result, json_file)


@contextmanager
def _machine(port: str | None, baud: int) -> Iterator[Connection]:
    """Yield a connected Grbl; a failure ends the command with a message."""
    try:
        with connected(port, baud) as connection:
            yield connection
    except SettingsError as error:
        raise failed(error) from error
