"""Tables about machines: settings, errors, alarms, boards and their options."""

import ast
from pathlib import Path
from typing import Any

from .. import paths
from ..boardfile import board_check, options
from ..grbl import messages
from ..grbl.comments import setting_comments
from ..replay import differences, known_differences
from .markdown import as_code, table

# Settings, errors, alarms


def settings_table() -> str:
    """Return settings with default, unit and meaning."""
    paths.use_firmware()
    from base import settings

    comments = setting_comments()
    rows = []
    for number, _, kind, default, unit in settings._TABLE:
        count = 3 if kind == settings.AXIS else 1  # one each for X, Y and Z
        names = " ".join(f"`${number + axis}`" for axis in range(count))
        rows.append((names, f"{default:g}", unit, as_code(comments[number])))
    return table(("Setting", "Default", "Unit", "Meaning"), rows)


def _replies(kind: str, numbers: dict[int, str]) -> str:
    """Return a table of replies such as error:1, with their meanings."""
    rows = [(f"`{kind}:{number}`", as_code(words)) for number, words in numbers.items()]
    return table(("Reply", "Meaning"), rows)


def errors_table() -> str:
    """Return the meanings of error:n."""
    return _replies("error", messages.errors())


def alarms_table() -> str:
    """Return the meanings of ALARM:n."""
    return _replies("ALARM", messages.alarms())


# Boards


def options_table() -> str:
    """Return all options of a board file, with type, default and meaning."""
    rows = [
        (f"`{row.name}`", row.type, _default(row), as_code(row.meaning)) for row in options.OPTIONS
    ]
    return table(("Option", "Type", "Default", "Meaning"), rows)


def _default(row: options.Option) -> str:
    """Return the default as a board file would have it."""
    if row.default is options.NEEDED:
        return ""
    return f'`"{row.default}"`' if isinstance(row.default, str) else f"`{row.default}`"


def _board_files() -> list[Path]:
    return sorted(paths.BOARDS.glob("[!_]*.py"))


def boards_table() -> str:
    """Return board files with the first line of their docstrings."""
    rows = []
    for path in _board_files():
        text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
        if not text:
            raise ValueError(f"{path} has no docstring: add one that says what it is")
        rows.append((f"`{path.name}`", text.splitlines()[0]))
    return table(("File", "Machine"), rows)


def pins_table() -> str:
    """Return a table with a row for each connection, and a column for each real board."""
    from ..boardfile.files import load_board
    from ..boardfile.new_board import CONTROLS, ITEMS

    boards = {path.name: load_board(path.stem) for path in _board_files()}
    real = {name: board for name, board in boards.items() if not board_check.is_simulated(board)}
    rows = []
    for item in ITEMS:
        pins = [_pins(board, item.name, CONTROLS) for board in real.values()]
        if any(pins):
            rows.append((f"`{item.name}`", *pins))
    rows.append(("`REPL_PIN`", *(_pins(board, "REPL_PIN", ()) for board in real.values())))
    return table(("", *(f"`{name}`" for name in real)), rows)


def _pins(board: Any, name: str, controls: tuple[str, ...]) -> str:
    """Return the pins of a connection in a board file; "" if there are none. controls: the names
    of the pins in its tuple CONTROL, in order."""
    if name in controls:
        control_pins = getattr(board, "CONTROL", ())
        index = controls.index(name)
        value = control_pins[index] if index < len(control_pins) else None
    else:
        value = getattr(board, name, None)
    if value is None:
        return ""
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)


# Differences from Grbl


def differences_table() -> str:
    """Return all intended differences from the recordings of Grbl."""
    rows = [(row.name, "replies", row.reason) for row in differences.DIFFERENCES]
    rows += [(row.name, "one case", row.reason) for row in differences.QUIRKS]
    rows += [(name, "motion", reason) for name, reason in differences.MOTION]
    rows += [
        (row.name, "whole cases", row.reason)
        # The first of MOTIONS is one of CASES, too.
        for row in (*known_differences.CASES, *known_differences.MOTIONS[1:])
    ]
    rows = [(name, where, as_code(reason)) for name, where, reason in rows]
    return table(("Name", "Where", "What and why"), rows)
