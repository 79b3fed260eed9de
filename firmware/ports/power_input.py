"""Power input: a contact to ground that opens when the supply fails, or its wire is cut.

The contact is an optocoupler or a supply monitor (docs/wiring.md). The edge interrupts once, until
arm(): interference costs one interrupt in a turn of the main loop.
"""

import micropython
from machine import Pin
from micropython import const

from ports.storage.prepared_page import PreparedPages

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType


def of_board(board: "ModuleType") -> "PowerInput":
    """Return the input of a board file that names POWER_FAIL, its pin."""
    option = board.__dict__.get
    pin = option("POWER_FAIL", None)
    assert pin is not None
    without_pull, is_hard = pin in option("NO_PULL_UP", ()), option("ENGINE") == "pio"
    return PowerInput(pin, without_pull, is_hard)


class PowerInput:
    """The input, and pages of flash for what must be stored. number: the pin's; without_pull: it
    has a resistor outside; is_hard: interrupts can be hard. is_armed: the next edge interrupts."""

    def __init__(self, number: int, without_pull: bool, is_hard: bool) -> None:
        self.pages = PreparedPages()
        self._number = number
        self._without_pull = without_pull
        self._is_hard = is_hard
        self.is_armed = True

    def attach(self, on_fail: "Callable[[], object]", on_fault: "Callable[[], object]") -> None:
        """Set up the pin. From now on on_fail is called, in an interrupt, when the contact opens;
        on_fault if on_fail raises."""
        self._on_fail, self._on_fault = on_fail, on_fault
        if self._without_pull:
            self._pin = Pin(self._number, Pin.IN)
        else:
            self._pin = Pin(self._number, Pin.IN, Pin.PULL_UP)
        if self._is_hard:
            self._pin.irq(self._changed, Pin.IRQ_RISING, hard=True)
        else:
            self._pin.irq(self._changed, Pin.IRQ_RISING)

    @micropython.native
    def is_good(self) -> bool:
        """Return whether the contact is closed."""
        return not self._pin()

    def arm(self) -> None:
        """Interrupt again at the next edge."""
        self.is_armed = True
        self._pin.irq().trigger(Pin.IRQ_RISING)

    @micropython.native
    def _changed(self, pin: "Pin") -> None:
        """Disarm the pin, and report a failing supply if the contact is still open. Interrupt."""
        try:
            pin.irq().trigger(0)
            self.is_armed = False
            if pin():
                self._on_fail()
        except BaseException:
            self._on_fault()
