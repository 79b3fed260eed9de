"""The command `ugrbl decode`."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from ..compiling import maps
from ..compiling.decode import build_of, decode, is_fault
from ..compiling.maps import MapError
from ..grbl.gcode_file import NotText, check_text, name_of, read_bytes
from ..grbl.lines import split_lines
from .outputs import examples, words

EXAMPLES = examples(
    "ugrbl decode fault.txt",
    "ugrbl decode < log",
    "ugrbl decode fault.txt --map build/rpi_pico.map.json",
)

_WANTED = 'one names its places, as in File "motion", line 3'


def command(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="[FILE]", readable=False, help="What the board has told; - is stdin."
        ),
    ] = Path("-"),
    map_file: Annotated[
        Path | None,
        typer.Option("--map", metavar="FILE", help="The map of the build. [default: found]"),
    ] = None,
) -> None:
    """Say where in the sources a fault is that a board reports.

    Takes a traceback, or a log with a line [MSG:…] of a fault. The board tells its build; the map
    of that is found where it was built or deployed with this computer, and where the firmware
    here is the same. A build keeps no line numbers on the board, but with --debug: without, the
    lines of each function are told.
    """
    try:
        text = _told(file)
        map_ = _map(build_of(text), map_file)
    except (OSError, MapError) as error:
        Console(stderr=True).print(f"[red]{escape(words(error))}", highlight=False, soft_wrap=True)
        raise typer.Exit(1) from error
    for line in decode(text, map_):
        typer.echo(line)
    if not is_fault(text):
        typer.echo(f"{name_of(file)} tells of no fault: {_WANTED}", err=True)


def _told(file: Path) -> str:
    """What the board has told. A log may hold a damaged letter; a picture is no log."""
    data = read_bytes(file)
    try:
        check_text(split_lines(data) or [b"?"], name_of(file))
    except NotText as error:
        raise OSError(f"{name_of(file)} cannot be read: it is no text") from error
    return data.decode("utf-8", "replace")


def _map(number: str, file: Path | None) -> dict[str, Any]:
    if file:
        map_ = maps.read(file)
        if number and map_["id"] != number:
            raise MapError(f"the board has the build {number}; {file} is of {map_['id']}")
        return map_
    if number:
        return maps.find(number).map
    map_ = maps.of(debug=False)
    typer.echo(f"no build is told: read as of the firmware that is here, {map_['id']}", err=True)
    return map_
