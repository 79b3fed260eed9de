"""The user's own Python on a board: put there, read and taken away.

A new file is written beside the old one and takes its place by a renaming, which a board's file
system does or does not do. A new folder is written as NAME.part, is NAME.whole once it is that,
and takes the place of NAME by two renamings on the board; where the power goes between them, the
next start does the second one (firmware/ports/storage/user_files.py).
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Protocol

from ..boardfile.options import BY_NAME
from .deploy import DeployError, Running

# Under which the firmware keeps the last traceback, and the endings of what it keeps.
_TRACES = ("custom.txt", "custom.new", "custom.old")


class CustomFiles(Protocol):
    """A board with MicroPython, at its prompt. Files raise OSError, all may raise DeployError."""

    told: list[str]

    def enter(self) -> None:
        """Get the prompt; a machine in motion is not disturbed."""

    def options(self) -> dict[str, Any]:
        """CUSTOM, OUTPUTS and INPUTS of its board file."""

    def names(self, folder: str) -> list[str]:
        """All that is in a folder; "" is the root."""

    def read(self, path: str) -> bytes:
        """A file."""

    def write(self, path: str, content: bytes, progress: Callable[[int], None]) -> None:
        """Make or replace a file."""

    def rename(self, pairs: "Iterable[tuple[str, str]]") -> None:
        """One behind the other; a file gives way to another that gets its name."""

    def remove(self, path: str) -> None:
        """A file less; its folder, too, when it was the last."""

    def make_folder(self, path: str) -> None:
        """It may be there already."""

    def restart(self) -> Running:
        """Leave the prompt, start the firmware; messages of its $I are `told` then."""

    def close(self) -> None:
        """Give the port back."""


def name_of(options: Mapping[str, Any]) -> str:
    """What the board reads. DeployError where it is to read none."""
    name: str = options["CUSTOM"]
    if problem := BY_NAME["CUSTOM"].problem(name):
        raise DeployError(
            f"its board file says what cannot be: {problem}", "mend the board file, and deploy it"
        )
    if not name:
        raise DeployError(
            'its board file says CUSTOM = "": it reads none',
            "take that line out of the board file, and deploy it",
        )
    return name


def pull(shelf: CustomFiles, name: str) -> dict[str, bytes]:
    """What it reads, by path: NAME.py, or else what is in the folder NAME; nothing where neither
    is there."""
    there = shelf.names("")
    _finish(shelf, name, there)
    if f"{name}.py" in there:
        return {f"{name}.py": shelf.read(f"{name}.py")}
    paths = [f"{name}/{file}" for file in shelf.names(name) if file.endswith(".py")]
    return {path: shelf.read(path) for path in sorted(paths)}


def push(
    shelf: CustomFiles, name: str, files: Mapping[str, bytes], written: "Callable[[int], None]"
) -> None:
    """Put them in the place of what is there: NAME.py, or files of the folder NAME."""
    there = shelf.names("")
    _check_folder(shelf, name)
    _finish(shelf, name, there)
    _clear(shelf, name, there)
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
        away = [(name, f"{name}.gone")] if name in there else []
        shelf.rename([*away, (f"{name}.whole", name)])
        if single in there:
            shelf.remove(single)
        _remove_folder(shelf, f"{name}.gone")
    _forget_trace(shelf, there)


def remove(shelf: CustomFiles, name: str) -> bool:
    """Take it away. Returns whether there was any."""
    there = shelf.names("")
    _check_folder(shelf, name)
    _finish(shelf, name, there)
    _clear(shelf, name, there)
    _remove_folder(shelf, name)  # before the file, in whose shadow it may be
    if f"{name}.py" in there:
        shelf.remove(f"{name}.py")
    _forget_trace(shelf, there)
    return name in there or f"{name}.py" in there


def _check_folder(shelf: CustomFiles, name: str) -> None:
    """DeployError where something of the user's would be lost with the old folder."""
    others = [file for file in shelf.names(name) if not file.endswith(".py")]
    if others:
        raise DeployError(
            f"the folder {name} on the board has files that are no Python: {', '.join(others)}",
            f"put them elsewhere first: `mpremote cp :{name}/{others[0]} :`, then `mpremote rm`",
        )


def _finish(shelf: CustomFiles, name: str, there: list[str]) -> None:
    """As the firmware's next start would: a push was cut between its two renamings."""
    if f"{name}.whole" in there and name not in there:
        shelf.rename([(f"{name}.whole", name)])
        there[:] = shelf.names("")


def _clear(shelf: CustomFiles, name: str, there: list[str]) -> None:
    """What a push that was cut has left."""
    if f"{name}.py.new" in there:
        shelf.remove(f"{name}.py.new")
    for ending in ("part", "whole", "gone"):
        _remove_folder(shelf, f"{name}.{ending}")


def _remove_folder(shelf: CustomFiles, folder: str) -> None:
    for file in shelf.names(folder):
        shelf.remove(f"{folder}/{file}")


def _forget_trace(shelf: CustomFiles, there: list[str]) -> None:
    """The traceback is of the file before."""
    for file in _TRACES:
        if file in there:
            shelf.remove(file)
