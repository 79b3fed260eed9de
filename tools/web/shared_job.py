"""Share the open program, and the progress of its job.

All browsers see both. After the browser that sends the job has gone, the next controlling one may
continue.
"""

import json
from typing import Any

# The page's names of the states with lines still to send, or with a question to answer.
_LEFT = "left"
_UNDER_WAY = ("running", "refused", "tool", "ending", _LEFT)


class SharedJob:
    """The open program and the progress of its job.

    program: {"id", "name", "program"}, as a browser opened it. The controlling browser reports the
    progress, with "state" and "sent", the number of lines sent to the board.
    """

    def __init__(self) -> None:
        self.program: dict[str, str] = {}
        self._progress: dict[str, Any] = {}  # of the job; empty: none has begun

    @property
    def is_under_way(self) -> bool:
        """Return whether the job has begun and has not ended."""
        return self._progress.get("state") in _UNDER_WAY

    @property
    def is_left(self) -> bool:
        """Return whether no browser sends the job; lines that wait for the board still go out."""
        return self._progress.get("state") == _LEFT

    def open(self, program: dict[str, str]) -> None:
        """Open another program; no job has begun."""
        self.program, self._progress = program, {}

    def update(self, progress: dict[str, Any]) -> bool:
        """Store the controlling browser's report, and return True; ignore it, and return False, if
        it is not of the open program."""
        if not self.program or progress.get("id") != self.program["id"]:
            return False
        self._progress = progress
        return True

    def leave(self) -> None:
        """Mark the job as left by its browser; another may continue it."""
        self._progress["state"] = _LEFT

    def stop(self, why: str) -> None:
        """Stop the job, because the machine has lost the lines it received."""
        self._progress.update(state="stopped", why=why)

    def message(self) -> str:
        """Return the JSON message for browsers; "" if no program is open."""
        if not self.program:
            return ""
        id_and_name = {key: self.program[key] for key in ("id", "name")}  # without its text
        return json.dumps({"job": {**id_and_name, **self._progress}})


def program_of(body: bytes) -> "dict[str, str] | None":
    """Return the posted program; None if it is invalid."""
    try:
        posted = json.loads(body)
        program = {key: posted[key] for key in ("id", "name", "program")}
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    return program if all(isinstance(value, str) for value in program.values()) else None
