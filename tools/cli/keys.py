"""Keys of the terminal, read one by one, and their real-time commands for Grbl."""

import os
import re
import select
import sys
from types import TracebackType
from typing import Any

# Grbl 1.1's real-time commands by key. Space is the largest key there is.
COMMANDS = {
    " ": b"!",
    "!": b"!",
    "~": b"~",
    "\n": b"~",
    "\r": b"~",
    "0": b"\x90",
    "+": b"\x91",
    "-": b"\x92",
    ">": b"\x93",
    "<": b"\x94",
    "3": b"\x95",
    "2": b"\x96",
    "1": b"\x97",
    "=": b"\x99",
    "*": b"\x9a",
    "/": b"\x9b",
}
HELP = (
    "keys: space holds, ~ or Enter resumes, + - > < 0 feed, 1 2 3 rapids 25 50 100 %, "
    "* / = spindle, Ctrl-C holds and asks"
)
# On a Windows console, arrow and function keys arrive as one of these and the character of another
# key.
_FIRST_OF_TWO = ("\0", "\xe0")
# The sequences of arrow and function keys contain characters of other keys.
_SEQUENCE = re.compile(r"\x1b(?:[\[O][0-9;]*[A-Za-z~])?")


class Keys:
    """The keyboard, as a context. Without `listen`, or without a terminal, no key is ever
    pressed."""

    def __init__(self, listen: bool = True) -> None:
        self._listen = listen and sys.stdin.isatty()
        self._saved: Any = None  # mode of the terminal before; None: not changed

    def __enter__(self) -> "Keys":
        if sys.platform != "win32" and self._listen:
            import termios
            import tty

            self._saved = termios.tcgetattr(sys.stdin)
            tty.setcbreak(sys.stdin)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if sys.platform != "win32" and self._saved is not None and sys.stdin.isatty():
            import termios

            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._saved)
        self._saved = None

    def commands(self) -> bytes:
        """Return the keys pressed since the last call, as real-time commands."""
        return commands(self._read())

    def _read(self) -> str:
        """Return the keys pressed since the last call; "" if none, or without a terminal."""
        if sys.platform == "win32":
            import msvcrt

            return _read_console(msvcrt) if self._listen else ""
        if self._saved is None or not select.select([sys.stdin], [], [], 0)[0]:
            return ""
        return os.read(sys.stdin.fileno(), 64).decode("latin-1")


def _read_console(msvcrt: Any) -> str:
    """Return the keys pressed in a Windows console since the last call, without arrow and function
    keys, which take two reads."""
    keys = ""
    while msvcrt.kbhit():
        key = msvcrt.getwch()
        if key in _FIRST_OF_TWO:  # an arrow or function key
            msvcrt.getwch()
        else:
            keys += key
    return keys


def commands(keys: str) -> bytes:
    """Return the real-time commands of keys; arrow and function keys have none."""
    return b"".join(COMMANDS.get(key, b"") for key in _SEQUENCE.sub("", keys))
