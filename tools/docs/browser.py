"""The words of the page in the browser: meanings of the firmware's numbers, as JSON in its
file."""

import json
from typing import Any

from .. import paths
from ..grbl import messages, settings_file

PAGE = paths.TOOLS / "web" / "page" / "index.html"
_BEGIN = '<script type="application/json" id="words">\n'
_END = "\n</script>"
# With a punch, $30 to $33 differ; with a laser, $33 is its frequency.
_TOOLS = {"laser": "extras/tools/laser", "punch": "extras/tools/punch"}


def update(text: str) -> str:
    """Return the page with its words up to date: what is between _BEGIN and _END."""
    before, _, words_and_after = text.partition(_BEGIN)
    _, end, after = words_and_after.partition(_END)
    return before + _BEGIN + _as_json(words()) + end + after


def words() -> dict[str, dict[str, Any]]:
    """Return the words by kind, then by number: text of errors and alarms; of settings name, text,
    unit, limits, whether the number is the first of one per axis, and default."""
    tables = {module: list(table) for module, table in settings_file.tables().items()}
    found: dict[str, dict[str, Any]] = {
        "errors": {str(number): text for number, text in messages.errors().items()},
        "alarms": {str(number): text for number, text in messages.alarms().items()},
        "settings": {
            str(row[0]): _words(module, row) for module, table in tables.items() for row in table
        },
    }
    for tool, module in _TOOLS.items():
        table = settings_file.of_tool(tool)
        found[tool] = {str(row[0]): _words(module, row) for row in table}
    return found


def _words(module: str, row: Any) -> list[Any]:
    """Return the words of a setting's row, whether it has a number per axis, and its default."""
    meaning = settings_file.row_meaning(module, row)
    return [*meaning, settings_file.is_per_axis(row), row[3]]


def _as_json(tables: dict[str, dict[str, Any]]) -> str:
    """Return JSON with a line for each number, so that a change is visible."""
    parts = []
    for kind, rows in tables.items():
        lines = [
            f"{json.dumps(number)}: {json.dumps(row, ensure_ascii=False)}"
            for number, row in rows.items()
        ]
        parts.append(f"{json.dumps(kind)}: {{\n" + ",\n".join(lines) + "\n}")
    return "{" + ",\n".join(parts) + "}"
