"""Stream a program to any Grbl on a serial port, by character counting or line by line.

Whatever ends it early, the machine is first put on hold, because Grbl would continue with the
lines it has received.
"""

import re
import signal
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple, Protocol, overload

from .. import paths
from ..grbl.gcode_file import (
    CYCLE_START,
    FEED_HOLD,
    RESET,
    STATUS,
    comment,
    is_answer,
    is_welcome,
    sanitize,
    shown,
    without_comments,
)
from ..grbl.messages import meaning
from .connection import POLL_S, Connection, SendError, is_deaf, way_out

_HOLD_S = 15.0  # time limit for the machine to stop
_RESET_S = 3.0  # time limit for the welcome, and then for a status report
_SILENCE_S = 10.0  # after so much silence the user is notified
REFUSED = " was refused"  # end of `stopped` if a refused line was the cause
_ENDED = ("Idle", "Check", "Sleep")  # states in which nothing is being executed
_PAUSE = re.compile(rb"M0+(?![\d.])", re.IGNORECASE)


class Line(NamedTuple):
    """A line to send. number: in the program, from 1; 0 for a line that prepares for it."""

    number: int
    data: bytes  # as sent, without line end
    text: str  # for display


class Choice(Enum):
    """What to do with a held machine."""

    RESUME = "r"
    KEEP_GOING = "k"  # and do not ask again
    ABORT = "a"


@dataclass
class Report:
    """The result. Lines count from 1."""

    answered: int = 0  # lines answered, including preparing ones
    line: int = 0  # number in the program of the last line answered
    errors: list[tuple[int, str]] = field(default_factory=list)
    stopped: str = ""  # why it ended early; "" if it did not
    signal: int = 0  # the signal that ended it
    lost: bool = False  # the connection to the machine is lost
    drains: int = 0  # underruns during this program, if the board counts them
    # The machine's last state; position and blocks left are those before a reset.
    state: str = ""
    place: list[float] = field(default_factory=list)
    place_line: int = 0  # the last line answered before that position was reported
    blocks_left: int | None = None

    def ok(self) -> bool:
        """Return whether everything was sent and no line was refused."""
        return not self.errors and not self.stopped


class View(Protocol):
    """Shows the progress and asks the user."""

    def progress(self, answered: int, status: str) -> None:
        """`answered` lines are done; `status` is the last status report."""

    def message(self, words: str) -> None:
        """Show a message."""

    def ask(self, why: str) -> Choice:
        """The machine is held: ask what to do next."""

    def keys(self) -> bytes:
        """Return real-time commands that the user has entered by keys."""


class Ready(Sequence[Line]):
    """Lines of a file from one on, prepared when they are read: comments are made safe to send.
    lead: lines that are sent before them."""

    def __init__(self, lines: Sequence[bytes], first: int = 1, lead: Sequence[Line] = ()) -> None:
        self._lines = lines
        self._first = first
        self._lead = lead

    def __len__(self) -> int:
        return len(self._lead) + len(self._lines) - self._first + 1

    @overload
    def __getitem__(self, index: int) -> Line: ...
    @overload
    def __getitem__(self, index: slice) -> list[Line]: ...
    def __getitem__(self, index: "int | slice") -> "Line | list[Line]":
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        # range() raises IndexError, and counts a negative index from the end.
        offset = range(len(self))[index] - len(self._lead)
        if offset < 0:  # a line of lead: these come first, and -1 is the last of them
            return self._lead[offset]
        number = self._first + offset
        line = self._lines[number - 1]
        return Line(number, sanitize(line), shown(line))


class _Mute:
    """A View without a user."""

    def progress(self, answered: int, status: str) -> None:
        """Ignore it."""

    def message(self, words: str) -> None:
        """Ignore it."""

    def ask(self, why: str) -> Choice:
        """Abort, because nobody can answer."""
        return Choice.ABORT

    def keys(self) -> bytes:
        """Return no keys."""
        return b""


class Stream:
    """Sends one program. by_line: one line at a time. keep_going: also after refused lines.

    In each round it sends what fits, reads, and holds the machine if `_why_hold` says so.
    """

    def __init__(
        self,
        connection: Connection,
        lines: Sequence[Line],
        view: View,
        by_line: bool = False,
        keep_going: bool = False,
    ) -> None:
        self.report = Report()
        self._connection = connection
        self._lines = lines
        self._view = view
        self._by_line = by_line
        self._keep_going = keep_going
        self._sent = 0  # number of lines sent
        self._unanswered: deque[int] = deque()  # lengths of the lines sent and not yet answered
        self._polled_at = 0.0  # time of the last ?
        self._drains_before: int | None = None  # underruns before this program; None: not known
        # Status reports in a row, since the last answer, with a state of _ENDED.
        self._ended_reports = 0
        self._why_hold = ""  # why the machine is to be held; "" if it is not
        self._asking = False  # the user is being asked
        self._notified_state = ""  # the state that the user was last notified of
        self._held_by_key = False

    def interrupt(self, number: int = signal.SIGINT) -> None:
        """Hold the machine at once. May be called from a signal handler.

        Then Ctrl-C asks what to do next; Ctrl-C during that question answers it (_ask). Any other
        signal ends the program, because there may be no user.
        """
        self._connection.write(FEED_HOLD)
        self._why_hold = "Ctrl-C"
        if number != signal.SIGINT:
            self.report.signal = number
            self._why_hold = signal.Signals(number).name
        if self._asking:
            raise KeyboardInterrupt

    def run(self) -> Report:
        """Send everything and wait until the machine is idle. Never raises SendError: the report
        then says why it stopped. Any other exception holds the machine."""
        try:
            self._stream()
        except SendError as error:
            self.report.stopped = str(error)
            self.report.lost = True
        except BaseException:
            self._connection.write(FEED_HOLD)
            raise
        return self.report

    def _stream(self) -> None:
        """Repeat rounds until the program has ended, or something has stopped it."""
        self._connection.status = ""
        self._connection.heard = time.monotonic()  # questions to the user may have taken long
        try:
            while not self.report.stopped and not self._finished():
                self._do_round()
        except OSError as error:  # a full disk, or a closed pipe
            self._connection.write(FEED_HOLD)
            self._view = _Mute()  # shows nothing, and answers with abort
            self._why_hold = f"the progress cannot be shown ({paths.why(error)})"
            self._hold()

    def _do_round(self) -> None:
        """Send as much as fits, process what was received, and hold if that is due."""
        if not self._why_hold:
            self._fill()
        self._poll()
        for line in self._connection.lines():
            self._handle(line)
        self._send_keys(self._view.keys())
        if self._why_hold:
            self._hold()

    def _send_keys(self, keys: bytes) -> None:
        """Send real-time commands of the user, those from 0x80 on only to a Grbl that has them."""
        if not self._connection.takes_overrides:
            keys = bytes(byte for byte in keys if byte < 0x80)
        if keys:
            self._held_by_key |= FEED_HOLD in keys
            self._connection.write(keys)

    def _finished(self) -> bool:
        """Return whether all lines are answered and two later status reports say the machine is
        idle. The first of them may be from before the last motion began."""
        return self._all_answered() and self._ended_reports >= 2

    def _all_answered(self) -> bool:
        return self._sent == len(self._lines) and not self._unanswered

    def _fill(self) -> None:
        """Send lines as long as they fit into Grbl's buffer, or one by one (by_line)."""
        while self._sent < len(self._lines):
            line = self._lines[self._sent].data + b"\n"
            # Lines that prepare for a program are sent one by one, so that none follows a refused
            # one.
            is_after_lead = self._sent > 0 and self._lines[self._sent - 1].number == 0
            if self._unanswered and (is_after_lead or not self._fits(len(line))):
                return
            self._connection.write(line)
            self._unanswered.append(len(line))
            self._sent += 1

    def _fits(self, length: int) -> bool:
        return not self._by_line and sum(self._unanswered) + length <= self._connection.window

    def _poll(self) -> None:
        """Request the status from time to time, and report a silent machine to the user."""
        now = time.monotonic()
        if now - self._polled_at >= POLL_S:
            self._polled_at = now
            self._connection.write(STATUS)
        if now - self._connection.heard >= _SILENCE_S:
            self._connection.heard = now  # the next message comes after as long again
            self._view.message(f"the machine has sent nothing for {_SILENCE_S:g} s")

    def _handle(self, line: str) -> None:
        """Process a line from the machine: an answer, an alarm, a reset, a status or a message."""
        report = self.report
        if is_answer(line) and self._unanswered:
            self._answered(line)
        elif line.startswith("ALARM:"):
            report.stopped = f"{line}: {meaning(line)}"
            report.state = "Alarm"
        elif is_welcome(line):
            report.stopped = "the controller was reset"
        elif line.startswith("<"):
            state = self._connection.state()
            self._ended_reports = self._ended_reports + 1 if state in _ENDED else 0
            self._note_report()
            self._view.progress(report.answered, line)
            self._explain_state(state)
        elif line:
            self._view.message(line)

    def _answered(self, answer: str) -> None:
        """Count the answer to the oldest line. After a refusal hold, unless keep_going."""
        self._unanswered.popleft()
        self._connection.status = ""  # it may be older than the answer
        self._ended_reports = 0
        line = self._lines[self.report.answered]
        self.report.answered += 1
        self.report.line = line.number
        if answer == "ok":
            return
        self.report.errors.append((line.number, answer))
        # Number 0: a line that prepares for the program.
        name = f"line {line.number}" if line.number else "on the way there"
        self._view.message(f"{name}: {line.text}: {answer}: {meaning(answer, line.text)}")
        if not self._keep_going and not self._why_hold:
            self._connection.write(FEED_HOLD)
            self._why_hold = f"{name}{REFUSED}"

    def _note_report(self) -> None:
        """Store what the last status report says: state, position, blocks left, underruns."""
        if self._drains_before is None:
            self._drains_before = self._connection.drains()
        self.report.drains = self._connection.drains() - self._drains_before
        self.report.state = self._connection.state() or self.report.state
        if place := self._connection.place():
            self.report.place = place
            self.report.place_line = self.report.line
            self.report.blocks_left = self._connection.blocks_left()

    def _explain_state(self, state: str) -> None:
        """Notify the user once why nothing moves, if it is not this program that holds."""
        if state == "Sleep" and not self._all_answered():
            self.report.stopped = f"the machine has gone to sleep: {way_out(state)}"
        if not is_deaf(state) or self._why_hold:
            self._notified_state = ""
            self._held_by_key = False
        elif state.partition(":")[0] != self._notified_state:
            self._notified_state = state.partition(":")[0]
            self._view.message(
                self._pause_by_m0() or f"the machine is in {state}: {way_out(state)}"
            )

    def _pause_by_m0(self) -> str:
        """Return a message if the program has paused the machine by M0; else ""."""
        if not self._unanswered or self._held_by_key:
            return ""
        line = self._lines[self.report.answered]  # the oldest line without an answer
        if not _PAUSE.search(without_comments(line.data).replace(b" ", b"")):
            return ""
        words = comment(line.text.encode("utf-8"))
        reason = f": {words}" if words else ""
        return f"line {line.number}: M0 pauses{reason} (~ or the start button goes on)"

    def _hold(self) -> None:
        """Wait until the machine stands still before anything else, because during motion Grbl
        ignores a cycle start and a reset loses steps. Then ask what to do next."""
        self._connection.wait_for(self._handle_until_rest, _HOLD_S)
        if self.report.stopped:
            return
        choice = Choice.ABORT if self.report.signal else self._ask(self._why_hold)
        if choice is Choice.ABORT:
            self._give_up()
            return
        for line in self._connection.lines():  # reports during this hold
            self._handle(line)
        self._keep_going |= choice is Choice.KEEP_GOING
        self._why_hold = ""
        self._connection.write(CYCLE_START)

    def _ask(self, why: str) -> Choice:
        """Ask the user what to do next. Ctrl-C meanwhile means abort: interrupt() raises it."""
        self._asking = True
        try:
            return self._view.ask(why)
        except KeyboardInterrupt:
            return Choice.ABORT
        finally:
            self._asking = False
            self._connection.heard = time.monotonic()  # nothing was read meanwhile

    def _give_up(self) -> None:
        """Reset: the tool is switched off, and Grbl's buffers are cleared."""
        self.report.stopped = self._why_hold
        self._connection.write(RESET)
        self._connection.status = ""  # it is from before the reset
        self._connection.wait_for(is_welcome, _RESET_S)
        self._connection.wait_for(lambda line: line.startswith("<"), _RESET_S)
        self.report.state = self._connection.state()

    def _handle_until_rest(self, line: str) -> bool:
        """Process a line; return whether the machine stands still, or the program has ended."""
        self._handle(line)
        if self.report.stopped:
            return True
        return line.startswith("<") and self._connection.at_rest()
