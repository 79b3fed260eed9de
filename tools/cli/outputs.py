"""Where commands write: looked at before the work, so that none is done in vain; then written."""

import json
import os
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from .. import paths
from ..boardfile.files import BoardFileError, board_file
from ..grbl.gcode_file import STDIN

Json = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", help="Write the result there; - is stdout."),
]
# What a path or a job can be drawn as.
PICTURES = (".html", ".png", ".svg")


_BOARD = "board"  # the parameter of commands that is a name, or a path


def check_outputs(
    *files: Path | None, plot: Path | None = None, given: Mapping[str, object] | None = None
) -> None:
    """OSError or ValueError where a file cannot be written. Nothing has been made then.

    plot: one that is a drawing; given: the command's parameters by name, its locals(): what is
    not among those to write is read, and never written over. `-` is stdout.
    """
    if plot and str(plot) != STDIN and plot.suffix.lower() not in PICTURES:
        raise ValueError(f"{plot}: it can be {', '.join(PICTURES)}")
    named = [file for file in (*files, plot) if file]
    if twice := [file for file in named if named.count(file) > 1]:
        raise ValueError(f"{twice[0]} is named twice: what is written there last would be all")
    others = {name: value for name, value in (given or {}).items() if not _is_one(value, named)}
    keep = [file for file in _read(others) if file.exists()]
    for file in named:
        if str(file) != STDIN:
            _check(file)
            if file.exists() and any(map(file.samefile, keep)):
                raise ValueError(f"{file} is what is read: it is not written over")


def _is_one(value: object, files: list[Path]) -> bool:
    """The very object: a file that is read may have the same name as one that is written."""
    return any(value is file for file in files)


def _read(given: Mapping[str, object]) -> Iterator[Path]:
    """Files that a command has been given to read, the Python files of folders too."""
    for name, value in given.items():
        if name == _BOARD and isinstance(value, str):
            try:
                yield board_file(value)
            except BoardFileError:
                continue  # which the command says, in its turn
        elif isinstance(value, Path):
            yield value
            yield from value.glob("*.py")


def _check(file: Path) -> None:
    if os.path.isdir(file):  # Path's fails where a name is too long
        raise IsADirectoryError(f"{file} is a folder: name a file")
    paths.check_writable(file)


def check_output(*files: Path | None, given: Mapping[str, object] | None = None) -> None:
    """End the command before its work where a file could not be written after it."""
    try:
        check_outputs(*files, given=given)
    except (OSError, ValueError) as error:
        raise failed(error) from error


def save_json(found: object, file: Path) -> None:
    """Write it; `-` is stdout. What goes wrong with it ends the command with the reason."""
    save_text(json.dumps(found, indent=1) + "\n", file)


def save_text(text: str, file: Path) -> None:
    """Write a file; `-` is stdout. What goes wrong with it ends the command with the reason."""
    if str(file) == STDIN:
        sys.stdout.write(text)
        return
    try:
        paths.write(file, text.encode())
    except OSError as error:
        raise failed(error) from error


def examples(*lines: str) -> str:
    """Command lines for the end of a help text, which keeps them as they are."""
    return "\n".join(("\b", "Examples:", *(f"  {line}" for line in lines)))


def agree(question: str, otherwise: str) -> None:
    """Ask whether to go on, on stderr. Anything but yes ends the command; so does nobody there."""
    try:
        agreed = typer.confirm(question, err=True)
    except typer.Abort as error:
        raise failed(f"{otherwise}; --yes does not ask") from error
    if not agreed:
        raise failed(otherwise)


def failed(why: object) -> typer.Exit:
    """Say why on stderr; raise what this returns."""
    if isinstance(why, BrokenPipeError):
        raise why  # nobody reads stdout any more: the command ends without a word
    Console(stderr=True).print(f"[red]{escape(words(why))}", highlight=False)
    return typer.Exit(1)


def words(why: object) -> str:
    """What went wrong as people say it, without the number of the system's error."""
    if isinstance(why, OSError) and why.strerror:
        said = paths.why(why)
        return f"{why.filename}: {said}" if why.filename else said
    return str(why)
