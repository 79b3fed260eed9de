"""The command `ugrbl decode`."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from ..compiling import maps
from ..compiling.decode import build_of, decode
from ..compiling.maps import MapError

EXAMPLES = (
    "Examples:  ugrbl decode fault.txt   ·   ugrbl decode < log   ·   "
    "ugrbl decode fault.txt --map build/rpi_pico.map.json"
)


def command(
    file: Annotated[
        Path, typer.Argument(metavar="[FILE]", help="What the board has told; - is stdin.")
    ] = Path("-"),
    map_file: Annotated[
        Path | None,
        typer.Option("--map", metavar="FILE", help="The map of the build. [default: found]"),
    ] = None,
) -> None:
    """Say what a board means that tells of a fault: functions, files and lines.

    Takes a traceback, or a log with a line [MSG:…] of a fault. The board tells its build; the map
    of that is found where it was built or deployed with this computer, and where the firmware
    here is the same. A build keeps no line numbers on the board, but with --debug: without, the
    lines of each function are told.
    """
    try:
        text = sys.stdin.read() if str(file) == "-" else file.read_text("utf-8", "replace")
        map_ = _map(build_of(text), map_file)
    except (OSError, MapError) as error:
        Console(stderr=True).print(f"[red]{escape(str(error))}", highlight=False, soft_wrap=True)
        raise typer.Exit(1) from error
    for line in decode(text, map_):
        typer.echo(line)


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
