"""Pins of an ESP32 that are not steps: limits, probe, controls, spindle, coolant, enable.

Interrupts are soft here: what they call runs between two bytecodes, at the latest when what
MicroPython does in C has been done; and not at all where eight others wait already. So
poll_inputs() is called in every turn of the engine and of the main loop: it finds what nobody has
heard.
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

# 0 is the engine's.
_LOOK_TIMER = const(1)
_CONTROL_TIMER = const(2)

# The watchdog cannot be stopped, but told to wait for so long: a week. Its hardware counts 2**32
# quarters of a millisecond at the most.
_NO_MORE_MS = const(604_800_000)


class EspPort(PortPins):
    """A Port.

    enable: who sets the drivers' enable, where that is not a pin of the ESP32.
    """

    def __init__(self, board: "ModuleType", enable: "Callable[[int], None] | None" = None) -> None:
        pins = None if enable else getattr(board, "ENABLE", None)
        timers = Timer(_LOOK_TIMER), Timer(_CONTROL_TIMER)
        super().__init__(board, timers, pins, False)
        self._set_enable = enable
        self._limits_looked = self._estop_looked = 0
        self._sensors_looked = -1  # nobody wants to hear of them

    def attach(self, listener: "InputListener") -> None:
        """As on other chips; only what changes from now on counts."""
        self._limits_looked = self.limits()
        self._controls_seen = self.controls()
        super().attach(listener)

    def poll_inputs(self) -> None:
        """Act on inputs that have changed as if their interrupts had come."""
        limits = self.limits()
        if limits != self._limits_looked:
            self._limits_looked = limits
            waits = self._limits_wait  # its timer will look, and is not to begin anew
            if self._limits_enabled and limits != self._limits_seen and not waits:
                self._limit_changed(_first(self._limits))
        if not self._quiet and self.controls() != self._controls_seen:
            self._control_changed(_first(self._controls))
        if self._estop and self._estop.value() != self._estop_looked:
            self._estop_looked = self._estop.value()
            self._control_changed(self._estop)
        self._look_at_probe()
        if self._sensors_looked >= 0 and self.sense() != self._sensors_looked:
            self._sensors_looked = self.sense()
            if not self._sensors_wait:
                self._sensor_changed(_first(self._sensors))

    def watch_pins(self, on_change: "Callable[[], None]") -> None:
        """Call on_change, in an interrupt, whenever an input of an extra changes."""
        super().watch_pins(on_change)
        self._sensors_looked = self.sense()

    def enable(self, level: int) -> None:
        """Level of the motor drivers' enable pins, or output."""
        if self._set_enable:
            self._set_enable(level)
        else:
            super().enable(level)

    def watch(self, timeout_ms: int) -> "Callable[[], None] | None":
        """Make the chip start anew where the result is not called for so long; 0: no more."""
        watchdog = machine.WDT(timeout=timeout_ms or _NO_MORE_MS)
        return watchdog.feed if timeout_ms else None


def _first(pins: "list[Pin | None]") -> "Pin":
    """One of those that are wired; its interrupt is as good as the others'."""
    return next(pin for pin in pins if pin)
