"""Start of an ESP32: its highest clock, and compiled parts into memory before all else.

Compiled code needs memory that the processor may run from, and MicroPython's heap grows into the
same. So these modules are first, the largest at their head.
"""

import esp32
import machine
from micropython import const

_HZ = const(240_000_000)  # it starts with 160 MHz


def prepare(modules: "list[str]") -> None:
    """Import the modules. Raises MemoryError with what was free where there is no room."""
    machine.freq(_HZ)
    name = ""
    try:
        for name in modules:
            __import__(name)
    except MemoryError:
        heaps = esp32.idf_heap_info(esp32.HEAP_EXEC)
        free = sum([heap[1] for heap in heaps])
        piece = max([heap[2] for heap in heaps])
        raise MemoryError(
            "no room for %s among compiled code: %d bytes free, %d in one piece"
            % (name, free, piece)
        )
