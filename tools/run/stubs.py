"""Stubs for editors and type checkers, from the sources: what a program may call, with docstrings.

    typings/ugrbl_motion/    the package ugrbl_motion
    typings/ugrbl/           what custom.py imports, and m

Both are put in the folder `typings`, where Pyright and Pylance look without being configured.
kept: the names that a stub has; an annotation with another name of the firmware becomes Any.
"""

import ast
import builtins
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from .. import paths

FOLDER = "typings"
_MOTION = "ugrbl_motion"
# Names that a program sees, by module of the package.
_OF_MOTION = {
    "line_queue": ("Motor",),
    "group": ("GroupError", "Output", "Axis", "Group"),
    "homing": ("Switch", "Homing"),
}
# The same of custom.py, in the order in which they need each other. MachineApi is m.
_OF_CUSTOM = {
    "handlers": ("Refused", "Refuse", "mcode", "gcode", "every", "On"),
    "positions": ("Position", "ModalState"),
    "persistent": ("PersistentValues",),
    "pin_api": ("Stopped", "PinApi"),
    "machine_api": ("MachineApi",),
}
# Methods that have no underscore and are the firmware's.
_FOR_FIRMWARE = (
    *("begin_handler", "restart_clock", "check_stopped", "clear_requests", "has_jogs"),
    *("start_jogs", "keep_length", "write", "halt", "join", "__getattr__", "__repr__"),
)
_TYPING = """\
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

"""
_TYPES = ("array", "Callable", "Iterator", "Mapping", "Sequence", "Any")


def save(stubs: Mapping[str, str], folder: Path) -> None:
    """Write stubs, by path, into a folder."""
    for path, text in stubs.items():
        paths.write(folder / path, text.encode())


def motion() -> dict[str, str]:
    """Return the stubs of ugrbl_motion by path, with the mark of a typed package."""
    kept = [name for names in _OF_MOTION.values() for name in names]
    found = {"__init__.pyi": _source(f"{_MOTION}/__init__"), "py.typed": ""}
    for module, names in _OF_MOTION.items():
        text = _source(f"{_MOTION}/{module}")
        found[f"{module}.pyi"] = _stub(text, names, kept, _imports(text, kept))
    return {f"{FOLDER}/{_MOTION}/{name}": text for name, text in found.items()}


def custom() -> dict[str, str]:
    """Return the stub of what custom.py imports as ugrbl, by path."""
    kept = [name for names in _OF_CUSTOM.values() for name in names]
    texts = {module: _source(f"extras/custom/{module}") for module in _OF_CUSTOM}
    parts = [_stub(texts[module], names, kept, ()) for module, names in _OF_CUSTOM.items()]
    body = "\n".join(part.removeprefix(_TYPING) for part in parts)
    events = "".join(_events(texts["handlers"]))
    # into the class On, before its first method
    body = body.replace("    def input(self", events + "\n    def input(self", 1)
    body = body.replace("MachineApi", "Machine") + "\non: On\n"
    doc = '"""What custom.py imports as ugrbl. `def vacuum(m: Machine, P): …` completes m."""\n\n'
    folder = f"{FOLDER}/ugrbl"
    return {f"{folder}/__init__.pyi": doc + _TYPING + body, f"{folder}/py.typed": ""}


def _source(name: str) -> str:
    return (paths.FIRMWARE / f"{name}.py").read_text(encoding="utf-8")


def _imports(text: str, kept: Iterable[str]) -> Iterator[str]:
    """Yield the imports of names that other modules of the package have."""
    for node in ast.parse(text).body:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(f"{_MOTION}."):
            names = [one for one in node.names if one.name in kept]
            if names:
                yield ast.unparse(ast.ImportFrom(node.module, names, 0))


def _events(handlers: str) -> Iterator[str]:
    """Yield a line for each event that On has: on.startup and so on."""
    for node in ast.parse(handlers).body:
        match node:
            case ast.Assign([ast.Name("MOVING" | "DURING_MOTION")], value):
                for name in ast.literal_eval(value):
                    yield f"    {name}: Callable[[Callable[..., Any]], Callable[..., Any]]\n"
            case ast.Assign([ast.Name("REPORT")], value):
                name = ast.literal_eval(value)
                yield f"    {name}: Callable[[Callable[..., Any]], Callable[..., Any]]\n"


def _stub(text: str, names: Iterable[str], kept: Iterable[str], imports: Iterable[str]) -> str:
    """Return the stub of a module's (text) public classes and functions of these names. imports:
    lines to begin with."""
    tree = ast.parse(text)
    aliases = {
        node.targets[0].id: node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
    }
    body: list[ast.stmt] = []
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and node.name in names:
            body.append(_class(node))
        elif isinstance(node, ast.FunctionDef) and node.name in names:
            body.append(_function(node))
    made = ast.Module(body, [])
    for part in ast.walk(made):  # replace the annotations
        for field in ("annotation", "returns"):
            if getattr(part, field, None):
                setattr(part, field, _Annotation(kept, aliases).visit(getattr(part, field)))
    return "\n".join([_TYPING, *imports, "", ast.unparse(ast.fix_missing_locations(made)), ""])


class _Annotation(ast.NodeTransformer):
    """Replaces names of the firmware's types, which a program does not have, by Any, and aliases
    by what they stand for."""

    def __init__(self, kept: Iterable[str], aliases: "dict[str, ast.expr]") -> None:
        self._kept = (*kept, *_TYPES)
        self._aliases = aliases

    def visit_Constant(self, node: ast.Constant) -> ast.expr:
        if isinstance(node.value, str):  # a quoted annotation
            made: ast.expr = self.visit(ast.parse(node.value, mode="eval").body)
            return made
        return node

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id in self._aliases:
            made: ast.expr = self.visit(self._aliases[node.id])
            return made
        if node.id in self._kept or hasattr(builtins, node.id):
            return node
        return ast.Name("Any", ast.Load())


def _class(node: ast.ClassDef) -> ast.ClassDef:
    """Return a class with its public part."""
    body: list[ast.stmt] = [ast.Expr(ast.Constant(ast.get_docstring(node) or ""))]
    for part in node.body:
        match part:
            case ast.FunctionDef(name) | ast.AsyncFunctionDef(name):
                special = name.startswith("__") and name.endswith("__")
                if (special or not name.startswith("_")) and name not in _FOR_FIRMWARE:
                    body += _attributes(part) if name == "__init__" else []
                    body.append(_function(part))
            case ast.AnnAssign(ast.Name(name)) if not name.startswith("_"):
                body.append(part)
            case ast.Assign([ast.Name(name)], ast.Constant(value)) if not name.startswith("_"):
                body.append(_attribute(name, ast.Name(type(value).__name__, ast.Load())))
    return ast.ClassDef(node.name, node.bases, [], body, [])


def _attributes(init: "ast.FunctionDef | ast.AsyncFunctionDef") -> Iterator[ast.stmt]:
    """Yield the public attributes that __init__ sets: annotated, or from a parameter or class."""
    types = {one.arg: one.annotation for one in init.args.args}
    for node in ast.walk(init):
        found: ast.expr | None = None
        match node:
            case ast.AnnAssign(ast.Attribute(ast.Name("self"), name), annotation):
                found = annotation
            case ast.Assign([ast.Attribute(ast.Name("self"), name)], ast.Name(value)):
                found = types.get(value)
            case ast.Assign([ast.Attribute(ast.Name("self"), name)], ast.Call(ast.Name(value))):
                found = ast.Name(value, ast.Load())
            case ast.Assign([ast.Attribute(ast.Name("self"), name)], ast.Constant(value)):
                found = ast.Name(type(value).__name__, ast.Load())
            case _:
                continue
        if found and not name.startswith("_"):
            yield _attribute(name, found)


def _attribute(name: str, annotation: ast.expr) -> ast.AnnAssign:
    return ast.AnnAssign(ast.Name(name, ast.Store()), annotation, None, 1)


def _function(
    node: "ast.FunctionDef | ast.AsyncFunctionDef",
) -> "ast.FunctionDef | ast.AsyncFunctionDef":
    """Return a function without its body."""
    doc = ast.get_docstring(node)
    node.body = [ast.Expr(ast.Constant(doc if doc else ...))]
    kept = ("property",)
    node.decorator_list = [one for one in node.decorator_list if ast.unparse(one) in kept]
    return node
