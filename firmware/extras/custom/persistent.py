"""Persistent values: m.keep of custom.py, small values stored over power-off.

m.keep["z1"] = 3.5 stores a number or a text under a name. It takes effect at once. It is written
when the machine is idle and no line waits. A power cut leaves the old values or the new ones.
"""

import json

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import Any

    from control.saves import Saves

_FILE = "keep"  # of the values in flash, one JSON line [name, value] for each


class PersistentValues:
    """The stored values, by name. is_due: a value has changed and is not stored yet."""

    def __init__(self, saves: "Saves") -> None:
        self._saves = saves
        self._values: "dict[str, Any]" = {}
        self.is_due = False
        for line in saves.load(_FILE) or ():
            try:
                name, value = json.loads(line)
            except (ValueError, TypeError):
                continue  # a damaged line: the other values stay valid
            if isinstance(name, str):
                self._values[name] = value

    def __getitem__(self, name: str) -> "Any":
        """Return the value. KeyError if there is none."""
        return self._values[name]

    def __contains__(self, name: str) -> bool:
        """Return whether there is a value of that name."""
        return name in self._values

    def get(self, name: str, default: "Any" = None) -> "Any":
        """Return the value, or `default` if there is none."""
        return self._values.get(name, default)

    def __setitem__(self, name: str, value: "Any") -> None:
        """Store a finite number or a text. True and False are stored as 1 and 0.

        TypeError for another type, or a name that is not text. ValueError for inf and nan.
        """
        if isinstance(value, bool):
            value = int(value)  # in MicroPython a bool is no int
        if not isinstance(name, str):
            raise TypeError("m.keep: the name %r must be a text" % (name,))
        if isinstance(value, float) and value - value != 0:  # inf, nan: not valid in JSON
            raise ValueError("m.keep: %s is not finite" % name)
        if not isinstance(value, (int, float, str)):
            raise TypeError("m.keep: %s is neither a number nor a text" % name)
        if name not in self._values or self._values[name] != value:
            self._values[name] = value
            self.is_due = True

    def __delitem__(self, name: str) -> None:
        """Remove a value. KeyError if there is none."""
        del self._values[name]
        self.is_due = True

    def write(self) -> None:
        """Hand the values to the store. Call it only while idle."""
        self.is_due = False
        lines = [json.dumps([name, value]) for name, value in self._values.items()]
        self._saves.save(_FILE, lines)
