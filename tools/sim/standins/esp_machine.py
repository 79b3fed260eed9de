"""The ESP32's `machine` module, where it differs from the RP2's: all callbacks are soft.

Modelled on ports/esp32 of MicroPython and ESP-IDF 5: I2S plays a ring of DMA buffers for ever,
clears each one after it was played, and returns the one played longest ago; if buffers are not
taken, the oldest is dropped. In virtual time; runs under CPython and MicroPython. What is not
modelled raises an exception.
"""

import io

from esp_clock import clock

_DMA_FRAMES = 256
_POLL = 3  # MP_STREAM_POLL
_FIRST_PAD = 0x3FF44530  # GPIO_FUNC0_OUT_SEL_CFG_REG of the ESP32
_FIRST_PAD_S3 = 0x60004554
# Offsets of registers with a bit per pin: output enables, and levels.
_ENABLES = (0x24, 0x30)
_LEVELS = (0x3C, 0x40)
_LEDC_SIGNAL = 71
_hz = [160_000_000]  # the frequency at power-up


def freq(hz: int = 0) -> int:
    if hz:
        if hz not in (80_000_000, 160_000_000, 240_000_000):
            raise ValueError("frequency must be 80MHz, 160MHz or 240MHz")
        _hz[0] = hz
    return _hz[0]


class Pads:
    """machine.mem32, limited to pins: the GPIO matrix (which signal each pin shows), output
    enables, and levels.

    `log` has (us, selection word) of every change, by pin: the signal, `inverted`, and OFF, which
    is not the chip's: the pin's output is disabled.
    """

    register = 0x100  # the pin's own level
    inverted = 0x200
    OFF = 0x10000
    first = _FIRST_PAD

    def __init__(self) -> None:
        self.log: "dict[int, list[tuple[int, int]]]" = {}

    def connect(self, pin: int, signal: int) -> None:
        """Connect a signal to a pin, as a driver does."""
        self.log.setdefault(pin, []).append((clock.us, signal))

    def _pin(self, address: int) -> int:
        """Return the pin whose selection register has this address."""
        pin = (address - self.first) // 4
        if address % 4 or (pin not in self.log and pin not in Pin.pins):
            raise ValueError("no such register is modelled")
        return pin

    def word(self, pin: int) -> int:
        """Return a pin's selection word, with OFF."""
        return self.log[pin][-1][1] if pin in self.log else self.register

    def take_output(self, pin: int) -> None:
        """Make a pin an input, as gpio_set_direction() of ESP-IDF does."""
        self.connect(pin, self.register | self.OFF)

    def _first_pin(self, address: int, registers: "tuple[int, int]") -> int:
        """Return the pin of bit 0 if the address is one of these registers, which have a bit per
        pin and are for pins 0 to 31 and from 32; else -1."""
        offset = address - (self.first & ~0xFFF)  # from the beginning of the GPIO registers
        return 32 * registers.index(offset) if offset in registers else -1

    def __getitem__(self, address: int) -> int:
        """Return a register: a pin's selection word, or levels of up to 32 pins."""
        first = self._first_pin(address, _LEVELS)
        if first < 0:
            return self.word(self._pin(address)) & ~self.OFF
        from esp_pcnt import pad_now

        clock.work(1)
        pins = [pin for pin in Pin.pins if first <= pin < first + 32]
        return sum([pad_now(pin) << (pin - first) for pin in pins])

    def __setitem__(self, address: int, word: int) -> None:
        """Write a pin's selection word, or enable the outputs of all pins whose bit is set."""
        first = self._first_pin(address, _ENABLES)
        if first < 0:
            pin = self._pin(address)
            self.connect(pin, word | (self.word(pin) & self.OFF))
            return
        for pin in range(first, first + 32):
            if word >> (pin - first) & 1:
                self.connect(pin, self.word(pin) & ~self.OFF)


mem32 = Pads()


class IRQ:
    """The result of Pin.irq()."""

    def __init__(self, pin: "Pin") -> None:
        self._pin = pin

    def trigger(self, edges: int) -> int:
        if edges & ~3:
            raise ValueError("levels would call for ever")
        before, self._pin.trigger = self._pin.trigger, edges
        return before


class Pin:
    """A pin; `log` has (us, level) of every change of its output."""

    IN, OUT = 1, 3
    PULL_DOWN, PULL_UP = 1, 2
    IRQ_RISING, IRQ_FALLING = 1, 2
    pins: "dict[int, Pin]" = {}
    _is_new = True  # the first __init__ of a pin: later ones keep its state
    without_output = (34, 35, 36, 37, 38, 39)  # and without pull-ups: ESP32

    def __new__(cls, id: int, *_: object, **__: object) -> "Pin":
        if not 0 <= id < 49:
            raise ValueError("invalid pin")
        if id not in cls.pins:
            cls.pins[id] = object.__new__(cls)
        return cls.pins[id]

    def __init__(
        self, id: int, mode: int = -1, pull: "int | None" = -1, *, value: "int | None" = None
    ) -> None:
        if self._is_new:
            self._is_new = False
            self.id = id
            self.level = 0
            self.mode = 0
            self.pull: "int | None" = None
            self.driven = False
            self.log: "list[tuple[int, int]]" = []
            self.handler: object = None
            self.trigger = 0
        if id in self.without_output and (mode == self.OUT or pull not in (-1, None)):
            raise ValueError("pin can only be input, and has no pull")
        if mode != -1:
            self.mode = mode
        if pull != -1:
            self.pull = pull
            if not self.driven and pull in (self.PULL_UP, self.PULL_DOWN) and self.mode == self.IN:
                self._set(1 if pull == self.PULL_UP else 0)
        if value is not None:
            self.value(value)

    def __call__(self) -> int:
        return self.value()

    def value(self, level: "int | None" = None) -> int:
        if level is None:
            return self.level
        if self.mode != self.OUT:
            raise ValueError("an input is written to")
        self.level = 1 if level else 0
        self.log.append((clock.us, self.level))
        return 0

    def _set(self, level: int) -> None:
        """Set an input's level; if it changes, call the handler of this edge."""
        if level != self.level:
            self.level = level
            edge = self.IRQ_RISING if level else self.IRQ_FALLING
            if self.handler and self.trigger & edge:
                clock.call(self.handler, self)

    def irq(self, handler: object = None, trigger: int = 3) -> "IRQ":
        if handler is not None:
            self.handler = handler
            self.trigger = trigger
        return IRQ(self)

    def drive(self, level: int) -> None:
        """Set the level from outside."""
        self.driven = True
        self._set(level)


class PWM:
    """A PWM output."""

    outputs: "dict[int, PWM]" = {}  # by pin

    def __init__(
        self, dest: Pin, *, freq: int, duty_u16: int = 0, invert: "bool | int" = False
    ) -> None:
        self.freq(freq)
        self.pin = dest
        self.invert = invert
        mem32.connect(dest.id, _LEDC_SIGNAL)
        PWM.outputs[dest.id] = self
        self.duty_u16(duty_u16)

    def freq(self, value: int = 0) -> int:
        if value:
            if not 0 < value <= 40_000_000:
                raise ValueError("frequency must be from 1Hz to 40MHz")
            self.frequency = value
        return self.frequency

    def duty_u16(self, duty: int) -> None:
        if not 0 <= duty <= 65535:
            raise ValueError("duty_u16 must be from 0 to 65535")
        self.duty = duty
        self.pin.log.append((clock.us, duty))


class Timer:
    """machine.Timer of the ESP32: soft callbacks only."""

    ONE_SHOT, PERIODIC = 0, 1

    def __init__(self, id: int = -1) -> None:
        if id >= 4:
            raise ValueError("there are only 4 hardware timers")
        self.due = 0
        self._period = 0
        self._mode = 0

    def init(
        self, *, mode: int = 1, period: int = -1, callback: object = None, hard: bool = False
    ) -> None:
        if hard:
            raise ValueError("hard Timers are not implemented")
        if period <= 0:
            raise ValueError("Timer period is too short for this timer")
        self.deinit()
        self.callback = callback
        self._mode = mode
        self._period = period * 1000
        self.due = clock.us + self._period
        clock.timers.append(self)
        clock.rearmed()

    def rearm(self) -> None:
        """Set the next due time. It does not depend on how late the callback runs."""
        self.due += self._period
        if self._mode == self.ONE_SHOT:
            self.deinit()

    def deinit(self) -> None:
        """Stop the timer. A callback that is already scheduled still runs."""
        if self in clock.timers:
            clock.timers.remove(self)
            clock.rearmed()


class WDT:
    """The watchdog. There is one; a new object sets its timeout again, and it never stops. `fed`:
    time of the last feed."""

    timeout_ms = 0
    fed = 0

    def __init__(self, id: int = 0, timeout: int = 5000) -> None:
        if id != 0:
            raise ValueError
        if timeout <= 0:
            raise ValueError("WDT timeout too short")
        if timeout >= 1 << 30:
            raise ValueError("its hardware counts no further")
        WDT.timeout_ms = timeout
        self.feed()

    def feed(self) -> None:
        if WDT.fed and clock.us - WDT.fed > 1000 * WDT.timeout_ms:
            raise RuntimeError("the chip has started anew meanwhile")
        WDT.fed = clock.us


class I2S(io.IOBase):
    """machine.I2S, transmitting. `played` gets (us, words as bytes) of each DMA buffer started."""

    RX, TX = 0, 1
    STEREO, MONO = 0, 1
    open_streams: "dict[int, I2S]" = {}
    open_us = 400  # duration of opening
    recording = False  # fill `played`

    def __init__(
        self,
        id: int,
        *,
        sck: object,
        ws: object,
        sd: object,
        mode: int,
        bits: int,
        format: int,
        rate: int,
        ibuf: int,
    ) -> None:
        if id not in (0, 1):
            raise ValueError("invalid id")
        if mode != self.TX or format != self.MONO:
            raise NotImplementedError("only what our engine uses is modelled")
        if bits not in (16, 32):
            raise ValueError("invalid bits")
        if bits == 16 or _DMA_FRAMES * 1_000_000 % rate:  # a buffer takes whole us
            raise NotImplementedError("only what our engine uses is modelled")
        clock.work(self.open_us)
        self.rate = rate
        self.size = _DMA_FRAMES * bits // 8
        self.buffer_us = _DMA_FRAMES * 1_000_000 // rate
        self.memory = [bytearray(self.size) for _ in range(max(2, ibuf // self.size))]
        self.played: "list[tuple[int, bytes]]" = []
        self._never_waits = False  # write(), once poll() has been used
        self._free: "list[int]" = []  # indices of buffers played and not taken, oldest first
        self._current: "bytearray | None" = None  # the buffer taken, and being written
        self._written = 0  # bytes written to it
        self._began = clock.us  # when the buffer now playing began
        self._playing = 0  # its index
        self._has_interrupts = True  # not during a write to flash
        self._record()
        I2S.open_streams[id] = self

    def _record(self) -> None:
        if self.recording:
            self.played.append((self._began, bytes(self.memory[self._playing])))

    def run(self) -> None:
        """Let DMA work up to the present time."""
        count = len(self.memory)
        while self._began + self.buffer_us <= clock.us:
            self._began += self.buffer_us
            done = self._playing
            self._playing = (done + 1) % count
            self._record()
            if self._has_interrupts:
                self._free_buffer(done)

    def _free_buffer(self, done: int) -> None:
        """Handle the interrupt at the end of a buffer: it may be written again."""
        buffer = self.memory[done]
        buffer[:] = bytes(len(buffer))  # auto_clear
        if len(self._free) == len(self.memory) - 1:  # the oldest one is lost to the writer
            self._free.pop(0)
        self._free.append(done)

    def flash_write(self, us: int) -> None:
        """Write to flash: all buffers that end meanwhile cause a single interrupt, for the last
        one."""
        self.run()
        began = self._began
        self._has_interrupts = False
        clock.work(us)
        self.run()
        self._has_interrupts = True
        if self._began > began:
            self._free_buffer((self._playing - 1) % len(self.memory))

    def fileno(self) -> int:
        """Support poll() of CPython: return a file that is always writable."""
        self._never_waits = True
        return 1

    def ioctl(self, request: int, flags: int) -> int:
        """Support poll() of MicroPython."""
        if request != _POLL:
            return -1
        self._never_waits = True
        return flags

    def write(self, buf: "bytearray | memoryview") -> int:
        """Write to free buffers; return the number of bytes. Without poll(), wait for buffers."""
        if not self.size:
            raise OSError("the stream is closed")
        self.run()
        done = 0
        while done < len(buf):
            if self._current is None or self._written == self.size:  # take another one
                while not self._free and not self._never_waits:
                    clock.work(self.buffer_us)
                    self.run()
                if not self._free:
                    break
                self._current = self.memory[self._free.pop(0)]
                self._written = 0
            count = min(len(buf) - done, self.size - self._written)
            self._current[self._written : self._written + count] = buf[done : done + count]
            self._written += count
            done += count
        clock.work(20)
        return done

    def deinit(self) -> None:
        if not self.size:
            return
        self.run()
        self.size = 0
        clock.work(20)
        self.closed_us = clock.us
        clock.work(100)
