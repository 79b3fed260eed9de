"""The program that is open, and how far its job is.

All browsers see it, and where the one that sends it has gone, the next one that drives may go on.
"""

import json
from typing import Any

# As the page names them: these still have lines to send, or wait for somebody's word.
_LEFT = "left"
_UNDER_WAY = ("running", "refused", "ending", _LEFT)


class SharedJob:
    """program: what a browser has opened, {"id", "name", "program"}; told: what the driver says of
    its job, with "state" and "sent", how many of its lines have gone to the board."""

    def __init__(self) -> None:
        self.program: dict[str, str] = {}
        self._told: dict[str, Any] = {}

    @property
    def is_under_way(self) -> bool:
        """Whether it has begun and has not ended."""
        return self._told.get("state") in _UNDER_WAY

    @property
    def is_left(self) -> bool:
        """Whether nobody sends it: what waits for the board is to go there all the same."""
        return self._told.get("state") == _LEFT

    def open(self, program: dict[str, str]) -> None:
        """Another program: no job has begun."""
        self.program, self._told = program, {}

    def tell(self, told: dict[str, Any]) -> bool:
        """The driver says how far it is. Returns whether it is a job of that program."""
        if not self.program or told.get("id") != self.program["id"]:
            return False
        self._told = told
        return True

    def leave(self) -> None:
        """Who has sent it drives no more; another may go on."""
        self._told["state"] = _LEFT

    def stop(self, why: str) -> None:
        """The machine has forgotten what it was given."""
        self._told.update(state="stopped", why=why)

    def news(self) -> str:
        """For browsers; "" where no program is open."""
        if not self.program:
            return ""
        named = {"id": self.program["id"], "name": self.program["name"]}
        return json.dumps({"job": {**named, **self._told}})


def program_of(body: bytes) -> "dict[str, str] | None":
    """A program that was posted; None where it is none."""
    try:
        found = json.loads(body)
        return {
            key: found[key] for key in ("id", "name", "program") if found[key] == str(found[key])
        }
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
