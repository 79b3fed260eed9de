"""Tables for docs/custom.md, from the firmware's docstrings."""

import ast
from collections.abc import Iterator

from .. import paths
from .markdown import table

# The machine API and its base class. Methods above the line are the extra's, not for handlers.
_API_MODULES = {"machine_api": "# Motion", "pin_api": "# Pins"}
_KEEPERS = ("halt",)


def machine_api_table() -> str:
    """Return every public method of m, with its docstring."""
    rows = [
        (f"`m.{_call(method)}`", " ".join((ast.get_docstring(method) or "").split()))
        for method in machine_api_methods()
    ]
    kept = "A number or a text that is kept; `in`, `del` and `get(name, default)`."
    rows.append(("`m.keep[name]`", kept))
    return table(("Call", "What it does"), rows)


def machine_api_methods() -> Iterator[ast.FunctionDef]:
    """Yield the methods that a handler may call."""
    for module, line in _API_MODULES.items():
        text = (paths.FIRMWARE / "extras" / "custom" / f"{module}.py").read_text(encoding="utf-8")
        first = text[: text.index(line)].count("\n")
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef) and node.col_offset and node.lineno > first:
                if node.name[0] != "_" and node.name not in _KEEPERS:
                    yield node


def _call(method: ast.FunctionDef) -> str:
    """Return a method as it is called: `wait_for(name, closed=True)`; a property by its name."""
    if "property" in map(ast.unparse, method.decorator_list):
        return method.name
    names = [argument.arg for argument in method.args.args[1:]]
    defaults = [ast.unparse(default) for default in method.args.defaults]
    required = names[: len(names) - len(defaults)]
    pairs = zip(names[len(required) :], defaults, strict=True)
    optional = [f"{name}={default}" for name, default in pairs]
    return f"{method.name}({', '.join(required + optional)})"
