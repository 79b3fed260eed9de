"""Pins of an ESP32 that are not steps: limits, probe, controls, spindle, coolant, enable.

Interrupts are soft here: what they call runs between two bytecodes, at the latest when what
MicroPython does in C has been done. Inputs are closed when pulled to ground; an input that is
not wired (None in the board file) is never closed.
"""

import time

from machine import PWM, Pin
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType
    from typing import Any

_FULL = const(65535)  # duty_u16
_BOTH_EDGES = Pin.IRQ_RISING | Pin.IRQ_FALLING


class EspPort:
    """A Port. enable: who sets the drivers' enable, where that is not a pin of the ESP32."""

    def __init__(self, board: "ModuleType", enable: "Callable[[int], None] | None" = None) -> None:
        def option(name: str, default: "Any" = None) -> "Any":
            return getattr(board, name, default)

        # Pins that can only be inputs have no pull-ups either: resistors do that on the board.
        self._without_pull = option("NO_PULL_UP", ())
        self.pwm_max: int = option("PWM_MAX", 1000)
        self._limits = [self._input(pin) for pin in option("LIMIT", ())]
        self._controls = [self._input(pin) for pin in option("CONTROL", ())]
        self._probe = self._input(option("PROBE"))
        self._set_enable = enable
        self._enable = self._output(option("ENABLE")) if enable is None else None
        self._direction = self._output(option("SPINDLE_DIR"))
        self._spindle_on = self._output(option("SPINDLE_ON"))
        self._flood = self._output(option("FLOOD"))
        self._mist = self._output(option("MIST_PIN"))
        self._pwm: "PWM | None" = None
        pwm = option("SPINDLE_PWM")
        if pwm is not None:
            self._pwm = PWM(Pin(pwm), freq=option("PWM_HZ", 5000), duty_u16=0)
        self._on_contact: "Callable[[], None] | None" = None
        self._contact_level = True

    def _input(self, pin: "int | None") -> "Pin | None":
        if pin is None:
            return None
        if pin in self._without_pull:
            return Pin(pin, Pin.IN)
        return Pin(pin, Pin.IN, Pin.PULL_UP)

    def _output(self, pin: "int | None") -> "Pin | None":
        return None if pin is None else Pin(pin, Pin.OUT, value=0)

    # The Port seam

    def attach(self, on_limits: "Callable[[], None]", on_controls: "Callable[[], None]") -> None:
        """Who is called, in a soft interrupt, when one of these inputs changes."""
        self._on_limits = on_limits
        self._on_controls = on_controls
        for pin in self._limits:
            if pin:
                pin.irq(handler=self._limit_changed, trigger=_BOTH_EDGES)
        for pin in self._controls:
            if pin:
                pin.irq(handler=self._control_changed, trigger=_BOTH_EDGES)
        if self._probe:
            self._probe.irq(handler=self._look_at_probe, trigger=_BOTH_EDGES)

    def _limit_changed(self, _pin: object) -> None:
        self._on_limits()

    def _control_changed(self, _pin: object) -> None:
        self._on_controls()

    def watch_probe(self, on_contact: "Callable[[], None] | None", closed: bool) -> None:
        """Call on_contact once, in a soft interrupt, as soon as the probe pin is `closed`."""
        self._contact_level = closed
        self._on_contact = on_contact
        self._look_at_probe(None)

    def _look_at_probe(self, _pin: object) -> None:
        on_contact = self._on_contact
        if on_contact and self.probe() == self._contact_level:
            self._on_contact = None
            on_contact()

    def limits(self) -> int:
        """Mask of limit inputs pulled to ground, bit 0 = X."""
        return _mask(self._limits)

    def controls(self) -> int:
        """Mask of control inputs pulled to ground: reset, hold, start, door."""
        return _mask(self._controls)

    def probe(self) -> bool:
        """The probe input is pulled to ground."""
        return self._probe is not None and self._probe.value() == 0

    def enable(self, level: int) -> None:
        """Level of the motor drivers' enable pin."""
        if self._set_enable:
            self._set_enable(level)
        elif self._enable:
            self._enable.value(level)

    def direction(self, level: int) -> None:
        """Level of the spindle direction pin: 1 = counterclockwise."""
        if self._direction:
            self._direction.value(level)

    def spindle(self, on: bool, power: int) -> None:
        """Spindle output: enable, and PWM power 0..pwm_max."""
        if self._pwm:
            self._pwm.duty_u16(power * _FULL // self.pwm_max)
        if self._spindle_on:
            self._spindle_on.value(1 if on else 0)

    def coolant(self, mask: int) -> None:
        """Coolant outputs: flood, mist."""
        if self._flood:
            self._flood.value(mask & 1)
        if self._mist:
            self._mist.value(mask >> 1 & 1)

    def ticks_ms(self) -> int:
        """Milliseconds, wrapping; compare with elapsed_ms."""
        return time.ticks_ms()

    def elapsed_ms(self, since: int) -> int:
        """Milliseconds since a value of ticks_ms()."""
        return time.ticks_diff(time.ticks_ms(), since)


def _mask(pins: "list[Pin | None]") -> int:
    mask = 0
    for bit, pin in enumerate(pins):
        if pin and pin.value() == 0:
            mask |= 1 << bit
    return mask
