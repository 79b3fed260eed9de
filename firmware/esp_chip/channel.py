"""Channels: esp32.RMT of one axis, with the immediate stop that it lacks.

On the ESP32 `active(False)` overwrites only the first symbol of a train, and waits for the train's
end with interrupts off, while its pulses continue (ESP-IDF 5.5.1, rmt_tx.c). So a stop disconnects
the pin: the GPIO matrix connects it to the pin's own register, at its idle level. The channel
plays the train to its end without a pin, as MicroPython expects.

A train fits into the channel's memory, with its end marker. An interrupt would have to refill a
longer one; that interrupt waits while flash is written, and old steps would be repeated.
"""

import sys

import esp32
import machine
from micropython import const

RESOLUTION_HZ = const(1_000_000)  # a tick of RMT is 1 us

# A pin's word in the GPIO matrix.
_SIGNAL_BITS = const(0x1FF)  # the number of the signal that it outputs
_OWN_LEVEL = const(0x100)  # no signal, but the pin's own level
_INVERTED = const(0x200)  # the pin is inverted

# Per chip: symbols in a block of RMT's memory, blocks, RMT's first signal, pin 0's word's address.
_ESP32 = (64, 8, 87, 0x3FF44530)
_ESP32_S3 = (48, 4, 81, 0x60004554)


def _chip() -> "tuple[int, int, int, int]":
    """Return this chip's numbers: symbols in a block of RMT's memory, its blocks, the number of
    its first signal, and the address of pin 0's word in the GPIO matrix. Raises ValueError on an
    ESP32-S2."""
    name = sys.implementation._machine.split(" with ")[-1].replace("-", "")  # as ESP32S3
    if name.startswith("ESP32S2"):
        raise ValueError("ENGINE = rmt is for ESP32 and ESP32-S3")
    return _ESP32_S3 if name.startswith("ESP32S3") else _ESP32


def most_steps(axes: int) -> int:
    """Return the most steps in a train with so many axes, which share RMT's memory: each step
    takes a symbol, and the end takes one."""
    symbols, blocks, _, _ = _chip()
    return symbols * (blocks // axes) - 1


class Channel:
    """The pulses of one axis. number: of the channel, from 0, one per axis. pin: number of STEP.
    axes: how many there are; they share RMT's memory."""

    def __init__(self, number: int, pin: int, axes: int) -> None:
        symbols, blocks, first_signal, pin_0_word = _chip()
        step = machine.Pin(pin, machine.Pin.OUT, value=0)
        self._rmt = esp32.RMT(
            number, pin=step, resolution_hz=RESOLUTION_HZ, num_symbols=symbols * (blocks // axes)
        )
        self._matrix_word = pin_0_word + 4 * pin  # address of the pin's word in the GPIO matrix
        self._signal = machine.mem32[self._matrix_word] & _SIGNAL_BITS
        # The pin must output one of RMT's signals now.
        if not 0 <= self._signal - first_signal < blocks:
            raise ValueError(
                "pin %d does not output RMT pulses: choose a free pin that can be an output" % pin
            )
        self._inverted = 0  # or _INVERTED
        self.cut()  # until play()

    def invert(self, on: int) -> None:
        """Make pulses low (on = 1), or high (0). Only while idle."""
        self._inverted = _INVERTED if on else 0
        self.cut()

    def cut(self) -> None:
        """Disconnect the pin from the channel, at its idle level."""
        machine.mem32[self._matrix_word] = _OWN_LEVEL | self._inverted

    def play(self, durations: "list[int]") -> None:
        """Start a train: durations in us, a pause first; the last train must have ended."""
        machine.mem32[self._matrix_word] = self._signal | self._inverted
        self._rmt.write_pulses(durations, False)
