"""Saves: lines to be stored wait here until the loop writes them, before the line is answered.

Code that changes stored values is deep in calls, and so is a file system. Both together would need
more stack than the interrupts leave.
"""

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Iterable

    from interfaces import Store


class Saves:
    """A Store in front of another one, which changes only in write_due().

    damaged: names whose data was damaged, with True if an older copy was used. due: lines to
    write, by name.
    """

    def __init__(self, store: "Store") -> None:
        self._store = store
        self.damaged = store.damaged
        self.due: "dict[str, list[str]]" = {}

    def load(self, name: str) -> "list[str] | None":
        """Return the lines stored under that name: an empty list if there never were any, None if
        they are lost. Due lines are not considered."""
        return self._store.load(name)

    def save(self, name: str, lines: "Iterable[str]") -> None:
        """Replace the lines under that name at the next write_due()."""
        self.due[name] = list(lines)

    def write_due(self) -> None:
        """Write all due lines; only while idle. Raises OSError if some could not be stored: these
        are then valid until power-off."""
        failed: "OSError | None" = None
        while self.due:
            name, lines = self.due.popitem()
            try:
                self._store.save(name, lines)
            except OSError as reason:
                failed = reason
        if failed:
            raise failed
