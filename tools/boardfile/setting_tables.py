"""Tables of the settings that a board has, including those of its extras."""

from types import ModuleType
from typing import TYPE_CHECKING

from .. import paths
from ..grbl.settings_file import of_tool, tables

if TYPE_CHECKING:
    from base.settings import Rows


def tables_of(board: ModuleType) -> "dict[str, Rows]":
    """Return the rows by the firmware's module that has them, those of TOOL last; settings of the
    user's own extras are not known."""
    paths.use_firmware()
    from boot import select_extras

    names = {
        "base/settings",
        *(name.replace(".", "/") for name in select_extras.extra_names(board, with_custom=False)),
    }
    found = {module: rows for module, rows in tables().items() if module in names}
    tool = getattr(board, "TOOL", "")
    if tool in ("laser", "punch"):
        found[f"extras/tools/{tool}"] = of_tool(tool)
    return found
