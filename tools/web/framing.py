"""Split the controlling browser's bytes into whole lines and realtime bytes for the board.

If a browser left half a line, it would become part of the next browser's first line, and the
machine would move where no one had sent it. So a line waits for its end, and realtime bytes
overtake it, as in Grbl itself.
"""

import re
from collections.abc import Iterator

from ..grbl.gcode_file import RESET
from ..grbl.wire_bytes import permitted

# Grbl refuses much shorter lines, so a line cut at this length is refused as the whole line is.
_LONGEST = 4096
_PARTS = re.compile(rb"[?~!\x18\x80-\xff]|[\r\n]|[^?~!\x18\x80-\xff\r\n]+")


class Framing:
    """Store an incomplete line until its end arrives."""

    def __init__(self) -> None:
        self._incomplete_line = bytearray()

    def take(self, data: bytes) -> Iterator[tuple[bytes, bool]]:
        """Yield (part, is_realtime) for each complete line, with its end, and each realtime byte.

        Bytes that are not part of Grbl's protocol are dropped.
        """
        for part in _PARTS.findall(permitted(data)):
            if part in b"\r\n":
                line = bytes(self._incomplete_line + part)
                self._incomplete_line.clear()
                yield line, False
            elif len(part) == 1 and _is_realtime(part):
                if part == RESET:
                    self.forget()  # Grbl drops its incomplete line as well
                yield part, True
            else:
                space = _LONGEST - len(self._incomplete_line)
                self._incomplete_line += part[:space]

    def forget(self) -> None:
        """Drop the incomplete line."""
        self._incomplete_line.clear()


def _is_realtime(part: bytes) -> bool:
    """Return whether Grbl executes this byte at once, instead of reading it as a line."""
    return part in b"?~!\x18" or part >= b"\x80"
