"""The terminal of `ugrbl console`: a line with the state, input lines with a history, keys that
jog."""

import asyncio
import textwrap
from contextlib import suppress
from pathlib import Path

from prompt_toolkit import PromptSession
from prompt_toolkit.filters import Condition
from prompt_toolkit.history import FileHistory
from prompt_toolkit.key_binding import KeyBindings, KeyPressEvent
from prompt_toolkit.patch_stdout import patch_stdout

from .keys import COMMANDS
from .session import JOGS, Session

_HISTORY = ".ugrbl_history"
_POLL_S = 0.01
_GAP = "   "  # separates parts of a text
_UNBREAKABLE = "\0"  # stands for a blank at which no line is broken
_LINE_HELP = "Tab: jog with keys   Ctrl-X: reset   Ctrl-D: leave"
_KEY_HELP = (
    "Tab: type lines   arrows, PgUp, PgDn jog   [ ] step   , . speed   x y z set zero   h home"
    "   u unlock   space holds   ~ resumes   + - 0 feed   1 2 3 rapids   * / = spindle"
    "   Ctrl-X: reset"
)
_OTHER_KEYS = "[],.huxyz" + "".join(key for key in COMMANDS if key.isprintable() and key != " ")


class _History(FileHistory):
    """A history that ignores a full disk, or a folder that is not writable."""

    def store_string(self, string: str) -> None:
        with suppress(OSError):
            super().store_string(string)


class Terminal:
    """Reads lines with a history, or keys that move the machine; Tab switches between them."""

    def __init__(self, machine_session: Session) -> None:
        self._machine_session = machine_session
        self._in_key_mode = False
        self._prompt_session: PromptSession[str] = PromptSession(
            history=_History(str(Path.home() / _HISTORY)),
            bottom_toolbar=self._toolbar,
            key_bindings=self._bindings(),
            refresh_interval=0.2,
        )

    async def run(self) -> None:
        """Run until the user leaves, or the machine cannot be reached."""
        polling = asyncio.create_task(self._poll())
        reading = asyncio.create_task(self._read_lines())
        done, _ = await asyncio.wait((polling, reading), return_when=asyncio.FIRST_COMPLETED)
        for task in (polling, reading):
            task.cancel()
        await asyncio.gather(polling, reading, return_exceptions=True)
        for task in done:
            task.result()  # raises the exception with which it ended, if any

    async def _poll(self) -> None:
        """Poll the machine until this is cancelled, or the connection fails."""
        while True:
            self._machine_session.poll()
            await asyncio.sleep(_POLL_S)

    async def _read_lines(self) -> None:
        """Read lines from the user and enter them, until the end of input (Ctrl-D)."""
        while True:
            try:
                with patch_stdout():
                    self._machine_session.enter(
                        await self._prompt_session.prompt_async(self._prompt)
                    )
            except KeyboardInterrupt:  # Ctrl-C clears the line
                continue
            except EOFError:
                return

    def _prompt(self) -> str:
        return f"jog, {self._machine_session.jog_line()} " if self._in_key_mode else "> "

    def _toolbar(self) -> str:
        columns = self._prompt_session.output.get_size().columns
        shown = self._machine_session.status(), _KEY_HELP if self._in_key_mode else _LINE_HELP
        return "\n".join(line for text in shown for line in wrapped(text, columns))

    def _bindings(self) -> KeyBindings:
        """Return the keys: Tab and Ctrl-X always, those that move the machine only in key mode."""
        bindings = KeyBindings()
        in_key_mode = Condition(lambda: self._in_key_mode)

        @bindings.add("tab")
        def _switch(event: KeyPressEvent) -> None:
            self._in_key_mode = not self._in_key_mode
            self._machine_session.leave()

        @bindings.add("c-x", eager=True)
        def _reset(event: KeyPressEvent) -> None:
            self._machine_session.reset()

        def press(event: KeyPressEvent) -> None:
            for pressed in event.key_sequence:
                self._machine_session.press(_name(pressed.key))

        for key in (*JOGS, *_OTHER_KEYS, "space", "enter"):
            bindings.add(key, filter=in_key_mode, eager=True)(press)
        bindings.add("<any>", filter=in_key_mode)(lambda event: None)  # others do nothing
        return bindings


def wrapped(text: str, columns: int) -> list[str]:
    """Wrap text to a terminal's width. Words that no gap separates stay together, if they fit."""
    joined = text.replace(" ", _UNBREAKABLE).replace(_UNBREAKABLE * len(_GAP), _GAP)
    lines = textwrap.wrap(joined, columns, break_on_hyphens=False)
    return [line.replace(_UNBREAKABLE, " ") for line in lines]


def _name(key: str) -> str:
    """Return a key's name for Session.press()."""
    text = str(getattr(key, "value", key))
    return {"c-m": "\r", "c-j": "\n"}.get(text, text)
