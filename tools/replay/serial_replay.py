"""Replay conversations on a real device over a serial port, in real time.

The device returns to machine position 0 and factory settings before each case: it moves, and its
settings are lost.
"""

import time
from collections.abc import Callable
from typing import Any

from .compare import Json


def needs_a_bench(case: Json) -> str:
    """Return why a case or motion record cannot be replayed on a serial port alone, or ""."""
    if "program" in case or case["init"] != "defaults":  # a motion record, or erased memory
        return "needs the simulator"
    steps = [*case["steps"], *(item for item in case["setup"] if isinstance(item, dict))]
    for step in steps:
        if step.keys() & {"pins", "switches", "power", "eeprom_patch"}:
            return "needs a hand on pins or power"
        if step["wait"] == "stream":
            return "needs the simulator"
    return ""


def _never() -> bool:
    return False


class SerialReplay:
    """Replays cases on a real device, in real time. It may move. port: an open serial port."""

    def __init__(self, port: Any) -> None:
        self._serial = port
        self._text = ""
        self._lines: list[str] = []

    def replay(self, case: Json) -> Json:
        """Return what was observed, as tools/sim/replay.py does: lines of each step; moves as if
        they were right."""
        self._make_default()
        observed: Json = {"setup": [], "steps": []}
        for line, _ in case["setup"]:
            observed["setup"].append({"lines": self._step(line + "\n", "ok", 0)})
        for step in case["steps"]:
            lines = self._step(step["send"], step["wait"], step["t_ms"], step.get("settle_ms"))
            # As recorded, because a port shows neither motors nor outputs.
            seen = {"moved": step.get("moved") or [0, 0, 0], "out": step.get("out", {})}
            seen["moving"] = step.get("moving", False)
            observed["steps"].append({"lines": lines, "partial": self._text, **seen})
        return observed

    def _make_default(self) -> None:
        """Move to machine position 0, restore factory settings, then reset."""
        self._step("\x18", wait="banner", t_ms=0)
        self._step("$X\n", wait="ok", t_ms=0)
        self._step("G21G90G53G0X0Y0Z0\n", wait="ok", t_ms=0)
        self._step("G4P0.01\n", wait="ok", t_ms=0)  # answered when the move has ended
        self._step("$RST=*\n", wait="banner", t_ms=0, settle_ms=500)  # it writes much to memory
        self._step("\x18", wait="banner", t_ms=0)

    def _step(
        self, send: str, wait: str, t_ms: float, settle_ms: float | None = None
    ) -> list[str]:
        """Send a text, and return the lines received until its wait is over, and some ms longer.

        wait: as in the recordings, "ok", "report" and so on, or "ms 200". t_ms: how long it took
        when recorded; the device may take longer. settle_ms: time to go on listening afterwards;
        None or 0: 60 ms after a banner, else 50.
        """
        self._lines = []
        self._serial.write(send.encode("latin-1"))
        self._serial.flush()
        if wait.startswith("ms "):
            self._listen(_never, float(wait.removeprefix("ms ")))
        else:
            wanted = send.count("\n") + send.count("\r")
            is_over = {
                "ok": lambda: self._answers() >= wanted,
                "idle": lambda: self._answers() >= wanted,
                "report": lambda: self._starts("<"),
                "banner": lambda: self._starts("Grbl"),
            }[wait]
            self._listen(is_over, t_ms * 3 + 20_000)
            if wait == "idle":  # a port does not show when motion has ended
                self._listen(_never, t_ms * 1.1 + 300)
            self._listen(_never, settle_ms or {"banner": 60}.get(wait, 50))
        return self._lines

    def _answers(self) -> int:
        """Return how many answers were received in this step."""
        return sum(line == "ok" or line.startswith("error:") for line in self._lines)

    def _starts(self, start: str) -> bool:
        """Return whether a line that begins so was received in this step."""
        return any(line.startswith(start) for line in self._lines)

    def _listen(self, until: Callable[[], bool], milliseconds: float) -> None:
        """Collect lines in _lines until until() is true (_never: for the whole time), or the time
        is over. An unfinished line stays in _text."""
        end = time.monotonic() + milliseconds / 1000
        while not until() and time.monotonic() < end:
            self._text += self._serial.read(4096).decode("latin-1")
            *lines, self._text = self._text.split("\r\n")
            self._lines += lines
