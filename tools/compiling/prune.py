"""Imports in vain go, before the firmware is compiled.

Where constants and functions have been put in place, a module has no use for the name any more;
nor for `const`, which is the compiler's. Each such name would take a place in the module's
dictionary and a search at start. A module that is imported for its effects is none of ours.
"""

import ast
from collections.abc import Iterator, Mapping

from . import scan

_Import = ast.Import | ast.ImportFrom


def prune(sources: Mapping[str, str]) -> dict[str, str]:
    """The modules, by name, without imports that nothing in all of them uses."""
    trees = {name: ast.parse(text) for name, text in sources.items()}
    asked = {key for tree in trees.values() for key in _asked(tree)}
    found = {}
    for name, text in sources.items():
        used = set(_used(trees[name])) | {what for module, what in asked if module in (name, "")}
        lines = text.splitlines(keepends=True)
        for node in scan.walk(trees[name]):
            if isinstance(node, _Import) and _is_ours(node, sources):
                left = [alias for alias in node.names if _name(alias) not in used]
                if left:
                    _replace(lines, node, _without(node, left))
        found[name] = "".join(lines)
    return found


def _asked(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """Module, or an empty text for any, and what it is asked for."""
    aliases = set(scan.imports(tree))
    for node in scan.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield from ((node.module, alias.name) for alias in node.names)
        elif isinstance(node, ast.Attribute) and scan.root(node.value) in aliases:
            yield "", node.attr


def _used(tree: ast.Module) -> Iterator[str]:
    """Names that the code asks for; const() where the compiler does not see to it."""
    ours = {
        statement.value.func
        for statement in tree.body
        if isinstance(statement, ast.Assign)
        and isinstance(statement.value, ast.Call)
        and ast.unparse(statement.value.func) == "const"
    }
    for node in scan.walk(tree):
        if isinstance(node, ast.Name) and node not in ours:
            yield node.id


def _is_ours(node: _Import, sources: Mapping[str, str]) -> bool:
    if isinstance(node, ast.ImportFrom):
        return node.module in sources or node.module == "micropython"
    return all(alias.name in sources for alias in node.names)


def _name(alias: ast.alias) -> str:
    return (alias.asname or alias.name).partition(".")[0]


def _without(node: _Import, gone: list[ast.alias]) -> str:
    left = ", ".join(ast.unparse(alias) for alias in node.names if alias not in gone)
    if not left:
        return "pass"
    source = f"from {node.module} " if isinstance(node, ast.ImportFrom) else ""
    return f"{source}import {left}"


def _replace(lines: list[str], node: ast.stmt, text: str) -> None:
    """An import stands alone on its lines, but for a comment; their number stays."""
    first, last = node.lineno - 1, (node.end_lineno or node.lineno) - 1
    lines[first : last + 1] = [" " * node.col_offset + text + "\n", *["\n"] * (last - first)]
