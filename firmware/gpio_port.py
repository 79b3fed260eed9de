"""Pins that are not steps, as far as all chips have them alike: see gpio.py, gpio_esp.py.

Inputs are closed when pulled to ground; one that is not wired (None in the board file) is never
closed. What they call in an interrupt neither allocates nor raises.
"""

import time

from machine import PWM, Pin, Timer
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from types import ModuleType
    from typing import Any

_FULL = const(65535)  # duty_u16
_BOTH_EDGES = Pin.IRQ_RISING | Pin.IRQ_FALLING


class PortPins:
    """A Port, and a PunchPort where the board file has the pins.

    timer: one that nobody else uses. enables: pins of the motor drivers' enable. has_hard:
    interrupts can be hard.
    """

    def __init__(
        self,
        board: "ModuleType",
        timer: Timer,
        enables: "int | tuple[int, ...] | None",
        has_hard: bool,
    ) -> None:
        def option(name: str, default: "Any" = None) -> "Any":
            return getattr(board, name, default)

        self._hard = has_hard
        # Pins that can only be inputs have no pull-ups either: resistors do that on the board.
        self._without_pull: "tuple[int, ...]" = option("NO_PULL_UP", ())
        # Full spindle power; 16383 at the most, for the interrupt has small integers only.
        self.pwm_max: int = option("PWM_MAX", 1000)
        # How long a stroke of the punch takes at the most.
        self.punch_timeout_ms: int = option("PUNCH_TIMEOUT_MS", 1000)
        # For how long a button's contacts may bounce.
        self._debounce_ms: int = option("CONTROL_DEBOUNCE_MS", 0)
        self._limits = [self._input(pin) for pin in option("LIMIT", ())]
        self._controls = [self._input(pin) for pin in option("CONTROL", ())]
        self._probe = self._input(option("PROBE"))
        if not isinstance(enables, tuple):
            enables = () if enables is None else (enables,)
        # Motors are off until the machine has been built.
        self._enables = [Pin(pin, Pin.OUT, value=1) for pin in enables]
        self._direction = _output(option("SPINDLE_DIR"))
        self._spindle_on = _output(option("SPINDLE_ON"))
        self._flood = _output(option("FLOOD"))
        self._mist = _output(option("MIST_PIN"))
        pwm = option("SPINDLE_PWM")
        self._pwm: "PWM | None" = None
        if pwm is not None:
            self._pwm = PWM(Pin(pwm), freq=option("PWM_HZ", 5000), duty_u16=0)
        self._punch_down = _output(option("PUNCH_DOWN"))
        self._punch_up = _output(option("PUNCH_UP"))
        self._punch_sensors = (
            self._input(option("PUNCH_DOWN_SENSOR")),
            self._input(option("PUNCH_UP_SENSOR")),
        )
        self._on_contact: "Callable[[], None] | None" = None
        self._contact_level = True
        self._timer = timer
        self._quiet = False  # a button bounces
        self._seen = 0
        self._settle = self._settled  # taking a method as a value allocates

    def _input(self, pin: "int | None") -> "Pin | None":
        if pin is None:
            return None
        if pin in self._without_pull:
            return Pin(pin, Pin.IN)
        return Pin(pin, Pin.IN, Pin.PULL_UP)

    def _hear(self, pins: "Iterable[Pin | None]", changed: "Callable[[Pin], object]") -> None:
        for pin in pins:
            if pin and self._hard:
                pin.irq(changed, _BOTH_EDGES, hard=True)
            elif pin:
                pin.irq(changed, _BOTH_EDGES)

    # The Port seam

    def attach(self, on_limits: "Callable[[], None]", on_controls: "Callable[[], None]") -> None:
        """Who is called, in an interrupt, when one of these inputs changes."""
        self._on_limits = on_limits
        self._on_controls = on_controls
        self._hear(self._limits, self._limit_changed)
        self._hear(self._controls, self._control_changed)
        self._hear((self._probe,), self._look_at_probe)

    def _limit_changed(self, _pin: object) -> None:
        self._on_limits()

    def _control_changed(self, _pin: object) -> None:
        if self._quiet:
            return
        self._on_controls()
        if self._debounce_ms:
            self._quiet = True
            self._seen = self.controls()
            self._timer.init(
                mode=Timer.ONE_SHOT,
                period=self._debounce_ms,
                callback=self._settle,
                hard=self._hard,
            )

    def _settled(self, _timer: object) -> None:
        self._quiet = False
        if self.controls() != self._seen:
            self._control_changed(None)

    def watch_probe(self, on_contact: "Callable[[], None] | None", closed: bool) -> None:
        """Call on_contact once, in an interrupt, as soon as the probe pin is `closed`."""
        self._on_contact = None
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
        """Level of the motor drivers' enable pins."""
        for pin in self._enables:
            pin.value(level)

    def direction(self, level: int) -> None:
        """Level of the spindle direction pin: 1 = counterclockwise."""
        if self._direction:
            self._direction.value(level)

    def spindle(self, on: bool, power: int) -> None:
        """Spindle output: enable, and PWM power 0..pwm_max. May be called in an interrupt."""
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

    # The punch

    def punch(self, down: int, up: int) -> None:
        """Levels of the two actuators' pins. May be called in an interrupt."""
        if self._punch_down:
            self._punch_down.value(down)
        if self._punch_up:
            self._punch_up.value(up)

    def punch_sensors(self) -> int:
        """Levels of the sensors' pins: bit 0 down, bit 1 up."""
        return 3 ^ _mask(self._punch_sensors)

    def watch_punch(self, on_change: "Callable[[], None]") -> None:
        """Call on_change, in an interrupt, whenever a sensor's pin changes."""
        self._on_punch = on_change
        self._hear(self._punch_sensors, self._punch_changed)

    def _punch_changed(self, _pin: object) -> None:
        self._on_punch()

    # For power_up.py

    def safe(self) -> None:
        """What could do harm off; motors stay as they are: an axis that drops is no safer."""
        self.spindle(False, 0)
        self.coolant(0)

    def held(self, pin: "int | None") -> bool:
        """A button between this pin and ground is held."""
        return pin is not None and Pin(pin, Pin.IN, Pin.PULL_UP).value() == 0


def _output(pin: "int | None") -> "Pin | None":
    return None if pin is None else Pin(pin, Pin.OUT, value=0)


def _mask(pins: "list[Pin | None] | tuple[Pin | None, ...]") -> int:
    mask = 0
    for bit in range(len(pins)):
        pin = pins[bit]
        if pin and pin.value() == 0:
            mask |= 1 << bit
    return mask
