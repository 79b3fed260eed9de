"""Comments of the firmware: the meaning of its tables' rows, for files and documents."""

import ast

from .. import paths

# The annotation of tables of settings.
_KIND = "Rows"


def source(module: str) -> str:
    """Return the text of a module: `talk/commands`."""
    return (paths.FIRMWARE / f"{module}.py").read_text(encoding="utf-8")


def above(module: str, line: int, what: str) -> str:
    """Return the comment that ends above a line; only its part after an empty comment line."""
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
    """Return the comment above each row of a module's tables of settings. ValueError if one is
    missing."""
    found: dict[int, str] = {}
    for node in ast.parse(source(module)).body:
        if isinstance(node, ast.AnnAssign) and _KIND in ast.unparse(node.annotation):
            assert isinstance(node.value, ast.Tuple)
            for row in node.value.elts:
                assert isinstance(row, ast.Tuple)
                number = ast.literal_eval(row.elts[0])
                found[number] = above(module, row.lineno, f"${number}")
    return found
