"""A user's day with a minimal sender, like Grbl's own examples: a port and a loop.

    python drive_plain.py line|count PLAN_FILE RESULT_FILE

line: send a line when the one before is answered. count: keep up to 127 bytes unanswered.
"""

import json
import re
import sys
import time
from collections import deque
from pathlib import Path
from typing import Any

import serial

_PATIENCE_S = 60.0
_POLL_S = 0.1
_WINDOW = 127
_PLACE = r"-?\d+\.\d{3}(,-?\d+\.\d{3}){2,5}"
_REPORT = re.compile(
    r"<(?P<state>Idle|Run|Hold:[01]|Jog|Alarm|Home|Check|Door:[0-3]|Sleep)"
    rf"\|MPos:(?P<mpos>{_PLACE})"
    r"(\|Bf:\d+,\d+)?(\|Ln:\d+)?\|FS:\d+,\d+(\|Pn:[XYZPDHRS]+)?"
    rf"(\|WCO:(?P<wco>{_PLACE}))?"
    r"(\|Ov:(?P<ov>\d+),\d+,\d+)?(\|A:[SCFM]+)?>"
)
_KNOWN = re.compile(
    r"|ok|\$(?P<number>\d+)=(?P<value>\d+(\.\d{3})?)|Grbl (?P<version>1\.1\w) \['\$' for help\]"
    r"|\[MSG:[^\]]*\]|\[GC:[^\]]*\]|\[VER:[^\]]*\]|\[OPT:[^\]]*\]|\[G\d\d(\.1)?:[^\]]*\]"
    r"|\[TLO:[^\]]*\]|\[PRB:[^\]]*\]"
)


class Plain:
    """The port, and the known state of the machine."""

    def __init__(self, plan: Any, by_line: bool) -> None:
        self.plan = plan
        self.window = 0 if by_line else _WINDOW
        self.port = serial.serial_for_url(plan["port"], 115200, timeout=0.01)
        self.result: Any = {
            "unparsed": [],
            "errors": [],
            "override": [],
            "states": [],
            "settings": {},
        }
        self.unanswered_lengths: deque[int] = deque()
        self.state = ""
        self.mpos = [0.0] * 3
        self.wco = [0.0] * 3
        self.asked = 0.0
        self.rest = ""

    def poll(self) -> None:
        """Ask for a report when it is due, and read the bytes received."""
        if time.monotonic() - self.asked > _POLL_S:
            self.asked = time.monotonic()
            self.port.write(b"?")
        self.rest += self.port.read(max(1, self.port.in_waiting)).decode("latin-1")
        *lines, self.rest = self.rest.split("\r\n")
        for line in lines:
            self.read(line)

    def read(self, line: str) -> None:
        result = self.result
        report = _REPORT.fullmatch(line)
        known = _KNOWN.fullmatch(line)
        if report:
            self.record_report(report)
        elif line.startswith(("error:", "ALARM:")):
            result["errors"].append(line)
        elif not known:
            result["unparsed"].append(line)
        elif known["number"]:
            result["settings"][known["number"]] = known["value"]
        elif known["version"]:
            result["version"] = known["version"]
        if line == "ok" or line.startswith("error:"):
            if self.unanswered_lengths:
                self.unanswered_lengths.popleft()
            else:
                result["unparsed"].append(line + " without a question")

    def record_report(self, report: re.Match[str]) -> None:
        self.state = report["state"]
        self.mpos = [float(mm) for mm in report["mpos"].split(",")[:3]]
        if report["wco"]:
            self.wco = [float(mm) for mm in report["wco"].split(",")[:3]]
        if report["ov"]:
            self.result["override"].append(int(report["ov"]))
        if self.state not in self.result["states"][-1:]:
            self.result["states"].append(self.state)

    def until(self, what: str, condition: Any) -> None:
        end = time.monotonic() + _PATIENCE_S
        while not condition():
            if time.monotonic() > end:
                raise RuntimeError(f"never {what}: {self.state} {self.mpos}")
            self.poll()

    def send(self, line: str) -> None:
        """Send as soon as space is free."""
        data = line.encode() + b"\n"
        self.until("room", lambda: not self.unanswered_lengths or self.fits(len(data)))
        self.port.write(data)
        self.unanswered_lengths.append(len(data))

    def fits(self, length: int) -> bool:
        return sum(self.unanswered_lengths) + length <= self.window

    def ask(self, line: str) -> None:
        self.send(line)
        self.until(f"answered {line}", lambda: not self.unanswered_lengths)

    def wpos(self) -> list[float]:
        return [round(m - o, 3) for m, o in zip(self.mpos, self.wco, strict=True)]

    def is_idle_at(self, place: list[float]) -> bool:
        return self.state == "Idle" and self.mpos == place


def run_day(sender: Plain) -> None:
    """Do everything that belongs to the day."""
    plan, result = sender.plan, sender.result
    sender.port.write(b"\x18")
    sender.until("greeted", lambda: "version" in result)
    # Perhaps for the connection: lines that arrive before the reset's own greeting are dropped.
    reset_s = time.monotonic()
    sender.until("reset", lambda: time.monotonic() > reset_s + 0.5)
    sender.ask("$$")
    sender.ask("$I")
    sender.ask("$H")
    sender.until("homed", lambda: sender.is_idle_at(plan["homed"]))
    result["homed"] = sender.mpos
    sender.ask(plan["jog"])
    sender.until("jogged", lambda: sender.is_idle_at(plan["jogged"]))
    sender.ask(plan["zero"])
    sender.until("zeroed", lambda: not any(sender.wpos()))
    result["zeroed"] = sender.wpos()
    half = len(plan["program"]) // 2
    for line in plan["program"][:half]:
        sender.send(line)
    for percent in (110, 120):  # one at a time: Grbl keeps them as flags, two at once count once
        sender.port.write(b"\x91")
        sender.until("overridden", lambda percent=percent: percent in result["override"])
    sender.port.write(b"!")
    sender.until("held", lambda: sender.state == "Hold:0")
    result["held"] = sender.mpos
    sender.port.write(b"~")
    for line in plan["program"][half:]:
        sender.send(line)
    sender.until(
        "done", lambda: not sender.unanswered_lengths and sender.is_idle_at(plan["ended"])
    )
    result["mpos"], result["wpos"] = sender.mpos, sender.wpos()


def main() -> None:
    mode, plan_file, result_file = sys.argv[1:]
    sender = Plain(json.loads(Path(plan_file).read_text()), mode == "line")
    try:
        run_day(sender)
    except RuntimeError as error:
        sender.result["failed"] = str(error)
    Path(result_file).write_text(json.dumps(sender.result))


if __name__ == "__main__":
    main()
