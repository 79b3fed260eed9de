# mypy: disable-error-code=arg-type
"""Where MicroPython keeps what has come over USB: a ring in memory, found by trying it out."""

import array

import micropython
from link_escape import push
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

# MicroPython's struct ringbuf_t: address, size : 16, iget : 16, iput : 16.
_RING_BYTES = const(512)
_MEMORY = const(0x20000000)
_MEMORY_WORDS = const(0x10000)
_TRIALS = (b"Where is the ring?", b"Here?")
_REMEMBERED = const(8)  # integers that take() wants, the first being the ring's address


@micropython.viper
def _find(memory: ptr32, start: int, trial: ptr8, length: int) -> int:
    """Index, from start on, of a word that may begin a ring that ends with the trial; or -1."""
    i = start
    while i < _MEMORY_WORDS - 3:
        at = memory[i] - _MEMORY
        sizes = memory[i + 1]
        if at > 0 and at < 4 * _MEMORY_WORDS and sizes & 0xFFFF == _RING_BYTES:
            get = (sizes >> 16) & 0xFFFF
            put = memory[i + 2] & 0xFFFF
            if get < _RING_BYTES and put < _RING_BYTES and (put - get) & 511 >= length:
                data = ptr8(memory[i])
                same = 0
                while same < length and data[(get + same) & 511] == trial[same]:
                    same += 1
                if same == length:
                    return i
        i += 1
    return -1


def find(
    drain: "Callable[[], bytearray]",
    take: "Callable[[array.array[int], bytearray, int], int]",
) -> int:
    """Address of the ring, or 0. drain: reads all that has come; take: as link_usb has it."""
    early = drain()
    found = 0
    try:
        push(_TRIALS[0])
    except (AttributeError, OSError):
        return found
    index = _find(_MEMORY, 0, _TRIALS[0], len(_TRIALS[0]))
    while index >= 0 and not found:
        at = array.array("i", (_MEMORY + 4 * index,) + (0,) * (_REMEMBERED - 1))
        trial = bytearray(len(_TRIALS[0]))
        take(at, trial, len(trial))
        push(_TRIALS[1])
        if _find(_MEMORY, index, _TRIALS[1], len(_TRIALS[1])) == index:
            found = at[0]
        index = _find(_MEMORY, index + 1, _TRIALS[0], len(_TRIALS[0]))
    early += drain()
    text = bytes(early).replace(_TRIALS[0], b"").replace(_TRIALS[1], b"")
    if text:
        push(text)
    return found
