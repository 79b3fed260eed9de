"""Pins of an ESP32 that are not steps: limits, probe, controls, spindle, coolant, enable.

Interrupts are soft here: their callbacks run between two bytecodes, at the latest when a C
function of MicroPython returns; and not at all if eight others already wait. So poll_inputs() is
called in every turn of the engine and of the main loop, and finds changes that were missed.
"""

import machine
from machine import Timer
from micropython import const
from ports.port import PortPins

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

    from interfaces import InputListener
    from machine import Pin

# Timers of PortInputs; timer 0 is the engine's.
_LOOK_TIMER = const(1)
_CONTROL_TIMER = const(2)

# The watchdog cannot be stopped. Its hardware counts at most 2**32 quarters of a millisecond.
_NO_MORE_MS = const(604_800_000)  # a week: so long it waits instead


class EspPort(PortPins):
    """A Port.

    enable: sets the drivers' enable, if that is not a pin of the ESP32.
    """

    def __init__(self, board: "ModuleType", enable: "Callable[[int], None] | None" = None) -> None:
        pins = None if enable else getattr(board, "ENABLE", None)
        timers = Timer(_LOOK_TIMER), Timer(_CONTROL_TIMER)
        super().__init__(board, timers, pins, has_hard=False)  # interrupts are soft
        self._set_enable = enable
        # Levels that poll_inputs() has found last.
        self._limits_polled = self._estop_polled = 0
        self._sensors_polled = -1  # sensors, inputs of extras, are not watched: see watch_pins()

    def attach(self, listener: "InputListener") -> None:
        """Call the listener for changed inputs, as PortPins; only changes from now on count."""
        self._limits_polled = self.limits()
        self._controls_seen = self.controls()
        super().attach(listener)

    def poll_inputs(self) -> None:
        """Handle changed inputs as if their interrupts had come.

        ..._polled: levels that the last call has found; ..._seen: those reported last.
        ..._disarmed, _is_settling: a timer runs, which will read the inputs itself.
        """
        limits = self.limits()
        if limits != self._limits_polled:
            self._limits_polled = limits
            timer_runs = self._limits_disarmed  # it will read them, and must not start again
            if self._limits_enabled and limits != self._limits_seen and not timer_runs:
                self._limit_changed(_first(self._limits))
        if not self._is_settling and self.controls() != self._controls_seen:
            self._control_changed(_first(self._controls))  # any pin: the handler reads them all
        if self._estop and self._estop.value() != self._estop_polled:
            self._estop_polled = self._estop.value()
            self._control_changed(self._estop)
        self._look_at_probe()  # reports a contact, if one is waited for
        if self._sensors_polled >= 0 and self.sense() != self._sensors_polled:
            self._sensors_polled = self.sense()
            if not self._sensors_disarmed:
                self._sensor_changed(_first(self._sensors))

    def watch_pins(self, on_change: "Callable[[], None]") -> None:
        """Call on_change, in an interrupt, when an input of an extra changes."""
        super().watch_pins(on_change)
        self._sensors_polled = self.sense()

    def enable(self, level: int) -> None:
        """Set the level of the motor drivers' enable pins, or output."""
        if self._set_enable:
            self._set_enable(level)
        else:
            super().enable(level)

    def watch(self, timeout_ms: int) -> "Callable[[], None] | None":
        """Start the watchdog: the chip resets if the result is not called for timeout_ms. 0 ends
        it."""
        watchdog = machine.WDT(timeout=timeout_ms or _NO_MORE_MS)
        return watchdog.feed if timeout_ms else None


def _first(pins: "list[Pin | None]") -> "Pin":
    """Return one of the wired pins, to call their interrupt's handler with: it does the same for
    any of them."""
    return next(pin for pin in pins if pin)
