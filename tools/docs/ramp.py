"""The picture ramp.png of docs/speed.md: the speed at the start of a move, ours and Grbl's.

Grbl's are the first steps of a recording of real Grbl, in the project's shared folder; ours are
those of the simulator with the same settings. A speed is one step by the time since the step
before, so it shows every step.
"""

import json
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from .. import paths
from ..run import machine
from ..run.program import ProgramLink
from .pages import ROOT
from .pictures import FOLDER, shrink

if TYPE_CHECKING:
    from array import array

    from ..sim.rig import Rig

NAME = "ramp.png"
RECORDING = ROOT.parent / "shared/conformance/motion/04_line_y_20_feed_1000_accel_100.json"
_AXIS = 1  # Y, the only one that moves
_STEPS_PER_MM = 250


def grbl_ms() -> list[float]:
    """Return the times of Grbl's first steps, in ms after the first one."""
    events = json.loads(RECORDING.read_text("utf-8"))["first_events_us"]
    return [us / 1000 for us, _ in events]


def our_ms() -> list[float]:
    """Return the times of the simulator's steps of the same program, in ms after the first one."""
    recorded = json.loads(RECORDING.read_text("utf-8"))
    paths.use_firmware()
    from motion.layout import ROW_AXES, ROW_STRIDE

    from ..sim.engine import step_tick

    # Sends each line at once (0: no delay), and waits for its answer (None).
    def script(_link: ProgramLink) -> Iterator[tuple[int, bytes] | None]:
        for line in (*recorded["settings"], *recorded["program"]):
            yield 0, line.encode()
            yield None

    # Called for each row of steps that the engine executes. start: its first tick.
    def trace(start: int, row: "array[int]") -> None:
        base = ROW_AXES + ROW_STRIDE * _AXIS  # of the axis, in the row: its number of steps
        steps = row[base]
        ticks.extend(start + step_tick(row, base, step) for step in range(steps))

    ticks: list[int] = []
    rig: "Rig" = machine.build("sim", lambda rig: ProgramLink(rig, script))
    rig.engine.trace = trace
    machine.run(rig)
    return [1000 * (tick - ticks[0]) / rig.engine.tick_hz for tick in ticks]


def speeds(times_ms: Sequence[float]) -> tuple[list[float], list[float]]:
    """Return the middles of the intervals between steps, in ms, and their speeds, in mm/s."""
    middles = [(a + b) / 2 for a, b in pairwise(times_ms)]
    return middles, [1000 / _STEPS_PER_MM / (b - a) for a, b in pairwise(times_ms)]


def draw(file: Path) -> None:
    """Draw the picture. Raises FileNotFoundError without the recording."""
    from matplotlib.figure import Figure

    theirs = grbl_ms()
    ours = [ms for ms in our_ms() if ms <= theirs[-1]]
    figure = Figure((8, 3.4), dpi=150, layout="tight")
    axes = figure.subplots()
    for label, times, colour in (("Grbl 1.1h", theirs, "#d62728"), ("ugrbl", ours, "#1f77b4")):
        axes.plot(*speeds(times), ".-", color=colour, label=label)
    axes.set(xlabel="ms after the first step", ylabel="mm/s", xlim=(0, theirs[-1]), ylim=(0, None))
    axes.legend(loc="upper left")
    axes.grid(alpha=0.3)
    with TemporaryDirectory() as folder:
        drawn = Path(folder) / NAME
        figure.savefig(drawn)
        shrink(drawn, file)


def keep() -> Path:
    """Draw the picture into the folder of the documents."""
    draw(FOLDER / NAME)
    return FOLDER / NAME
