"""The comments of the firmware: what its tables' rows are for, as files and documents say it."""

import ast

from .. import paths

_SETTINGS = "base/settings"


def source(module: str) -> str:
    """The text of a module: `talk/commands`."""
    return (paths.FIRMWARE / f"{module}.py").read_text(encoding="utf-8")


def above(module: str, line: int, what: str) -> str:
    """The comment that ends above a line; where an empty one parts it, what follows."""
    words: list[str] = []
    for text in reversed(source(module).splitlines()[: line - 1]):
        comment = text.strip()
        if not comment.startswith("# "):
            break
        words.insert(0, comment[2:])
    if not words:
        raise ValueError(f"{what} has no comment above it in {module}.py")
    return " ".join(words)


def setting_comments() -> dict[int, str]:
    """What is said above each row of the settings' table; ValueError if one has no comment."""
    for node in ast.parse(source(_SETTINGS)).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "_TABLE":
            rows = [(ast.literal_eval(row.elts[0]), row.lineno) for row in _tuples(node.value)]
            return {number: above(_SETTINGS, at, f"${number}") for number, at in rows}
    raise ValueError(f"{_SETTINGS}.py has no _TABLE")


def _tuples(rows: ast.expr) -> list[ast.Tuple]:
    assert isinstance(rows, ast.Tuple)
    return [row for row in rows.elts if isinstance(row, ast.Tuple)]
