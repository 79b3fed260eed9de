"""Rehearse a program in the simulator, with a machine in the same state as the real one.

check() is quick: it uses check mode, to find lines that will be refused. Rehearsal executes every
step, in a process of its own while the program is already being sent; its result gives the total
time and the machine's position at each time. Run as a program, this module is that process: it
reads a pickled Job from stdin and writes a pickled Forecast to stdout.

A script yields what its sender does next: a line with its number (0: it is not in the program), or
None: it waits until the machine is idle.
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

_ON_PATH_MM = 0.005  # a block must be closer than another one by more than that
_OFF_PATH_MM = 1.0  # a position further from all blocks is on none of them
_XYZ = 3  # numbers of a position


@dataclass
class Forecast:
    """What a program will do. Lines count from 1; positions are machine positions in mm.

    A long program has millions of lines and blocks, so their data are in arrays.
    """

    answered_s: "array[float]" = field(default_factory=lambda: array("d"))  # by line
    block_line: "array[int]" = field(default_factory=lambda: array("i"))  # by the planner's block
    block_ends: "array[float]" = field(default_factory=lambda: array("f"))  # three numbers each
    start: list[float] = field(default_factory=list)
    total_s: float = 0.0
    stopped: str = ""  # why the forecast ends early; "" if it does not
    # replies to $G and $# before the line Job.report_state_before_line
    at_line: list[str] = field(default_factory=list)
    at_place: list[float] = field(default_factory=list)  # machine position there
    refused: list[int] = field(default_factory=list)  # line numbers
    own: str = ""  # handlers of custom.py, as $I names them
    # outputs that custom.py has on there
    outputs_on: list[str] = field(default_factory=list)

    def seconds_left(self, line: int) -> float | None:
        """Return the time from the answer to a line until the end; None if it is not known."""
        if self.stopped or line > len(self.answered_s):
            return None
        return self.total_s - (self.answered_s[line - 1] if line else 0.0)

    def line_at(
        self, answered: int, place: Sequence[float], planned: int, left: int | None
    ) -> int | None:
        """Return the line that was executed when the machine stopped; None if that is not clear.

        answered: the last line answered. place: where it stopped. planned: capacity of the planner
        in blocks. left: blocks in the planner; None if the machine does not report them. Where the
        path crosses itself, the earlier line is returned, because it is better to repeat a part
        than to leave one out.
        """
        end = bisect_right(self.block_line, answered)  # number of blocks of the lines answered
        # The line after that may have put blocks into the planner before it is answered.
        end_with_next = bisect_right(self.block_line, answered + 1)
        # If these are one at most, the blocks in the planner are the last ones.
        if left is not None and end_with_next <= end + 1:
            return self.block_line[max(0, end - left)] if left and end else answered
        first = max(0, end - planned - 1)
        least_mm, nearest = inf, None
        for block in range(first, end_with_next):
            mm = _distance(place[:_XYZ], self._begin(block), self.block_end(block))
            if mm < least_mm - _ON_PATH_MM:
                least_mm, nearest = mm, block
        if nearest is None or least_mm > _OFF_PATH_MM:
            return None
        return self.block_line[nearest]

    def highest_mm(self, line: int) -> float:
        """Return the highest Z before a line: safe for moves to every position so far."""
        heights = self.block_ends[2 : _XYZ * self.blocks_before(line) : _XYZ]
        return max(self.start[2], max(heights, default=self.start[2]))

    def blocks_before(self, line: int) -> int:
        """Return the number of blocks of the lines before that one."""
        return bisect_left(self.block_line, line)

    def block_end(self, block: int) -> Sequence[float]:
        """Return the end of a block."""
        return self.block_ends[_XYZ * block : _XYZ * (block + 1)]

    def _begin(self, block: int) -> Sequence[float]:
        """Return the beginning of a block."""
        return self.block_end(block - 1) if block else self.start


def _distance(place: Sequence[float], begin: Sequence[float], end: Sequence[float]) -> float:
    """Return the distance from a point to a line segment, in mm."""
    length_sqr = dist(begin, end) ** 2
    share = 0.0  # part of the segment's length up to the nearest point
    if length_sqr:
        dot = sum((p - b) * (e - b) for p, b, e in zip(place, begin, end, strict=True))
        share = min(1.0, max(0.0, dot / length_sqr))
    nearest = [b + share * (e - b) for b, e in zip(begin, end, strict=True)]
    return dist(place, nearest)


@dataclass
class Job:
    """A program to rehearse. check: in check mode. report_state_before_line: the line before which
    position, modes and offsets are put into the forecast; 0: never.

    letters, axes: of the real machine, from $I and $$, if no board is named. custom: path of the
    user's own Python. inputs: rules for its inputs, as for --input.
    """

    lines: Sequence[bytes]
    commands: list[str]
    board: str = machine.DEFAULT_BOARD
    report_state_before_line: int = 0
    check: bool = False
    letters: str = ""
    axes: int = machine.DEFAULT_AXES
    custom: str = ""
    inputs: list[str] = field(default_factory=list)

    def around(self) -> machine.Around:
        """Return the surroundings of the machine. ValueError if they are not possible."""
        rules = [inputs.rule(text) for text in self.inputs]
        return machine.around(self.board, Path(self.custom) if self.custom else None, rules)


class _Watcher(Recorder):
    """A Recorder that also records the end of each block and its line."""

    def __init__(self, rig: "Rig") -> None:
        super().__init__(rig)
        self.forecast = Forecast()
        self._watching = False

    def begin(self) -> None:
        """Start recording: the program follows."""
        self.start_clock()
        self._watching = True
        self.forecast.start = self._planned_place()

    def _note(self, row: int) -> None:
        """Note a planned block, with its end and its line."""
        super()._note(row)
        is_spare_row = row == self._planner.flow[self._layout.ROWS]  # takes up backlash only
        if self._watching and not is_spare_row:
            self.forecast.block_line.append(self._rig.link.now_at())
            self.forecast.block_ends.extend(self._planned_place())

    def ask_place(self) -> None:
        """Note the position at standstill. It is not the end of the last block if that block was a
        probing motion."""
        self.forecast.at_place = self._planned_place()

    def _planned_place(self) -> list[float]:
        """Return the end of the last block, in mm."""
        from motion import planner as planners
        from motion.steps import motor_steps

        planner = self._rig.controller.planner
        steps = [position - planners._BIAS for position in planner.position]  # stored with a bias
        if hasattr(self._deviating, "skew"):  # its planner has positions of motors, not of axes
            places = array("i", steps + [0 for _ in steps])
            motors = [motor_steps(places, 0, planner.axes, moves) for moves in self._axes_of_motor]
            steps = [self._deviating.axis_steps(motors, axis) for axis in range(planner.axes)]
        resolutions = planner.steps_per_mm
        return [round(n / per_mm, 4) for n, per_mm in zip(steps[:_XYZ], resolutions, strict=False)]


class _Link(ProgramLink):
    """A ProgramLink that records when each line was answered."""

    def __init__(self, rig: "Rig", script: Callable[[ProgramLink], Iterator[Step]]) -> None:
        super().__init__(rig, script)
        self.answered = array("q")  # in ticks

    def _answer(self, line: str) -> None:
        """Process an answer, and note its time."""
        super()._answer(line)
        if self._answered_line:  # a line of the program
            self.answered.append(self.rig.now)


def rehearse(job: Job, progress: Callable[[int], None] | None = None) -> tuple[Result, Forecast]:
    """Run a job. Commands for the initial state that the simulator refuses are skipped.

    OwnPythonError if the user's own Python cannot be loaded.
    """

    def script(link: ProgramLink) -> Iterator[Step]:
        """Set the initial state, then send the program with the clock running."""
        from base import state

        if link.rig.controller.state.run == state.ALARM:
            yield 0, b"$X"
        for command in [*job.commands, *(["$C"] if job.check else [])]:
            yield 0, command.encode("latin-1")
            yield None
        watcher.begin()
        lines_before = max(job.report_state_before_line - 1, 0)
        yield from link.program(job.lines[:lines_before], progress, watcher.is_plain)
        if job.report_state_before_line:
            yield from _ask_state(link, watcher)
        yield from link.program(job.lines[lines_before:], progress, watcher.is_plain)
        yield None
        watcher.stop_clock(link.last_event)

    rig = machine.build(
        job.board,
        lambda rig: _Link(rig, script),
        letters=job.letters,
        axes=job.axes,
        around=job.around(),
    )
    if rig.custom_module:
        rig.custom_module.on_endless_wait = rig.link.stop
        rig.custom_module.on_switched = rig.link.note_output
    watcher = _Watcher(rig)
    begun = rig.now
    machine.run(rig)
    link: _Link = rig.link
    link.result.wide_arcs = watcher.wide_arcs
    if rig.custom_module:
        link.result.faults = rig.custom_module.faults
        link.result.own = rig.custom_module.handler_names()
    return link.result, _forecast(watcher, link, begun)


def _ask_state(link: ProgramLink, watcher: _Watcher) -> Iterator[Step]:
    """Yield the steps that put position, outputs, modes and offsets into the forecast."""
    yield None
    forecast = watcher.forecast
    watcher.ask_place()
    last_levels = {name: on for _, name, on in link.result.switched}
    forecast.outputs_on = [name for name, on in last_levels.items() if on]
    link.replies.clear()
    yield 0, b"$G"
    yield 0, b"$#"
    yield None
    forecast.at_line = [reply for reply in link.replies if reply.startswith("[")]


def _forecast(watcher: _Watcher, link: _Link, begun: int) -> Forecast:
    """Return the complete forecast. begun: the tick of its start if the program did not begin."""
    forecast = watcher.forecast
    begun = watcher._begun or begun
    hz = link.rig.engine.tick_hz
    forecast.answered_s = array("d", ((tick - begun) / hz for tick in link.answered))
    forecast.total_s = round(watcher.totals().time_s, 3)
    forecast.own = link.result.own
    forecast.refused = [line for line, _ in link.result.errors]
    if link.result.stopped:  # a handler's fault, if there is one, is the cause
        forecast.stopped = (link.result.faults or [link.result.stopped])[-1]
    return forecast


def check(job: Job, progress: Callable[[int], None] | None = None) -> tuple[Result, int]:
    """Check a program in check mode. Returns the result, with the refused lines, and the line at
    which the check stopped; 0 if it did not.

    Lines that begin with $ are left out, because check mode does not allow them.
    """
    lines = Changed(job.lines, _without_dollar)
    result, _ = rehearse(
        replace(job, lines=lines, report_state_before_line=0, check=True), progress
    )
    if not result.stopped or not result.other_output:
        return result, 0
    stopped_at, _ = result.other_output[-1]  # the last message is that of the stop
    return result, stopped_at


def _without_dollar(line: bytes) -> bytes:
    """Return the line, or an empty one instead of a line that begins with $."""
    return b"" if line.lstrip().startswith(b"$") else line


class Rehearsal:
    """A job in a process of its own."""

    def __init__(self, job: Job) -> None:
        self.forecast: Forecast | None = None  # None until it is known
        command = [sys.executable, "-m", f"{__package__}.rehearsal"]
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # so that Ctrl-C reaches only the sender
        )
        self._thread = threading.Thread(target=self._talk, args=(job,), daemon=True)
        self._thread.start()

    def wait(self, seconds: float | None = None) -> Forecast | None:
        """Return the forecast when it is available; None if the simulator has failed, or after
        `seconds`."""
        self._thread.join(seconds)
        return self.forecast

    def close(self) -> None:
        """End the process; the forecast is no longer needed."""
        self._process.kill()
        self._thread.join()

    def _talk(self, job: Job) -> None:
        """Send the job to the process, and receive its forecast."""
        try:
            with self._process as process:
                assert process.stdin and process.stdout
                with process.stdin as stdin:
                    pickle.dump(vars(job), stdin)
                forecast = pickle.load(process.stdout)
        except (OSError, EOFError, pickle.UnpicklingError):  # the process has failed or was killed
            return
        if process.returncode == 0:
            self.forecast = Forecast(**forecast)


def main() -> None:
    """Rehearse the job from stdin, at low priority."""
    if hasattr(os, "nice"):
        os.nice(10)
    parent = os.getppid()

    def stop_if_orphan(_line: int) -> None:
        """Stop if the process that waits for the forecast has ended. Called as progress."""
        if os.getppid() != parent:
            raise KeyboardInterrupt("who has asked for it is gone")

    out = sys.stdout.buffer
    sys.stdout = sys.stderr  # for output of handlers
    try:
        _, forecast = rehearse(Job(**pickle.load(sys.stdin.buffer)), stop_if_orphan)
    except OwnPythonError as error:
        forecast = Forecast(stopped=str(error))
    pickle.dump(vars(forecast), out)


if __name__ == "__main__":
    main()
