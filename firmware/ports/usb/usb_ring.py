# mypy: disable-error-code=arg-type
"""Locate the ring where MicroPython stores bytes received over USB, by trial in memory.

And locate where TinyUSB, the library below it, stores the host's control lines (DTR, which says
whether a program has the port open): a struct recognised by its two pointers into itself.
"""

import array

import micropython
from micropython import const

from ports.escape import push
from ports.link_memory import LINE_STATE_ADDRESS, RING_ADDRESS, RING_BYTES

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

_MEMORY = const(0x20000000)  # address where the chip's RAM begins,
_MEMORY_WORDS = const(0x10000)  # and how much of it is searched, in words of 4 bytes
_LOW_16 = const(0xFFFF)
_RING_MASK = const(511)  # RING_BYTES - 1: indices wrap
_TRIALS = (b"Where is the ring?", b"Here?")  # what is received as a trial

# TinyUSB's struct cdcd_interface_t, in words: 7 bytes, the last of which are line_state and
# wanted_char, -1; line_coding; from _FIFOS on two FIFOs of a few words, each with address and size
# first; then the memory that the first address points to, then that of the second.
_FIFOS = const(4)  # offset in the struct, in words
_FIFO_WORDS_LEAST = const(3)
_FIFO_WORDS_MOST = const(8)
_LINE_STATE = const(5)  # offset in the struct, in bytes


@micropython.viper
def _find(memory: ptr32, start: int, trial: ptr8, length: int) -> int:
    """Return the index, from `start` on, of a word that may begin a ring whose next bytes are the
    trial; -1 if there is none.

    memory: the chip's RAM as words; length: of the trial, in bytes. MicroPython's ringbuf_t: the
    data's address, then size, iget and iput of 16 bits each.
    """
    i = start
    while i < _MEMORY_WORDS - 3:
        offset = memory[i] - _MEMORY  # of the data, if this is its address
        sizes = memory[i + 1]
        if offset > 0 and offset < 4 * _MEMORY_WORDS and sizes & _LOW_16 == RING_BYTES:
            get = (sizes >> 16) & _LOW_16
            put = memory[i + 2] & _LOW_16
            if get < RING_BYTES and put < RING_BYTES and (put - get) & _RING_MASK >= length:
                data = ptr8(memory[i])
                same = 0
                while same < length and data[(get + same) & _RING_MASK] == trial[same]:
                    same += 1
                if same == length:
                    return i
        i += 1
    return -1


@micropython.viper
def find_line(memory: ptr32) -> int:
    """Return the address of line_state, or 0 if no words look like TinyUSB's struct. memory: the
    chip's RAM as words."""
    for i in range(_MEMORY_WORDS - 3 * _FIFO_WORDS_MOST):
        # If the struct begins at word i, the first FIFO is here, and its first word points past
        # the second one.
        here = _MEMORY + 4 * (i + _FIFOS)
        first_data = memory[i + _FIFOS]
        words = (first_data - here) >> 3  # of one FIFO: two of them lie in between
        is_near = words >= _FIFO_WORDS_LEAST and words <= _FIFO_WORDS_MOST
        if is_near and first_data == here + 8 * words:
            second_data = first_data + (memory[i + _FIFOS + 1] & _LOW_16)  # after the first's size
            # The last condition is wanted_char == -1.
            if memory[i + _FIFOS + words] == second_data and (memory[i + 1] >> 16) & 0xFF == 0xFF:
                return _MEMORY + 4 * i + _LINE_STATE
    return 0


def find(
    state: "array.array[int]",
    drain: "Callable[[], bytearray]",
    read_ring: "Callable[[array.array[int], bytearray, int], int]",
) -> None:
    """Store both addresses in a link's state (RING_ADDRESS, LINE_STATE_ADDRESS), 0 if not found.
    drain: reads all bytes received; read_ring: usb_link._read_ring, which reads from the ring at
    RING_ADDRESS.

    Some bytes are received as a trial, and memory is searched for them. A place that has them is
    the ring if it also gets a second trial. Bytes received meanwhile are put back.
    """
    received = drain()  # from the sender, before and during the trials
    try:
        push(_TRIALS[0])
    except (AttributeError, OSError):
        return
    ring = 0
    index = -1
    while not ring:
        index = _find(_MEMORY, index + 1, _TRIALS[0], len(_TRIALS[0]))
        if index < 0:
            break
        state[RING_ADDRESS] = _MEMORY + 4 * index  # where read_ring() reads
        trial = bytearray(len(_TRIALS[0]))
        read_ring(state, trial, len(trial))  # if this is the ring, the first trial is removed
        push(_TRIALS[1])
        if _find(_MEMORY, index, _TRIALS[1], len(_TRIALS[1])) == index:  # its next bytes are these
            ring = state[RING_ADDRESS]
    received += drain()
    text = bytes(received).replace(_TRIALS[0], b"").replace(_TRIALS[1], b"")
    if text:
        push(text)
    state[RING_ADDRESS] = ring
    state[LINE_STATE_ADDRESS] = find_line(_MEMORY)
