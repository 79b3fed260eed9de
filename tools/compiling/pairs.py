"""Pairs and triples of values are taken apart without a tuple in between.

`a, b = x, y` costs MicroPython two moves on its stack. `a, b = (x, y)`, which is how ast.unparse()
writes that, is an object to its compiler: 16 bytes, and on a Pico 30 us.
"""

import ast
from collections.abc import Iterator

_MOST = 3  # of four and more MicroPython makes a tuple either way


def pairs(text: str) -> str:
    """A module without parentheses around what is taken apart at once. No line moves."""
    lines = [line.encode() for line in text.splitlines(keepends=True)]
    found = sorted(_values(ast.parse(text)), key=lambda each: each.col_offset, reverse=True)
    for value in found:
        whole = lines[value.lineno - 1]
        bare = ", ".join(map(ast.unparse, value.elts)).encode()
        lines[value.lineno - 1] = whole[: value.col_offset] + bare + whole[value.end_col_offset :]
    return b"".join(lines).decode()


def _values(tree: ast.Module) -> Iterator[ast.Tuple]:
    for node in ast.walk(tree):
        match node:
            case ast.Assign([ast.Tuple(names)], ast.Tuple(values) as found) if (
                len(names) == len(values) <= _MOST
                and found.lineno == found.end_lineno
                and not any(isinstance(each, ast.Starred) for each in (*names, *values))
            ):
                yield found
