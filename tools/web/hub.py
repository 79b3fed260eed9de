"""Connect all browsers to one board: all receive its bytes, only the controlling one sends.

When no browser controls, a watcher may still send `?`, because that moves nothing.

All of it runs in the event loop. The board's threads call in with call_soon_threadsafe.
"""

import asyncio
import json
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, Protocol

from ..device.connection import state_of
from ..grbl.gcode_file import FEED_HOLD, JOG_CANCEL, RESET, STATUS
from .framing import Framing
from .shared_job import SharedJob

# Unread bytes allowed per browser: a job of 100,000 lines with all its answers and reports.
_UNREAD_BYTES = 1_000_000
_MESSAGE_BYTES = 65_536
# More waiting lines than this stop reading from the controlling browser until the board reads
# some.
_LINES_AHEAD = 2000
_POLL_S = 0.01
_LONGEST_LINE = 1024


class Board(Protocol):
    """The board's interface that the hub uses, see board_link.py."""

    @property
    def name(self) -> str:
        """Return the name of its port."""

    @property
    def is_open(self) -> bool:
        """Return whether it is connected."""

    def write_line(self, line: bytes) -> None:
        """Send a whole line."""

    def write_now(self, byte: bytes) -> None:
        """Send a realtime byte."""

    def forget_lines(self) -> None:
        """Drop the lines that are not sent yet."""

    def waiting(self) -> int:
        """Return the number of lines that are not sent yet."""


class Socket(Protocol):
    """A websocket with aiohttp's interface."""

    async def send_bytes(self, data: bytes) -> None:
        """Send a binary message."""

    async def send_str(self, data: str) -> None:
        """Send a text message."""


class Browser:
    """One websocket with its queue of unsent data.

    who: its name in the log; drop: ends its connection at once.
    """

    def __init__(self, socket: Socket, who: str, drop: Callable[[], None]) -> None:
        self.who = who
        self.drop = drop
        self._socket = socket
        self._parts: deque[bytes | str] = deque()
        self._unread = 0  # bytes and characters in the queue
        self._has_parts = asyncio.Event()  # signals a new part

    def put(self, part: bytes | str) -> bool:
        """Queue a part for sending. Return whether space was free for it."""
        if self._unread + len(part) > _UNREAD_BYTES:
            return False
        self._parts.append(part)
        self._unread += len(part)
        self._has_parts.set()
        return True

    async def send_on(self) -> None:
        """Send queued parts until the connection breaks (ConnectionError)."""
        while True:
            await self._has_parts.wait()
            self._has_parts.clear()
            while self._parts:
                part = self._parts.popleft()
                if isinstance(part, str):
                    await self._socket.send_str(part)
                    self._unread -= len(part)
                else:
                    data = self._joined(part)
                    await self._socket.send_bytes(data)
                    self._unread -= len(data)

    def _joined(self, data: bytes) -> bytes:
        """Join successive byte parts of the queue to `data`, into one message."""
        parts = [data]
        size = len(data)
        while self._parts and isinstance(self._parts[0], bytes) and size < _MESSAGE_BYTES:
            parts.append(self._parts.popleft())  # type: ignore[arg-type]
            size += len(parts[-1])
        return b"".join(parts)


class LastState:
    """Track the state in the last status report."""

    def __init__(self) -> None:
        self.state = ""  # Idle, Run, …; "" if it is not known
        self._incomplete_line = b""

    def hear(self, data: bytes) -> bool:
        """Read bytes from the board. Return whether the machine has restarted."""
        has_restarted = False
        *lines, incomplete = (self._incomplete_line + data).split(b"\n")
        self._incomplete_line = incomplete[-_LONGEST_LINE:]
        for line in lines:
            if line.startswith(b"<"):
                # Without the substate of `Hold:0`.
                self.state = state_of(line.decode("latin-1")).partition(":")[0]
            elif line.startswith(b"Grbl"):
                self.forget()
                has_restarted = True
        return has_restarted

    def forget(self) -> None:
        """Mark the state as unknown."""
        self.state = ""


class Hub:
    """The browsers of one board. log: receives sentences for the user who runs the server."""

    def __init__(self, board: Board, log: Callable[[str], None]) -> None:
        self._board = board
        self._log = log
        self._browsers: list[Browser] = []
        self._controller: Browser | None = None  # the browser that controls the machine
        self._framing = Framing()
        self._machine = LastState()
        self._job = SharedJob()

    # Browsers

    def join(self, browser: Browser) -> None:
        """Add a browser; it takes control if no browser has it."""
        self._browsers.append(browser)
        if self._controller is None:
            self._controller = browser
        self._send_state()
        self._send_job([browser])

    def leave(self, browser: Browser) -> None:
        """Remove a browser whose connection has ended."""
        if browser not in self._browsers:
            return
        self._browsers.remove(browser)
        if browser is self._controller:
            self._release_control("has gone")
        self._send_state()

    def drive(self, browser: Browser, wanted: bool) -> None:
        """Give control to a browser that has asked for it (wanted), or take it back from one that
        releases it; the last one that asks has it."""
        if wanted and browser is not self._controller:
            self._leave_job()
            self._drop_input()
            self._controller = browser
            self._log(f"{browser.who} drives now")
        elif not wanted and browser is self._controller:
            self._release_control("drives no more")
        self._send_state()

    async def send(self, browser: Browser, data: bytes) -> None:
        """Pass a browser's bytes to the board if it controls, else drop them; but pass a `?` while
        no browser controls. Then wait while too many lines wait for the board."""
        if self._controller is None and data == STATUS:
            self._board.write_now(STATUS)
        if browser is not self._controller:
            return
        for part, is_realtime in self._framing.take(data):
            if part == RESET:
                self._board.forget_lines()  # else they would be executed after the reset
            if is_realtime:
                self._board.write_now(part)
            else:
                self._board.write_line(part)
        while self._board.waiting() > _LINES_AHEAD and browser is self._controller:
            await asyncio.sleep(_POLL_S)

    def _release_control(self, how: str) -> None:
        """Take control from the browser that has it. Hold a running machine, and cancel a jog.

        how: for the log, such as `has gone`.
        """
        who = self._controller.who if self._controller else ""
        self._controller = None
        self._leave_job()
        self._drop_input()
        stop = {"Run": FEED_HOLD, "Jog": JOG_CANCEL}.get(self._machine.state)
        if stop is None or not self._board.is_open:
            return
        self._board.write_now(stop)
        effect = "the motion is held (!)" if stop == FEED_HOLD else "the jog is cancelled"
        self._log(f"{who} {how} while the machine was in {self._machine.state}: {effect}")
        self._machine.forget()  # so the command is sent only once

    def _drop_input(self) -> None:
        """Drop input of the last controlling browser: an incomplete line, and lines that wait for
        the board.

        Lines of a job that the next browser may continue count as sent, so they stay.
        """
        self._framing.forget()
        if not self._job.is_left:
            self._board.forget_lines()

    # The job

    def open_job(self, program: dict[str, str]) -> bool:
        """Open a program for all browsers. Return False while a job is running."""
        if self._job.is_under_way:
            return False
        self._job.open(program)
        self._send_job(self._browsers)
        return True

    def get_program(self) -> dict[str, str]:
        """Return the open program; empty if none is open."""
        return self._job.program

    async def tell_job(self, browser: Browser, progress: dict[str, Any], lines: str) -> None:
        """Share the controlling browser's progress and send its lines together."""
        if browser is self._controller and self._job.update(progress):
            self._send_job(other for other in self._browsers if other is not browser)
        await self.send(browser, lines.encode("latin-1", "ignore"))

    def _leave_job(self) -> None:
        """Leave a job under way to the next controlling browser."""
        if self._job.is_under_way:
            self._job.leave()
            self._send_job(self._browsers)

    def _stop_job(self, why: str) -> None:
        """Stop a job under way; no browser can continue it."""
        if self._job.is_under_way:
            self._job.stop(why)
            self._send_job(self._browsers)

    def _send_job(self, browsers: Iterable[Browser]) -> None:
        """Send the open program's name and its progress."""
        message = self._job.message()
        if message:
            self._put(message, browsers)

    # The board

    def heard(self, data: bytes) -> None:
        """Pass bytes from the board to all browsers."""
        has_restarted = self._machine.hear(data)
        self._put(data, self._browsers)
        if has_restarted:
            self._stop_job("the machine was reset")

    def link_changed(self) -> None:
        """React to a broken or restored link to the board."""
        self._framing.forget()
        self._machine.forget()
        self._send_state()
        self._stop_job("the connection is lost")

    def _send_state(self) -> None:
        """Send the current state to each browser."""
        for browser in tuple(self._browsers):
            self._put(self._state_for(browser), [browser])

    def _state_for(self, browser: Browser) -> str:
        """Return the JSON message: the link, whether this browser controls, and how many watch."""
        controlling = int(self._controller is not None)
        return json.dumps(
            {
                "link": {"name": self._board.name, "open": self._board.is_open},
                "driver": browser is self._controller,
                "drivers": controlling,
                "watchers": len(self._browsers) - controlling,
            }
        )

    def _put(self, part: bytes | str, browsers: Iterable[Browser]) -> None:
        """Queue a part for browsers; one that has no space for it is disconnected."""
        for browser in tuple(browsers):
            if not browser.put(part) and browser in self._browsers:
                self._log(f"{browser.who} does not receive data fast enough, and is disconnected")
                browser.drop()
                self.leave(browser)
