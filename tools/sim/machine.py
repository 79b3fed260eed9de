"""A simulated machine for tests of senders and programs: lines in; answers, steps and pins out.

CPython only: the firmware runs its own endless loop, in a thread that waits when nothing is
requested. So virtual time stands still between two calls, and every run has the same result.
"""

import importlib.util
import queue
import re
import sys
import threading
from pathlib import Path

from .. import paths

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Mapping
    from types import ModuleType, TracebackType
    from typing import Any

    Job = Callable[[], Generator[Any, None, list[str]]]

_BOOT_MS = 20_000
_WIRE_MS = 20  # time for the last reply to arrive
_LIMIT_MS = 60_000
_SETTING = re.compile(r"\$(\d+)=(\S*)")
_OUTPUTS = "enable_pin spindle_on spindle_pwm spindle_dir flood mist own_outputs".split()


class Machine:
    """A machine that has been switched on; `welcome` has the lines of its welcome.

    board: a name in boards/, the path of a board file, or a module. settings: by $-number, in
    addition to the factory settings. ValueError for a board that does not exist. Times are in ms
    of virtual time; if something takes longer than its limit, TimeoutError is raised.
    """

    def __init__(
        self,
        board: "str | Path | ModuleType" = "sim",
        settings: "Mapping[int, float] | None" = None,
    ) -> None:
        paths.use_firmware()
        from .replay import factory_store
        from .rig import Rig
        from .sender import Sender

        module: "Any" = _load(board) if isinstance(board, (str, Path)) else board
        store = factory_store(module)
        store.files["settings"] += [
            f"${number}={value}" for number, value in (settings or {}).items()
        ]
        self.rig = Rig(module, store)
        self._sender = Sender(self.rig)
        # For the firmware's thread: jobs, which are generators for the rig's script; None is the
        # end. From it: the result of each one, or its exception.
        self._jobs: "queue.SimpleQueue[Job | None]" = queue.SimpleQueue()
        self._done: "queue.SimpleQueue[list[str] | BaseException]" = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run_firmware, daemon=True)
        self._thread.start()
        self.welcome = self._do(lambda: self._lines_until(self._has_welcomed), _BOOT_MS)

    def __enter__(self) -> "Machine":
        return self

    def __exit__(
        self,
        kind: "type[BaseException] | None",
        error: "BaseException | None",
        trace: "TracebackType | None",
    ) -> None:
        self.close()

    def close(self) -> None:
        """Switch the machine off."""
        if self._thread.is_alive():
            self._jobs.put(None)
            self._thread.join()

    # Functions of a sender

    def ask(self, line: str, limit_ms: float = _LIMIT_MS) -> "list[str]":
        """Send a line. Returns the lines received until it is answered; the answer is the last
        one. limit_ms: of virtual time, else TimeoutError."""
        return self.program([line], limit_ms)

    def program(self, lines: "Iterable[str]", limit_ms: float = _LIMIT_MS) -> "list[str]":
        """Send lines as fast as the buffer allows, until all are answered. Returns the lines
        received."""

        def job() -> "Generator[Any, None, list[str]]":
            yield from self._sender.stream([line.rstrip("\n") + "\n" for line in lines])
            return self._sender.take()

        return self._do(job, limit_ms)

    def send(self, text: "str | bytes") -> None:
        """Send text without waiting: a real-time command, or lines whose answers are read
        later."""
        data = text.encode("latin-1") if isinstance(text, str) else text
        self._act(lambda: self.rig.link.send(data))

    def status(self) -> str:
        """Return the answer to `?`."""
        self.send("?")
        lines = self._do(lambda: self._lines_until(lambda: bool(self._reports())))
        return next(line for line in reversed(lines) if line.startswith("<"))

    def settings(self) -> "dict[int, str]":
        """Return the settings that `$$` shows."""
        matches = [_SETTING.fullmatch(line) for line in self.ask("$$")]
        return {int(match[1]): match[2] for match in matches if match}

    # Time

    @property
    def now_ms(self) -> float:
        """Return the time since power-up."""
        return self.rig.now / self.rig.ticks_per_ms

    def run(self, ms: float) -> "list[str]":
        """Let so much time pass. Returns the lines received."""

        def job() -> "Generator[Any, None, list[str]]":
            yield self.rig.ms(ms)
            return self._sender.take()

        return self._do(job)

    def rest(self, limit_ms: float = 10 * _LIMIT_MS) -> "list[str]":
        """Let time pass until motion has ended, also in a hold or an alarm. Returns the lines
        received."""

        def job() -> "Generator[Any, None, list[str]]":
            yield from self._sender.until(self._sender.at_rest)
            yield self.rig.ms(_WIRE_MS)
            return self._sender.take()

        return self._do(job, limit_ms)

    # Inputs and outputs

    def steps(self) -> "list[int]":
        """Return the steps that each motor has made since the start, counted at the pins."""
        self.rig.engine.physical(self.rig.scratch)
        return list(self.rig.scratch)

    def outputs(self) -> "dict[str, int]":
        """Return the levels of the outputs. enable_pin 0: motors have power. spindle_pwm: of
        PWM_MAX. own_outputs: a mask of an extra's pins."""
        return {name: int(getattr(self.rig.port, name)) for name in _OUTPUTS}

    def push(self, **pins: bool) -> None:
        """Close or open inputs: limit_x, probe, reset, hold, start."""
        self._act(lambda: self.rig.port.push(pins))

    def switch(self, pin: str, motor: int, steps: int, above: bool = True) -> None:
        """From now on, close an input while a motor (from 0) is at so many steps or above; with
        above=False, at so many or below. pin: as for push()."""
        from .engine import Switch

        self.rig.engine.switches.append(Switch(pin, motor, above, steps))

    # The firmware's thread

    def _run_firmware(self) -> None:
        """Run the firmware until the machine is switched off. This is the thread."""
        try:
            self.rig.run(self._script())
        except BaseException as error:  # raised in the next call
            self._done.put(error)

    def _script(self) -> "Generator[Any, None, None]":
        """Do one job after another, and wait while there is none. The rig runs this script; while
        it waits for a job, virtual time stands still."""
        while (job := self._jobs.get()) is not None:
            try:
                result: "list[str] | BaseException" = yield from job()
            except Exception as error:
                result = error
            self._done.put(result)

    def _do(self, job: "Job", limit_ms: float = _LIMIT_MS) -> "list[str]":
        """Have the firmware's thread do a job; returns its result, or raises its exception."""
        from .sender import TooLong

        if not self._thread.is_alive():
            raise RuntimeError("the machine is switched off")
        self._sender.allow(limit_ms)
        self._jobs.put(job)
        result = self._done.get()
        if isinstance(result, TooLong):
            raise TimeoutError(
                f"the call did not end within {limit_ms:g} ms of the machine's time"
            ) from result
        if isinstance(result, BaseException):
            raise result
        return result

    def _act(self, action: "Callable[[], None]") -> None:
        """Run an action in the firmware's thread; no time passes."""

        def job() -> "Generator[Any, None, list[str]]":
            action()
            yield self.rig.now  # a job is a generator: resumed at once
            return []

        self._do(job)

    def _lines_until(self, condition: "Callable[[], bool]") -> "Generator[Any, None, list[str]]":
        """Wait until a condition is true. Returns the lines received. This is a job for _do()."""
        yield from self._sender.until(condition)
        return self._sender.take()

    def _reports(self) -> "list[str]":
        """Return the status reports received."""
        return [line for line in self._sender.lines if line.startswith("<")]

    def _has_welcomed(self) -> bool:
        return any(line.startswith("Grbl") for line in self._sender.lines)


def _load(board: "str | Path") -> "ModuleType":
    """Load a board file by its name or its path. ValueError if it does not exist."""
    if str(paths.BOARDS.parent) not in sys.path:
        sys.path.append(str(paths.BOARDS.parent))  # board files import each other
    file = Path(board) if str(board).endswith(".py") else paths.BOARDS / f"{board}.py"
    spec = importlib.util.spec_from_file_location(file.stem, file)
    if not file.is_file() or spec is None or spec.loader is None:
        raise ValueError(f"no board {str(board)!r}: there is no {file}")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
