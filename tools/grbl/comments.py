"""Comments of the firmware: the meaning of its tables' rows, for files and documents."""

import ast

from .. import paths

# The annotation of tables of settings.
_TABLE_TYPE = "Rows"  # of a module's tables of settings


def source(module: str) -> str:
    """Return the text of a module: `talk/commands`."""
    return (paths.FIRMWARE / f"{module}.py").read_text(encoding="utf-8")


def above(module: str, line: int, what: str) -> str:
    """Return the comment that ends above a line (from 1) as one line; only its part after an empty
    comment line. ValueError if there is none: `what` lacks it."""
    lines_of_comment: list[str] = []
    for text in reversed(source(module).splitlines()[: line - 1]):
        comment = text.strip()
        if not comment.startswith("# "):
            break  # no comment, or an empty line of it
        lines_of_comment.insert(0, comment[2:])
    if not lines_of_comment:
        raise ValueError(f"{what} has no comment above it in {module}.py")
    return " ".join(lines_of_comment)


def setting_comments(module: str = "base/settings") -> dict[int, str]:
    """Return the comment above each row of a module's tables of settings. ValueError if one is
    missing."""
    found: dict[int, str] = {}
    for node in ast.parse(source(module)).body:
        if isinstance(node, ast.AnnAssign) and _TABLE_TYPE in ast.unparse(node.annotation):
            assert isinstance(node.value, ast.Tuple)
            for row in node.value.elts:
                assert isinstance(row, ast.Tuple)
                number = ast.literal_eval(row.elts[0])
                found[number] = above(module, row.lineno, f"${number}")
    return found
