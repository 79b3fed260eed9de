"""esp32.PCNT, which counts the levels at the pins, in virtual time.

Modelled on ports/esp32/esp32_pcnt.c of MicroPython 1.28 and pcnt_legacy.c of ESP-IDF 5: a pin that
is given to a counter becomes an input with a pull-up, and its output is disconnected. Arguments
that they refuse are refused, and so is what our programs do not use. Runs under CPython and
MicroPython.
"""

import esp_machine
from esp_clock import clock

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    Event = tuple[int, int, int]  # us, source, new value

# Sources of a pin's level: the selection word of the GPIO matrix, its own level, and the signal.
_WORD, _OWN, _SIGNAL = 0, 1, 2
_SELECTION = 0x1FF  # bits of the word that select the signal
_FULL_DUTY = 65_535


def _channel(pin: int) -> "Any":
    """Return the RMT channel of a pin, or None."""
    import esp32

    for channel in esp32.RMT.channels:
        if channel.pin.id == pin:
            return channel
    return None


class Pad:
    """The level at a pin, from now on: its own level, its RMT channel's, or its PWM's."""

    def __init__(self, pin: int) -> None:
        self.pin = pin
        self.level = 0
        self._read = [0, 0]  # of both logs: by source, _WORD and _OWN
        self._train = self._edge = 0  # the next edge: index of its train, and in this train
        # The present values, by source: _WORD, _OWN, _SIGNAL.
        self._sources = [esp_machine.Pads.register, 0, 0]
        self.run(clock.us)

    def run(self, until: int) -> "list[tuple[int, int]]":
        """Return changes of the level since the last call and up to then, (us, level)."""
        events = self._log_events(until) + self._train_events(until)
        changes = []
        # By time, then by index, because MicroPython's sort() is not stable.
        for _, index in sorted([(events[i][0], i) for i in range(len(events))]):
            us, source, value = events[index]
            self._sources[source] = value
            level = self._level_now()
            if level != self.level:
                self.level = level
                changes.append((us, level))
        return changes

    def _level_now(self) -> int:
        """Return the level that follows from the sources: the word selects one of the others."""
        word = self._sources[_WORD]
        if word & esp_machine.Pads.OFF:
            return 1  # the pull-up
        has_own = word & _SELECTION == esp_machine.Pads.register
        is_inverted = word & esp_machine.Pads.inverted
        return self._sources[_OWN if has_own else _SIGNAL] ^ (1 if is_inverted else 0)

    def _log_events(self, until: int) -> "list[Event]":
        """Return new entries of both logs up to then: of selection words, and of own levels."""
        pin = esp_machine.Pin.pins[self.pin]
        words = esp_machine.mem32.log.get(self.pin, [])
        own_levels = [] if self.pin in esp_machine.PWM.outputs else pin.log  # of a PWM: its duty
        events = []
        for source, log in ((_WORD, words), (_OWN, own_levels)):
            while self._read[source] < len(log) and log[self._read[source]][0] <= until:
                us, value = log[self._read[source]]
                events.append((us, source, value))
                self._read[source] += 1
        return events

    def _train_events(self, until: int) -> "list[Event]":
        """Return new edges of the channel's trains up to then; of an aborted train, those up to
        its end."""
        channel = _channel(self.pin)
        events: "list[Event]" = []
        while channel and self._train < len(channel.trains):
            start, level, durations, end = channel.trains[self._train]
            us = start + sum(durations[: self._edge])
            while self._edge < len(durations) and us <= min(until, end):
                events.append((us, _SIGNAL, level ^ (self._edge & 1)))
                us += durations[self._edge]
                self._edge += 1
            if end > until:
                break
            events.append((end, _SIGNAL, 0))  # the idle level
            self._train += 1
            self._edge = 0
        return events


def pwm_level(pwm: "Any", us: int) -> int:
    """Return the level of a PWM's output. Its period begins at 0."""
    period = 1_000_000 // pwm.frequency  # us
    return int(_FULL_DUTY * (us % period) < pwm.duty * period) ^ int(pwm.invert)


def pad_now(pin: int) -> int:
    """Return the level at a pin now. The level of a PWM follows from the time."""
    pwm = esp_machine.PWM.outputs.get(pin)
    if pwm is None:
        if pin not in PCNT.pads:
            PCNT.pads[pin] = Pad(pin)
        PCNT.pads[pin].run(clock.us)
        return PCNT.pads[pin].level
    is_off = esp_machine.mem32.word(pin) & esp_machine.Pads.OFF
    return 1 if is_off else pwm_level(pwm, clock.us)  # 1: the pull-up


class PCNT:
    """A counter, one per id. Only what our programs use is modelled: one channel, no interrupt."""

    IGNORE, INCREMENT, DECREMENT = 0, 1, 2
    NORMAL, REVERSE, HOLD = 0, 1, 2
    units: "dict[int, PCNT]" = {}
    pads: "dict[int, Pad]" = {}  # pins that have been read
    most_units = 8  # S3: 4
    lose = 0  # for tests: every n-th step is missed; 0: none

    _pad: "Pad | None"  # of the pin whose steps are counted
    _mode: "Pad | None"  # of the pin that may reverse them
    _pwm: "Any"  # the PWM at the pin, else None
    _range: "tuple[int, int]"  # limits of the count

    def __new__(cls, id: int, **_: object) -> "PCNT":
        if not 0 <= id < cls.most_units:
            raise ValueError("invalid id")
        if id not in cls.units:
            cls.units[id] = object.__new__(cls)
            cls.units[id].deinit()
        return cls.units[id]

    def __init__(self, id: int, **arguments: "Any") -> None:
        self.init(**arguments)

    def init(
        self,
        *,
        channel: int = 0,
        pin: "Any" = None,
        mode_pin: "Any" = None,
        rising: "int | None" = None,
        falling: int = 0,
        mode_low: int = 0,
        mode_high: int = 0,
        min: "int | None" = None,
        max: "int | None" = None,
        filter: int = 0,
        value: "int | None" = None,
    ) -> None:
        """Set what is given; the rest stays. New limits, or value=0, set the count to 0."""
        if channel or filter or falling or mode_low or rising == self.DECREMENT:
            raise NotImplementedError("only what our programs use is modelled")
        if mode_pin is not None and pin is None:
            raise ValueError("pin")
        if mode_high not in (self.NORMAL, self.REVERSE):
            raise ValueError("mode_high")
        if min is not None and not -32768 <= min <= 0:
            raise ValueError("minimum")
        if max is not None and not 0 <= max <= 32767:
            raise ValueError("maximum")
        if value:
            raise ValueError("value")
        self._run()
        self._set_pins(pin, mode_pin)
        if rising is not None:
            self._counts, self._reverses = rising == self.INCREMENT, mode_high == self.REVERSE
        self._range = (
            self._range[0] if min is None else min,
            self._range[1] if max is None else max,
        )
        if not (min is None and max is None and value is None):
            self._value = 0

    def _set_pins(self, pin: "Any", mode_pin: "Any") -> None:
        """Make the pins inputs, and follow their levels; None: the pin stays the same."""
        for new_pin in (pin, mode_pin):
            if new_pin is not None:
                esp_machine.mem32.take_output(new_pin.id)
        if pin is not None:
            self._pwm = esp_machine.PWM.outputs.get(pin.id)
            self._pad = Pad(pin.id)
        if mode_pin is not None:
            self._mode = Pad(mode_pin.id)

    def deinit(self) -> None:
        """Release the pins, and restore the initial state."""
        self._pad = None
        self._mode = None
        self._pwm = None
        self._counts = self._reverses = self._started = False
        self._range = (0, 0)
        self._value = self._seen = 0  # the count, and the number of steps at the pin
        self._since = clock.us  # the steps before are counted already

    def start(self) -> None:
        self._run()
        self._started = True

    def stop(self) -> None:
        self._run()
        self._started = False

    def value(self, value: "int | None" = None) -> int:
        """Return the count; with 0, reset it."""
        if value:
            raise ValueError("value")
        self._run()
        count = self._value
        if value == 0:
            self._value = 0
        return count

    def _run(self) -> None:
        """Count the steps up to now."""
        if self._pwm:
            self._run_pwm()
        elif self._pad:
            mode_changes = self._mode.run(clock.us) if self._mode else []
            mode_level = self._level_before(mode_changes)
            for us, level in self._pad.run(clock.us):
                while mode_changes and mode_changes[0][0] <= us:
                    mode_level = mode_changes.pop(0)[1]
                is_rising = level == 1
                if is_rising and self._started and self._counts:
                    self._step(-1 if mode_level and self._reverses else 1)
        self._since = clock.us

    def _level_before(self, mode_changes: "list[tuple[int, int]]") -> int:
        """Return the mode pin's level before these changes; 0 without a mode pin."""
        if mode_changes:
            return 1 - mode_changes[0][1]
        return self._mode.level if self._mode else 0

    def _run_pwm(self) -> None:
        """Count a PWM's periods up to now."""
        is_off = esp_machine.mem32.word(self._pwm.pin.id) & esp_machine.Pads.OFF
        if not is_off and self._started and 0 < self._pwm.duty < _FULL_DUTY:
            period = 1_000_000 // self._pwm.frequency  # us
            self._value += clock.us // period - self._since // period

    def _step(self, sign: int) -> None:
        """Count a step forward (1) or backward (-1)."""
        self._seen += 1
        if self.lose and self._seen % self.lose == 0:
            return  # missed, for a test
        self._value += sign
        if not self._range[0] < self._value < self._range[1]:
            raise OverflowError(
                "the counter has overflowed: it restarts at 0 without calling a handler"
            )
