"""Preview queue: simulations for browsers, one process at a time; the newest request wins."""

import asyncio
import sys
from collections.abc import Callable
from http import HTTPStatus
from typing import NamedTuple

from .preview import REFUSED

LONGEST_S = 120.0
_SHOWN_LINES = 20  # of the output of a simulator that failed, in the log


class Answer(NamedTuple):
    """The answer to a browser: JSON if the status is 200, else a sentence."""

    status: HTTPStatus
    text: str


class PreviewQueue:
    """Preview programs for a machine of that board. log: receives faults of the simulator."""

    def __init__(
        self, board: str, log: Callable[[str], None], longest_s: float = LONGEST_S
    ) -> None:
        self._board = board
        self._log = log
        self._longest_s = longest_s
        self._starting = asyncio.Lock()  # one start at a time
        self._running: asyncio.subprocess.Process | None = None

    async def look(self, body: bytes) -> Answer:
        """Return the answer to a request, see preview.py. A newer call ends this one, with status
        409."""
        process = await self._start()
        try:
            out, err = await asyncio.wait_for(process.communicate(body), self._longest_s)
        except asyncio.TimeoutError:
            return self._too_long()
        except ConnectionError:  # it ended before it had read everything
            out, err = b"", b""
        finally:
            was_replaced = self._running is not process  # by a newer call, or closed
            if not was_replaced:
                self._running = None
            _end(process)
        await process.wait()
        if process.returncode == 0:
            return Answer(HTTPStatus.OK, out.decode())
        if process.returncode == REFUSED:
            return Answer(HTTPStatus.BAD_REQUEST, out.decode())
        if was_replaced:
            return Answer(HTTPStatus.CONFLICT, "another program is being simulated now: ask again")
        return self._failed(err.decode("utf-8", "replace"))

    def close(self) -> None:
        """End the running simulation."""
        process, self._running = self._running, None
        if process is not None:
            _end(process)

    async def _start(self) -> asyncio.subprocess.Process:
        """End the running simulation, and start another process."""
        async with self._starting:
            self.close()
            self._running = await asyncio.create_subprocess_exec(
                sys.executable,
                "-m",
                f"{__package__}.preview",
                self._board,
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.PIPE,
                start_new_session=True,  # so that Ctrl-C ends only the server
            )
            return self._running

    def _too_long(self) -> Answer:
        """Return the answer for a program that takes too long."""
        text = f"the simulator has not come to the program's end within {self._longest_s:g} s"
        return Answer(HTTPStatus.GATEWAY_TIMEOUT, f"{text}: `ugrbl run` has no such limit")

    def _failed(self, output: str) -> Answer:
        """Return the answer after a fault of the simulator, and log the end of its output."""
        last_lines = output.strip().splitlines()[-_SHOWN_LINES:]
        self._log("\n".join(["the simulator has failed:", *last_lines]))
        why = last_lines[-1] if last_lines else "it has said nothing"
        return Answer(HTTPStatus.INTERNAL_SERVER_ERROR, f"the simulator has failed: {why}")


def _end(process: asyncio.subprocess.Process) -> None:
    """Kill a process if it still runs."""
    if process.returncode is None:
        process.kill()
