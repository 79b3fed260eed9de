"""Saves: what is to be kept waits here until the loop has it written, before the line is answered.

Whoever changes what is kept is deep in calls, and so is a file system: one on top of the other
they need more stack than there is beside the interrupts.
"""

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Iterable

    from interfaces import Store


class Saves:
    """A Store in front of another one, which save() leaves as it is until write_due()."""

    def __init__(self, store: "Store") -> None:
        self._store = store
        self.damaged = store.damaged
        self.due: "dict[str, list[str]]" = {}

    def load(self, name: str) -> "list[str] | None":
        """The lines kept under that name: none where there never were any, None where they are
        lost."""
        return self._store.load(name)

    def save(self, name: str, lines: "Iterable[str]") -> None:
        """Replace them with the next write_due()."""
        self.due[name] = list(lines)

    def write_due(self) -> None:
        """Write what is due; at rest only. Raises OSError where something could not be kept: it
        holds until the power goes."""
        failed: "OSError | None" = None
        while self.due:
            name, lines = self.due.popitem()
            try:
                self._store.save(name, lines)
            except OSError as reason:
                failed = reason
        if failed:
            raise failed
