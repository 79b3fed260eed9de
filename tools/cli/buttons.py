"""Buttons of `ugrbl sim`: a user pushes inputs by typing their names in its terminal."""

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
    """Interprets lines of stdin: `probe` closes the input, or opens it again; `probe on`, `probe
    off`."""

    def __init__(self, inputs: "Inputs", console: Console) -> None:
        self._inputs = inputs
        self._console = console
        self._lines: deque[str] = deque()

    def listen(self) -> None:
        """Read stdin in a thread from now on. The end of stdin ends only the thread."""
        if hasattr(signal, "SIGTTIN"):
            signal.signal(signal.SIGTTIN, signal.SIG_IGN)  # in the background there is no input
        self.say(f"Inputs: {', '.join(self._inputs.names)}. Type a name to push it or release it.")
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        """Store the lines of stdin until it ends. Runs in the thread; poll() processes them."""
        try:
            for line in sys.stdin:
                self._lines.append(line)
        except (OSError, ValueError):
            # treated as the end of stdin: the terminal is closed, or belongs to another process
            return

    def poll(self) -> None:
        """Process all lines typed so far."""
        while self._lines:
            self.enter(self._lines.popleft())

    def enter(self, line: str) -> None:
        """Process one line: NAME, NAME on, NAME off; an empty one lists the closed inputs."""
        name, _, word = line.strip().partition(" ")
        known = self._inputs.names
        if not name:
            closed = [name for name in known if self._inputs.is_closed(name)]
            self.say(f"closed: {', '.join(closed) or 'none'}")
        elif name not in known:
            self.say(f"there is no input {name}; there are {', '.join(known)}")
        elif word and word not in _WORDS:
            self.say(f"write {name} on or {name} off, not {word}")
        else:
            toggled = not self._inputs.is_closed(name)
            self._inputs.push(name, _WORDS.get(word, toggled))
            self.say(f"{name} is {'closed' if self._inputs.is_closed(name) else 'open'}")

    def say(self, text: str) -> None:
        """Show a text to the user."""
        self._console.print(text, highlight=False, soft_wrap=True, markup=False)
