"""Streams a program to any Grbl on a serial port, by character counting or line by line."""

import re
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Protocol

import serial

from .gcode_file import CYCLE_START, FEED_HOLD, RESET, STATUS, is_answer
from .messages import meaning

BAUD = 115200
WINDOW = 127  # bytes in Grbl's receive buffer, less one
_POLL_S = 0.2
_READ_S = 0.02
# An Arduino that resets when its port is opened says nothing for a second or two.
_START_S = 5.0
_HOLD_S = 5.0
_AT_REST = ("Hold:0", "Door:0", "Idle", "Check", "Alarm")
_OPTIONS = re.compile(r"\[OPT:[^,]*,\d+,(\d+)\]")
_BUFFER = re.compile(r"\|Bf:\d+,(\d+)")


class SendError(Exception):
    """The program cannot be sent, or not to its end."""


class Connection:
    """Lines from and bytes to a Grbl."""

    def __init__(self, port: str, baud: int = BAUD) -> None:
        try:
            self._serial = serial.Serial(port, baud, timeout=_READ_S, exclusive=True)
        except serial.SerialException as error:
            raise SendError(f"cannot open {port}: {error}") from error
        self._text = ""
        self.window = WINDOW
        self.status = ""

    def close(self) -> None:
        """Give the port back."""
        self._serial.close()

    def write(self, data: bytes) -> None:
        """Send bytes."""
        self._serial.write(data)

    def lines(self) -> list[str]:
        """The lines that have come; waits a moment for the first."""
        try:
            data = self._serial.read(max(1, self._serial.in_waiting))
        except serial.SerialException as error:
            raise SendError(f"the connection broke: {error}") from error
        self._text += data.decode("latin-1")
        *lines, self._text = self._text.split("\r\n")
        for line in lines:
            if line.startswith("<"):
                self._note_status(line)
        return lines

    def state(self) -> str:
        """The machine's state as last reported: `Idle`, `Hold:0` …"""
        return re.split("[|>]", self.status[1:])[0]

    def wait_for(self, done: Callable[[str], bool], seconds: float) -> bool:
        """Ask for the status until one of the lines that come is what is waited for."""
        until = time.monotonic() + seconds
        asked = 0.0
        while time.monotonic() < until:
            if time.monotonic() - asked >= _POLL_S:
                self.write(STATUS)
                asked = time.monotonic()
            heard = [
                done(line) for line in self.lines()
            ]  # every line, for done() may collect them
            if any(heard):
                return True
        return False

    def start(self) -> None:
        """Wait until Grbl listens, and ask how much it can take."""
        if not self.wait_for(lambda line: line.startswith("<"), _START_S):
            raise SendError("no Grbl answers on this port")
        if self.state() == "Alarm":
            raise SendError("the machine is locked in Alarm: home it ($H) or unlock it ($X) first")
        self.ask("$I")

    def ask(self, line: str) -> list[str]:
        """Send a line and return what it is answered with, the answer last."""
        self.write(line.encode("latin-1") + b"\n")
        replies: list[str] = []

        def answered(reply: str) -> bool:
            options = _OPTIONS.fullmatch(reply)
            if options:
                self._widen(int(options[1]))
            if not reply.startswith("<"):
                replies.append(reply)
            return is_answer(reply)

        if not self.wait_for(answered, _START_S):
            raise SendError(f"no answer to {line}")
        return replies

    def _note_status(self, line: str) -> None:
        self.status = line
        free = _BUFFER.search(line)
        if free:
            self._widen(int(free[1]))

    def _widen(self, buffer: int) -> None:
        self.window = max(self.window, buffer - 1)


@dataclass
class Report:
    """How it went. Lines count from 1."""

    answered: int = 0
    errors: list[tuple[int, str]] = field(default_factory=list)
    stopped: str = ""  # why it did not come to its end, if it did not
    state: str = ""  # of the machine, at last

    def ok(self) -> bool:
        """All is done, and nothing was refused."""
        return not self.errors and not self.stopped


class View(Protocol):
    """Who shows the progress and answers the one question."""

    def progress(self, answered: int, status: str) -> None:
        """So many lines are done, and this is the last status report."""

    def message(self, text: str) -> None:
        """Something worth reading."""

    def resume(self) -> bool:
        """The user has stopped the machine: go on, or give up?"""


class Stream:
    """One program on its way through a connection. by_line: one line at a time."""

    def __init__(
        self, connection: Connection, lines: Sequence[bytes], view: View, by_line: bool = False
    ) -> None:
        self.report = Report()
        self._connection = connection
        self._lines = lines
        self._view = view
        self._by_line = by_line
        self._sent = 0
        self._unanswered: deque[int] = deque()  # their lengths
        self._polled = 0.0
        self._interrupted = False

    def interrupt(self) -> None:
        """Hold the machine as soon as may be. May be called from a signal handler."""
        self._interrupted = True

    def run(self) -> Report:
        """Send everything and wait until the machine is at rest."""
        self._connection.status = ""
        while not self.report.stopped and not self._finished():
            self._fill()
            self._poll()
            for line in self._connection.lines():
                self._handle(line)
            if self._interrupted:
                self._hold()
        self.report.state = self._connection.state()
        return self.report

    def _finished(self) -> bool:
        """Everything is answered, and a status report that came after that says so, too."""
        done = self._sent == len(self._lines) and not self._unanswered
        return done and self._connection.state() in ("Idle", "Check")

    def _fill(self) -> None:
        while self._sent < len(self._lines):
            line = self._lines[self._sent] + b"\n"
            if self._unanswered and not self._fits(len(line)):
                return
            self._connection.write(line)
            self._unanswered.append(len(line))
            self._sent += 1

    def _fits(self, length: int) -> bool:
        return not self._by_line and sum(self._unanswered) + length <= self._connection.window

    def _poll(self) -> None:
        if time.monotonic() - self._polled >= _POLL_S:
            self._polled = time.monotonic()
            self._connection.write(STATUS)

    def _handle(self, line: str) -> None:
        report = self.report
        if is_answer(line) and self._unanswered:
            self._unanswered.popleft()
            self._connection.status = ""  # it may be older than the answer
            report.answered += 1
            if line != "ok":
                self._refused(line)
        elif line.startswith("ALARM:"):
            report.stopped = f"{line}: {meaning(line)}"
        elif line.startswith("Grbl "):
            report.stopped = "the controller was reset"
        elif line.startswith("<"):
            self._view.progress(report.answered, line)
        elif line:
            self._view.message(line)

    def _refused(self, answer: str) -> None:
        number = self.report.answered
        self.report.errors.append((number, answer))
        text = self._lines[number - 1].decode("latin-1").strip()
        self._view.message(f"line {number}: {text}: {answer}: {meaning(answer)}")

    def _hold(self) -> None:
        """Come to rest before anything else: Grbl ignores a cycle start and loses steps at a reset
        as long as the machine moves.
        """
        self._interrupted = False
        self._connection.write(FEED_HOLD)
        self._connection.wait_for(self._is_at_rest, _HOLD_S)
        if self._view.resume():
            self._connection.write(CYCLE_START)
        else:
            self._connection.write(RESET)
            self.report.stopped = "given up by the user"

    def _is_at_rest(self, line: str) -> bool:
        self._handle(line)
        return line.startswith("<") and self._connection.state() in _AT_REST


@contextmanager
def ctrl_c(action: Callable[[], None]) -> Iterator[None]:
    """Within this, Ctrl-C does that instead of raising."""
    before = signal.signal(signal.SIGINT, lambda number, frame: action())
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
