"""The comments of the firmware: what its tables' rows are for, as files and documents say it."""

import ast

from .. import paths

# What tables of settings are annotated with.
_KIND = "Rows"


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


def setting_comments(module: str = "base/settings") -> dict[int, str]:
    """What is said above each row of a module's tables of settings; ValueError if one has no
    comment."""
    found: dict[int, str] = {}
    for node in ast.parse(source(module)).body:
        if isinstance(node, ast.AnnAssign) and _KIND in ast.unparse(node.annotation):
            assert isinstance(node.value, ast.Tuple)
            for row in node.value.elts:
                assert isinstance(row, ast.Tuple)
                number = ast.literal_eval(row.elts[0])
                found[number] = above(module, row.lineno, f"${number}")
    return found
