"""Start of an ESP32: set its highest clock, and check that there is enough memory.

Compiled code takes 88 kB of the memory that can be executed, and MicroPython's heap grows into the
same memory if there is no PSRAM. Frozen code stays in flash.
"""

import sys

import esp32
import machine
from micropython import const

_HZ = const(240_000_000)  # at reset it is 160 MHz
# The firmware's need of memory from here on, without the heap. Measured, see docs/esp32.md.
_WANTED_BYTES = const(150_000)  # free memory: compiled code and heap
_COMPILED_BYTES = const(88_000)  # compiled code's part of it


def prepare() -> None:
    """Set the clock, and check the free memory. Call it before any compiled code is loaded.
    Raises MemoryError if that and the heap would not fit."""
    machine.freq(_HZ)
    # Per region of memory: its size, its free bytes, and two numbers that are not needed.
    heaps = esp32.idf_heap_info(esp32.HEAP_DATA)
    free = sum([free_bytes for _, free_bytes, _, _ in heaps])
    wanted = _WANTED_BYTES
    if "base.frozen" in sys.modules:  # the firmware is frozen: its code stays in flash
        wanted -= _COMPILED_BYTES
    if free < wanted:
        raise MemoryError(
            "only %d bytes of RAM are free, the firmware needs %d: use a module with PSRAM and "
            "the MicroPython image for it" % (free, wanted)
        )
