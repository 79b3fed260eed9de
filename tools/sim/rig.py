"""The rig: firmware, engine, pins and wire on one virtual clock, driven by a script.

The firmware runs its own endless loop. When it asks the link for bytes and there are none, the rig
lets time pass to the next event and resumes the script. A script is a generator: it acts on the
rig and yields either a tick at which it is resumed, or a function that is called after every event
until it returns True.
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

# Segments in the engine at a time, as on a board where hardware plays them.
_SEGMENT_QUEUE = 5
_POLL_MS = 1  # in motion, the firmware's loop runs this often while nothing else is due


class PowerOff(KeyboardInterrupt):
    """Unwinds the firmware when the script ends or cycles the power. A KeyboardInterrupt, as for
    Ctrl-C on a board, so that it does not count as a fault of the user's own Python."""


class MemoryStore:
    """A Store in memory: it survives power cycles of the rig."""

    def __init__(self) -> None:
        self.files: "dict[str, list[str]]" = {}
        self.damaged: "dict[str, bool]" = {}

    def load(self, name: str) -> "list[str] | None":
        return self.files.get(name)

    def save(self, name: str, lines: "Iterable[str]") -> None:
        self.files[name] = list(lines)


class _NoWritesInMotion:
    """A Store in front of the rig's, and of job files: it checks that nothing is written during
    motion.

    On a board, a write to flash stops the processor, and the pulses with it. On a rig, a write
    during motion raises an exception.
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
        """Check that nothing moves. Called before anything is written, as by a board's store."""
        if not self._idle():
            raise RuntimeError("firmware bug: something is stored while the motors turn")


class _Board:
    """A board's options."""


def _without_custom(board: "Any") -> "Any":
    """Return a copy of a board that reads no Python of the user's, whatever is in the current
    folder: by default the firmware would load custom.py from there."""
    copied = _Board()
    for name, value in dict(board.__dict__, CUSTOM="").items():
        if name[:2] != "__":  # no attribute of the module itself
            setattr(copied, name, value)
    return copied


class Rig:
    """One simulated machine. board: a module as in boards/; store: a Store; link: makes a Link.

    full: segments are not cut into slices, as in Grbl. coarse: also not cut, and full segments are
    so many times as long as Grbl's 10 ms. The steps are the same, and take the same time in total;
    there are fewer segments, and the times within a segment are less exact.
    """

    idle_poll_ms = _POLL_MS  # and when idle, if nothing pushes inputs

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
        engine_of_tool = {"punch": PunchEngine, "laser": SimBeamEngine}.get(tool, SimEngine)
        self.engine = engine_of_tool(axes, getattr(board, "SEGMENT_QUEUE", _SEGMENT_QUEUE))
        self.engine.tick_hz = SimEngine.tick_hz // coarse
        self._full = full or coarse > 1
        self.ticks_per_ms = self.engine.tick_hz / 1000
        self.drivers = DriverBus(getattr(board, "TMC2209", ()), self.engine.idle)
        self.scratch = array("i", [0] * axes)  # for steps of motors that are used at once
        # How long parts of the firmware take, 0 by default: a turn of its loop, each `ok` and
        # status report, the start of motion.
        ticks_per_us = self.ticks_per_ms / 1000
        self.loop_ticks = int(getattr(board, "LOOP_US", 0) * ticks_per_us)
        self.answer_ticks = int(getattr(board, "ANSWER_US", 0) * ticks_per_us)
        start_ticks = int(getattr(board, "START_US", 0) * ticks_per_us)
        if start_ticks:
            self.engine.prepare = lambda: self.pass_time(self.now + start_ticks)
        self.port = (PunchPort if has_punch else SimPort)(self, board)
        self.engine.pins_changed = self.port.update
        if isinstance(self.engine, SimBeamEngine):
            self.engine.burning = lambda: self.port.spindle_pwm
        self.inputs: "Any" = None  # pushed by rules, and the user's own Python: see tools/run/
        self.custom_module: "Any" = None
        self.link: "Any" = link(self)
        self.controller: "Controller"  # set by run()
        # called whenever a new controller has been built
        self.on_built: "Callable[[], None] | None" = None
        self._script: "Script"
        self._wake: "Wake"  # when to resume the script: a tick, or a condition
        self._restarts = False  # the script has asked for cycle_power()

    @property
    def now(self) -> int:
        """Return the virtual time in ticks of the engine."""
        return self.engine.now

    def ms(self, milliseconds: float) -> int:
        """Return the tick that is so many milliseconds from now."""
        return self.now + int(milliseconds * self.ticks_per_ms)

    def run(self, script: "Script") -> None:
        """Power up and run the firmware until the script, a generator, ends; power up again each
        time that it cycles the power. At the end the outputs of the port stay as they are."""
        self._script = script
        self._wake = self.now
        while True:
            self._restarts = False
            self.drivers.attach(getattr(self.board, "TMC_UART", ()))
            try:
                store = _NoWritesInMotion(self.store, self.engine.idle)
                self.controller = wiring.build(
                    self.board, self.link, self.port, self.engine, store
                )
                self._give_reports_time()
                if self._full and not isinstance(self.engine, SimBeamEngine):
                    FullSegments(self.controller).attach()
                if self.on_built:
                    self.on_built()
                self.controller.power_up()
                self.controller.protocol.run()  # endless: PowerOff is raised inside
            except PowerOff:
                self.engine.power_off()
                self.link.power_off()
            if not self._restarts:
                return
            self.port.power_off()

    def _give_reports_time(self) -> None:
        """Make status reports take time. Requests during this time are answered by the same
        report.

        A function that adds a field to reports is called for each one: this one adds nothing, and
        lets the time pass.
        """

        def field() -> str:
            """Let the time of a report pass; return no field."""
            self.pass_time(self.now + self.answer_ticks)
            return ""

        if self.answer_ticks:
            self.controller.state.hooks.fields += (field,)

    def cycle_power(self) -> None:
        """Restart the firmware, with its memory kept, when the script yields. Called by the
        script."""
        self._restarts = True

    def power_off(self) -> None:
        """End the machine: raise PowerOff. Called by a link."""
        raise PowerOff()

    def moving(self) -> bool:
        """Return whether the motors turn."""
        return not self.engine.idle()

    def wait(self) -> None:
        """Let time pass to the next event. Called when the firmware has nothing to read."""
        must_poll = self.inputs or not self.engine.idle()
        self.pass_time(self.ms(_POLL_MS if must_poll else self.idle_poll_ms), or_arrival=True)

    def skip(self) -> None:
        """Let time pass, without a script, until something may have changed by itself."""
        engine = self.engine
        event = self.ms(_POLL_MS) if engine.idle() else engine.next_event()
        engine.advance(max(event, self.now))

    def pass_time(self, to: int, or_arrival: bool = False) -> None:
        """Let time pass until tick `to`, or with or_arrival until a byte arrives at the device.
        Resume the script whenever its wake has come."""
        engine, link = self.engine, self.link
        while True:
            stop = to  # the next tick at which something other than the engine may act
            arrival = link.next_event() if or_arrival else None
            if arrival is not None and arrival < stop:
                stop = arrival
            wake = self._wake
            if not callable(wake) and wake < stop:
                stop = wake
            event = engine.next_event()  # ends this turn too, because it may change a condition
            if event > stop >= engine.now:
                engine.now = stop  # the common case: nothing happens in the engine until then
            else:  # a past `stop` does not turn time back
                engine.advance(max(min(event, stop), engine.now))
            link.advance()
            self._wake_script()
            arrival = link.next_event() if or_arrival else None
            if engine.now >= to or (arrival is not None and arrival <= engine.now):
                return

    def _wake_script(self) -> None:
        """Resume the script, again and again, while its tick has come or its condition is true.
        PowerOff when it ends or cycles the power."""
        while self._wake() if callable(self._wake) else self._wake <= self.engine.now:
            try:
                self._wake = next(self._script)
            except StopIteration:
                raise PowerOff()
            if self._restarts:
                raise PowerOff()
