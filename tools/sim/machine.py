"""A simulated machine for tests of senders and programs: lines in, answers, steps and pins out.

CPython only: the firmware runs its own endless loop, in a thread that waits wherever nothing is
asked of it. So virtual time stands still between two calls, and every run is like the last one.
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
_WIRE_MS = 20  # what has been said is on its way
_LIMIT_MS = 60_000
_SETTING = re.compile(r"\$(\d+)=(\S*)")
_OUTPUTS = "enable_pin spindle_on spindle_pwm spindle_dir flood mist own_outputs".split()


class Machine:
    """A machine that has been switched on, and has said what is in `welcome`.

    board: a name of boards/, the path of a file like those, or a module; settings: by $-number,
    besides the factory's. ValueError for a board that there is not. Times are in ms of the
    machine's own; where something takes longer than its limit, TimeoutError.
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
        store.files["settings"] += [f"${n}={value}" for n, value in (settings or {}).items()]
        self.rig = Rig(module, store)
        self._sender = Sender(self.rig)
        self._jobs: "queue.SimpleQueue[Job | None]" = queue.SimpleQueue()
        self._done: "queue.SimpleQueue[list[str] | BaseException]" = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._live, daemon=True)
        self._thread.start()
        self.welcome = self._do(lambda: self._until(self._has_welcomed), _BOOT_MS)

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
        """Switch it off."""
        if self._thread.is_alive():
            self._jobs.put(None)
            self._thread.join()

    # What a sender does

    def ask(self, line: str, limit_ms: float = _LIMIT_MS) -> "list[str]":
        """Send a line; the lines that come until it is answered, the answer last."""
        return self.program([line], limit_ms)

    def program(self, lines: "Iterable[str]", limit_ms: float = _LIMIT_MS) -> "list[str]":
        """Send lines as fast as there is room for them, until all are answered; what has come."""

        def job() -> "Generator[Any, None, list[str]]":
            yield from self._sender.stream([line.rstrip("\n") + "\n" for line in lines])
            return self._sender.take()

        return self._do(job, limit_ms)

    def send(self, text: "str | bytes") -> None:
        """Send that and wait for nothing: a real-time command, or lines without their answers."""
        data = text.encode("latin-1") if isinstance(text, str) else text
        self._act(lambda: self.rig.link.send(data))

    def status(self) -> str:
        """The answer to `?`."""
        self.send("?")
        lines = self._do(lambda: self._until(lambda: bool(self._reports())))
        return next(line for line in reversed(lines) if line.startswith("<"))

    def settings(self) -> "dict[int, str]":
        """What `$$` shows."""
        found = [_SETTING.fullmatch(line) for line in self.ask("$$")]
        return {int(row[1]): row[2] for row in found if row}

    # Time

    @property
    def now_ms(self) -> float:
        """How long it has been on."""
        return self.rig.now / self.rig.ticks_per_ms

    def run(self, ms: float) -> "list[str]":
        """Let so much time pass; the lines that have come."""

        def job() -> "Generator[Any, None, list[str]]":
            yield self.rig.ms(ms)
            return self._sender.take()

        return self._do(job)

    def rest(self, limit_ms: float = 10 * _LIMIT_MS) -> "list[str]":
        """Let time pass until motion has ended, in a hold or an alarm too; the lines that have
        come."""

        def job() -> "Generator[Any, None, list[str]]":
            yield from self._sender.until(self._sender.at_rest)
            yield self.rig.ms(_WIRE_MS)
            return self._sender.take()

        return self._do(job, limit_ms)

    # What is around it

    def steps(self) -> "list[int]":
        """The steps that each motor has made since the start, as the pins count them."""
        self.rig.engine.physical(self.rig.scratch)
        return list(self.rig.scratch)

    def outputs(self) -> "dict[str, int]":
        """Levels of the outputs; enable_pin 0: motors have power; spindle_pwm of PWM_MAX;
        own_outputs: a mask of an extra's pins."""
        return {name: int(getattr(self.rig.port, name)) for name in _OUTPUTS}

    def push(self, **pins: bool) -> None:
        """Close inputs, or open them: limit_x, probe, reset, hold, start."""
        self._act(lambda: self.rig.port.push(pins))

    def switch(self, pin: str, motor: int, steps: int, above: bool = True) -> None:
        """From now on an input is closed while a motor (from 0) is at so many steps or above, or
        at so many or below."""
        from .engine import Switch

        self.rig.engine.switches.append(Switch(pin, motor, above, steps))

    # The firmware's thread

    def _live(self) -> None:
        try:
            self.rig.run(self._script())
        except BaseException as error:  # whoever asks next is told
            self._done.put(error)

    def _script(self) -> "Generator[Any, None, None]":
        while (job := self._jobs.get()) is not None:
            try:
                done: "list[str] | BaseException" = yield from job()
            except Exception as error:
                done = error
            self._done.put(done)

    def _do(self, job: "Job", limit_ms: float = _LIMIT_MS) -> "list[str]":
        from .sender import TooLong

        if not self._thread.is_alive():
            raise RuntimeError("the machine is switched off")
        self._sender.allow(limit_ms)
        self._jobs.put(job)
        done = self._done.get()
        if isinstance(done, TooLong):
            raise TimeoutError(f"not within {limit_ms:g} ms of the machine's time") from done
        if isinstance(done, BaseException):
            raise done
        return done

    def _act(self, action: "Callable[[], None]") -> None:
        """Run that in the firmware's thread; no time passes."""

        def job() -> "Generator[Any, None, list[str]]":
            action()
            yield self.rig.now
            return []

        self._do(job)

    def _until(self, condition: "Callable[[], bool]") -> "Generator[Any, None, list[str]]":
        yield from self._sender.until(condition)
        return self._sender.take()

    def _reports(self) -> "list[str]":
        return [line for line in self._sender.lines if line.startswith("<")]

    def _has_welcomed(self) -> bool:
        return any(line.startswith("Grbl") for line in self._sender.lines)


def _load(board: "str | Path") -> "ModuleType":
    """A board file, by its name or its path. ValueError where there is none."""
    if str(paths.BOARDS.parent) not in sys.path:
        sys.path.append(str(paths.BOARDS.parent))  # board files take things from one another
    file = Path(board) if str(board).endswith(".py") else paths.BOARDS / f"{board}.py"
    found = importlib.util.spec_from_file_location(file.stem, file)
    if not file.is_file() or found is None or found.loader is None:
        raise ValueError(f"no board {str(board)!r}: there is no {file}")
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module
