# mypy: ignore-errors
"""Pulse counters of an ESP32. They read pins that others drive; no wire is needed.

MicroPython makes an input of each pin that a counter gets, and disconnects it from its output
(pcnt_set_pin() of ESP-IDF). So the pin's output selection in the GPIO matrix is restored, and the
output is enabled again. A counter has 16 bits; no check makes as many steps at a time.
"""

from esp32 import PCNT
from machine import Pin, mem32

from .config import CONFIG

MOST = 32_000  # a counter's range, in steps from 0, both ways
# Offsets of registers with a bit per pin, for pins 0 to 31 and for those above. ENABLE_SET is
# write-1-to-set: it enables the output of each pin whose bit is 1, and leaves the others as they
# are (GPIO_ENABLE_W1TS, GPIO_ENABLE1_W1TS).
ENABLE_SET, ENABLE_SET_HIGH = 0x24, 0x30
LEVELS, LEVELS_HIGH = 0x3C, 0x40  # the levels at the pins


def signal_at(pin):
    """Return the address of the register that selects a pin's output signal."""
    return CONFIG["gpio"] + CONFIG["out_sel"] + 4 * pin


def bit_at(pin, low, high):
    """Return address and bit number of a pin in a register with a bit per pin."""
    return CONFIG["gpio"] + (low if pin < 32 else high), pin & 31


def keep_outputs(pins, make_counter):
    """Return the result of make_counter(), and keep these pins as outputs.

    make_counter() makes inputs of them. After it, each pin gets its former signal again, and its
    output is enabled.
    """
    signals = [mem32[signal_at(pin)] for pin in pins]  # which signal each pin outputs
    counter = make_counter()
    for pin, signal in zip(pins, signals):
        mem32[signal_at(pin)] = signal
        address, bit = bit_at(pin, ENABLE_SET, ENABLE_SET_HIGH)
        mem32[address] = 1 << bit  # write-1-to-set: enables this output only
    return counter


def pad_level(pin):
    """Return the level at the pin, whatever drives it."""
    address, bit = bit_at(pin, LEVELS, LEVELS_HIGH)
    return mem32[address] >> bit & 1


class Counter:
    """Counts the steps of one axis: forward minus backward, since reset()."""

    def __init__(self, unit, step, direction):
        def make_counter():
            """Return a counter of rising edges, up or down by the direction's level."""
            return PCNT(
                unit,
                pin=Pin(step),
                mode_pin=Pin(direction),
                rising=PCNT.INCREMENT,
                falling=PCNT.IGNORE,
                mode_low=PCNT.NORMAL,
                mode_high=PCNT.REVERSE,
                min=-MOST,
                max=MOST,
                filter=0,
            )

        self._unit = keep_outputs((step, direction), make_counter)
        self._unit.start()
        self.reset()

    def steps(self):
        """Return the count."""
        return self._unit.value()

    def reset(self):
        """Set the count to 0."""
        self._unit.value(0)

    def close(self):
        """Release the counter. Its pins are then without a function."""
        self._unit.deinit()


class Edges:
    """Counts the rising edges of one pin, whatever drives it."""

    def __init__(self, unit, pin):
        def make_counter():
            # Without a mode_pin, that is, it always counts up, although this unit may have counted
            # steps, with a direction, before.
            return PCNT(
                unit, pin=Pin(pin), rising=PCNT.INCREMENT, falling=PCNT.IGNORE, min=-MOST, max=MOST
            )

        self._unit = keep_outputs((pin,), make_counter)
        self._unit.start()
        self.take()

    def take(self):
        """Return the count and set it to 0."""
        return self._unit.value(0)
