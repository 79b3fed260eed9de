"""Persistent values: m.keep of custom.py, small values kept over power-off.

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


class PersistentValues:
    """The values, by name."""

    def __init__(self, saves: "Saves") -> None:
        self._saves = saves
        self._values: "dict[str, Any]" = {}
        self.is_due = False
        for line in saves.load(_FILE) or ():
            try:
                name, value = json.loads(line)
            except (ValueError, TypeError):
                continue  # damaged: the others are as they were
            if isinstance(name, str):
                self._values[name] = value

    def __getitem__(self, name: str) -> "Any":
        return self._values[name]

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def get(self, name: str, default: "Any" = None) -> "Any":
        """The value, or another where there is none."""
        return self._values.get(name, default)

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
        if name not in self._values or self._values[name] != value:
            self._values[name] = value
            self.is_due = True

    def __delitem__(self, name: str) -> None:
        del self._values[name]
        self.is_due = True

    def write(self) -> None:
        """Have them written; at rest only."""
        self.is_due = False
        lines = [json.dumps([name, value]) for name, value in self._values.items()]
        self._saves.save(_FILE, lines)
