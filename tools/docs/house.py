"""The structure: the folders of firmware and tools, their contents and their imports."""

import ast
from collections.abc import Iterator
from pathlib import Path

from .. import paths
from .markdown import table

# From the bottom up; main.py, which MicroPython starts, is above them.
FOLDERS = "base motion control language talk ports pio esp_chip extras boot ugrbl_motion".split()
# The folders of the package on the desktop, each above those that it imports.
ROOMS = "grbl sim boardfile compiling run draw replay device image web docs cli".split()


def imports() -> set[tuple[str, str]]:
    """Return which folder imports from which, including imports of types: (importing,
    imported)."""
    found = set()
    for folder in FOLDERS:
        for path in (paths.FIRMWARE / folder).rglob("*.py"):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            found |= {(folder, used) for used in _folders(tree) if used != folder}
    return found


def _folders(tree: ast.Module) -> Iterator[str]:
    """Yield the folders of the firmware from which a module imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module]
        else:
            continue
        for name in names:
            top = name.partition(".")[0]
            if top in FOLDERS:
                yield top


def folders_table() -> str:
    """Return every module with the first sentence of its docstring."""
    rows = []
    for folder in FOLDERS:
        for path in sorted((paths.FIRMWARE / folder).rglob("[!_]*.py")):
            name = path.relative_to(paths.FIRMWARE).as_posix()
            rows.append((f"`{name}`", _first_sentence(path)))
    return table(("Module", "What it is"), rows)


def rooms_table() -> str:
    """Return every folder of the package on the desktop with the first sentence of its
    docstring."""
    files = ((room, paths.TOOLS / room / "__init__.py") for room in ROOMS)
    rows = [(f"`{room}/`", _first_sentence(file)) for room, file in files]
    return table(("Room", "What is in it"), rows)


def _first_sentence(path: Path) -> str:
    """Return the first sentence of a module's docstring."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
    if not text:
        raise ValueError(f"{path} has no docstring: add one that says what it is")
    words = " ".join(text.partition("\n\n")[0].split())
    return words.partition(". ")[0].rstrip(".") + "."
