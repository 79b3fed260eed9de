"""Timer engine: the common part of both ESP32 engines, driven by a timer.

Interrupts are soft here: MicroPython prints an exception of one, and calls it again. So a turn
catches all exceptions. A fault switches the tool off, then stops the motors, and is reported to
the main loop.

An edge at a pin is lost while the scheduler's queue of eight is full, and a timer of 1 ms fills it
in 8 ms of a garbage collection. So each turn first checks the inputs.
"""

import gc
import time

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    from interfaces import NextSegment


SETUP_US = const(10)  # from a change of direction to a step
LOST_US = const(500_000)  # a train, or a buffer that DMA accepts, that is so late will never come
_COLLECT_TRAINS = const(100)  # garbage is collected after so many: more often than automatically


def _nothing() -> None:
    """Default callback: do nothing."""


class TimerEngine:
    """Base of both engines. on_poll: checks the inputs. on_fault: switches the tool off."""

    def __init__(self) -> None:
        self.on_poll: "Callable[[], None]" = _nothing
        self.on_fault: "Callable[[], object]" = _nothing
        self._failure: "BaseException | None" = None
        self._trains_since = 0  # trains since the last collection
        self._collect_us = 0  # time of the last collection; 0: unknown

    def attach(
        self,
        next_segment: "NextSegment",
        on_power: "Callable[[int], None]",
        on_rest: "Callable[[], None]",
    ) -> None:
        """Set the source of segments, and two callbacks. next_segment(row) fills in a segment's
        row, and returns 0 if there is none. on_power is passed the spindle power of each segment
        as it starts, on_rest is called when motion has ended."""
        self._next_segment = next_segment
        self._on_power = on_power
        self._on_rest = on_rest

    def fault(self) -> str:
        """Return the engine's fault, in words; "" without a fault."""
        if self._failure:
            words = "refilling the step pulse buffer failed: %s %s" % (
                type(self._failure).__name__,
                self._failure,
            )
            # A sender must not find "error" or "ok" in it, the answers to a line.
            return words.replace("rror", "rr").replace("ok", "o-k")
        return "step pulses came later than scheduled" if self._is_late() else ""

    def _refill(self, _timer: object) -> None:
        """Do one turn, in the timer's interrupt. After a fault only the inputs are checked."""
        try:
            self.on_poll()
            if self._failure is None:
                self._advance()
        except BaseException as why:
            self._fail(why)

    def _fail(self, why: BaseException) -> None:
        """Note a fault, which the main loop will report, switch the tool off, and stop the
        motors. If one of these fails, too, its exception is the fault."""
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
        """Collect garbage, if that is due and room_us, the time until the next turn, is enough.

        An automatic collection between two trains delays motion by its whole time, because soft
        interrupts wait for it.
        """
        self._trains_since += 1
        if self._trains_since > 2 * _COLLECT_TRAINS:
            self._collect_us >>= 1  # room_us was never enough; it may take less time by now
            self._trains_since = _COLLECT_TRAINS
        if self._trains_since >= _COLLECT_TRAINS and self._collect_us < room_us:
            before = time.ticks_us()
            gc.collect()
            self._collect_us = time.ticks_diff(time.ticks_us(), before)
            self._trains_since = 0

    # Implemented by the engines

    def _advance(self) -> None:
        """Do one turn."""
        raise NotImplementedError

    def _halt(self) -> None:
        """Stop the motors, and do not become idle, so that the main loop asks for the fault."""
        raise NotImplementedError

    def _is_late(self) -> bool:
        """Return whether motion is so late that it will never continue."""
        raise NotImplementedError
