"""A simulated machine for the commands: its board by name, its place to keep settings."""

import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import paths
from .file_store import FileStore

if TYPE_CHECKING:
    from .sim.rig import Rig

DEFAULT_BOARD = "sim"


def boards() -> list[str]:
    """The names of all boards."""
    return sorted(path.stem for path in paths.BOARDS.glob("[!_]*.py"))


def load_board(name: str) -> Any:
    """The module of a board; ValueError if there is none of that name."""
    if name not in boards():
        raise ValueError(f"no board {name!r}; there are {', '.join(boards())}")
    folder = str(paths.BOARDS.parent)
    if folder not in sys.path:
        sys.path.append(folder)
    return import_module(f"boards.{name}")


class UntimedLink:
    """What the rig wants of a Link without a script, whose bytes take no time on a wire."""

    def next_event(self) -> None:
        """Nothing is on its way."""

    def advance(self) -> None:
        """Nothing arrives by time alone."""

    def power_off(self) -> None:
        """Nothing is lost."""


def build(board: str, link: "Callable[[Rig], UntimedLink]", settings: Path | None = None) -> "Rig":
    """A rig with that board. link: makes the Link; settings: the file that keeps them, if any."""
    paths.use_firmware()
    from .sim.rig import Rig

    return Rig(load_board(board), FileStore(settings) if settings else None, link)


def run(rig: "Rig") -> None:
    """Power it up and let it run until its link switches it off."""
    rig.run(iter([lambda: False]))
