"""A program's rehearsal in the simulator, on a stage like the machine it is for.

check() is quick: check mode, to find what will be refused. Rehearsal makes every step, in a
process of its own while the program is being sent already, and knows then how long it takes and
where the machine is when. Run as a program, this is that process: a pickled Job on stdin, a
pickled Forecast on stdout.
"""

import os
import pickle
import subprocess
import sys
import threading
from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from math import dist, inf
from pathlib import Path
from typing import TYPE_CHECKING

from ..grbl.lines import Changed
from . import inputs, machine
from .own_python import OwnPythonError
from .program import ProgramLink, Result, Step
from .recorder import Recorder

if TYPE_CHECKING:
    from ..sim.rig import Rig

_ON_PATH_MM = 0.005
_OFF_PATH_MM = 1.0
_XYZ = 3  # numbers of a place


@dataclass
class Forecast:
    """What a program will do. Lines count from 1, places are machine positions in mm.

    A long one has millions of lines and blocks: what is known of each is in arrays.
    """

    answered_s: "array[float]" = field(default_factory=lambda: array("d"))  # by line
    block_line: "array[int]" = field(default_factory=lambda: array("i"))  # by the planner's block
    block_ends: "array[float]" = field(default_factory=lambda: array("f"))  # three numbers each
    start: list[float] = field(default_factory=list)
    total_s: float = 0.0
    stopped: str = ""  # why it knows no more
    at_line: list[str] = field(default_factory=list)  # $G and $# before the line asked for
    at_place: list[float] = field(default_factory=list)  # where it rests there
    refused: list[int] = field(default_factory=list)  # lines
    own: str = ""  # the handlers of custom.py, as $I names them
    outputs_on: list[str] = field(default_factory=list)  # by custom.py, before the line asked for

    def seconds_left(self, line: int) -> float | None:
        """How long it takes from the moment on at which a line is answered."""
        if self.stopped or line > len(self.answered_s):
            return None
        return self.total_s - (self.answered_s[line - 1] if line else 0.0)

    def line_at(
        self, answered: int, place: Sequence[float], planned: int, left: int | None
    ) -> int | None:
        """The line that was being made when the machine stopped; None where that is not clear.

        answered: the last line answered; planned: blocks that fit into the planner; left: blocks
        that were in it, where the machine tells. Where the path crosses itself there, the
        earlier line is taken: to make some of it again is better than to leave some of it out.
        """
        end = bisect_right(self.block_line, answered)
        if left is not None and bisect_right(self.block_line, answered + 1) <= end + 1:
            return self.block_line[max(0, end - left)] if left and end else answered
        first = max(0, end - planned - 1)
        last = bisect_right(self.block_line, answered + 1)
        near, best = inf, None
        for block in range(first, last):
            far = _distance(place[:_XYZ], self._begin(block), self.block_end(block))
            if far < near - _ON_PATH_MM:
                near, best = far, block
        if best is None or near > _OFF_PATH_MM:
            return None
        return self.block_line[best]

    def highest_mm(self, line: int) -> float:
        """The highest Z up to there: high enough to get everywhere."""
        heights = self.block_ends[2 : _XYZ * self.blocks_before(line) : _XYZ]
        return max(self.start[2], max(heights, default=self.start[2]))

    def blocks_before(self, line: int) -> int:
        """How many blocks the lines before that one make."""
        return bisect_left(self.block_line, line)

    def block_end(self, block: int) -> Sequence[float]:
        """Where a block ends."""
        return self.block_ends[_XYZ * block : _XYZ * (block + 1)]

    def _begin(self, block: int) -> Sequence[float]:
        return self.block_end(block - 1) if block else self.start


def _distance(place: Sequence[float], begin: Sequence[float], end: Sequence[float]) -> float:
    """From a place to the nearest point of a straight line."""
    length_sqr = dist(begin, end) ** 2
    along = 0.0
    if length_sqr:
        dot = sum((p - b) * (e - b) for p, b, e in zip(place, begin, end, strict=True))
        along = min(1.0, max(0.0, dot / length_sqr))
    nearest = [b + along * (e - b) for b, e in zip(begin, end, strict=True)]
    return dist(place, nearest)


@dataclass
class Job:
    """What is to be rehearsed. ask_at: line before which modes and offsets are asked for.

    letters, axes: of the machine that it is for, as $I and $$ tell, where no board is named.
    custom: the user's own Python, a path; inputs: who pushes its inputs, as --input says it.
    """

    lines: Sequence[bytes]
    commands: list[str]
    board: str = machine.DEFAULT_BOARD
    ask_at: int = 0
    check: bool = False
    letters: str = ""
    axes: int = machine.DEFAULT_AXES
    custom: str = ""
    inputs: list[str] = field(default_factory=list)

    def around(self) -> machine.Around:
        """What is around the machine. ValueError where that cannot be."""
        rules = [inputs.rule(text) for text in self.inputs]
        return machine.around(self.board, Path(self.custom) if self.custom else None, rules)


class _Watcher(Recorder):
    """A Recorder that also notes where each block ends, and which line wants it."""

    def __init__(self, rig: "Rig") -> None:
        super().__init__(rig)
        self.forecast = Forecast()
        self._watching = False

    def begin(self) -> None:
        """The program is about to be sent."""
        self.start_clock()
        self._watching = True
        self.forecast.start = self._planned_place()

    def _note(self, row: int) -> None:
        super()._note(row)
        if self._watching and row != self._planner.flow[self._layout.ROWS]:
            self.forecast.block_line.append(self._rig.link.now_at())
            self.forecast.block_ends.extend(self._planned_place())

    def ask_place(self) -> None:
        """Note where it rests: not where the last block ends, if that was a probe's."""
        self.forecast.at_place = self._planned_place()

    def _planned_place(self) -> list[float]:
        """Where the last block ends."""
        from motion import planner
        from motion.steps import motor_steps

        made = self._rig.controller.planner
        steps = [position - planner._BIAS for position in made.position]
        if hasattr(self._beside, "skew"):  # it plans places of motors
            places = array("i", steps + [0 for _ in steps])
            motors = [motor_steps(places, 0, made.axes, moves) for moves in self._moves]
            steps = [self._beside.axis_steps(motors, i) for i in range(made.axes)]
        per_mm = made.steps_per_mm
        return [round(n / mm, 4) for n, mm in zip(steps[:_XYZ], per_mm, strict=False)]


class _Link(ProgramLink):
    """A ProgramLink that knows when each line was answered."""

    def __init__(self, rig: "Rig", script: Callable[[ProgramLink], Iterator[Step]]) -> None:
        super().__init__(rig, script)
        self.answered = array("q")  # ticks

    def _answer(self, line: str) -> None:
        super()._answer(line)
        if self._last:
            self.answered.append(self.rig.now)


def rehearse(job: Job, progress: Callable[[int], None] | None = None) -> tuple[Result, Forecast]:
    """Run a job. A command for the stage that the simulator refuses is left out.

    OwnPythonError where the user's own Python cannot be taken up.
    """

    def script(link: ProgramLink) -> Iterator[Step]:
        from base import state

        if link.rig.controller.state.run == state.ALARM:
            yield 0, b"$X"
        for command in [*job.commands, *(["$C"] if job.check else [])]:
            yield 0, command.encode("latin-1")
            yield None
        watcher.begin()
        before = max(job.ask_at - 1, 0)
        yield from link.program(job.lines[:before], progress, watcher.is_plain)
        if job.ask_at:
            yield from _ask(link, watcher)
        yield from link.program(job.lines[before:], progress, watcher.is_plain)
        yield None
        watcher.stop_clock(link.news)

    rig = machine.build(
        job.board,
        lambda rig: _Link(rig, script),
        letters=job.letters,
        axes=job.axes,
        around=job.around(),
    )
    if rig.custom_module:
        rig.custom_module.on_endless_wait, rig.custom_module.on_switched = (
            rig.link.stop,
            rig.link.note_output,
        )
    watcher = _Watcher(rig)
    begun = rig.now
    machine.run(rig)
    link: _Link = rig.link
    link.result.wide_arcs = watcher.wide_arcs
    if rig.custom_module:
        link.result.faults, link.result.own = (
            rig.custom_module.faults,
            rig.custom_module.handler_names(),
        )
    return link.result, _forecast(watcher, link, begun)


def _ask(link: ProgramLink, watcher: _Watcher) -> Iterator[Step]:
    yield None
    forecast = watcher.forecast
    watcher.ask_place()
    forecast.outputs_on = [
        name for name, on in {name: on for _, name, on in link.result.switched}.items() if on
    ]
    link.replies.clear()
    yield 0, b"$G"
    yield 0, b"$#"
    yield None
    forecast.at_line = [reply for reply in link.replies if reply.startswith("[")]


def _forecast(watcher: _Watcher, link: _Link, begun: int) -> Forecast:
    forecast = watcher.forecast
    begun = watcher._begun or begun
    hz = link.rig.engine.tick_hz
    forecast.answered_s = array("d", ((tick - begun) / hz for tick in link.answered))
    forecast.total_s = round(watcher.totals().time_s, 3)
    forecast.own = link.result.own
    forecast.refused = [line for line, _ in link.result.errors]
    forecast.stopped = link.result.stopped and (link.result.faults or [link.result.stopped])[-1]
    return forecast


def check(job: Job, progress: Callable[[int], None] | None = None) -> tuple[Result, int]:
    """What will be refused, and the line at which it stopped, if it did.

    Lines beginning with $ are for a machine that is not in check mode, and left out.
    """
    lines = Changed(job.lines, _without_dollar)
    result, _ = rehearse(replace(job, lines=lines, ask_at=0, check=True), progress)
    return result, result.other_output[-1][0] if result.stopped and result.other_output else 0


def _without_dollar(line: bytes) -> bytes:
    return b"" if line.lstrip().startswith(b"$") else line


class Rehearsal:
    """A job in a process of its own."""

    def __init__(self, job: Job) -> None:
        self.forecast: Forecast | None = None  # once it is known
        command = [sys.executable, "-m", f"{__package__}.rehearsal"]
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for the sender
        )
        self._thread = threading.Thread(target=self._talk, args=(job,), daemon=True)
        self._thread.start()

    def wait(self, seconds: float | None = None) -> Forecast | None:
        """The forecast, as soon as it is there; None where the simulator has failed."""
        self._thread.join(seconds)
        return self.forecast

    def close(self) -> None:
        """It is not needed any more."""
        self._process.kill()
        self._thread.join()

    def _talk(self, job: Job) -> None:
        try:
            with self._process as process:
                assert process.stdin and process.stdout
                with process.stdin as there:
                    pickle.dump(vars(job), there)
                forecast = pickle.load(process.stdout)
        except (OSError, EOFError, pickle.UnpicklingError):  # it has failed, or is not needed
            return
        if process.returncode == 0:
            self.forecast = Forecast(**forecast)


def main() -> None:
    """Rehearse what stdin says, when the computer has nothing better to do."""
    if hasattr(os, "nice"):
        os.nice(10)
    parent = os.getppid()

    def needed(line: int) -> None:
        if os.getppid() != parent:
            raise KeyboardInterrupt("who has asked for it is gone")

    out = sys.stdout.buffer
    sys.stdout = sys.stderr  # for what a handler prints
    try:
        _, forecast = rehearse(Job(**pickle.load(sys.stdin.buffer)), needed)
    except OwnPythonError as error:
        forecast = Forecast(stopped=str(error))
    pickle.dump(vars(forecast), out)


if __name__ == "__main__":
    main()
