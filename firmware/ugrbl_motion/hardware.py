"""Hardware: the step engine and the pins of the chip that runs this, as far as a group needs them.

The only module here that imports `machine`. The simulator puts its own object in `own`.
"""

import sys
import time

import micropython
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from interfaces import GroupHardware, StepEngine
    from machine import Pin

    Pins = tuple[int, ...]


def pio(step: "Pins", direction: "Pins") -> "StepEngine":
    """Create the engine of an RP2040 or RP2350."""
    from pio.engine import PioEngine

    return PioEngine(step, direction)


def rmt(step: "Pins", direction: "Pins") -> "StepEngine":
    """Create the engine of an ESP32."""
    from esp_chip.rmt import RmtEngine
    from esp_chip.start import prepare

    prepare()
    return RmtEngine(step, direction)


class Hardware:
    """Engine, outputs and inputs of this chip."""

    _has_engine = False

    def __init__(self) -> None:
        self._outputs: "list[Pin]" = []

    def engine(self, step: "Pins", direction: "Pins") -> "StepEngine":
        """Create the step engine. step, direction: pin numbers per motor. Raises OSError if this
        chip has none, or it is in use."""
        engines = {"rp2": pio, "esp32": rmt}
        if sys.platform not in engines:
            raise OSError(
                "no step engine for %s: on a computer use the simulator's" % sys.platform
            )
        if Hardware._has_engine:
            raise OSError("this chip has one step engine: put all axes into one Group")
        engine = engines[sys.platform](step, direction)
        Hardware._has_engine = True  # of the class: a chip has one
        return engine

    def make_outputs(self, pins: "Sequence[int]", levels: int) -> None:
        """Create the outputs that write() sets, at these pin numbers. levels: a bit each."""
        from machine import Pin

        self._outputs = [Pin(pin, Pin.OUT, value=levels >> i & 1) for i, pin in enumerate(pins)]

    @micropython.native
    def write(self, levels: int) -> None:
        """Set the outputs, a bit each. Called in an interrupt."""
        for pin in self._outputs:
            pin.value(levels & 1)
            levels >>= 1

    def watch(
        self, number: int, level: int, on_change: "Callable[[], object]"
    ) -> "Callable[[], bool]":
        """Call on_change, in an interrupt, when the input at pin `number` gets that level.

        Returns a function that says whether it has the level; the pull-up is on. on_change comes
        as soon as the chip can: in a hard interrupt where there are any.
        """
        from machine import Pin

        pin = Pin(number, Pin.IN, Pin.PULL_UP)

        @micropython.native
        def changed(_pin: object) -> None:
            if pin.value() == level:  # else it was a disturbance, which is over already
                on_change()

        edge = Pin.IRQ_RISING if level else Pin.IRQ_FALLING
        if sys.platform == "rp2":
            pin.irq(changed, edge, hard=True)
        else:
            pin.irq(changed, edge)
        return lambda: pin.value() == level

    def sleep_ms(self, milliseconds: int) -> None:
        """Wait."""
        time.sleep_ms(milliseconds)


# Creates what a group uses that is given none.
own: "Callable[[], GroupHardware]" = Hardware
