"""The firmware as text: its comments are what the documents say. And tables of Markdown."""

import re
from collections.abc import Iterable

from .. import paths

Row = tuple[str, ...]

_DOLLAR = re.compile(r"'?(\$[\w$=]*)'?")


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
    return as_code(" ".join(words))


def as_code(text: str) -> str:
    """The text with what begins with $ as code."""
    return _DOLLAR.sub(r"`\1`", text)


def table(header: Row, rows: Iterable[Row]) -> str:
    """A table of Markdown."""
    lines = [header, ("---",) * len(header), *rows]
    return "\n".join(
        f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines
    )
