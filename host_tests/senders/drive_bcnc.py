"""A user's day with bCNC: its Sender and its controller for Grbl 1.x, without its windows.

    python drive_bcnc.py PLAN_FILE RESULT_FILE

Runs in the Python that has bCNC. This file replaces what its main window adds to a Sender: the
queue of a run (bmain.Application.run), and the calls that draw.
"""

import importlib.util
import json
import os
import re
import sys
import time
from pathlib import Path

_PATIENCE_S = 60.0
# Kinds of lines that parseLine() only shows in the terminal, as with real Grbl. A whole status
# report can be one of them: the Sender asks on a timer and for its own purposes (reset, unlock,
# overrides), records one question only (sio_status), and logs the answer to the other.
_KNOWN = re.compile(
    r"\$\d+=|Grbl |\[(MSG|GC|VER|OPT|G\d\d|G92|TLO|PRB|HLP):"
    r"|<[A-Z][a-z]+(:\d)?\|[MW]Pos:[-\d.,]+(\|[A-Z][A-Za-z]*:[-\w.,]+)*>$"
)


def find_bcnc():
    spec = importlib.util.find_spec("bCNC")
    home = Path(spec.origin).parent
    for folder in ("controllers", "plugins", "lib", ""):
        sys.path.insert(0, str(home / folder))
    os.environ["HOME"] = str(Path(sys.argv[2]).parent)  # keep the user's settings out
    return home


def make_sender():
    import builtins

    builtins._ = lambda text: text
    import Utils

    Utils.loadConfiguration()
    from Sender import Sender

    class Headless(Sender):
        """A Sender without a window."""

        def event_generate(self, *_, **__):
            pass

        def disable(self):
            pass

        def busy(self):
            pass

        def notBusy(self):
            pass

    return Headless()


class Day:
    """One sender, one plan, and the results."""

    def __init__(self, sender, plan):
        from CNC import CNC, WAIT

        self.sender = sender
        self.plan = plan
        self.vars = CNC.vars
        self.compile = CNC.compile
        self.wait_mark = WAIT
        self.result = {"unparsed": [], "errors": [], "override": [], "states": []}

    def collect_log(self):
        """Empty the log that its terminal would show."""
        while not self.sender.log.empty():
            kind, text = self.sender.log.get()
            if kind == self.sender.MSG_ERROR:
                self.result["errors"].append(text)
            elif kind == self.sender.MSG_RECEIVE and not _KNOWN.match(text):
                self.result["unparsed"].append(text)
        self.result["override"].append(self.vars["OvFeed"])
        state = self.vars["state"]
        if state not in self.result["states"][-1:]:
            self.result["states"].append(state)

    def until(self, what, condition):
        end = time.monotonic() + _PATIENCE_S
        while not condition():
            if time.monotonic() > end:
                raise RuntimeError(f"never {what}: {self.vars['state']}, {self.position('m')}")
            self.collect_log()
            time.sleep(0.02)
        self.collect_log()

    def position(self, kind):
        return [float(self.vars[kind + axis]) for axis in "xyz"]

    def is_idle_at(self, expected):
        near = all(abs(a - b) < 0.005 for a, b in zip(self.position("m"), expected))
        return self.vars["state"] == "Idle" and near and self.sender.queue.empty()

    def run(self):
        """Do what bmain.Application.run() does with lines."""
        sender = self.sender
        sender.initRun()
        sender._runLines = sys.maxsize
        sender._gcount = 0
        self.vars["running"] = True
        count = 1
        for line in self.compile(self.plan["program"]):
            sender.queue.put(line + "\n" if isinstance(line, str) else line)
            count += 1
        sender._runLines = count
        sender.queue.put((self.wait_mark,))

    def run_day(self):
        sender, plan, result, values = self.sender, self.plan, self.result, self.vars
        sender.open(plan["port"], 115200)
        self.until("locked", lambda: values["state"] == "Alarm")
        sender.softReset()
        self.until("greeted", lambda: "version" in values)
        time.sleep(1)
        result["version"] = values["version"]
        result["controller"] = sender.controller
        sender.viewSettings()
        self.until("told its settings", lambda: "grbl_132" in values)
        result["settings"] = {
            name[5:]: value for name, value in values.items() if name.startswith("grbl_")
        }
        sender.home()
        self.until("homed", lambda: self.is_idle_at(plan["homed"]))
        result["homed"] = self.position("m")
        sender.mcontrol.jog("X-10Y-20")
        self.until("jogged", lambda: self.is_idle_at(plan["jogged"]))
        sender.mcontrol._wcsSet(0, 0, 0)
        self.until("zeroed", lambda: not any(self.position("w")))
        result["zeroed"] = self.position("w")

        self.run()
        self.until("running", lambda: values["state"] == "Run")
        for percent in (110, 120):  # in steps: a report with WCO: lacks Ov:, so one go overshoots
            values["_OvFeed"] = percent
            values["_OvChanged"] = True
            self.until("overridden", lambda percent=percent: values["OvFeed"] == percent)
        sender.feedHold()
        self.until("held", lambda: values["state"] == "Hold:0")
        result["held"] = self.position("m")
        sender.resume()
        self.until("resumed", lambda: values["state"] == "Run")
        self.until(
            "done", lambda: sender._gcount >= sender._runLines and self.is_idle_at(plan["ended"])
        )
        # As its window does at the end of a job: hold, reset, unlock, and restore all modes.
        sender.cleanAfter = True
        sender.runEnded()
        self.until("purged", lambda: not sender.cleanAfter and sender.queue.empty())
        self.until("in place", lambda: self.is_idle_at(plan["ended"]))
        result["mpos"], result["wpos"] = self.position("m"), self.position("w")


def main():
    plan_file, result_file = map(Path, sys.argv[1:])
    find_bcnc()
    day = Day(make_sender(), json.loads(plan_file.read_text()))
    try:
        day.run_day()
    except Exception as error:
        day.result["failed"] = repr(error)
    day.collect_log()
    result_file.write_text(json.dumps(day.result))
    day.sender.thread = None
    os._exit(0)


if __name__ == "__main__":
    main()
