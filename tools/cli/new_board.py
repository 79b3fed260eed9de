"""The command `ugrbl new-board`."""

import os
import sys
from collections.abc import Callable
from keyword import iskeyword
from pathlib import Path
from typing import Annotated, NamedTuple

import typer
from rich.console import Console
from rich.markup import escape

from .. import paths
from ..boardfile import board_check, files, new_board
from ..boardfile.chips import CHIPS, Chip
from ..boardfile.new_board import ITEMS, Board, BoardError, Item, Pins
from ..grbl.settings_file import as_line
from ..sim import motor_names
from .outputs import check_outputs, examples, failed, save_json, words
from .screen import summary

EXAMPLES = examples(
    "ugrbl new-board my_router",
    "ugrbl new-board my_router --chip pico --pin step=2,3,4 --pin dir=5,6,7",
)
_NAMES = ", ".join(item.name.lower() for item in ITEMS)
_CHIPS = "|".join(CHIPS)

Motors = Annotated[
    str | None,
    typer.Option(metavar="LETTERS", help="Axis of each motor: XYZY has two motors on Y."),
]
Rotary = Annotated[
    str | None, typer.Option(metavar="LETTERS", help="Rotary axes, in degrees: A, or AC.")
]
Network = Annotated[
    bool, typer.Option("--network", help="Connect over the board's Wi-Fi: docs/network.md.")
]
Page = Annotated[bool, typer.Option("--page", help="Also serve the control page in the network.")]


def _read_chip(name: str) -> Chip:
    if name not in CHIPS:
        raise typer.BadParameter(f"{name} is not one of {', '.join(CHIPS)}")
    return CHIPS[name]


Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        "-o",
        metavar="FILE",
        help="Board file to write, or a folder for it. [default: here]",
    ),
]


def command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the file: my_router.")],
    chip: Annotated[
        Chip | None,
        typer.Option(parser=_read_chip, metavar=f"[{_CHIPS}]", help="The chip or module."),
    ] = None,
    title: Annotated[str, typer.Option(help="A description of the machine, in a line.")] = "",
    pin: Annotated[
        list[str] | None,
        typer.Option(metavar="WHAT=PINS", help=f"Pins of WHAT, which is one of {_NAMES}."),
    ] = None,
    motors: Motors = None,
    rotary: Rotary = None,
    network: Network = False,
    page: Page = False,
    setting: Annotated[
        list[str] | None, typer.Option("--set", metavar="N=V", help="A default setting: 100=800.")
    ] = None,
    ask: Annotated[
        bool | None,
        typer.Option("--ask/--no-ask", help="Ask for missing values. [default: on a terminal]"),
    ] = None,
    out: Out = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write the pins to this file; - is stdout."),
    ] = None,
) -> None:
    """Make a board file, and show the wiring.

    It asks for the pins that options do not give, and checks all of them.
    """
    can_ask = sys.stdin.isatty() if ask is None else ask
    console = Console(stderr=str(json_file) == "-")
    file = out or Path()
    if os.path.isdir(file) or not file.suffix:
        file /= f"{name}.py"
    try:
        _check_name(name)
        if file.suffix != ".py":
            raise BoardError(f"{file}: the name of a board file must end in .py")
        check_outputs(json_file, file)
        if file.exists() and not force:
            raise BoardError(f"{file} exists already; --force replaces it")
        board = Board(title or name.replace("_", " ").capitalize(), _chip(console, chip, can_ask))
        words = _Words(_pins_of_options(pin or []), motors, rotary)
        _set_pins(console, board, words, can_ask)
        board.defaults = _defaults(setting or [])
        board.network, board.page = network or page, page
        new_board.check(board)
        _write(board, file)
    except (BoardError, OSError, ValueError) as error:
        raise failed(error) from error
    _show(console, board, file)
    if json_file:
        save_json({"file": str(file), **board.as_json()}, json_file)


def _check_name(name: str) -> None:
    """Raise BoardError if a module cannot have that name."""
    if not name.isidentifier():
        raise BoardError(
            f"{name}: a name may have letters, digits and _, and must not begin with a digit"
        )
    if iskeyword(name):
        raise BoardError(f"{name} is a reserved word of Python: choose another name")


class _Words(NamedTuple):
    """Values given by options."""

    pins: dict[str, str]  # by name of the item
    motors: str | None
    rotary: str | None


def _set_pins(console: Console, board: Board, said: _Words, can_ask: bool) -> None:
    """Set all pins, and after those for steps what their motors move."""
    for item in ITEMS:
        board.pins[item.name] = _item_pins(console, board, item, said.pins.get(item.name), can_ask)
        if item.name == "STEP":
            board.motors = _motors(console, board, said.motors, can_ask)
            board.rotary = _rotary(console, board, said.rotary, can_ask)


def _pins_of_options(words: list[str]) -> dict[str, str]:
    """Return the pins given by options, by name of the item."""
    given = {}
    for word in words:
        name, _, pins = word.partition("=")
        if name.upper() not in new_board.BY_NAME:
            raise BoardError(f"{word}: it must be one of {_NAMES}, as in step=2,3,4")
        if not pins.strip():
            raise BoardError(f"{name} has no pins: write it as {name}=2,3,4")
        given[name.upper()] = pins
    return given


def _chip(console: Console, chip: Chip | None, can_ask: bool) -> Chip:
    """Return the chip from its option, or ask the user; BoardError if nobody can be asked."""
    if chip is None:
        if not can_ask:
            raise BoardError(f"no chip is given: --chip needs one of {', '.join(CHIPS)}")
        for key, one in CHIPS.items():
            console.print(f"  {key:8} {one.title}", highlight=False)
        first = next(iter(CHIPS))
        chip = typer.prompt("Chip or module of the board", default=first, value_proc=_read_chip)
    return chip


def _item_pins(
    console: Console, board: Board, item: Item, text: str | None, can_ask: bool
) -> Pins:
    """Return the pins of one item, from its option (text; None if it is missing) or from the user,
    who is asked until they are valid."""
    if text is not None or not can_ask:
        pins = new_board.read_pins(text or "")
        new_board.check_item(board, item, pins)
        return pins
    while True:
        question = item.question[0].upper() + item.question[1:]
        if item.needed:
            answer = typer.prompt(question)
        else:
            answer = typer.prompt(
                f"{question}; leave empty for none", default="", show_default=False
            )
        try:
            pins = new_board.read_pins(answer)
            new_board.check_item(board, item, pins)
            return pins
        except BoardError as error:
            console.print(f"[yellow]{escape(str(error))}", highlight=False)


def _motors(console: Console, board: Board, text: str | None, can_ask: bool) -> str:
    """Return the axis of each motor; "" if each has its own. With three motors there is no
    question. text: of the option; None if it is missing."""
    count = len(board.pins["STEP"])
    one_each = motor_names.AXIS_LETTERS[:count]
    if text is None and (not can_ask or count <= new_board.FEWEST_AXES):
        new_board.check_axes(board)
        return ""
    question = "Axis of each motor, for example XYZY for two motors on Y"
    suggestion = (motor_names.AXIS_LETTERS * 2)[:count]
    letters = _letters(console, board, text, question, suggestion, new_board.check_motors)
    return "" if letters == one_each else letters


def _rotary(console: Console, board: Board, text: str | None, can_ask: bool) -> str:
    """Return the rotary axes; with X, Y and Z only there is no question."""
    if text is None and (not can_ask or board.axes <= new_board.FEWEST_AXES):
        return ""
    question = "Rotary axes, for example A; leave empty for none"
    return _letters(console, board, text, question, "", new_board.check_rotary)


def _letters(
    console: Console,
    board: Board,
    text: str | None,
    question: str,
    default: str,
    check: Callable[[Board, str], None],
) -> str:
    """Return letters from an option (text), or if it is None from the user, who is asked until
    they are valid. check: raises BoardError for others."""
    while True:
        letters = text
        if letters is None:
            letters = typer.prompt(question, default=default, show_default=bool(default))
        letters = letters.upper()
        try:
            check(board, letters)
            return letters
        except BoardError as error:
            if text is not None:
                raise
            console.print(f"[yellow]{escape(str(error))}", highlight=False)


def _defaults(settings: list[str]) -> dict[int, float]:
    """Return settings given as 100=800, by number. BoardError for other texts."""
    values = {}
    for text in settings:
        number, _, value = as_line(text)[1:].partition("=")
        try:
            values[int(number)] = float(value)
        except ValueError as error:
            raise BoardError(f"{text} is no setting; write it as 100=800") from error
    return values


def _write(board: Board, file: Path) -> None:
    """Write the file and check it as a board file; a file that fails is removed."""
    before = file.read_bytes() if file.exists() else None
    try:
        paths.write(file, board.text().encode())
    except OSError as error:
        raise BoardError(words(error)) from error
    problems = board_check.problems(files.load(file))
    if problems:
        if before is None:
            file.unlink()
        else:
            paths.write(file, before)
        raise BoardError("; ".join(problems))


def _show(console: Console, board: Board, file: Path) -> None:
    """Show the wiring, hints about the pins, and the file's name."""
    rows = [(f"GPIO {pin}", what) for pin, what in board.wiring()]
    console.print(summary(rows))
    for text in new_board.oddities(board):
        console.print(f"[yellow]note[/]: {escape(text)}", highlight=False)
    console.print(f"written: {file}", highlight=False)
