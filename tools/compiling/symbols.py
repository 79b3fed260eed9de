"""The map of a build: what the names and places mean that a board tells.

Attributes have short names on a board, and files have no line numbers. So a build keeps, in JSON:

    id         what tells this build from others; the board knows it, see STAMP
    debug      whether names and line numbers are on the board
    classes    by class, by an attribute's short name: its name
    modules    by module:
      file         in the folder firmware/
      functions    by name (`Class.method`): first and last line
      names        by short name: what it may be, wherever in the module
      lines        of a debug build, by line as the board tells it: the line of the file
"""

import ast
import hashlib
from collections.abc import Iterator, Mapping
from typing import Any

from .shorten import Shortened

# What base/errors.py has for an id; a build has its own in this place.
STAMP = '"--------"'
_DIGITS = 8

_Function = ast.FunctionDef | ast.AsyncFunctionDef


def stamped(made: Shortened) -> Shortened:
    """The same, with its id in it: by the texts as they are compiled, and what names mean."""
    known = repr((sorted(made.texts.items()), sorted(made.names.items())))
    number = hashlib.sha256(known.encode()).hexdigest()[:_DIGITS]
    texts = {name: text.replace(STAMP, f'"{number}"') for name, text in made.texts.items()}
    return made._replace(texts=texts, id=number)


def describe(sources: Mapping[str, str], made: Shortened, debug: bool) -> dict[str, Any]:
    """The map of what was made of these sources."""
    modules = {}
    for name, text in sources.items():
        tree = ast.parse(text)
        modules[name] = {
            "file": _file(name, sources),
            "functions": {function: span for function, span, _ in functions(tree)},
            "names": made.modules.get(name, {}),
        }
        if debug:
            modules[name]["lines"] = _lines(tree, ast.parse(made.texts[name]))
    return {"id": made.id, "debug": debug, "classes": made.classes, "modules": modules}


def _file(module: str, sources: Mapping[str, str]) -> str:
    is_package = any(name.startswith(f"{module}.") for name in sources)
    return module.replace(".", "/") + ("/__init__.py" if is_package else ".py")


def functions(tree: ast.AST, prefix: str = "") -> Iterator[tuple[str, tuple[int, int], _Function]]:
    """Every function by its whole name, its lines, decorators left out, and itself."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, _Function):
            yield prefix + node.name, (node.lineno, node.end_lineno or node.lineno), node
        if isinstance(node, _Function | ast.ClassDef):
            yield from functions(node, f"{prefix}{node.name}.")
        else:
            yield from functions(node, prefix)


def _lines(before: ast.Module, after: ast.Module) -> dict[str, int]:
    """Where each line of the functions that MicroPython interprets comes from.

    No pass changes what statements these have. Native ones tell no lines.
    """
    found: dict[str, int] = {}
    origin = {name: node for name, _, node in functions(before)}
    for name, _, node in functions(after):
        ours, theirs = _statements(origin[name]), _statements(node)
        if [*map(type, ours)] == [*map(type, theirs)]:
            found.update((str(b.lineno), a.lineno) for a, b in zip(ours, theirs, strict=True))
    return found


def _statements(node: ast.AST) -> list[ast.stmt]:
    return [part for part in ast.walk(node) if isinstance(part, ast.stmt)]
