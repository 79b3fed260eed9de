"""Keys of the terminal, one by one as they are pressed, and what they tell a Grbl."""

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
    "keys: space holds, ~ or Enter goes on, + - > < 0 feed, 1 2 3 rapids 25 50 100 %, "
    "* / = spindle, Ctrl-C holds and asks"
)
# Of a Windows console arrow and function keys come as one of these and the sign of another key.
_TWO_READS = ("\0", "\xe0")
# What arrow and function keys send holds signs of other keys.
_SEQUENCE = re.compile(r"\x1b(?:[\[O][0-9;]*[A-Za-z~])?")


class Keys:
    """The keyboard, as a context. Not listened to, or no terminal: nothing is ever pressed."""

    def __init__(self, listen: bool = True) -> None:
        self._listen = listen and sys.stdin.isatty()
        self._saved: Any = None

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
        """What has been pressed since, as real-time commands."""
        return commands(self._read())

    def _read(self) -> str:
        if sys.platform == "win32":
            import msvcrt

            return _read_console(msvcrt) if self._listen else ""
        if self._saved is None or not select.select([sys.stdin], [], [], 0)[0]:
            return ""
        return os.read(sys.stdin.fileno(), 64).decode("latin-1")


def _read_console(msvcrt: Any) -> str:
    """The keys pressed in a Windows console since, without those that take two reads."""
    keys = ""
    while msvcrt.kbhit():
        key = msvcrt.getwch()
        if key in _TWO_READS:
            msvcrt.getwch()
        else:
            keys += key
    return keys


def commands(keys: str) -> bytes:
    """The real-time commands of keys; those of arrows and functions do nothing."""
    return b"".join(COMMANDS.get(key, b"") for key in _SEQUENCE.sub("", keys))
