"""Words of a machine's own Python (custom.py), as $I lists them, and lines that run its handlers.

A simulator without that Python does not know these words, nor where the handlers move the tool.
"""

import re
from collections.abc import Iterable

from .gcode_file import without_comments

_TOLD = re.compile(r"\[(?:MSG:)?Custom: (.*)\]")  # without MSG: in the dialect 0.9
# The firmware cuts its list; names after that length are not known.
_LONGEST = 120 - len("Custom: ")
_WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")
# Events whose handlers may move, and the words that trigger them.
_EVENTS = {
    "on.tool_select": r"T",
    "on.tool_change": r"M6",
    "on.probe_done": r"G38(\.\d)?",
    "on.spindle": r"M[2345]|M30|S",
    "on.coolant": r"M[2789]|M30",
    "on.program_paused": r"M0",
    "on.program_done": r"M2|M30",
    "on.after_homing": r"\$H.*",
    "on.after_unlock": r"\$X",
}


class CustomCodes:
    """The list of a machine's own handlers. text: as in $I, names separated by commas."""

    def __init__(self, text: str = "") -> None:
        self.text = text
        self.is_cut = len(text) >= _LONGEST
        self._names = text.split(", ")[: -1 if self.is_cut else None]  # the last one may be cut

    @classmethod
    def read(cls, lines: Iterable[str]) -> "CustomCodes":
        """Find the list in the replies to $I; empty if there is none."""
        found = (match[1] for line in lines if (match := _TOLD.fullmatch(line)))
        return cls(next(found, ""))

    def word_in(self, line: bytes) -> str:
        """Return the first of the machine's words on a line, M6 if it changes tools; "" if there
        is none. A word may have parts, "M62 P3", all of which must be on the line."""
        on_line = _words(line)
        for name in self._names:
            word = "M6" if name == "on.tool_change" else name
            if word[:1] in "MG" and all(part in on_line for part in word.split()):
                return word
        return ""

    def handler_of(self, line: bytes) -> str:
        """Return the handler that a line runs and that may move: a word or an event; "" if none is
        known."""
        if word := self.word_in(line):
            return word
        # What the patterns of events describe: a word, its letter, or the whole line ($H).
        texts = [*_words(line), *(word[0] for word in _words(line)), _code(line)]
        for name, pattern in _EVENTS.items():
            if name in self._names or self.is_cut:  # an incomplete list may lack the event
                if any(re.fullmatch(pattern, text) for text in texts):
                    return name
        return ""


def _code(line: bytes) -> str:
    """Return a line's G-code in capitals, without comments and spaces."""
    return without_comments(line).decode("latin-1").upper().replace(" ", "").strip()


def _words(line: bytes) -> list[str]:
    """Return the words in the firmware's form: `M06` is M6."""
    return [f"{letter}{float(number):g}" for letter, number in _WORD.findall(_code(line))]
