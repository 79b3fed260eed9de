"""Bytes of whoever drives, as a board is to get them: whole lines, and what acts at once.

Half a line that a browser has left behind would become a part of the next one's first line, and a
machine would go where nobody has sent it. So a line waits for its end, and real-time commands
overtake it, as they do in Grbl itself.
"""

import re
from collections.abc import Iterator

from ..grbl.gcode_file import RESET
from ..grbl.wire_bytes import permitted

# Grbl refuses lines far shorter than that; what is longer is refused in part as well as in whole.
_LONGEST = 4096
_PARTS = re.compile(rb"[?~!\x18\x80-\xff]|[\r\n]|[^?~!\x18\x80-\xff\r\n]+")


class Framing:
    """What has come of a line stays here until all of it has."""

    def __init__(self) -> None:
        self._line = bytearray()

    def take(self, data: bytes) -> Iterator[tuple[bytes, bool]]:
        """The next bytes; those that are not of Grbl's protocol are dropped. Yields lines with
        their end, and single bytes that act at once; with each whether it is one of these."""
        for part in _PARTS.findall(permitted(data)):
            if part in b"\r\n":
                line = bytes(self._line + part)
                self._line.clear()
                yield line, False
            elif len(part) == 1 and _acts(part):
                if part == RESET:
                    self.forget()  # as Grbl drops what it has of a line
                yield part, True
            else:
                self._line += part[: _LONGEST - len(self._line)]

    def forget(self) -> None:
        """The line that has begun will not be ended."""
        self._line.clear()


def _acts(part: bytes) -> bool:
    return part in b"?~!\x18" or part >= b"\x80"
