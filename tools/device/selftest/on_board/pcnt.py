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
ENABLE, ENABLE_HIGH = 0x24, 0x30  # registers that enable outputs: of pins 0 to 31, and above
LEVELS, LEVELS_HIGH = 0x3C, 0x40  # registers with the levels at the pins


def signal_at(pin):
    """Return the address of the register that selects a pin's output signal."""
    return CONFIG["gpio"] + CONFIG["out_sel"] + 4 * pin


def bit_at(pin, low, high):
    """Return address and bit number of a pin in a register with a bit per pin."""
    return CONFIG["gpio"] + (low if pin < 32 else high), pin & 31


def given_back(pins, take):
    """Call take(), then make these pins outputs with their former signals again. Returns its
    result."""
    shown = [mem32[signal_at(pin)] for pin in pins]
    taken = take()
    for pin, word in zip(pins, shown):
        mem32[signal_at(pin)] = word
        address, bit = bit_at(pin, ENABLE, ENABLE_HIGH)
        mem32[address] = 1 << bit
    return taken


def pad_level(pin):
    """Return the level at the pin, whatever drives it."""
    address, bit = bit_at(pin, LEVELS, LEVELS_HIGH)
    return mem32[address] >> bit & 1


class Counter:
    """Counts the steps of one axis: forward minus backward, since reset()."""

    def __init__(self, unit, step, direction):
        def take():
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

        self._unit = given_back((step, direction), take)
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
        def take():
            # This unit may have counted steps before; it has the mode of another pin from that.
            return PCNT(
                unit, pin=Pin(pin), rising=PCNT.INCREMENT, falling=PCNT.IGNORE, min=-MOST, max=MOST
            )

        self._unit = given_back((pin,), take)
        self._unit.start()
        self.take()

    def take(self):
        """Return the count and set it to 0."""
        return self._unit.value(0)
