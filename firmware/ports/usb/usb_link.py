# mypy: disable-error-code="arg-type, has-type, misc"
"""The sender on the board's USB, which MicroPython exposes as stdin and stdout.

MicroPython collects the bytes received in a ring of 512 bytes. Its streams return them one at a
time, at 13 us each, or in pieces whose length one has to know. So the ring is located in memory
(usb_ring.py) and read in place; if it is not found, bytes are read one at a time. USB makes the
sender wait when the ring is full: no byte is ever lost.

The supervisor's timer reads the ring, too: Ctrl-X acts even while the main loop is busy, and a
sender that opens the port is noticed and greeted. What MicroPython writes while no port is open
waits for the first one that is opened.

escape.py is the way back to the REPL.
"""

import array
import select
import sys
import time

import micropython
from base.float32 import for_kernels
from micropython import const

from ports.escape import CTRL_C, Escape
from ports.link_memory import (
    ANSWER_BYTES,
    AWAY_MS,
    DISCARD_PIECES,
    DOLLAR_WAITS,
    HAS_CONTROL_BYTES,
    HOST_IS_DEAF,
    IS_OPEN,
    JUST_NOW,
    LINE_STATE_ADDRESS,
    LOOP_HAS_READ,
    LOOP_READS_RING,
    QUIET_TURNS,
    REOPENED,
    RING_ADDRESS,
    RING_BYTES,
    RING_WAS_FULL,
    STATE_LENGTH,
    STOP_CAUSE,
    WAS_USED,
    WRITE_MS,
)

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

_CTRL_X = const(24)
_DOLLAR = const(0x24)  # the character $
_PACKET = const(64)  # bytes of a USB packet, which must fit into the ring
_RING_MASK = const(511)  # RING_BYTES - 1: indices wrap
_GET = const(3)  # index of iget, where the next byte is read, in ringbuf_t as words of 16 bits
_PUT = const(4)  # and of iput, where the next byte is stored

_DEAF_MS = const(250)  # a host that does not read for so long is absent: writes do not wait for it

# An Arduino is silent for longer after it has been opened, and senders rely on it: the Universal
# G-Code Sender starts twice if it is greeted before it has noted that it has started.
_GREET_MS = const(300)  # from the opening of the port to the greeting, if nothing is received

# Answers to lines are collected, up to so many bytes, and until nothing was received for so many
# turns: a write to USB takes as long as reading a line. Longer output is sent at once, together
# with those that wait. So is the answer to a $ command, because its sender waits for it.
_ANSWERS_BYTES = const(64)  # of answers that may wait,
_OUT_BYTES = const(192)  # and with longer output, with which they are sent at once
_MOST_QUIET_TURNS = const(2)  # turns without input that answers wait
_LONGEST_ANSWER = const(16)  # bytes of the answer to a line; longer data is other output
_LATER = const(-1)  # result of _collect(): the answer waits. Above 0: a count of bytes to send

_HAS_FLAGS = const(0x100)  # in _read_ring()'s result, above its count: call _handle_flags()
_FLUSH = const(0x200)  # its result if no byte was read and waiting answers must be sent

_SETUP = const(0x50100000)  # address of the host's last request, of RP2040's and RP2350's USB
_SET_LINE_STATE = const(0x2221)  # a request: bit 16 says whether the port is open (DTR)
_LINE_CODING = const(0x2021)  # sent only when the port is opened: SET is 0x2021, GET is 0x21A1
_SET_CONFIGURATION = const(0x0900)  # sent when the cable has been plugged in
_REQUEST = const(0xFFFF)  # mask of the request
_REQUEST_WITH_DTR = const(0x1FFFF)  # and with bit 16
_SET_OR_GET = const(0xFE7F)  # mask of the bits in which SET and GET do not differ


@micropython.viper
def _read_ring(state: ptr32, buf: ptr8, room: int) -> int:
    """Move up to `room` bytes, but fewer than _HAS_FLAGS, from MicroPython's ring into buf.

    state: the link's, by the indices of link_memory.py; state[RING_ADDRESS] is the ring's address.
    Returns how many bytes were moved, plus _HAS_FLAGS if UsbLink._handle_flags() has work to do:
    the port was opened again, the supervisor has stopped the machine, control bytes were read that
    may request the prompt, or no byte was moved and the ring was so full that more may wait
    outside it. Without bytes and work, _FLUSH if answers have waited for _MOST_QUIET_TURNS calls.
    """
    if room >= _HAS_FLAGS:
        room = _HAS_FLAGS - 1
    state[LOOP_READS_RING] = 1  # _poll_reset(), an interrupt, must not move iget now
    state[LOOP_HAS_READ] = 1  # for the supervisor: the loop is alive
    indices = ptr16(state[RING_ADDRESS])  # MicroPython's ringbuf_t, in words of 16 bits
    data = ptr8(ptr32(state[RING_ADDRESS])[0])  # it begins with the address of its bytes
    get = indices[_GET]
    put = indices[_PUT]
    if (put - get) & _RING_MASK >= RING_BYTES - _PACKET:  # a packet may not fit
        state[RING_WAS_FULL] = 1
    count = 0
    while get != put and count < room:
        c = data[get]
        buf[count] = c
        if c <= CTRL_C:  # Ctrl-A or Ctrl-C
            state[HAS_CONTROL_BYTES] = 1
        elif c == _DOLLAR:
            state[DOLLAR_WAITS] = 1
        get = (get + 1) & _RING_MASK
        count += 1
    indices[_GET] = get
    state[LOOP_READS_RING] = 0
    flag = HAS_CONTROL_BYTES if count else RING_WAS_FULL  # index; RING_WAS_FULL waits for count 0
    if state[REOPENED] | state[STOP_CAUSE] | state[flag]:
        return count | _HAS_FLAGS
    if count == 0 and state[ANSWER_BYTES]:
        state[QUIET_TURNS] += 1
        if state[QUIET_TURNS] >= _MOST_QUIET_TURNS:
            return _FLUSH
    return count


@micropython.viper
def _add_answer(memory: object, data: ptr8, count: int) -> int:
    """Append the first `count` bytes of data to the answers that wait. Returns 0 if they do not
    fit, _LATER if they wait, or how many bytes of waiting answers to send now. memory: the link's
    state and the buffer of these."""
    state, out = memory
    return int(_collect(ptr32(state), ptr8(out), data, count))


@micropython.viper
def _collect(state: ptr32, out: ptr8, data: ptr8, count: int) -> int:
    """Append the first `count` bytes of data to the answers that wait, in out. Returns 0 if they
    do not fit, _LATER if they wait, or how many bytes of out to send now.

    state: the link's. state[ANSWER_BYTES] bytes wait, for state[QUIET_TURNS] turns without input;
    state[DOLLAR_WAITS]: a $ was received that has not been answered. Up to _LONGEST_ANSWER bytes
    are the answer to a line: it waits for more unless it answers a $. Longer data is other output:
    it is sent now, with all that waits.
    """
    length = state[ANSWER_BYTES]
    if length + count > (_ANSWERS_BYTES if count <= _LONGEST_ANSWER else _OUT_BYTES):
        return 0
    for i in range(count):
        out[length + i] = data[i]
    length += count
    state[ANSWER_BYTES] = length
    if count <= _LONGEST_ANSWER:
        if state[DOLLAR_WAITS] == 0:
            return _LATER
        state[DOLLAR_WAITS] = 0
    state[ANSWER_BYTES] = 0  # the caller sends them
    state[QUIET_TURNS] = 0
    return length


class UsbLink:
    """A Link.

    read_into(buf) moves the bytes received into buf and returns how many; write(data) sends, soon.
    shared: memory shared with the supervisor. poll_reset: called by the supervisor's timer, None
    if the ring was not found. check_supervisor: the supervisor's, called in the main loop, which
    raises. is_slow: Ctrl-X is found only when the main loop reads. _state: the link's, the same
    array as `shared`, by the indices of link_memory.py. _answers: answers that wait to be sent.
    _since_ms: ticks_ms() when the port was opened.
    """

    read_into: "Callable[[bytearray], int]"
    write: "Callable[[bytes | bytearray | memoryview], None]"

    def __init__(self) -> None:
        micropython.kbd_intr(-1)  # Ctrl-C is an ordinary byte
        self.check_supervisor: "Callable[[], None]" = lambda: None
        self._in: "Any" = sys.stdin.buffer
        self._out: "Any" = sys.stdout.buffer
        self._input_poll: "Any" = select.poll()
        self._input_poll.register(sys.stdin, select.POLLIN)
        self._output_poll: "Any" = select.poll()
        self._output_poll.register(sys.stdout, select.POLLOUT)
        self._byte = bytearray(1)  # where _drain() reads each byte
        self._answers = bytearray(_OUT_BYTES)
        self._since_ms = 0
        self._escape = Escape(self.close)
        # One array with two names, the supervisor's and ours.
        self.shared = self._state = array.array("i", (0 for _ in range(STATE_LENGTH)))
        self._memory = for_kernels(self._state), for_kernels(self._answers)  # for _add_answer()
        if sys.platform == "rp2":
            from ports.usb import usb_ring

            usb_ring.find(self._state, self._drain, _read_ring)
        self.is_slow = self._state[RING_ADDRESS] == 0
        self.poll_reset: "Callable[[], int] | None" = None if self.is_slow else self._poll_reset
        # Made only now: they depend on whether the ring was found.
        self.read_into = self._make_read_into()
        self._send = self._make_send()
        self.write = self._make_write()

    def attach(self, at_rest: "Callable[[], bool]", on_open: "Callable[[], None]") -> None:
        """Set two functions: at_rest returns whether the REPL may be requested now; on_open greets
        a sender that opens the port again."""
        self._escape.at_rest = at_rest
        self._on_open = on_open

    @micropython.viper
    def _poll_reset(self) -> int:
        """Drop all bytes up to the last Ctrl-X. Returns 1 if there was one, else 0. Interrupt.

        It also notes whether the port is open (DTR): from TinyUSB's variable if that was found,
        else from the host's last request. state[REOPENED] becomes JUST_NOW, 1, if it is opened
        again: the first time needs no greeting.
        """
        state = ptr32(self._state)
        indices = ptr16(state[RING_ADDRESS])  # MicroPython's ringbuf_t, in words of 16 bits
        data = ptr8(ptr32(state[RING_ADDRESS])[0])  # it begins with the address of its bytes
        get = indices[_GET]
        put = indices[_PUT]
        is_open = state[IS_OPEN]
        if state[LINE_STATE_ADDRESS]:
            is_open = ptr8(state[LINE_STATE_ADDRESS])[0] & 1
        else:
            request = ptr32(_SETUP)[0] & _REQUEST_WITH_DTR
            if request & _REQUEST == _SET_LINE_STATE:
                is_open = request >> 16
            if request & _SET_OR_GET == _LINE_CODING:
                is_open = 1
            if request & _REQUEST == _SET_CONFIGURATION:
                is_open = 0
        if is_open != state[IS_OPEN]:
            state[IS_OPEN] = is_open
            # Only a port that was open before, or has sent bytes, is greeted.
            state[REOPENED] = is_open & state[WAS_USED]
        if is_open or get != put:
            state[WAS_USED] = 1
        found = 0
        if state[LOOP_READS_RING] == 0:  # otherwise _read_ring() moves iget
            while get != put:
                c = data[get]
                get = (get + 1) & _RING_MASK
                if c == _CTRL_X:
                    indices[_GET] = get  # drops all bytes up to here
                    found = 1
        return found

    def _drain(self) -> bytearray:
        """Read all bytes received, one at a time by MicroPython's stream, and return them."""
        received = bytearray()
        while self._can_read() and self._in.readinto(self._byte):
            received.append(self._byte[0])
        return received

    # These closures are called in every turn and look up no attribute. A closure's values and
    # arguments are at most five in all: for more MicroPython allocates at each call.

    def _make_read_into(self) -> "Callable[[bytearray], int]":
        """Return read_into(): the one that reads the ring, or MicroPython's stream if the ring was
        not found."""
        if self._state[RING_ADDRESS] == 0:
            return self._read_plainly
        state, read_ring = for_kernels(self._state), _read_ring
        handle_flags, flush = self._handle_flags, self._flush

        # It sends answers without a call in between: this may be the deepest chain on the stack.
        def read_into(buf: bytearray) -> int:
            """Store received bytes in buf; returns their number."""
            count: int = read_ring(state, buf, len(buf))  # with the flags of _read_ring()
            if count < _HAS_FLAGS:
                return count
            return flush() if count == _FLUSH else handle_flags(buf, count - _HAS_FLAGS)

        return read_into

    def _make_send(self) -> "Callable[..., None]":
        """Return send(length, data). Its further parameters hold what it would otherwise look up
        at each call."""

        def send(
            length: int,
            data: "bytes | bytearray | memoryview" = self._answers,
            state: "array.array[int]" = self._state,
            out: "Callable[[bytes | bytearray | memoryview, int], object]" = self._out.write,
            sendable: "Callable[[int], object]" = self._output_poll.poll,
            now_ms: "Callable[[], int]" = time.ticks_ms,
            passed_ms: "Callable[[int, int], int]" = time.ticks_diff,
        ) -> None:
            """Send the first `length` bytes of data or, without it, of the waiting answers. Waits
            once for a host that does not read; then drops output until it reads (HOST_IS_DEAF)."""
            if state[HOST_IS_DEAF] and not sendable(0):
                return
            since = now_ms()
            state[AWAY_MS] = -WRITE_MS  # the supervisor allows the loop to be away for so long
            out(data, length)
            state[AWAY_MS] = 0
            state[HOST_IS_DEAF] = passed_ms(now_ms(), since) >= _DEAF_MS

        return send

    def _make_write(self) -> "Callable[[bytes | bytearray | memoryview], None]":
        """Return write(), which collects answers and sends them (see _collect())."""
        memory, add, send, make_room = self._memory, _add_answer, self._send, self._make_room

        # Locals, closure values and stack are eleven words: for more MicroPython allocates memory.
        def write(data: "bytes | bytearray | memoryview") -> None:
            """Collect an answer, or send it with those that wait."""
            due = add(memory, data, len(data))  # bytes to send now, _LATER, or 0: no space
            if due > 0:
                send(due)
            elif not due:
                make_room(data)

        return write

    def _make_room(self, data: "bytes | bytearray | memoryview") -> None:
        """Send the answers that wait, then write data that did not fit."""
        self._flush()
        if len(data) > _OUT_BYTES:
            self._send(len(data), data)
        else:
            self.write(data)

    def _handle_flags(self, buf: bytearray, count: int) -> int:
        """Handle what _read_ring() has flagged: a stop by the supervisor (raises), an opened port,
        a request for the prompt among the first `count` bytes of buf, a ring that was full.
        Returns count."""
        state = self._state
        if state[STOP_CAUSE]:
            self.check_supervisor()
        if state[REOPENED]:
            self._greet(count)
        if count:
            state[HAS_CONTROL_BYTES] = 0
            self._escape.listen(buf, count)
            return count
        if state[RING_WAS_FULL]:
            state[RING_WAS_FULL] = 0
            self._can_read()  # its poll moves the bytes outside into the ring
        return 0

    def _greet(self, count: int) -> None:
        """Greet a program that has opened the port, once it sends something or after _GREET_MS.
        count: bytes just read. state[REOPENED] is JUST_NOW at the first call, then JUST_NOW + 1
        until the greeting, then 0."""
        state = self._state
        if state[REOPENED] == JUST_NOW:
            state[REOPENED] = JUST_NOW + 1
            self._since_ms = time.ticks_ms()
        if state[REOPENED] and (
            count or time.ticks_diff(time.ticks_ms(), self._since_ms) >= _GREET_MS
        ):
            state[REOPENED] = 0
            self._on_open()

    def _can_read(self) -> bool:
        """Return whether a byte can be read without waiting."""
        for _ in self._input_poll.ipoll(0):
            return True
        return False

    def _read_plainly(self, buf: bytearray) -> int:
        """Move the bytes received into buf, one at a time, and return how many. Answers that wait
        are sent first."""
        self._state[LOOP_HAS_READ] = 1
        if self._state[STOP_CAUSE]:
            self.check_supervisor()
        self._flush()
        count = 0
        while count < len(buf) and self._can_read():
            self._in.readinto(self._byte)
            buf[count] = self._byte[0]
            count += 1
        if count:
            self._escape.listen(buf, count)
        return count

    def discard(self) -> None:
        """Drop the bytes received. MicroPython and its USB keep less than 1 kB; more may
        follow."""
        piece = bytearray(_PACKET)
        for _ in range(DISCARD_PIECES):
            self.read_into(piece)

    def _flush(self) -> int:
        """Send the answers that wait. Returns 0, for read_into(): no bytes were read."""
        state = self._state
        length, state[ANSWER_BYTES], state[QUIET_TURNS] = state[ANSWER_BYTES], 0, 0
        if length:
            self._send(length)
        return 0

    def close(self) -> None:
        """Send the answers that wait; let Ctrl-C interrupt again."""
        self._flush()
        micropython.kbd_intr(CTRL_C)
