"""Rounding to single precision goes where a board's own arithmetic does it.

A board's floats are single: each result is rounded as f32() (base/f32.py) rounds it on a desktop,
and a call there takes 20 us. What is not arithmetic stays in its call: it may be a whole number,
and is to be a float.
"""

import ast

_ROUND = "f32"


def singles(text: str) -> str:
    """A module without calls that do nothing on a board. No line moves."""
    calls = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    places = [(node.lineno, node.col_offset) for node in calls if _is_in_vain(node)]
    lines = [line.encode() for line in text.splitlines(keepends=True)]
    for line, column in sorted(places, reverse=True):
        whole = lines[line - 1]
        lines[line - 1] = whole[:column] + whole[column + len(_ROUND) :]  # the brackets stay
    return b"".join(lines).decode()


def _is_in_vain(node: ast.Call) -> bool:
    match node:
        case ast.Call(ast.Name(id), [ast.BinOp()]) if id == _ROUND:
            return True
        case ast.Call(ast.Name(id), [ast.Constant(float())]) if id == _ROUND:
            return True
        case ast.Call(ast.Name(id), [ast.Call(ast.Attribute(ast.Name("math")))]) if id == _ROUND:
            return True
    return False
