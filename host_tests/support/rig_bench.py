"""A whole simulated machine for tests: lines and real-time bytes in, everything recorded."""

from array import array
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from types import ModuleType
from typing import Any

from base import state as st
from laws import Limits, Watch
from ugrbl.boardfile.files import load_board
from ugrbl.sim.replay import factory_store
from ugrbl.sim.rig import Rig
from ugrbl.sim.sender import Sender

_WINDOW = 127
_LIMIT_MS = 600_000


class Machine:
    """The firmware on the simulator.

    settings: values by $-number that differ from the factory's. watched: its settings are sound,
    and
    its plans and segments are recorded for the laws.
    """

    def __init__(
        self,
        settings: "dict[int, float] | None" = None,
        board: "str | ModuleType" = "sim",
        watched: bool = True,
    ) -> None:
        module = load_board(board) if isinstance(board, str) else board
        store = factory_store(module)
        store.files["settings"] += [f"${n}={value}" for n, value in (settings or {}).items()]
        self.rig = Rig(module, store)
        if watched:
            self.rig.on_built = self._built
        self.rig.engine.trace = self._trace
        self.sender = Sender(self.rig)
        self.rows: list[tuple[int, array[int]]] = []
        self.received: list[str] = []

    def _built(self) -> None:
        controller: Any = self.rig.controller
        settings = controller.settings
        settings.load()
        self.limits = Limits.of(settings, self.rig.engine.max_step_hz(settings.step_pulse_us))
        self.watch = Watch(
            controller.planner, controller.segments, self.limits, self.rig.engine.tick_hz
        )
        # The function that the engine is about to be given, extras included.
        hooks = controller.state.hooks
        self.watch._next, hooks.next_segment = hooks.next_segment, self.watch.next

    def _trace(self, start: int, row: "array[int]") -> None:
        self.rows.append((start, row[:]))

    def physical(self) -> "list[int]":
        """Return the motors' position."""
        self.rig.engine.physical(self.rig.scratch)
        return list(self.rig.scratch)

    def reported(self) -> "list[float]":
        """Return MPos of the last status report."""
        report = next(line for line in reversed(self.received) if line.startswith("<"))
        return [float(x) for x in report.split("MPos:")[1].split("|")[0].split(",")]

    def play(self, lines: Sequence[str], events: "Iterable[tuple[int, str]]" = ()) -> None:
        """Stream lines, send real-time bytes at their ms, come to rest, ask for a report."""
        self.run(self._play(lines, sorted(events)))

    def run(self, script: Iterator[Any]) -> None:
        """Run the firmware with a script; raise the script's exception here."""
        failed: list[Exception] = []

        def guarded() -> Iterator[Any]:
            try:
                yield from script
            except Exception as error:
                failed.append(error)

        self.rig.run(guarded())
        if failed:
            raise failed[0]

    def start(self) -> Iterator[Any]:
        """Wait for the banner."""
        self.sender.allow(_LIMIT_MS)
        yield from self.sender.wait("banner", "")
        self.take()

    def take(self) -> "list[str]":
        """Return the lines received since the last call; `received` has all of them."""
        lines = self.sender.take()
        self.received += lines
        return lines

    def _play(self, lines: Sequence[str], events: "list[tuple[int, str]]") -> Iterator[Any]:
        yield from self.start()
        rig, sender = self.rig, self.sender
        waiting = deque(line + "\n" for line in lines)
        sent: deque[str] = deque()
        due = deque((rig.ms(ms), byte) for ms, byte in events)
        while waiting or sent or due:
            for line in self.take():
                if line.startswith("Grbl"):
                    sent.clear()
                    waiting.appendleft("$X\n")
                elif line == "ok" or line.startswith("error:"):
                    if sent:
                        sent.popleft()
            while due and due[0][0] <= rig.now:
                rig.link.send(due.popleft()[1].encode("latin-1"))
            while waiting and sum(map(len, [*sent, waiting[0]])) <= _WINDOW:
                sent.append(waiting.popleft())
                rig.link.send(sent[-1].encode())
            if not due and (sent or waiting):
                self._go_on()
            wake = due[0][0] if due else rig.ms(20)
            yield lambda wake=wake: sender.poll() or bool(sender.lines) or rig.now >= wake
        yield from self.rest()

    def converse(self, lines: Sequence[str], answered: "Callable[[str, list[str]], None]") -> None:
        """Send lines one by one; call answered(line, replies) after each."""

        def script() -> Iterator[Any]:
            yield from self.start()
            for line in lines:
                yield from self.sender.wait("idle", line + "\n", 1)
                answered(line, self.take())

        self.run(script())

    def _go_on(self) -> None:
        """Resume a machine in hold."""
        controller: Any = self.rig.controller
        if controller.state.run & (st.HOLD | st.DOOR):
            self.rig.link.send(b"~")

    def rest(self) -> Iterator[Any]:
        """Wait until the machine is at rest, and report."""
        rig = self.rig
        yield rig.ms(700)  # a pending reset or an alarm would discard the question
        while not self.idle():
            self._go_on()
            yield rig.ms(20)
            assert rig.now < self.sender.deadline, "the machine does not come to rest"
        self.take()
        yield from self.sender.wait("report", "?")
        self.take()

    def idle(self) -> bool:
        """Return whether nothing moves, and nothing will."""
        controller: Any = self.rig.controller
        state = controller.state
        quiet = not self.rig.moving() and self.rig.link.next_event() is None
        return quiet and state.run in (st.IDLE, st.ALARM, st.CHECK) and controller.planner.empty()
