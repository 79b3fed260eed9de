"""A Store in one text file: a `[name]` line, then the lines kept under it, indented."""

import os
from collections.abc import Iterable
from pathlib import Path

_INDENT = "    "


class FileStore:
    """Keeps the firmware's settings between runs. A damaged file counts as empty."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._kept = self._read()

    def load(self, name: str) -> list[str] | None:
        """What was last saved under name."""
        lines = self._kept.get(name)
        return None if lines is None else list(lines)

    def save(self, name: str, lines: Iterable[str]) -> None:
        """Replace the file by a new one, or leave it as it was."""
        self._kept[name] = list(lines)
        new = self._path.with_name(self._path.name + ".new")
        with new.open("w", encoding="latin-1", newline="\n") as file:
            for section, kept in self._kept.items():
                file.write("".join([f"[{section}]\n", *(f"{_INDENT}{line}\n" for line in kept)]))
            file.flush()
            os.fsync(file.fileno())
        new.replace(self._path)

    def _read(self) -> dict[str, list[str]]:
        kept: dict[str, list[str]] = {}
        try:
            text = self._path.read_text(encoding="latin-1")
        except OSError:
            return kept
        for line in text.splitlines():
            if line.startswith("[") and line.endswith("]"):
                kept[line[1:-1]] = []
            elif line.startswith(_INDENT) and kept and line.isprintable():
                kept[next(reversed(kept))].append(line.removeprefix(_INDENT))
            else:
                return {}
        return kept
