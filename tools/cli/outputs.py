"""Output files of commands: checked before the work, written after it. STDIN, "-", is stdout."""

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
    typer.Option("--json", metavar="FILE", help="Write the result to this file; - is stdout."),
]
# Formats of drawings.
PICTURES = (".html", ".png", ".svg")


_BOARD = "board"  # the parameter of commands that is a name or a path


def check_outputs(
    *files: Path | None, plot: Path | None = None, given: Mapping[str, object] | None = None
) -> None:
    """Raise OSError or ValueError if a file cannot be written. Nothing has been made then.

    plot: a file that is a drawing. given: the command's parameters by name, its locals(); files
    that are read are never overwritten. `-` is stdout.
    """
    if plot and str(plot) != STDIN and plot.suffix.lower() not in PICTURES:
        raise ValueError(f"{plot}: the picture's file must end in {', '.join(PICTURES)}")
    named = [file for file in (*files, plot) if file]
    if twice := [file for file in named if named.count(file) > 1]:
        raise ValueError(f"{twice[0]} is named twice: the second output would replace the first")
    inputs = {name: value for name, value in (given or {}).items() if not _is_one(value, named)}
    read = [file for file in _read(inputs) if file.exists()]
    for file in named:
        if str(file) != STDIN:
            _check(file)
            if file.exists() and any(map(file.samefile, read)):
                raise ValueError(f"{file} is the input file: it is not overwritten")


def _is_one(value: object, files: list[Path]) -> bool:
    """Return whether it is one of these objects. Identity counts, because a file that is read may
    have the same name as one that is written."""
    return any(value is file for file in files)


def _read(given: Mapping[str, object]) -> Iterator[Path]:
    """Yield the files that a command reads, including Python files in folders."""
    for name, value in given.items():
        if name == _BOARD and isinstance(value, str):
            try:
                yield board_file(value)
            except BoardFileError:
                continue  # the command itself reports this
        elif isinstance(value, Path):
            yield value
            yield from value.glob("*.py")


def _check(file: Path) -> None:
    if os.path.isdir(file):  # Path.is_dir() fails if a name is too long
        raise IsADirectoryError(f"{file} is a folder: name a file")
    paths.check_writable(file)


def check_output(*files: Path | None, given: Mapping[str, object] | None = None) -> None:
    """End the command before its work if a file could not be written after it."""
    try:
        check_outputs(*files, given=given)
    except (OSError, ValueError) as error:
        raise failed(error) from error


def save_json(found: object, file: Path) -> None:
    """Write JSON to a file; `-` is stdout. A failure ends the command with a message."""
    save_text(json.dumps(found, indent=1) + "\n", file)


def save_text(text: str, file: Path) -> None:
    """Write text to a file; `-` is stdout. A failure ends the command with a message."""
    if str(file) == STDIN:
        sys.stdout.write(text)
        return
    try:
        paths.write(file, text.encode())
    except OSError as error:
        raise failed(error) from error


def examples(*lines: str) -> str:
    """Return command lines for the end of a help text, which are not re-wrapped."""
    return "\n".join(("\b", "Examples:", *(f"  {line}" for line in lines)))


def agree(question: str, otherwise: str) -> None:
    """Ask a question on stderr. The command ends unless the answer is yes; also without a
    terminal. otherwise: the text that is shown then, that nothing was done."""
    try:
        agreed = typer.confirm(question, err=True)
    except typer.Abort as error:
        raise failed(f"{otherwise}; --yes skips this question") from error
    if not agreed:
        raise failed(otherwise)


def failed(why: object) -> typer.Exit:
    """Show a failure, an exception or a text, on stderr; returns the exception that ends the
    command with exit code 1."""
    if isinstance(why, BrokenPipeError):
        raise why  # the reader of stdout is gone: end without a message
    Console(stderr=True).print(f"[red]{escape(words(why))}", highlight=False)
    return typer.Exit(1)


def words(why: object) -> str:
    """Return an error in words, without the number of the system's error."""
    if isinstance(why, OSError) and why.strerror:
        reason = paths.why(why)
        return f"{why.filename}: {reason}" if why.filename else reason
    return str(why)
