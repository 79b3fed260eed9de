# mypy: ignore-errors
"""Pulse counters of an ESP32, which see the pads of pins that others drive: no wire is needed.

MicroPython makes an input of each pin that a counter is given, and takes the pin away from whoever
drives it (pcnt_set_pin() of ESP-IDF). So what the GPIO matrix had there is put back, and the
output is switched on again. A counter has 16 bits: nothing here makes as many steps at a time.
"""

from esp32 import PCNT
from machine import Pin, mem32

from .config import CONFIG

MOST = 32_000  # steps from 0, either way
ENABLE, ENABLE_HIGH = 0x24, 0x30  # registers that switch outputs on: pins 0 to 31, and above
LEVELS, LEVELS_HIGH = 0x3C, 0x40  # what the pads show


def signal_at(pin):
    """The register that says what a pin shows."""
    return CONFIG["gpio"] + CONFIG["out_sel"] + 4 * pin


def bit_at(pin, low, high):
    """Of a register with a bit per pin: its address, and the bit."""
    return CONFIG["gpio"] + (low if pin < 32 else high), pin & 31


def given_back(pins, take):
    """What take() returns, and these pins are as they were."""
    shown = [mem32[signal_at(pin)] for pin in pins]
    taken = take()
    for pin, word in zip(pins, shown):
        mem32[signal_at(pin)] = word
        address, bit = bit_at(pin, ENABLE, ENABLE_HIGH)
        mem32[address] = 1 << bit
    return taken


def pad_level(pin):
    """What the pad shows, whoever drives it."""
    address, bit = bit_at(pin, LEVELS, LEVELS_HIGH)
    return mem32[address] >> bit & 1


class Counter:
    """Steps of one axis: forward ones less backward ones, since reset()."""

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
        """So far."""
        return self._unit.value()

    def reset(self):
        """From 0."""
        self._unit.value(0)

    def close(self):
        """See no more. Its pins are nobody's then."""
        self._unit.deinit()


class Edges:
    """Rising edges of one pin, whatever others do."""

    def __init__(self, unit, pin):
        def take():
            # The steps' counter that this unit has been has its mode from another pin.
            return PCNT(
                unit, pin=Pin(pin), rising=PCNT.INCREMENT, falling=PCNT.IGNORE, min=-MOST, max=MOST
            )

        self._unit = given_back((pin,), take)
        self._unit.start()
        self.take()

    def take(self):
        """So far, and from 0 again."""
        return self._unit.value(0)
