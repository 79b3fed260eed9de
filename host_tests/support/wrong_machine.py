"""Replay recordings like tools/sim/replay_main.py, on a machine with a fault that the judge must
detect. UGRBL_FAULT names the fault."""

import importlib
import importlib.util
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

MAIN = Path(__file__).resolve().parents[2] / "tools" / "sim" / "replay_main.py"


def never_enables() -> None:
    """Leave the motors without power."""
    importlib.import_module("sim.port").SimPort.enable = lambda self, level: None


def turns_no_spindle() -> None:
    """Leave the spindle's pin off."""
    importlib.import_module("sim.port").SimPort.spindle = lambda self, on, power: None


def says_nothing() -> None:
    """Do not answer "?"."""
    report = importlib.import_module("talk.report").Report
    report.status = lambda self: memoryview(b"")


def is_off_after_a_hold() -> None:
    """Report the last axis four steps too far after a hold."""
    engine = importlib.import_module("sim.engine").SimEngine
    segments = importlib.import_module("motion.segments").Segments
    usual_position, usual_hold, usual_init = engine.position, segments.hold, segments.__init__
    held = [False]

    def begin(self: Any, *arguments: Any) -> None:
        held[0] = False
        usual_init(self, *arguments)

    def hold(self: Any, on: bool) -> None:
        held[0] = held[0] or on
        usual_hold(self, on)

    def position(self: Any, steps: Any) -> None:
        usual_position(self, steps)
        steps[len(steps) - 1] += 4 * held[0]

    segments.__init__, segments.hold, engine.position = begin, hold, position


def takes_three_times() -> None:
    """Run all motion at a third of its speed."""
    planner = importlib.import_module("motion.planner").Planner
    usual = planner.override

    def override(self: Any) -> None:
        state = self._state
        feed, rapid = state.feed_override, state.rapid_override
        state.feed_override, state.rapid_override = feed / 3, rapid / 3
        usual(self)
        state.feed_override, state.rapid_override = feed, rapid

    planner.override = override


FAULTS: dict[str, Callable[[], None]] = {
    fault.__name__: fault
    for fault in (
        never_enables,
        turns_no_spindle,
        says_nothing,
        is_off_after_a_hold,
        takes_three_times,
    )
}

if __name__ == "__main__":
    found = importlib.util.spec_from_file_location("replay_main", MAIN)
    assert found and found.loader
    main = importlib.util.module_from_spec(found)
    found.loader.exec_module(main)
    sys.argv[0] = str(MAIN)
    main.set_path()
    FAULTS[os.environ["UGRBL_FAULT"]]()
    main.main()
