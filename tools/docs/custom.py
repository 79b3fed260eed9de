"""Tables for docs/custom.md, from the firmware's docstrings."""

import ast
from collections.abc import Iterator

from .. import paths
from .markdown import table

# The machine API and its base class, with the comment that begins the methods for handlers.
_API_MODULES = {"machine_api": "# Motion", "pin_api": "# Pins"}
_NOT_FOR_HANDLERS = ("halt",)  # though it is below the heading


def machine_api_table() -> str:
    """Return a table of what a handler may call of its machine, `m`, with the docstrings."""
    rows = [
        (f"`m.{_call(method)}`", " ".join((ast.get_docstring(method) or "").split()))
        for method in machine_api_methods()
    ]
    kept = "A number or a text that stays stored without power; also `in`, `del` and "
    kept += "`get(name, default)`."
    rows.append(("`m.keep[name]`", kept))
    return table(("Call", "What it does"), rows)


def machine_api_methods() -> Iterator[ast.FunctionDef]:
    """Yield the methods that a handler may call."""
    for module, heading in _API_MODULES.items():
        text = (paths.FIRMWARE / "extras" / "custom" / f"{module}.py").read_text(encoding="utf-8")
        heading_line = text[: text.index(heading)].count("\n")
        for node in ast.walk(ast.parse(text)):
            if not isinstance(node, ast.FunctionDef):
                continue
            if node.col_offset and node.lineno > heading_line:  # indented: a method
                if node.name[0] != "_" and node.name not in _NOT_FOR_HANDLERS:
                    yield node


def _call(method: ast.FunctionDef) -> str:
    """Return a method as it is called: `wait_for(name, closed=True)`; a property by its name."""
    if "property" in map(ast.unparse, method.decorator_list):
        return method.name
    names = [argument.arg for argument in method.args.args[1:]]
    defaults = [ast.unparse(default) for default in method.args.defaults]
    required = names[: len(names) - len(defaults)]
    with_default = zip(names[len(required) :], defaults, strict=True)
    optional = [f"{name}={default}" for name, default in with_default]
    return f"{method.name}({', '.join(required + optional)})"
