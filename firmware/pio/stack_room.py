# mypy: disable-error-code=arg-type
"""Stack room: the user's Python ends where a kilobyte of the stack is left.

MicroPython ends what calls itself too deep where 256 bytes are left. An interrupt that comes just
then finds no room; MicroPython takes it away and prints why, for which 256 bytes are too little:
the chip hangs until the watchdog starts it anew. Where the limit stands is found by what stands
beside it, the top of the stack (mp_state_thread_t, MicroPython 1.26 to 1.28).
"""

import micropython
from micropython import const

from pio.stack import SIZE, find_top

_MARGIN = const(256)  # MicroPython's, on these chips
_ROOM = const(1024)
# MicroPython's variables lie at the beginning of memory.
_MEMORY = const(0x20000000)
_WORDS = const(16384)


@micropython.viper
def _lower(words: ptr32, count: int, top: int, limit: int, lower: int) -> int:
    for i in range(count):
        if words[i] == top and words[i + 1] == limit:
            words[i + 1] = lower
            return 1
    return 0


def leave() -> bool:
    """Leave that much from now on. False where the limit is not found: nothing has changed."""
    return bool(_lower(_MEMORY, _WORDS, find_top(), SIZE - _MARGIN, SIZE - _ROOM))
