"""Start of an ESP32: its highest clock, and whether there is memory for all that follows.

Compiled code takes 88 kB of what the processor may run from, and MicroPython's heap grows into the
same where there is no PSRAM.
"""

import esp32
import machine
from micropython import const

_HZ = const(240_000_000)  # it starts with 160 MHz
# What the firmware takes from here on, besides what the heap has. Measured, see docs/esp32.md.
_WANTED = const(150_000)


def prepare() -> None:
    """Before any compiled code. Raises MemoryError where it and the heap would not fit."""
    machine.freq(_HZ)
    free = sum([heap[1] for heap in esp32.idf_heap_info(esp32.HEAP_DATA)])
    if free < _WANTED:
        raise MemoryError(
            "%d bytes free of the %d that the firmware wants: take a module with PSRAM, and "
            "MicroPython's image for it" % (free, _WANTED)
        )
