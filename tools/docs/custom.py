"""Tables for docs/custom.md, out of what the firmware says of it."""

import ast
from collections.abc import Iterator

from .. import paths
from .markdown import table

_OPERATOR = paths.FIRMWARE / "extras" / "machine_operator.py"
# What custom.py is not handed m for: those above this line are its keeper's.
_FIRST = "# Motion"
_KEEPERS = ("halt",)


def operator_table() -> str:
    """Every public method of m, with what it says of itself."""
    rows = [
        (f"`m.{_call(method)}`", " ".join((ast.get_docstring(method) or "").split()))
        for method in operator_methods()
    ]
    kept = "A number or a text that is kept; `in`, `del` and `get(name, default)`."
    rows.append(("`m.keep[name]`", kept))
    return table(("Call", "What it does"), rows)


def operator_methods() -> Iterator[ast.FunctionDef]:
    """Those that a handler may call."""
    text = _OPERATOR.read_text(encoding="utf-8")
    first = text[: text.index(_FIRST)].count("\n")
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ClassDef) and node.name == "Operator":
            for method in node.body:
                if isinstance(method, ast.FunctionDef) and method.lineno > first:
                    if not method.name.startswith("_") and method.name not in _KEEPERS:
                        yield method


def _call(method: ast.FunctionDef) -> str:
    if method.decorator_list:
        return method.name  # a property
    names = [argument.arg for argument in method.args.args[1:]]
    defaults = [ast.unparse(default) for default in method.args.defaults]
    plain = names[: len(names) - len(defaults)]
    named = [f"{n}={d}" for n, d in zip(names[len(plain) :], defaults, strict=True)]
    return f"{method.name}({', '.join(plain + named)})"
