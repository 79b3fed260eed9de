"""Pins of an ESP32 that are not steps: limits, probe, controls, spindle, coolant, enable.

Interrupts are soft here: what they call runs between two bytecodes, at the latest when what
MicroPython does in C has been done.
"""

import machine
from gpio_port import PortPins
from machine import Timer
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

# 0 is the engine's.
_LIMIT_TIMER = const(1)
_CONTROL_TIMER = const(2)

# The watchdog cannot be stopped, but told to wait for so long: a week. Its hardware counts 2**32
# quarters of a millisecond at the most.
_NO_MORE_MS = const(604_800_000)


class EspPort(PortPins):
    """A Port, and a PunchPort where the board file has the pins.

    enable: who sets the drivers' enable, where that is not a pin of the ESP32.
    """

    def __init__(self, board: "ModuleType", enable: "Callable[[int], None] | None" = None) -> None:
        pins = None if enable else getattr(board, "ENABLE", None)
        timers = Timer(_LIMIT_TIMER), Timer(_CONTROL_TIMER)
        super().__init__(board, timers, pins, False)
        self._set_enable = enable

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
