"""A user's day with grbl-streamer: its public methods, its own log.

    python drive_grbl_streamer.py PLAN_FILE RESULT_FILE

Runs in the Python that has it. It overrides the feed by rewriting F words.
"""

import json
import logging
import os
import re
import sys
import time
from pathlib import Path

from grbl_streamer import GrblStreamer

_PATIENCE_S = 60.0
# Lines that it passes on without parsing, as with real Grbl.
_KNOWN = re.compile(r"\$(\d+)=(\S+)$|(Grbl )|\[GC:|\[(G\d\d|G92|TLO|PRB):")
_FEED = 1500


class Day:
    """One sender, one plan, and the results."""

    def __init__(self, plan):
        self.plan = plan
        self.result = {"unparsed": [], "errors": [], "override": [], "states": [], "settings": {}}
        self.booted = 0
        self.sender = GrblStreamer(self.event)
        self.sender.setup_logging(Complaints(self.result["unparsed"]))
        self.sender.poll_interval = 0.1

    def event(self, name, *data):
        result = self.result
        if name == "on_boot":
            self.booted += 1
        elif name == "on_read":
            known = _KNOWN.match(data[0])
            if not known:
                result["unparsed"].append(data[0])
            elif known[1]:
                result["settings"][known[1]] = known[2]
            elif known[3]:
                result["version"] = data[0].split()[1]
        elif name in ("on_error", "on_alarm"):
            result["errors"].append(data[0])
        elif name == "on_stateupdate":
            result["states"].append(data[0])
        elif name == "on_write" and (feed := re.search(r"F(\d+)", data[0])):
            result["override"].append(float(feed[1]))

    def until(self, what, condition):
        end = time.monotonic() + _PATIENCE_S
        while not condition():
            if time.monotonic() > end:
                raise RuntimeError(f"never {what}: {self.sender.cmode}, {self.sender.cmpos}")
            time.sleep(0.02)

    def is_idle_at(self, expected):
        near = all(abs(a - b) < 0.005 for a, b in zip(self.sender.cmpos, expected))
        return self.sender.cmode == "Idle" and near

    def run_day(self):
        sender, plan, result = self.sender, self.plan, self.result
        sender.cnect(plan["port"], 115200)
        self.until("greeted", lambda: self.booted)
        sender.poll_start()
        self.until("told its settings", lambda: "132" in result["settings"])
        self.until("locked", lambda: sender.cmode == "Alarm")
        sender.homing()
        self.until("homed", lambda: self.is_idle_at(plan["homed"]))
        result["homed"] = list(sender.cmpos)
        sender.send_immediately(plan["jog"])
        self.until("jogged", lambda: self.is_idle_at(plan["jogged"]))
        sender.send_immediately(plan["zero"])
        sender.hash_state_requested = True
        jogged = tuple(plan["jogged"])
        self.until("zeroed", lambda: sender.settings_hash["G54"][:3] == jogged)
        result["zeroed"] = [a - b for a, b in zip(sender.cmpos, sender.settings_hash["G54"])]

        sender.set_feed_override(True)
        sender.request_feed(_FEED)
        sender.write("\n".join(plan["program"]))
        sender.job_run()
        self.until("running", lambda: sender.cmode == "Run")
        time.sleep(0.5)
        sender.hold()
        self.until("held", lambda: sender.cmode == "Hold:0")
        result["held"] = list(sender.cmpos)
        sender.resume()
        self.until("resumed", lambda: sender.cmode == "Run")
        self.until("done", lambda: sender.job_finished and self.is_idle_at(plan["ended"]))
        result["mpos"] = list(sender.cmpos)
        result["wpos"] = [a - b for a, b in zip(sender.cmpos, jogged)]


class Complaints(logging.Handler):
    """Collect its logged errors: a line it could not parse, or did not send."""

    def __init__(self, into):
        super().__init__(logging.ERROR)
        self.into = into

    def emit(self, record):
        self.into.append(record.getMessage())


def main():
    plan_file, result_file = map(Path, sys.argv[1:])
    day = Day(json.loads(plan_file.read_text()))
    try:
        day.run_day()
    except Exception as error:
        day.result["failed"] = repr(error)
    result_file.write_text(json.dumps(day.result))
    os._exit(0)


if __name__ == "__main__":
    main()
