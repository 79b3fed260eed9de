"""Timer engine: what the timers of both ESP32 engines have in common.

Interrupts are soft here: MicroPython prints what one of them raises, and calls it again. So a turn
catches all. What goes wrong switches the tool off, then the motors, and is told to the main loop.

An edge at a pin is lost where the scheduler's eight places are taken, and a timer of a millisecond
takes them all in eight of a collection. So each turn begins with a look at the inputs.
"""

import gc
import time

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    from interfaces import NextSegment


# Direction is there so long before a step.
SETUP_US = const(10)
# What has not come so long after it was due, a train or a buffer that DMA takes, never will.
LOST_US = const(500_000)
# Garbage is collected after so many trains: more often than it would be by itself.
_COLLECT_TRAINS = const(100)


def _nothing() -> None:
    """Nobody has to be told."""


class TimerEngine:
    """Half an engine. on_poll: has the inputs looked at. on_fault: switches the tool off."""

    def __init__(self) -> None:
        self.on_poll: "Callable[[], None]" = _nothing
        self.on_fault: "Callable[[], object]" = _nothing
        self._failure: "BaseException | None" = None
        self._trains_since = 0  # the last collection
        self._collect_us = 0  # what that took, once it is known

    def attach(
        self,
        next_segment: "NextSegment",
        on_power: "Callable[[int], None]",
        on_rest: "Callable[[], None]",
    ) -> None:
        """Say where segments come from, who is told the spindle power of each as it starts, and
        who hears that motion has come to its end."""
        self._next_segment = next_segment
        self._on_power = on_power
        self._on_rest = on_rest

    def fault(self) -> str:
        """What is wrong with the engine, in words; "" as long as nothing is."""
        if self._failure:
            words = "the engine's turn has failed: %s %s" % (
                type(self._failure).__name__,
                self._failure,
            )
            return words.replace("rror", "rr").replace("ok", "o-k")
        return "motion is behind its own schedule" if self._is_late() else ""

    def _refill(self, _timer: object) -> None:
        try:
            self.on_poll()
            if self._failure is None:
                self._advance()
        except BaseException as why:
            self._fail(why)

    def _fail(self, why: BaseException) -> None:
        self._failure = why
        try:
            self.on_fault()
        except BaseException as worse:
            self._failure = worse
        try:
            self._halt()
        except BaseException as worse:
            self._failure = worse

    def _collect(self, room_us: int) -> None:
        """Collect garbage, if it is time for it and room_us are enough.

        A collection that comes by itself between two trains holds motion up for as long as it
        takes: interrupts are soft here, and wait for it.
        """
        self._trains_since += 1
        if self._trains_since > 2 * _COLLECT_TRAINS:
            self._collect_us >>= 1  # nothing had room for what one has taken: it may be less now
            self._trains_since = _COLLECT_TRAINS
        if self._trains_since >= _COLLECT_TRAINS and self._collect_us < room_us:
            before = time.ticks_us()
            gc.collect()
            self._collect_us = time.ticks_diff(time.ticks_us(), before)
            self._trains_since = 0

    # What the other half has

    def _advance(self) -> None:
        """A turn."""
        raise NotImplementedError

    def _halt(self) -> None:
        """Stop the motors; the engine is not idle, so that the main loop asks for the fault."""
        raise NotImplementedError

    def _is_late(self) -> bool:
        """Motion should have gone on long ago."""
        raise NotImplementedError
