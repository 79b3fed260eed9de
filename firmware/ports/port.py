"""Pins other than STEP and DIR, in code that all chips share: pio/pins.py, esp_chip/pins.py."""

import time

from machine import PWM, Pin, Timer
from micropython import const

from ports.input_pins import PortInputs

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType

_FULL_DUTY = const(65535)  # of duty_u16(): always high
_INVERTIBLE = ("SPINDLE_PWM", "SPINDLE_ON", "SPINDLE_DIR", "FLOOD", "MIST_PIN")


class PortPins(PortInputs):
    """A Port.

    timers: two that nothing else uses. enables: pins that enable the motor drivers. has_hard:
    interrupts can be hard. _killed: from kill() to revive(), while outputs stay off. An attribute
    that ends in _off is an output's level when off, 0 or 1. _tools: what kill() switches off:
    number, pin, and level when off; PWM is apart. _own, _own_numbers, _own_pwm, _own_hz: of each
    output of extras the pin, its number, its PWM or None, and the frequency requested.
    """

    def __init__(
        self,
        board: "ModuleType",
        timers: "tuple[Timer, Timer]",
        enables: "int | tuple[int, ...] | None",
        has_hard: bool,
    ) -> None:
        super().__init__(board, timers, has_hard)
        if not isinstance(enables, tuple):
            enables = () if enables is None else (enables,)
        # Motors are off until the machine has been built.
        self._enables = [Pin(pin, Pin.OUT, value=1) for pin in enables]
        self._killed = False
        self._tools: "list[tuple[int, Pin, int]]" = []
        self._own_pwm: "list[PWM | None]" = []
        self._own_hz: "list[int]" = []  # PWM sets the nearest frequency it can
        self._make_outputs(board)

    def _make_outputs(self, board: "ModuleType") -> None:
        """Make the outputs of spindle and coolant that the board file names, all off. An output
        that it does not name is None."""
        option = board.__dict__.get
        inverted: "tuple[str, ...]" = option("INVERT", ())
        off = [1 if name in inverted else 0 for name in _INVERTIBLE]
        # 0 or 1: a pin's level when off, so also what inverts its level. The direction pin is
        # never off unless it is an enable pin: there it is only the inversion.
        self._pwm_off, self._spindle_off, self._direction_off = off[:3]
        self._flood_off, self._mist_off = off[3:]
        self._pwm_number: "int | None" = option("SPINDLE_PWM", None)
        hz: int = option("PWM_HZ", 5000)
        self.pwm_max: int = option("PWM_MAX", 1000)
        pwm = _make_output(self._pwm_number, self._pwm_off)
        self.pwm = PWM(pwm, freq=hz, duty_u16=0, invert=self._pwm_off) if pwm else None
        self._spindle_on = self._make_tool(option("SPINDLE_ON", None), self._spindle_off)
        self._flood = self._make_tool(option("FLOOD", None), self._flood_off)
        self._mist = self._make_tool(option("MIST_PIN", None), self._mist_off)
        make = self._make_tool if option("SPINDLE_ENABLE_PIN", False) else _make_output
        self._direction = make(option("SPINDLE_DIR", None), self._direction_off)

    def _make_tool(self, number: "int | None", off: int) -> "Pin | None":
        """Return a pin as an output that is off, and that kill() switches off; None without a
        number. off: its level then."""
        pin = _make_output(number, off)
        if pin and number is not None:
            self._tools.append((number, pin, off))
        return pin

    # Outputs

    def enable(self, level: int) -> None:
        """Set the level of the motor drivers' enable pins; the caller applies $4."""
        for pin in self._enables:
            pin.value(level)

    def direction(self, level: int) -> None:
        """Set the spindle direction: 1 = counterclockwise. With SPINDLE_ENABLE_PIN the pin is an
        enable pin, and 1 switches the spindle on."""
        if self._direction:
            self._direction.value(level ^ self._direction_off)
        if self._killed:  # an interrupt's kill() may have come before the write above
            self.safe()

    def spindle(self, on: bool, power: int) -> None:
        """Set the spindle outputs: on or off, and PWM power from 0 to pwm_max. May be called in an
        interrupt."""
        if self.pwm:
            self.pwm.duty_u16(power * _FULL_DUTY // self.pwm_max)
        if self._spindle_on:
            self._spindle_on.value(on != self._spindle_off)  # an off level of 1 inverts
        if self._killed:  # kill() may have come before the writes above
            self.safe()

    def coolant(self, mask: int) -> None:
        """Set the coolant outputs to a mask: bit 0 flood, bit 1 mist."""
        if self._flood:
            self._flood.value(mask & 1 ^ self._flood_off)
        if self._mist:
            self._mist.value(mask >> 1 & 1 ^ self._mist_off)
        if self._killed:
            self.safe()

    def kill(self) -> object:
        """Switch off spindle, laser, coolant and outputs of extras, until revive(). A method that
        sets one of them checks afterwards whether kill() has come in between. Returns None."""
        self._killed = True
        self.safe()
        return None

    def revive(self) -> None:
        """Allow outputs to be set again; they are off."""
        if self._killed:
            self.safe()
            self._killed = False

    def safe(self) -> None:
        """Switch off all outputs that could do harm. Motors stay as they are: an axis that drops
        is no safer."""
        if self.pwm:
            self.pwm.duty_u16(0)
        for pwm in self._own_pwm:
            if pwm:
                pwm.duty_u16(0)
        for _, pin, level in self._tools:
            pin.value(level)

    # The clock

    def ticks_ms(self) -> int:
        """Return milliseconds, which wrap; compare with elapsed_ms."""
        return time.ticks_ms()

    def elapsed_ms(self, since: int) -> int:
        """Return the milliseconds since a value of ticks_ms()."""
        return time.ticks_diff(time.ticks_ms(), since)

    # Pins of extras

    def add_pins(self, outputs: "tuple[int, ...]", inputs: "tuple[int, ...]") -> None:
        """Make the outputs that drive() sets and the inputs that sense() reads, by their pins'
        numbers."""
        self._own_numbers = outputs
        self._own = [Pin(pin, Pin.OUT, value=0) for pin in outputs]
        self._own_pwm = [None] * len(outputs)
        self._own_hz = [0] * len(outputs)
        self._sensors = [self._make_input(pin) for pin in inputs]

    def drive(self, levels: int) -> None:
        """Set the levels of the outputs of extras: bit i for output i. May be called in an
        interrupt."""
        for i in range(len(self._own)):
            self._own[i].value(levels >> i & 1)
        if self._killed:
            self.safe()

    def pulse(self, index: int, hz: int, duty: int) -> None:
        """Start PWM on an output of extras (index), which drive() then no longer affects: hz
        periods per second, high for duty / 65535 of each; 0 is off. ValueError if the pin has no
        PWM or the frequency is impossible."""
        pwm = self._own_pwm[index]
        if pwm is None or self._own_hz[index] != hz:
            pwm = self._begin_pulses(index, hz)
            self._own_hz[index] = hz
        pwm.duty_u16(duty)
        if self._killed:
            self.safe()

    def _begin_pulses(self, index: int, hz: int) -> PWM:
        """Start an output's PWM, off, or change its frequency (hz); return it."""
        pwm = self._own_pwm[index]
        if pwm is None:
            pwm = self._own_pwm[index] = PWM(self._own[index], freq=hz, duty_u16=0)
        else:
            pwm.freq(hz)
        return pwm

    def rest(self, levels: int) -> None:
        """Set the levels that kill() gives to the outputs of extras: bit i for output i."""
        own = self._own
        tools = [(number, pin, off) for number, pin, off in self._tools if pin not in own]
        for i in range(len(own)):
            tools.append((self._own_numbers[i], own[i], levels >> i & 1))
        self._tools = tools

    # For power_up.py

    def held(self, pin: "int | None") -> bool:
        """Return whether a button between this pin and ground is held."""
        return pin is not None and Pin(pin, Pin.IN, Pin.PULL_UP).value() == 0


def _make_output(number: "int | None", level: int) -> "Pin | None":
    """Return an output that has this level now; None without a pin."""
    return None if number is None else Pin(number, Pin.OUT, value=level)
