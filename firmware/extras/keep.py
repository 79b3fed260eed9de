"""Keep: small values of the user's own, kept over power-off.

m.keep["z1"] = 3.5: a number or a text under a name. What is set holds at once, and is written when
the machine stands still and no line waits; a power cut leaves the old values or the new.
"""

import json

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import Any

    from control.saves import Saves

_FILE = "keep"


class Keep:
    """The values, by name."""

    def __init__(self, saves: "Saves") -> None:
        self._saves = saves
        self._values: "dict[str, Any] | None" = None
        self.is_due = False

    def _read(self) -> "dict[str, Any]":
        if self._values is None:
            values = {}
            for line in self._saves.load(_FILE) or ():
                try:
                    name, value = json.loads(line)
                except (ValueError, TypeError):
                    continue  # damaged: the others are as they were
                if isinstance(name, str):
                    values[name] = value
            self._values = values
        return self._values

    def __getitem__(self, name: str) -> "Any":
        return self._read()[name]

    def __contains__(self, name: str) -> bool:
        return name in self._read()

    def get(self, name: str, default: "Any" = None) -> "Any":
        """The value, or another where there is none."""
        return self._read().get(name, default)

    def __setitem__(self, name: str, value: "Any") -> None:
        """TypeError where it is neither a number nor a text, or its name is no text; ValueError
        for a number without end. True and False are kept as 1 and 0."""
        if isinstance(value, bool):
            value = int(value)  # no int to MicroPython
        if not isinstance(name, str):
            raise TypeError("keep: %r is no text" % (name,))
        if isinstance(value, float) and value - value != 0:  # inf, nan: nobody could read them
            raise ValueError("keep: %s is not finite" % name)
        if not isinstance(value, (int, float, str)):
            raise TypeError("keep: %s is neither a number nor a text" % name)
        values = self._read()
        if name not in values or values[name] != value:
            values[name] = value
            self.is_due = True

    def __delitem__(self, name: str) -> None:
        del self._read()[name]
        self.is_due = True

    def write(self) -> None:
        """Have them written; at rest only."""
        self.is_due = False
        lines = [json.dumps([name, value]) for name, value in self._read().items()]
        self._saves.save(_FILE, lines)
