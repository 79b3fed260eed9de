"""The open program, and the progress of its job.

All browsers see both. After the browser that sends the job has gone, the next driver may continue.
"""

import json
from typing import Any

# As the page names them: these still have lines to send, or wait for somebody's word.
_LEFT = "left"
_UNDER_WAY = ("running", "refused", "ending", _LEFT)


class SharedJob:
    """program: what a browser has opened, {"id", "name", "program"}. The driver reports the job's
    progress, with "state" and "sent", the number of lines that have gone to the board."""

    def __init__(self) -> None:
        self.program: dict[str, str] = {}
        self._progress: dict[str, Any] = {}

    @property
    def is_under_way(self) -> bool:
        """Whether it has begun and has not ended."""
        return self._progress.get("state") in _UNDER_WAY

    @property
    def is_left(self) -> bool:
        """Whether nobody sends it. Lines that wait for the board still go there."""
        return self._progress.get("state") == _LEFT

    def open(self, program: dict[str, str]) -> None:
        """Another program: no job has begun."""
        self.program, self._progress = program, {}

    def update(self, progress: dict[str, Any]) -> bool:
        """Take the driver's report. Returns whether it is of a job of the open program."""
        if not self.program or progress.get("id") != self.program["id"]:
            return False
        self._progress = progress
        return True

    def leave(self) -> None:
        """The browser that sent it is no longer the driver; another may continue."""
        self._progress["state"] = _LEFT

    def stop(self, why: str) -> None:
        """The machine has forgotten what it was given."""
        self._progress.update(state="stopped", why=why)

    def news(self) -> str:
        """For browsers; "" where no program is open."""
        if not self.program:
            return ""
        named = {"id": self.program["id"], "name": self.program["name"]}
        return json.dumps({"job": {**named, **self._progress}})


def program_of(body: bytes) -> "dict[str, str] | None":
    """A program that was posted; None where it is none."""
    try:
        found = json.loads(body)
        return {
            key: found[key] for key in ("id", "name", "program") if found[key] == str(found[key])
        }
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
