"""Meanings of Grbl's numbers, in words: `error:20`, `ALARM:1`.

The words are the comments in firmware/base/errors.py, and in extras that have alarms.
"""

import re
from functools import cache

from ..paths import FIRMWARE
from .gcode_file import without_comments

# A constant and the comment above it: comment, ALARM_ or "", number.
_CONSTANT = re.compile(r"((?:^#.*\n)+)^(ALARM_)?[A-Z_]\w* = const\((\d+)\)", re.MULTILINE)
_REPLY = re.compile(r"(error|ALARM):(\d+)")
# Grbl reads a number up to its comma, and reports the rest in one of these ways.
_AFTER_DECIMAL_COMMA = ("error:1", "error:2", "error:3")
_DECIMAL_COMMA = re.compile(rb",\d")
_SETTING = re.compile(r"\s*(\$\d+)\s*=")
# In answer to a line that is not a command, it comes only from a handler of the user's Python.
_INVALID_COMMAND = "error:3"
_REFUSED = " was refused with "
_HANDLER_REFUSES = "the machine's own Python (custom.py) refuses it; its message before says why"


@cache
def _table() -> dict[tuple[str, int], str]:
    """Return the meanings by kind (`error` or `ALARM`) and number: the comments above the
    constants in base/errors.py, and above the alarms of extras."""
    errors = (FIRMWARE / "base" / "errors.py").read_text(encoding="utf-8")
    found = {
        ("ALARM" if alarm else "error", int(number)): _words(comment)
        for comment, alarm, number in _CONSTANT.findall(errors)
    }
    for file in sorted((FIRMWARE / "extras").rglob("*.py")):
        for comment, alarm, number in _CONSTANT.findall(file.read_text(encoding="utf-8")):
            if alarm:
                found["ALARM", int(number)] = _words(comment)
    return found


def _words(comment: str) -> str:
    """Return the text of some lines of comment as one line."""
    return " ".join(line.lstrip("# ") for line in comment.splitlines())


def errors() -> dict[int, str]:
    """Return every error number with its meaning."""
    return {number: words for (kind, number), words in _table().items() if kind == "error"}


def alarms() -> dict[int, str]:
    """Return every alarm number with its meaning."""
    return {number: words for (kind, number), words in _table().items() if kind == "ALARM"}


def refusal(line: str, reply: str) -> str:
    """Return a text that a line was refused; see refused()."""
    return f"{line}{_REFUSED}{reply}"


def refused(words: str) -> str:
    """Return the meaning of the reply in a text of refusal(); "" for another text."""
    line, found, reply = words.partition(_REFUSED)
    return meaning(reply, line) if found else ""


def meaning(reply: str, line: str = "") -> str:
    """Return the meaning of a reply such as `error:20` or `ALARM:1`. line: the line it answers, if
    known."""
    if reply in _AFTER_DECIMAL_COMMA and _DECIMAL_COMMA.search(without_comments(line.encode())):
        return "A number is written with a decimal point, not a comma."
    if reply == _INVALID_COMMAND and (setting := _SETTING.match(line)):
        return (
            f"This machine has no setting {setting[1]}, or there is more than a number after "
            "the =."
        )
    is_command = line.strip()[:1] in ("", "$")  # or the line is not known
    if reply == _INVALID_COMMAND and not is_command:
        return _HANDLER_REFUSES
    if ": " in reply:
        return reply.partition(": ")[2]  # Grbl 0.9 sends the meaning itself
    match = _REPLY.fullmatch(reply)
    key = (match[1], int(match[2])) if match else ("", 0)
    return _table().get(key, "not a number of Grbl 1.1")
