"""The RP2040's `machine` module for CPython: pins, PWM and timers that a test reads and drives.

What is not modelled does not exist; what the board refuses is refused. Nothing happens by itself:
a test drives inputs and lets timers expire. The ESP32's is esp_machine.py. Parts that only the
user's own Python uses are in peripherals.py, and do nothing.
"""

import sys
from collections.abc import Callable
from typing import Any

import peripherals

ADC, RTC, UART = peripherals.ADC, peripherals.RTC, peripherals.UART
I2C, SoftI2C = peripherals.I2C, peripherals.SoftI2C
SPI, SoftSPI = peripherals.SPI, peripherals.SoftSPI
reset_cause, unique_id = peripherals.reset_cause, peripherals.unique_id

_PINS = 30  # of an RP2040; an RP2350B has _PINS_2350
_PINS_2350 = 48


def _is_rp2350() -> bool:
    return "RP2350" in getattr(sys.implementation, "_machine", "")


def freq(hz: int = 0) -> int:
    if hz:
        raise NotImplementedError("only what our engine uses is modelled")
    return 125_000_000


# Registers of the pins: IO_BANK0 of the RP2040 and of the RP2350. The aliases that follow flip,
# set and clear bits.
_BANKS = (0x40014000, 0x40028000)
_ALIAS = 0x1000
_CONTROL, _CONTROL_STEP = 0x40014004, 8
_OUTOVER = 8  # bit position of the override: 0 normal, 1 inverted, 2 low, 3 high
_FUNCTION_MASK, _FUNCTION_PWM, _FUNCTION_SIO = 31, 4, 5
_LEVELS = 0xD0000004  # of all pins, in SIO: read only


class _Memory:
    """Registers that have been written; the others are 0."""

    def __init__(self) -> None:
        self.words: dict[int, int] = {}

    def __getitem__(self, address: int) -> int:
        """Return a register's word; that of the levels follows from the pins."""
        if address % 4:
            raise ValueError("address not aligned")
        if address & 0xFFFFFFFF == _LEVELS:
            return sum(pin.value() << number for number, pin in Pin.pins.items())
        return self.words.get(address, 0)

    def __setitem__(self, address: int, value: int) -> None:
        """Write a register's word; through an alias: flip, set or clear its bits."""
        if address % 4:
            raise ValueError("address not aligned")
        value &= 0xFFFFFFFF
        for bank in _BANKS:
            alias, offset = divmod(address - bank, _ALIAS)
            if 0 < alias < 4:  # 1 flips, 2 sets, 3 clears
                address = bank + offset
                old = self[address]
                value = (old ^ value, old | value, old & ~value)[alias - 1]
                break
        self.words[address] = value


mem32 = _Memory()


class _Irq:
    """The result of Pin.irq()."""

    def __init__(self, pin: "Pin") -> None:
        self._pin = pin

    def trigger(self, edges: int) -> None:
        if edges & ~(Pin.IRQ_FALLING | Pin.IRQ_RISING):
            raise ValueError(
                "triggers of a level are not simulated: the handler would be called without end"
            )
        self._pin.trigger = edges
        if Pin.latched and self._pin in Pin.latched:
            Pin.latched.remove(self._pin)


class Pin:
    """A pin of the chip: one object per number. drive() sets it from outside, pad() is its output.

    Edges of a pin whose trigger is 0 are lost. A handler that raises is not called again. If there
    is a list `latched`, pins are added to it until a test calls interrupt(), as they wait while
    another interrupt runs.
    """

    IN, OUT, OPEN_DRAIN = 0, 1, 2
    PULL_UP, PULL_DOWN = 1, 2
    IRQ_FALLING, IRQ_RISING = 4, 8

    pins: dict[int, "Pin"] = {}
    latched: "list[Pin] | None" = None
    id: int

    def __new__(cls, id: int, *_: object, **__: object) -> "Pin":
        if not 0 <= id < (_PINS_2350 if _is_rp2350() else _PINS):
            raise ValueError("invalid pin")
        if id not in cls.pins:
            pin = cls.pins[id] = object.__new__(cls)
            pin.id, pin.mode, pin.pull = id, cls.IN, None
            pin.level, pin.driven = 0, None  # of its output; from outside, None: by nobody
            pin.handler, pin.trigger, pin.hard = None, 0, False
            pin.calls = 0
        return cls.pins[id]

    def __init__(
        self,
        id: int,
        mode: int = -1,
        pull: "int | None" = -1,
        *,
        value: "int | None" = None,
    ) -> None:
        """Set what is given; -1: it stays the same. __new__() has set the initial values."""
        self.mode: int = self.mode if mode == -1 else mode
        self.pull: "int | None" = self.pull if pull == -1 else pull
        self.driven: "int | None"
        self.handler: "Callable[[Pin], object] | None"
        self.trigger: int
        self.hard: bool
        self.calls: int  # calls of its handler
        if value is not None:
            self.level: int = value
        if mode != -1:
            self.select(_FUNCTION_SIO)

    def select(self, function: int) -> None:
        """Select the pin's function; this clears all overrides."""
        mem32[_CONTROL + _CONTROL_STEP * self.id] = function

    def pad(self) -> int:
        """Return the output: 0 to 65535, the share of time for which it is high."""
        control = mem32[_CONTROL + _CONTROL_STEP * self.id]
        is_pwm = control & _FUNCTION_MASK == _FUNCTION_PWM
        level = PWM.outputs[self.id].shape() if is_pwm else 65535 * self.level
        override = control >> _OUTOVER & 3
        return (level, 65535 - level, 0, 65535)[override]

    def __call__(self, level: "int | None" = None) -> int:
        return self.value(level)

    def on(self) -> None:
        self.value(1)

    def off(self) -> None:
        self.value(0)

    def toggle(self) -> None:
        self.value(not self.level)

    def value(self, level: "int | None" = None) -> int:
        """Return the level of the output, or of the input; with an argument, set the output. An
        input that nobody drives has the level of its pull."""
        if level is not None:
            self.level = 1 if level else 0
        if self.mode == Pin.OUT:
            return self.level
        if self.driven is not None:
            return self.driven
        return 1 if self.pull == Pin.PULL_UP else 0

    def irq(
        self,
        handler: "Callable[[Pin], object] | None" = None,
        trigger: int = 12,  # both edges
        *,
        hard: "bool | None" = None,
    ) -> "_Irq":
        if handler is not None:
            self.handler, self.trigger, self.hard = handler, trigger, bool(hard)
        elif hard is not None:
            raise NotImplementedError("removing a handler is not modelled")
        return _Irq(self)

    def drive(self, level: int) -> None:
        """Set the pin from outside; a change of level causes an interrupt, or waits in latched."""
        before = self.value()
        self.driven = level
        edge = Pin.IRQ_RISING if level else Pin.IRQ_FALLING
        if not self.handler or before == self.value() or not self.trigger & edge:
            return
        if Pin.latched is None:
            self.interrupt()
        elif self not in Pin.latched:
            Pin.latched.append(self)

    def interrupt(self) -> None:
        """Call its handler, which is removed if it raises."""
        self.calls += 1
        try:
            if self.handler:
                self.handler(self)
        except BaseException:
            self.handler, self.trigger = None, 0
            raise


def _checked_hz(hz: int) -> int:
    """Return a PWM's frequency, if the chip can make it."""
    if not 8 <= hz <= 62_500_000:
        raise ValueError("freq out of range")
    return hz


_CLOCK_HZ = 125_000_000


class PWM:
    """A pulse width; one per pin. A new value takes effect with the next pulse: see wrap()."""

    outputs: dict[int, "PWM"] = {}

    def __init__(self, pin: Pin, *, freq: int = 1907, duty_u16: int = 0, invert: int = 0) -> None:
        """Connect the pin. Without freq an RP2040 makes 1907 Hz: 125 MHz / 65536, in Hz.

        duty is the value set last, and playing that of the present pulse; both 0 to 65535.
        """
        self.frequency = _checked_hz(freq)
        self.duty = self.playing = duty_u16
        self.invert = invert
        PWM.outputs[pin.id] = self
        pin.select(_FUNCTION_PWM)

    def shape(self) -> int:
        """Return its output: 0 to 65535, the share of time for which it is high."""
        return 65535 - self.playing if self.invert else self.playing

    def wrap(self) -> None:
        """End a pulse."""
        self.playing = self.duty

    def freq(self, value: int = 0) -> int:
        """Return the integer closest to the frequency that the chip makes, at 125 MHz; with an
        argument, set it first."""
        if value:
            self.frequency = _checked_hz(value)
        counts = round(_CLOCK_HZ / self.frequency)
        return round(_CLOCK_HZ / counts)

    def duty_u16(self, duty: "int | None" = None) -> int:
        if duty is not None:
            if not 0 <= duty <= 65535:
                raise ValueError("duty out of range")
            self.duty = duty
        return self.duty

    def duty_ns(self, ns: int) -> None:
        self.duty_u16(min(65535, ns * self.frequency * 65535 // 1_000_000_000))

    def deinit(self) -> None:
        self.duty_u16(0)


class Timer:
    """A timer; expire() makes it due."""

    ONE_SHOT, PERIODIC = 0, 1

    def __init__(self, id: int = -1) -> None:
        if id != -1:
            raise ValueError("Timer doesn't exist")
        self.callback: "Callable[[Timer], object] | None" = None
        self.mode, self.period = Timer.PERIODIC, 0

    def init(
        self,
        *,
        mode: int = PERIODIC,
        period: int = -1,
        callback: "Callable[[Timer], object]",
        hard: bool = False,
    ) -> None:
        self.mode, self.period, self.callback, self.hard = mode, period, callback, hard

    def deinit(self) -> None:
        self.callback = None

    def expire(self) -> None:
        """Call the callback, as when its time is over."""
        callback = self.callback
        if self.mode == Timer.ONE_SHOT:
            self.callback = None
        if callback:
            callback(self)


class WDT:
    """A watchdog, which counts how often it has been fed."""

    def __init__(self, *, timeout: int) -> None:
        if not 1 <= timeout <= 8388:
            raise ValueError("timeout exceeds 8388")
        self.fed = 0

    def feed(self) -> None:
        self.fed += 1


class I2S:
    """Types only: the ESP32's is modelled in esp_machine.py."""

    TX: int
    STEREO: int
    MONO: int

    def __init__(self, *_: Any, **__: Any) -> None:
        raise NotImplementedError

    def write(self, data: object) -> int:
        raise NotImplementedError

    def fileno(self) -> int:
        raise NotImplementedError

    def deinit(self) -> None:
        raise NotImplementedError
