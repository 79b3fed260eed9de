"""Channels: esp32.RMT of one axis, and the stop at once that it does not have.

On the ESP32 `active(False)` overwrites the first symbol of a train only and waits for the train's
end, interrupts off, while its pulses go on (ESP-IDF 5.5.1, rmt_tx.c). So a stop takes the pin away
from the channel: the GPIO matrix gives it to the pin's own register, which rests. The train plays
on to nobody and to its end, as MicroPython expects it to.

A train fits into the channel's memory with the mark of its end. What did not fit would be filled
in by an interrupt, which waits while flash is written to, and old steps would be played again.
"""

import sys

import esp32
import machine
from micropython import const

RESOLUTION_HZ = const(1_000_000)

# A pin's word in the GPIO matrix: the signal it shows, and whether inverted.
_SIGNAL = const(0x1FF)
_REGISTER = const(0x100)  # no signal, but the pin's own level
_INVERTED = const(0x200)

# Of a chip: symbols of a block of RMT's memory, blocks, RMT's first signal, pin 0's word.
_ESP32 = (64, 8, 87, 0x3FF44530)
_ESP32_S3 = (48, 4, 81, 0x60004554)


def _chip() -> "tuple[int, int, int, int]":
    name = sys.implementation._machine.split(" with ")[-1].replace("-", "")
    if name.startswith("ESP32S2"):
        raise ValueError("ENGINE = rmt is for ESP32 and ESP32-S3")
    return _ESP32_S3 if name.startswith("ESP32S3") else _ESP32


def most_steps(axes: int) -> int:
    """How many steps there may be in a train: a symbol each, and one for the end."""
    symbols, blocks, _, _ = _chip()
    return symbols * (blocks // axes) - 1


class Channel:
    """number: from 0, for each axis. axes: how many there are; they share RMT's memory."""

    def __init__(self, number: int, pin: int, axes: int) -> None:
        symbols, blocks, signal, word = _chip()
        step = machine.Pin(pin, machine.Pin.OUT, value=0)
        self._rmt = esp32.RMT(
            number, pin=step, resolution_hz=RESOLUTION_HZ, num_symbols=symbols * (blocks // axes)
        )
        self._word = word + 4 * pin
        self._signal = machine.mem32[self._word] & _SIGNAL
        if not 0 <= self._signal - signal < blocks:
            raise ValueError("pin %d does not show what RMT makes" % pin)
        self._inverted = 0
        self.cut()

    def invert(self, on: int) -> None:
        """Pulses are low, or high. At rest."""
        self._inverted = _INVERTED if on else 0
        self.cut()

    def cut(self) -> None:
        """The pin rests, from now on."""
        machine.mem32[self._word] = _REGISTER | self._inverted

    def play(self, durations: "list[int]") -> None:
        """Begin a train, with a pause; the last one has ended. Returns once it has begun."""
        machine.mem32[self._word] = self._signal | self._inverted
        self._rmt.write_pulses(durations, False)
