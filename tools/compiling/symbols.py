"""The map of a build: what the names and places mean that a board tells.

Attributes have short names on a board, and files have no line numbers. So a build keeps, in JSON:

    id         what tells this build from others; the board knows it (base/errors.py)
    debug      whether names and line numbers are on the board
    classes    by class, by an attribute's short name: its name
    modules    by module:
      file         in the folder firmware/
      length       of the file, in lines
      functions    by name (`Class.method`): first and last line
      attributes   by short name: what it may be, wherever in the module
      variables    the same, of parameters and variables
      lines        of a debug build, by line as the board tells it: the line of the file
"""

import ast
import hashlib
from collections.abc import Iterator, Mapping
from difflib import SequenceMatcher
from typing import Any

from .shorten import Shortened

# What base/errors.py has for an id; a build has its own in this place.
OF_SOURCES = "--------"
_DIGITS = 8

_Function = ast.FunctionDef | ast.AsyncFunctionDef


def stamped(sources: Mapping[str, str], made: Shortened) -> Shortened:
    """The same, with its id in it: of what is compiled, what names mean, and where they stand."""
    known = repr([sorted(part.items()) for part in (sources, made.texts, made.names)])
    number = hashlib.sha256(known.encode()).hexdigest()[:_DIGITS]
    before, after = f'"{OF_SOURCES}"', f'"{number}"'
    texts = {name: text.replace(before, after) for name, text in made.texts.items()}
    return made._replace(texts=texts, id=number)


def describe(sources: Mapping[str, str], made: Shortened, debug: bool) -> dict[str, Any]:
    """The map of what was made of these sources."""
    modules = {}
    for name, text in sources.items():
        tree = ast.parse(text)
        modules[name] = {
            "file": _file(name, sources),
            "length": text.count("\n"),
            "functions": {function: span for function, span, _ in functions(tree)},
            "attributes": made.attributes.get(name, {}),
            "variables": made.variables.get(name, {}),
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
        elif not isinstance(node, ast.expr):  # which has none in it
            yield from functions(node, prefix)


def _lines(before: ast.Module, after: ast.Module) -> dict[str, int]:
    """Where each line comes from that MicroPython can tell.

    No pass changes what statements there are in a function that it interprets; native ones tell
    no lines. On a module's own level leaves go, and imports come.
    """
    found: dict[str, int] = {}
    ours, theirs = [*map(_kind, before.body)], [*map(_kind, after.body)]
    for a, b, count in SequenceMatcher(None, ours, theirs, False).get_matching_blocks():
        for one, other in zip(before.body[a : a + count], after.body[b : b + count], strict=True):
            found[str(other.lineno)] = one.lineno
    origin = {name: _statements(node) for name, _, node in functions(before)}
    for name, _, node in functions(after):
        pairs = [*zip(origin[name], _statements(node), strict=False)]
        if all(type(one) is type(other) for one, other in pairs):
            found.update((str(other.lineno), one.lineno) for one, other in pairs)
    return found


def _kind(statement: ast.stmt) -> tuple[type[ast.stmt], str]:
    return type(statement), getattr(statement, "name", "")


def _statements(node: ast.AST) -> list[ast.stmt]:
    return [part for part in ast.walk(node) if isinstance(part, ast.stmt)]
