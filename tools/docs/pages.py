"""The pages with generated parts, and the functions that generate them.

A part is between the lines `<!-- begin: NAME -->` and `<!-- end: NAME -->`; TABLES has the
function for each name.
"""

import re
from collections.abc import Callable

from .. import paths
from . import custom, house, machines, words

ROOT = paths.FIRMWARE.parent
DOCS = ROOT / "docs"
_NAMES = ("reference", "boards", "conformance", "architecture", "custom")
PAGES = tuple(DOCS / f"{name}.md" for name in _NAMES)

_MARKED = re.compile(r"(<!-- begin: ([\w-]+) -->\n).*?(<!-- end: \2 -->)", re.DOTALL)

TABLES: dict[str, Callable[[], str]] = {
    "g-words": words.g_table,
    "m-words": words.m_table,
    "commands": words.commands_table,
    "realtime": words.realtime_table,
    "settings": machines.settings_table,
    "errors": machines.errors_table,
    "alarms": machines.alarms_table,
    "options": machines.options_table,
    "boards": machines.boards_table,
    "pins": machines.pins_table,
    "differences": machines.differences_table,
    "modules": house.folders_table,
    "rooms": house.rooms_table,
    "operator": custom.machine_api_table,
}


def update(text: str) -> str:
    """Return the text with all its tables up to date."""
    return _MARKED.sub(lambda found: f"{found[1]}{TABLES[found[2]]()}\n{found[3]}", text)
