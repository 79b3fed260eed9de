"""Program files as senders see them: lines of bytes, cut at CRLF, LF or CR."""

import re
from pathlib import Path

# Bytes that Grbl takes off before it looks at lines. Those from 0x80 on are all its own.
STATUS = b"?"
CYCLE_START = b"~"
FEED_HOLD = b"!"
RESET = b"\x18"

# A doubled CR before the LF, as broken conversions leave it, ends one line and not two.
_LINE_END = re.compile(rb"\r*\n|\r")
_REALTIME = re.compile(rb"[?~!\x18\x80-\xff]")


def split_lines(data: bytes) -> list[bytes]:
    """The lines of a program without their ends."""
    lines = _LINE_END.split(data)
    if not lines[-1]:
        lines.pop()
    return lines


def read_lines(path: Path) -> list[bytes]:
    """The lines of a program file; line n of the file is element n - 1."""
    return split_lines(path.read_bytes())


def read_program(path: Path) -> list[bytes]:
    """As read_lines(); ValueError where there is nothing to run, or what is there is no text."""
    lines = read_lines(path)
    if not any(line.strip() for line in lines):
        raise ValueError(f"{path} is empty")
    if any(b"\0" in line for line in lines):
        raise ValueError(f"{path} is no text, and so no G-code")
    return lines


def has_realtime(line: bytes) -> bool:
    """Whether a line holds bytes that act at once, before the lines in front of it are done."""
    return _REALTIME.search(line) is not None


def is_answer(line: str) -> bool:
    """Whether a line from Grbl answers a line sent to it."""
    return line == "ok" or line.startswith("error:")
