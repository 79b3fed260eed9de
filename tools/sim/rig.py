"""The rig: firmware, engine, pins and wire in one virtual clock, driven by a script.

The firmware runs its own endless loop. When it asks the link for bytes and
there are none, the rig lets time pass to the next event and lets the script
look. A script is a generator: it acts on the rig and yields either a tick to
be woken at or a function to be called after every event until it returns True.
"""

from array import array

from boot import wiring

from .engine import SimEngine
from .full_segments import FullSegments
from .laser import SimBeamEngine
from .link import SimLink
from .port import SimPort
from .punch import PunchEngine, PunchPort
from .tmc2209 import DriverBus

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from typing import Any

    from interfaces import Store
    from talk.controller import Controller

    Wake = int | Callable[[], bool]
    Script = Iterator[Wake]

# Segments under way where a board has hardware that says it.
_SEGMENT_QUEUE = 5
_POLL_MS = 1  # while nothing else is due, the firmware's loop turns this often in motion


class PowerOff(KeyboardInterrupt):
    """Unwinds the firmware when the script ends or cycles the power. As Ctrl-C on a board it is
    nothing that the user's own Python has done."""


class MemoryStore:
    """A Store in memory: it survives power cycles of the rig."""

    def __init__(self) -> None:
        self.files: "dict[str, list[str]]" = {}
        self.damaged: "dict[str, bool]" = {}

    def load(self, name: str) -> "list[str] | None":
        return self.files.get(name)

    def save(self, name: str, lines: "Iterable[str]") -> None:
        self.files[name] = list(lines)


class _AtRest:
    """A Store in front of the rig's, and files of jobs beside it: they are written at rest only.

    On a board flash stops the processor, and pulses with it; here a write in motion is an error,
    in whatever is run on a rig.
    """

    def __init__(self, store: "Store", idle: "Callable[[], bool]") -> None:
        self._store = store
        self._idle = idle
        self.damaged = store.damaged

    def load(self, name: str) -> "list[str] | None":
        return self._store.load(name)

    def save(self, name: str, lines: "Iterable[str]") -> None:
        self.before()
        self._store.save(name, lines)

    def before(self) -> None:
        """Called before anything is written, as a board's store has it."""
        if not self._idle():
            raise RuntimeError("something is stored while the motors turn")


class _Board:
    """A board's own words, as its module has them."""


def _without_custom(board: "Any") -> "Any":
    """A copy of it that reads no Python of the user's, whatever lies where this is run."""
    made = _Board()
    for name, value in dict(board.__dict__, CUSTOM="").items():
        if name[:2] != "__":
            setattr(made, name, value)
    return made


class Rig:
    """One simulated machine. board: a module as in boards/; store: a Store; link: makes a Link.

    full: segments are not cut into slices, as Grbl's are not. coarse: nor are they, and full ones
    are so many times as long as Grbl's 10 ms. Steps are the same, and take as long all together;
    what is between the ends of a segment is less exact, and there are fewer.
    """

    idle_poll_ms = _POLL_MS  # and at rest, where nobody pushes inputs

    def __init__(
        self,
        board: "Any",
        store: "Store | None" = None,
        link: "Callable[[Rig], Any]" = SimLink,
        coarse: int = 1,
        full: bool = False,
    ) -> None:
        axes = len(board.STEP)
        self.board = board if hasattr(board, "CUSTOM") else _without_custom(board)
        self.store: "Any" = MemoryStore() if store is None else store
        tool = getattr(board, "TOOL", "spindle")
        has_punch = tool == "punch"
        engine = {"punch": PunchEngine, "laser": SimBeamEngine}.get(tool, SimEngine)
        self.engine = engine(axes, getattr(board, "SEGMENT_QUEUE", _SEGMENT_QUEUE))
        self.engine.tick_hz = SimEngine.tick_hz // coarse
        self._full = full or coarse > 1
        self.ticks_per_ms = self.engine.tick_hz / 1000
        self.drivers = DriverBus(getattr(board, "TMC2209", ()), self.engine.idle)
        self.scratch = array("i", [0] * axes)
        self.loop_ticks = int(getattr(board, "LOOP_US", 0) * self.ticks_per_ms / 1000)
        start_ticks = int(getattr(board, "START_US", 0) * self.ticks_per_ms / 1000)
        if start_ticks:
            self.engine.prepare = lambda: self.pass_time(self.now + start_ticks)
        self.answer_ticks = int(getattr(board, "ANSWER_US", 0) * self.ticks_per_ms / 1000)
        self.port = (PunchPort if has_punch else SimPort)(self, board)
        self.engine.pins_changed = self.port.update
        if isinstance(self.engine, SimBeamEngine):
            self.engine.burning = lambda: self.port.spindle_pwm
        self.inputs: "Any" = None  # who pushes them, and the user's own Python: see tools/run/
        self.custom_module: "Any" = None
        self.link: "Any" = link(self)
        self.controller: "Controller"  # once run() has built it
        self.on_built: "Callable[[], None] | None" = (
            None  # called whenever a new controller has been built
        )
        self._script: "Script"
        self._wake: "Wake"
        self._cycle = False

    @property
    def now(self) -> int:
        """Virtual time in ticks of the engine."""
        return self.engine.now

    def ms(self, milliseconds: float) -> int:
        """The tick so many milliseconds from now."""
        return self.now + int(milliseconds * self.ticks_per_ms)

    def run(self, script: "Script") -> None:
        """Power up and run the firmware until the script, a generator, ends."""
        self._script = script
        self._wake = self.now
        while True:
            self._cycle = False
            self.drivers.attach(getattr(self.board, "TMC_UART", ()))
            try:
                store = _AtRest(self.store, self.engine.idle)
                self.controller = wiring.build(
                    self.board, self.link, self.port, self.engine, store
                )
                self._give_reports_time()
                if self._full and not isinstance(self.engine, SimBeamEngine):
                    FullSegments(self.controller).attach()
                if self.on_built:
                    self.on_built()
                self.controller.power_up()
                self.controller.protocol.run()
            except PowerOff:
                self.engine.power_off()
                self.port.power_off()
                self.link.power_off()
            if not self._cycle:
                return

    def _give_reports_time(self) -> None:
        """A status report takes its time to make: what is asked meanwhile is answered by it."""

        def field() -> str:
            self.pass_time(self.now + self.answer_ticks)
            return ""

        if self.answer_ticks:
            self.controller.state.hooks.fields += (field,)

    def cycle_power(self) -> None:
        """Called by the script: the firmware starts anew, memory kept, once the script yields."""
        self._cycle = True

    def power_off(self) -> None:
        """Called by a link: the machine is not needed any more."""
        raise PowerOff()

    def moving(self) -> bool:
        """The motors are turning."""
        return not self.engine.idle()

    def wait(self) -> None:
        """The firmware has nothing to read: let time pass to the next event."""
        looked_at = self.inputs or not self.engine.idle()
        self.pass_time(self.ms(_POLL_MS if looked_at else self.idle_poll_ms), True)

    def skip(self) -> None:
        """Let time pass, without a script, until something may have changed by itself."""
        engine = self.engine
        to = self.ms(_POLL_MS) if engine.idle() else engine.next_event()
        engine.advance(max(to, self.now))

    def pass_time(self, to: int, or_arrival: bool = False) -> None:
        """Let time pass until `to`, or a byte arrives, waking the script where it asked for it."""
        engine, link = self.engine, self.link
        while True:
            step = to
            arrival = link.next_event() if or_arrival else None
            if arrival is not None and arrival < step:
                step = arrival
            wake = self._wake
            if not callable(wake) and wake < step:
                step = wake
            event = engine.next_event()
            if event > step >= engine.now:
                engine.now = step  # nothing happens there until then: what most turns are
            else:
                engine.advance(max(min(event, step), engine.now))
            link.advance()
            self._wake_script()
            arrival = link.next_event() if or_arrival else None
            if engine.now >= to or (arrival is not None and arrival <= engine.now):
                return

    def _wake_script(self) -> None:
        while self._wake() if callable(self._wake) else self._wake <= self.engine.now:
            try:
                self._wake = next(self._script)
            except StopIteration:
                raise PowerOff()
            if self._cycle:
                raise PowerOff()
