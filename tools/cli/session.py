"""A user at a Grbl: lines and keys go in, the machine's output comes out with explanations.

This module has no terminal; terminal.py has it. poll() is called often, and does all the work. A
jog by key continues while the key repeats, in pieces so short that the machine stops by itself if
the connection is lost.
"""

import re
import time
from collections import deque
from collections.abc import Callable

from ..device.connection import POLL_S, Connection, is_deaf, way_out
from ..grbl.gcode_file import (
    CYCLE_START,
    FEED_HOLD,
    JOG_CANCEL,
    RESET,
    STATUS,
    is_answer,
    is_welcome,
    problems,
    sanitize,
)
from ..grbl.messages import meaning
from ..grbl.settings_file import meaning as setting_meaning
from .keys import COMMANDS

STEPS_MM = (0.01, 0.1, 1.0, 10.0)
FEEDS_MM_MIN = (50, 100, 200, 500, 1000, 2000, 5000)
# Axis and direction of each key that jogs.
JOGS = {
    "left": "X-",
    "right": "X",
    "down": "Y-",
    "up": "Y",
    "pagedown": "Z-",
    "pageup": "Z",
}
_LINES = {"h": "$H", "u": "$X", "x": "G10 L20 P0 X0", "y": "G10 L20 P0 Y0", "z": "G10 L20 P0 Z0"}
# A key that is held repeats 10 to 30 times a second; fingers are slower.
_REPEAT_S = 0.15  # longest time between two events of a held key
_PIECE_S = 0.1  # motion in a piece of a jog
_AHEAD = 3  # pieces that may be unanswered
_FIRST_OVERRIDE = 0x80  # real-time bytes from here on
_SETTING = re.compile(r"\$(\d+)=(\S+)")
_FEED_AND_RPM = re.compile(r"\|FS?:(\d+)(?:,(\d+))?")
_OVERRIDES = re.compile(r"\|Ov:(\d+,\d+,\d+)")
_PINS = re.compile(r"\|Pn:([A-Z]+)")


class Session:
    """One machine and one user. show: displays a line."""

    def __init__(self, connection: Connection, show: Callable[[str], None]) -> None:
        self._connection = connection
        self._show = show
        # Lines to send, and lines sent; each with True if the user typed it: its ok is shown.
        self._to_send: deque[tuple[bytes, bool]] = deque()
        self._unanswered: deque[tuple[bytes, bool]] = deque()
        self._last_query_s = 0.0  # time of the last ?, as all times by time.monotonic()
        self._overrides = ""  # as reported: feed, rapids, spindle
        self._step_index = 2  # in STEPS_MM
        self._feed_index = 3  # in FEEDS_MM_MIN
        self._jog_key = ""  # the last key that jogs
        self._key_event_s = 0.0  # when the terminal last sent that key
        self._is_key_held = False  # it repeats: the jog continues until it stops repeating
        self._last_piece_s = 0.0  # when the last piece of a jog was queued
        self._explained_state = ""  # the last state, so that each is explained once

    # Input of the user

    def enter(self, line: str) -> None:
        """Send a line. A single ! ~ or ? acts at once."""
        data = line.strip().encode("utf-8")
        if data in (FEED_HOLD, CYCLE_START, STATUS):
            self._connection.write(data)
            if data == STATUS:
                self._show(self._connection.status)  # the last report; the next is in the toolbar
            return
        found = problems([data])
        if found and not found[0].in_comment:
            self._show(f"not sent: {found[0].text}")
            return
        is_typed = True
        self._to_send.append((sanitize(data), is_typed))

    def press(self, key: str) -> None:
        """Process a key: left, right …, or a letter."""
        if key in JOGS:
            self._jog(key)
        elif key in "[]":
            self._step_index = _moved(self._step_index, up=key == "]", choices=STEPS_MM)
        elif key in ",.":
            self._feed_index = _moved(self._feed_index, up=key == ".", choices=FEEDS_MM_MIN)
        elif key in _LINES:  # home, unlock, set zero
            self.enter(_LINES[key])
        elif key in COMMANDS:
            self._real_time(COMMANDS[key])

    def reset(self) -> None:
        """Reset the machine (Ctrl-X)."""
        self._to_send.clear()
        self._unanswered.clear()
        self._is_key_held = False
        self._connection.write(RESET)

    def leave(self) -> None:
        """End a jog, because the user leaves; everything else continues."""
        if self._is_key_held:
            self._stop_jog()

    # Output of the machine

    def poll(self) -> None:
        """Send lines if there is space, read received ones, and continue or end a jog."""
        now = time.monotonic()
        if now - self._last_query_s >= POLL_S:
            self._last_query_s = now
            self._connection.write(STATUS)
        self._send()
        self._keep_jogging(now)
        for line in self._connection.lines():
            self._receive(line)

    def status(self) -> str:
        """Return state, position, speeds, overrides and inputs in one line."""
        report = self._connection.status
        place = " ".join(
            f"{letter}{mm:.3f}"
            for letter, mm in zip("XYZABC", self._connection.work_place(), strict=False)
        )
        parts = [self._connection.state() or "no answer", place]
        if speeds := _FEED_AND_RPM.search(report):
            parts.append(f"F{speeds[1]}" + (f" S{speeds[2]}" if speeds[2] else ""))
        if self._overrides and self._overrides != "100,100,100":
            parts.append(f"overrides {self._overrides}")
        if inputs := _PINS.search(report):
            parts.append(f"inputs {inputs[1]}")
        return "   ".join(part for part in parts if part)

    def jog_line(self) -> str:
        """Return distance and speed of a jog by key."""
        return f"step {STEPS_MM[self._step_index]:g} mm, {FEEDS_MM_MIN[self._feed_index]} mm/min"

    def _send(self) -> None:
        """Send waiting lines, as far as the machine's buffer has space for them."""
        while self._to_send:
            line, is_typed = self._to_send[0]
            in_buffer = sum(len(sent) + 1 for sent, _ in self._unanswered)  # + 1: the line end
            if self._unanswered and in_buffer + len(line) + 1 > self._connection.window:
                return
            self._connection.write(line + b"\n")
            self._to_send.popleft()
            self._unanswered.append((line, is_typed))

    def _receive(self, line: str) -> None:
        """Process a line of the machine: a status report, an answer, or other output.

        Answers to lines that the user has not typed are not shown, unless they are errors.
        """
        is_shown, sent = line != "", b""
        if line.startswith("<"):
            found = _OVERRIDES.search(line)
            self._overrides = found[1] if found else self._overrides
            self._explain_state()
            return
        if is_answer(line) and self._unanswered:
            sent, is_shown = self._unanswered.popleft()
        elif is_welcome(line):
            self._unanswered.clear()  # after a reset they get no answer
        if is_shown or line.startswith("error:"):
            self._show(explained(line, sent.decode("latin-1")))

    def _explain_state(self) -> None:
        """Show the next step for a state in which no lines are read."""
        state = self._connection.state()
        if state != self._explained_state and (is_deaf(state) or state == "Alarm"):
            self._show(f"{state}: {way_out(state)}")
        self._explained_state = state

    def _real_time(self, command: bytes) -> None:
        """Send a real-time command, unless it is an override and the machine has none."""
        if command[0] >= _FIRST_OVERRIDE and not self._connection.takes_overrides:
            self._show("Grbl 0.9 has no overrides")
            return
        self._connection.write(command)

    # Jogging

    def _jog(self, key: str) -> None:
        """Jog by a step when a key is pressed, and continuously while it repeats."""
        if not self._connection.takes_overrides:
            self._show("Grbl 0.9 has no jogging: move it with G-code")
            return
        now = time.monotonic()
        repeats = key == self._jog_key and now - self._key_event_s < _REPEAT_S
        self._key_event_s = now
        if repeats:  # _keep_jogging() does the rest
            self._is_key_held = True
            return
        if self._is_key_held:  # and now it is another key
            self._stop_jog()
        self._jog_key = key
        self._piece(key, STEPS_MM[self._step_index])

    def _keep_jogging(self, now: float) -> None:
        """Send the next piece of a jog while its key repeats, and end it then."""
        if not self._is_key_held:
            return
        if now - self._key_event_s >= _REPEAT_S:
            self._stop_jog()
        elif now - self._last_piece_s >= _PIECE_S and len(self._unanswered) < _AHEAD:
            self._piece(self._jog_key, FEEDS_MM_MIN[self._feed_index] / 60 * _PIECE_S)

    def _piece(self, key: str, mm: float) -> None:
        """Queue a jog by `mm` in the direction of a key, at the chosen feed."""
        self._last_piece_s = time.monotonic()
        axis, sign = JOGS[key][0], JOGS[key][1:]
        line = f"$J=G91 G21 {axis}{sign}{mm:.3f} F{FEEDS_MM_MIN[self._feed_index]}"
        is_typed = False
        self._to_send.append((line.encode("ascii"), is_typed))

    def _stop_jog(self) -> None:
        """Cancel the jog; the machine slows down to a stop."""
        self._connection.write(JOG_CANCEL)
        self._to_send.clear()
        self._is_key_held = False


def explained(line: str, sent: str = "") -> str:
    """Return a line of Grbl's with its meaning: of an error, an alarm or a setting. sent: the line
    that it answers."""
    if line.startswith(("error:", "ALARM:")):
        return f"{line}: {meaning(line, sent)}"
    setting = _SETTING.match(line)
    if not setting:
        return line
    what = setting_meaning(int(setting[1]))
    return f"{setting[0]:16} {what.name}{', ' + what.unit if what.unit else ''}".rstrip()


def _moved(index: int, up: bool, choices: tuple[float, ...]) -> int:
    """Return the index of the next choice up or down; it stays at the ends."""
    return min(index + 1, len(choices) - 1) if up else max(index - 1, 0)
