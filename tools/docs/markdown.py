"""Markdown: code in a text, and tables."""

import re
from collections.abc import Iterable

Row = tuple[str, ...]

_DOLLAR = re.compile(r"'?(\$[\w$=#]*)'?")


def as_code(text: str) -> str:
    """Return the text with words that begin with $ as code."""
    return _DOLLAR.sub(r"`\1`", text)


def table(header: Row, rows: Iterable[Row]) -> str:
    """Return a table in Markdown."""
    lines = [header, ("---",) * len(header), *rows]
    escaped = "\\|"
    return "\n".join(
        f"| {' | '.join(cell.replace('|', escaped) for cell in line)} |" for line in lines
    )
