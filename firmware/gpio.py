"""Pins of an RP2040 or RP2350 that are not steps: limits, probe, controls, spindle, coolant.

Interrupts are hard: what they call runs at once, whatever the main loop does, and neither
allocates nor raises. They come before all others, so that a limit switch is heard also while
the pulse engine's interrupt runs. All pins have pull-ups.
"""

import sys

import machine
from gpio_port import PortPins
from machine import Timer
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

# The interrupt controller's table of priorities, a byte each: MicroPython leaves all at 0x80,
# and less comes first.
_PRIORITIES = const(0xE000E400)
_FIRST = const(0x40)

# The watchdog's control register, and where ones clear bits of it.
_WATCHDOG = const(0x40058000)
_WATCHDOG_2350 = const(0x400D8000)
_CLEAR = const(0x3000)


class GpioPort(PortPins):
    """A Port, and a PunchPort where the board file has the pins."""

    def __init__(self, board: "ModuleType") -> None:
        super().__init__(board, Timer(), getattr(board, "ENABLE", None), True)

    def attach(self, on_limits: "Callable[[], None]", on_controls: "Callable[[], None]") -> None:
        """Who is called, in a hard interrupt, when one of these inputs changes."""
        _raise_priority()
        super().attach(on_limits, on_controls)

    def watch(self, timeout_ms: int) -> "Callable[[], None] | None":
        """Make the chip start anew where the result is not called for so long; 0: no more."""
        if timeout_ms:
            watchdog: "Callable[[], None]" = machine.WDT(timeout=timeout_ms).feed
            return watchdog
        # MicroPython has no way to stop it; clearing the enabling bit is one.
        machine.mem32[(_WATCHDOG_2350 if _is_rp2350() else _WATCHDOG) + _CLEAR] = 1 << 30
        return None


def _raise_priority() -> None:
    """Interrupts of pins before all others."""
    number = 21 if _is_rp2350() else 13
    address = _PRIORITIES + number // 4 * 4
    shift = number % 4 * 8
    others = machine.mem32[address] & ~(0xFF << shift)
    machine.mem32[address] = others | _FIRST << shift


def _is_rp2350() -> bool:
    return "RP2350" in sys.implementation._machine
