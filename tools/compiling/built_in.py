"""Modules that are MicroPython's own are not looked for in the file system.

A file may take the place of most of them, so an import asks for a folder and two files of that
name, anew each time: 2.4 ms on a Pico, forty times. With a `u` in front of its name MicroPython
takes its own at once (mp_module_get_builtin() in py/objmodule.c).
"""

import ast

# All that a file may take the place of, on rp2 and esp32.
_MODULES = (
    *("array", "binascii", "collections", "errno", "hashlib", "heapq", "io", "json", "machine"),
    *("os", "platform", "random", "re", "select", "socket", "struct", "time"),
)


def built_in(text: str) -> str:
    """A module that imports them so. No line moves."""
    lines = [line.encode() for line in text.splitlines(keepends=True)]
    imports = (node for node in ast.walk(ast.parse(text)) if isinstance(node, _Import))
    for node in sorted(imports, key=lambda node: node.col_offset, reverse=True):
        if (new := _by_own_name(node)) and node.lineno == node.end_lineno:
            whole = lines[node.lineno - 1]
            made = ast.unparse(new).encode()
            lines[node.lineno - 1] = whole[: node.col_offset] + made + whole[node.end_col_offset :]
    return b"".join(lines).decode()


_Import = ast.Import | ast.ImportFrom


def _by_own_name(node: _Import) -> "_Import | None":
    """The same import; None where it is of others."""
    if isinstance(node, ast.ImportFrom):
        if node.module not in _MODULES:
            return None
        return ast.ImportFrom(f"u{node.module}", node.names, node.level)
    if not any(alias.name in _MODULES for alias in node.names):
        return None
    return ast.Import(
        [
            ast.alias(f"u{alias.name}", alias.asname or alias.name)
            if alias.name in _MODULES
            else alias
            for alias in node.names
        ]
    )
