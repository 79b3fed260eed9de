"""Buttons of `ugrbl sim`: a person pushes inputs by typing their names where it runs."""

import signal
import sys
import threading
from collections import deque
from typing import TYPE_CHECKING

from rich.console import Console

if TYPE_CHECKING:
    from ..run.inputs import Inputs

_WORDS = {"on": True, "off": False}


class Buttons:
    """Lines of stdin as pushes: `probe` closes it, or opens it again; `probe on`, `probe off`."""

    def __init__(self, inputs: "Inputs", console: Console) -> None:
        self._inputs = inputs
        self._console = console
        self._lines: deque[str] = deque()

    def listen(self) -> None:
        """From now on, in a thread; the end of stdin ends it and nothing else."""
        if hasattr(signal, "SIGTTIN"):
            signal.signal(signal.SIGTTIN, signal.SIG_IGN)  # in the background: nobody types
        self.say(f"Inputs: {', '.join(self._inputs.names)}. Type a name to push it or release it.")
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        try:
            for line in sys.stdin:
                self._lines.append(line)
        except (OSError, ValueError):
            return  # as with the end of stdin: a terminal that is gone, or another's

    def poll(self) -> None:
        """Do what has been typed."""
        while self._lines:
            self.enter(self._lines.popleft())

    def enter(self, line: str) -> None:
        """One line."""
        name, _, word = line.strip().partition(" ")
        known = self._inputs.names
        if not name:
            closed = [name for name in known if self._inputs.is_closed(name)]
            self.say(f"closed: {', '.join(closed) or 'none'}")
        elif name not in known:
            self.say(f"there is no input {name}; there are {', '.join(known)}")
        elif word and word not in _WORDS:
            self.say(f"{name} on or {name} off, not {word}")
        else:
            closes = _WORDS.get(word, not self._inputs.is_closed(name))
            self._inputs.push(name, closes)
            self.say(f"{name} is {'closed' if self._inputs.is_closed(name) else 'open'}")

    def say(self, text: str) -> None:
        """To the person."""
        self._console.print(text, highlight=False, soft_wrap=True, markup=False)
