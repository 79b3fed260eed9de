"""The user's own Python on a board, NAME.py or a folder NAME: write, read and remove it.

`shelf` is the board; `names` are the names in its root folder.

A new file is written under another name and renamed over the old one; a board's file system does
this completely or not at all. A new folder is written as NAME.part and renamed NAME.whole when
complete. Two renamings on the board then put it in the place of NAME; if the power fails between
them, the next start does the second one (firmware/ports/storage/user_files.py).
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Protocol

from ..boardfile.options import BY_NAME
from .deploy import SAVED, DeployError, Running

# Names of the files with the last traceback, where the board saves it.
_TRACES = ("custom.txt", "custom.new", "custom.old")


class CustomFiles(Protocol):
    """A board with MicroPython, at its prompt. Methods for files raise OSError; all may raise
    DeployError."""

    told: list[str]

    def enter(self) -> None:
        """Enter the prompt; a machine in motion is not disturbed."""

    def options(self) -> dict[str, Any]:
        """Return CUSTOM, OUTPUTS and INPUTS of its board file."""

    def names(self, folder: str) -> list[str]:
        """Return all names in a folder; "" is the root."""

    def read(self, path: str) -> bytes:
        """Return the content of a file."""

    def write(self, path: str, content: bytes, progress: Callable[[int], None]) -> None:
        """Create or replace a file."""

    def rename(self, pairs: "Iterable[tuple[str, str]]") -> None:
        """Rename files one after another; an existing file of the new name is replaced."""

    def remove(self, path: str) -> None:
        """Remove a file, and its folder if that is then empty."""

    def make_folder(self, path: str) -> None:
        """Create a folder; it may exist."""

    def restart(self) -> Running:
        """Leave the prompt and start the firmware; `told` then has the messages of its $I."""

    def close(self) -> None:
        """Close the port."""


def name_of(options: Mapping[str, Any]) -> str:
    """Return the name of the module that the board loads (CUSTOM). DeployError if it loads none,
    or if its board file is wrong."""
    name: str = options["CUSTOM"]
    if problem := BY_NAME["CUSTOM"].problem(name):
        raise DeployError(
            f"the board file on the board is wrong: {problem}",
            "correct the board file, and deploy it",
        )
    if not name:
        raise DeployError(
            'its board file says CUSTOM = "": it loads no Python of yours',
            "remove that line from the board file, and deploy it",
        )
    return name


def pull(shelf: CustomFiles, name: str) -> dict[str, bytes]:
    """Return the user's files by path: NAME.py, else those of the folder NAME; nothing if neither
    exists."""
    names = shelf.names("")
    _finish_interrupted_push(shelf, name, names)
    if f"{name}.py" in names:
        return {f"{name}.py": shelf.read(f"{name}.py")}
    paths = [f"{name}/{file}" for file in shelf.names(name) if file.endswith(".py")]
    return {path: shelf.read(path) for path in sorted(paths)}


def push(
    shelf: CustomFiles, name: str, files: Mapping[str, bytes], written: "Callable[[int], None]"
) -> None:
    """Replace the user's files. files: by path, NAME.py alone or files of the folder NAME.
    written: called with the number of bytes of every piece."""
    names = shelf.names("")
    _check_folder(shelf, name)
    _finish_interrupted_push(shelf, name, names)
    _remove_leftovers(shelf, name, names)
    single = f"{name}.py"
    if single in files:
        shelf.write(f"{single}.new", files[single], written)
        shelf.rename([(f"{single}.new", single)])
        _remove_folder(shelf, name)
    else:
        shelf.make_folder(f"{name}.part")
        for path, content in files.items():
            shelf.write(path.replace(name, f"{name}.part", 1), content, written)
        shelf.rename([(f"{name}.part", f"{name}.whole")])
        old_away = [(name, f"{name}.gone")] if name in names else []
        shelf.rename([*old_away, (f"{name}.whole", name)])
        if single in names:
            shelf.remove(single)
        _remove_folder(shelf, f"{name}.gone")
    _forget_trace(shelf)


def remove(shelf: CustomFiles, name: str) -> bool:
    """Remove the user's files. Returns whether there were any."""
    names = shelf.names("")
    _check_folder(shelf, name)
    _finish_interrupted_push(shelf, name, names)
    _remove_leftovers(shelf, name, names)
    _remove_folder(shelf, name)  # before the file, which it may hide
    if f"{name}.py" in names:
        shelf.remove(f"{name}.py")
    _forget_trace(shelf)
    return name in names or f"{name}.py" in names


def _check_folder(shelf: CustomFiles, name: str) -> None:
    """Raise DeployError if the old folder has files of the user's that would be lost."""
    others = [file for file in shelf.names(name) if not file.endswith(".py")]
    if others:
        raise DeployError(
            f"the folder {name} on the board has files that are no Python: {', '.join(others)}",
            f"put them elsewhere first: `mpremote cp :{name}/{others[0]} :`, then `mpremote rm`",
        )


def _finish_interrupted_push(shelf: CustomFiles, name: str, names: list[str]) -> None:
    """Complete a push that was interrupted between its two renamings, as the firmware's next start
    would, and update `names`."""
    if f"{name}.whole" in names and name not in names:
        shelf.rename([(f"{name}.whole", name)])
        names[:] = shelf.names("")


def _remove_leftovers(shelf: CustomFiles, name: str, names: list[str]) -> None:
    """Remove the unfinished files and folders of an interrupted push."""
    if f"{name}.py.new" in names:
        shelf.remove(f"{name}.py.new")
    for ending in ("part", "whole", "gone"):
        _remove_folder(shelf, f"{name}.{ending}")


def _remove_folder(shelf: CustomFiles, folder: str) -> None:
    """Remove a folder's files, and so the folder; it may be missing."""
    for file in shelf.names(folder):
        shelf.remove(f"{folder}/{file}")


def _forget_trace(shelf: CustomFiles) -> None:
    """Remove the traceback, because it belongs to the old file."""
    for file in shelf.names(SAVED):
        if file in _TRACES:
            shelf.remove(f"{SAVED}/{file}")
