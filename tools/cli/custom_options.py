"""Options of the commands that simulate: the user's own Python, and rules for its inputs."""

import re
from pathlib import Path
from typing import Annotated

import typer

from ..grbl.messages import meaning, refused
from ..run import inputs, machine
from ..run.program import Result

CustomFile = Annotated[
    Path | None,
    typer.Option(
        "--custom",
        metavar="FILE",
        help="Your own Python for the board: a .py file, or a folder.",
    ),
]
Inputs = Annotated[
    list[str] | None,
    typer.Option(
        "--input",
        metavar="NAME=WHEN",
        help="When an input of the simulator closes: on (always), off (never), at a position "
        "(probe=Z-30), or so long after a handler begins to wait for it (2s).",
    ),
]
Lenient = Annotated[
    bool,
    typer.Option(
        "--lenient", help="Accept words of other controllers, as a board with LENIENT does."
    ),
]
_ALARM = re.compile(r"ALARM:\d+")
# A probing motion without contact.
_HELP = {"ALARM:5": " Say where the probe touches: --input probe=Z-30"}


def around(board: str, custom: Path | None, rules: "list[str] | None") -> machine.Around:
    """Return the surroundings that these options describe. ValueError if they are not possible."""
    return machine.around(board, custom, [inputs.rule(text) for text in rules or ()])


def why_stopped(result: Result) -> str:
    """Return the cause in words: of the handler that failed, else of the alarm, with the next
    step."""
    if result.faults:
        return result.faults[-1]
    stopped = result.stopped
    known = meaning(stopped) if _ALARM.fullmatch(stopped) else refused(stopped)
    return ": ".join(filter(None, [stopped, known])) + _HELP.get(stopped, "")
