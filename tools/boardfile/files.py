"""Board files: their paths and contents, by name or path."""

import importlib.util
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from .. import paths
from ..grbl.gcode_file import NotText, check_utf8, read_bytes
from .board_check import imports, is_simulated, own_modules, problems


class BoardFileError(ValueError):
    """A board file is not valid, for these reasons, one per line."""


def boards() -> list[str]:
    """Return the names of all boards."""
    return sorted(path.stem for path in paths.BOARDS.glob("[!_]*.py"))


def board_file(name: str) -> Path:
    """Return the path of a board file: a name in boards/, or a path. BoardFileError if there is
    none.

    A file name alone, as `ugrbl new-board` shows it, is searched here and then in boards/.
    """
    file = Path(name)
    if file.suffix != ".py":
        _check_name(name)
        file = paths.BOARDS / f"{name}.py"
    is_bare_name = file.name == name
    if not file.is_file() and is_bare_name and file.stem in boards():
        file = paths.BOARDS / name
    if not file.is_file():
        where = " here, nor in boards/: see ugrbl new-board" if is_bare_name else ""
        raise BoardFileError(f"there is no file {file}{where}")
    return file


def _check_name(name: str) -> None:
    """Raise BoardFileError unless it is the name of a board in boards/."""
    if Path(name).suffix or Path(name).name != name:
        raise BoardFileError(
            f"{name} is no board file: the name of one ends in .py; create one with "
            "`ugrbl new-board`, or give a name from boards/, for example sim"
        )
    if name not in boards():
        raise BoardFileError(f"no board {name!r}; there are {', '.join(boards())}")


def load_board(name: str) -> Any:
    """Return the module of a board in boards/, or of any board file, also one for the simulator.

    BoardFileError if there is none of that name; for a file, it has all its problems.
    """
    if name.endswith(".py"):
        return _checked(board_file(name), may_be_simulated=True)
    _check_name(name)
    parent = str(paths.BOARDS.parent)  # boards/ is a package
    if parent not in sys.path:
        sys.path.append(parent)
    return import_module(f"boards.{name}")


def load(file: Path) -> ModuleType:
    """Return a board file as a module, without checks."""
    spec = importlib.util.spec_from_file_location(f"board_{file.stem}", file)
    if spec is None or spec.loader is None:
        raise BoardFileError(f"{file} is no Python file")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if own_modules(module) and str(file.parent) not in sys.path:
        sys.path.append(str(file.parent))  # the user's modules are imported from there
    return module


def load_for_build(file: Path) -> ModuleType:
    """Return the module of a real board; BoardFileError has all problems of the file."""
    return _checked(file, may_be_simulated=False)


def _checked(file: Path, may_be_simulated: bool) -> ModuleType:
    """Return a board file as a module; BoardFileError with all its problems if it has any."""
    try:
        source = read_bytes(file)
        check_utf8(source, file)
    except (OSError, NotText) as error:
        raise BoardFileError(str(error)) from error
    try:
        imported = list(imports(source.decode()))
        board = load(file)
    except SyntaxError as error:
        raise BoardFileError(f"{file} is no Python file: {error}") from error
    except Exception as error:
        raise BoardFileError(f"{file} fails: {type(error).__name__}: {error}") from error
    simulated = is_simulated(board)
    if simulated and not may_be_simulated:
        raise BoardFileError(
            f"{file.stem} is a machine of the simulator and has no pins: choose the file of a "
            "real board"
        )
    texts = [f"{file.name}: {problem}" for problem in problems(board)]
    if imported and not simulated:
        texts.append(
            f"{file.name} imports {imported[0]}, but only the board file itself is put on the "
            "board: copy that code into it"
        )
    if texts:
        raise BoardFileError("\n".join(texts))
    return board
