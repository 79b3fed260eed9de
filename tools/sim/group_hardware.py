"""Hardware of the simulator for ugrbl_motion: SimEngine, outputs, switches and a virtual clock.

`simulate()` makes every Group of a program a simulated one. Nothing runs while the program
computes: time passes in its waits, in asyncio's too, so each run has the same result.
"""

from array import array

from ugrbl_motion import hardware

from .engine import SimEngine, Switch

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

# Segments in the engine at a time, as on a board where hardware plays them.
_SEGMENT_QUEUE = 5


class SimHardware:
    """A GroupHardware. outputs: (tick, levels: a mask, steps of the motors) at every change. made:
    (start tick, row) of every segment, with the steps really made."""

    def __init__(self) -> None:
        self.outputs: "list[tuple[int, int, list[int]]]" = []
        self.made: "list[tuple[int, array[int]]]" = []
        self.sim: "SimEngine"
        # Of each watched input: number, level, on_change, whether it had the level.
        self._watched: "list[tuple[int, int, Callable[[], object], bool]]" = []

    # The GroupHardware interface

    def engine(self, step: "tuple[int, ...]", direction: "tuple[int, ...]") -> SimEngine:
        """Create the engine; its pins are not simulated, only its motors."""
        self.sim = SimEngine(len(step), _SEGMENT_QUEUE)
        self._steps = array("i", [0] * len(step))
        self.sim.trace = lambda start, row: self.made.append((start, row[:]))
        self.sim.pins_changed = self._look_at_switches
        return self.sim

    def make_outputs(self, pins: "Sequence[int]", levels: int) -> None:
        """Record the levels at the start."""
        self.outputs.append((0, levels, list(self.steps())))

    def write(self, levels: int) -> None:
        """Record a change."""
        self.outputs.append((self.sim.now, levels, list(self.steps())))

    def watch(
        self, number: int, level: int, on_change: "Callable[[], object]"
    ) -> "Callable[[], bool]":
        """Call on_change whenever the input changes to the level: 0 while its switch is closed.
        Returns a function that says whether it has the level."""

        def has_level() -> bool:
            return self._level(number) == level

        self._watched.append((number, level, on_change, has_level()))
        return has_level

    def sleep_ms(self, milliseconds: int) -> None:
        """Let time pass."""
        self.pass_s(milliseconds / 1000)

    # Interface for the simulator

    @property
    def now_s(self) -> float:
        """Return the virtual time."""
        return self.sim.now / self.sim.tick_hz

    def pass_s(self, seconds: float) -> None:
        """Let time pass, at least a tick."""
        self.sim.advance(self.sim.now + max(int(seconds * self.sim.tick_hz), 1))

    def switch(
        self, pin: int, axis: int, steps: int, above: bool = True, bounces: int = 0
    ) -> None:
        """Close an input while a motor (from 0, in the order of the axes' names) is at so many
        steps or above; with above=False, at so many or below. bounces: see Switch."""
        self.sim.switches.append(Switch(str(pin), axis, above, steps, bounces))

    def steps(self) -> "array[int]":
        """Return the steps that the motors have made, with their signs."""
        self.sim.physical(self._steps)
        return self._steps

    def _level(self, number: int) -> int:
        """Return an input's level now: 0 while its switch is closed, 1 without a switch."""
        self.steps()  # updates _steps
        for switch in self.sim.switches:
            if switch.pin == str(number) and switch.closed(self._steps[switch.axis]):
                return 0
        return 1

    def _look_at_switches(self) -> None:
        """Report the watched inputs that have changed to their level."""
        for i, (number, level, on_change, had_level) in enumerate(self._watched):
            has_level = self._level(number) == level
            self._watched[i] = number, level, on_change, has_level
            if has_level and not had_level:
                on_change()


def simulate() -> "list[SimHardware]":
    """Make all groups created from now on simulated: a Group gets its hardware from
    hardware.own(). Returns their hardware as they are made."""
    made: "list[SimHardware]" = []

    def own() -> SimHardware:
        made.append(SimHardware())
        return made[-1]

    hardware.own = own
    return made
