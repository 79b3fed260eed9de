# mypy: disable-error-code=arg-type
"""A websocket (RFC 6455) as a Connection: the link's bytes, in binary messages both ways.

Of what arrives only a frame's head and a ping are stored, so a message may have any length and any
number of parts. A frame that a browser would not send ends the connection, with a code that says
why. Text is only sent, never received: the latest state of control.

Output is followed by a ping with four random bytes. The pong that returns them proves that all
output before the ping has been read. Until then it counts as unproved, for client.py.
"""

import binascii
import hashlib
import os

import micropython
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from interfaces import Connection

_GUID = b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11"  # RFC 6455's, for the handshake
_CONTINUED = const(0)  # opcodes of frames; those from _CLOSE on are control frames
_TEXT = const(1)
_BINARY = const(2)
_CLOSE = const(8)
_PING = const(9)
_PONG = const(10)
_LAST = const(0x80)  # in the first byte: the message ends with this frame
_RESERVED = const(0x70)  # bits that must be 0
_OPCODE = const(0x0F)
_MASKED = const(0x80)  # in the second byte
_TWO_BYTES = const(126)  # as a length: two bytes of length follow; a higher number: eight
_MOST_CONTROL = const(125)  # bytes of a control frame's payload, at most
_MASK = const(4)  # bytes of a mask
_HEAD = const(8)  # bytes of a head: the first two, length, mask
_PAYLOAD = const(512)  # bytes of a frame sent, at most
_CHANCE = const(4)  # random bytes of a ping
_READS = const(4)  # reads in a row: a pong does not delay the message after it
_SEGMENT = const(100)  # what a frame counts for, at least, as in client.py
_UNPROVED = const(1600)  # with more than that, neither pongs nor news are sent

_GOOD_BYE = const(1000)  # codes of RFC 6455 for the end
_GOING_AWAY = const(1001)
_NO_FRAME = const(1002)
_NOT_TAKEN = const(1003)
_TOO_BIG = const(1009)


def accepted(key: bytes) -> bytes:
    """Return the value of Sec-WebSocket-Accept for a client's Sec-WebSocket-Key (RFC 6455)."""
    return binascii.b2a_base64(hashlib.sha1(key + _GUID).digest())[:-1]


@micropython.viper
def unmask(data: ptr8, at: int, count: int, to: int, head: ptr8, mask: int, phase: int) -> int:
    """Move `count` bytes of data down from index `at` to `to`, and remove their mask. Returns
    count.

    mask: index of the mask's four bytes in head. phase: index of the first of these bytes in the
    frame's payload, whose bytes are masked by each of the four in turn.
    """
    for i in range(count):
        data[to + i] = data[at + i] ^ head[mask + ((phase + i) & 3)]
    return count


class WebSocket:
    """A Connection. conn: the TCP connection after the handshake, whose OSErrors pass through.

    unproved: bytes sent that may not have been read; _covered: how many of them the ping under way
    will prove; _chance: its random bytes. news: text to send about control; told: the state that
    was sent last, see page_link.py. _over: code of the end; 0: open.

    The frame being received: _have of the _wanted bytes of its _head have come, as far as its
    length is known; then _done bytes of its payload, and _left are to come. _is_open: a message
    has begun and not ended. _control: a ping's or pong's payload. _pong: bytes of it to send back;
    -1: none. The frame being sent: _out, of which the bytes from _at to _end must still be sent.
    """

    def __init__(self, conn: "Connection") -> None:
        self._conn = conn
        self.told = -1
        self.news = b""
        self.unproved = 0
        self._covered = 0
        self._chance = b""
        self._head = bytearray(_HEAD)
        self._have = 0
        self._wanted = 2
        self._left = 0
        self._done = 0
        self._is_open = False
        self._control = bytearray(_MOST_CONTROL)
        self._pong = -1
        self._out = bytearray(_HEAD + _PAYLOAD)
        self._at = self._end = 0
        self._over = 0

    # The Connection interface

    def readinto(self, buf: bytearray) -> "int | None":
        """Move the bytes received into buf; return how many, None if there are none, 0 if the
        connection has ended."""
        self._flush()
        if self._over:
            return 0
        for _ in range(_READS):
            count = self._conn.readinto(buf)
            if not count:
                return count
            moved = self._decode(buf, count)
            if moved:
                return moved
        return None

    def write(self, data: "bytes | bytearray | memoryview") -> "int | None":
        """Send as much of data as fits into a frame, and return how many bytes; None while another
        frame is being sent or after the end."""
        if self._over or not self._flush():
            return None
        count = min(len(data), _PAYLOAD)
        self._frame(_BINARY, data, count)
        self._flush()
        return count

    def close(self) -> None:
        """Close the connection, with a last frame if there is space for it."""
        try:
            self._fail(_GOING_AWAY)
        except OSError:
            self._over = _GOING_AWAY  # the other end has closed first
        self._conn.close()

    # In

    def _decode(self, buf: bytearray, count: int) -> int:
        """Read frames, or parts of them, from the first `count` bytes of buf. The messages' bytes,
        which are the machine's, are moved to the beginning of the same buf. Returns how many."""
        moved = at = 0
        while at < count and not self._over:
            if self._have < self._wanted:
                self._head[self._have] = buf[at]
                self._have += 1
                at += 1
                self._read_head()
                continue
            piece = min(self._left, count - at)
            moved += self._take_piece(buf, at, piece, moved)
            at += piece
            self._left -= piece
            self._done += piece
            if not self._left:
                self._end_frame()
        return moved

    def _read_head(self) -> None:
        """Handle the head as far as it has come: after two bytes check them and set the head's
        length; once it is complete set the payload's length."""
        head, have = self._head, self._have
        if have < 2:
            return
        length = head[1] & ~_MASKED
        if have == 2:
            fault = self._fault(head[0], head[1], length)
            if fault:
                self._fail(fault)
                return
            self._wanted = 2 + _MASK + (2 if length == _TWO_BYTES else 0)
        elif have == self._wanted:
            if length == _TWO_BYTES:
                length = head[2] << 8 | head[3]
                if length < _TWO_BYTES:  # it must be the shortest form
                    self._fail(_NO_FRAME)
            self._left = length
            self._done = 0
            if not length:
                self._end_frame()

    def _fault(self, first: int, second: int, length: int) -> int:
        """Return the code with which a frame that is not allowed ends the connection; 0 if it is
        allowed. first, second: bytes of its head; length: the second without the mask bit."""
        opcode = first & _OPCODE
        is_last = first & _LAST
        if first & _RESERVED or not second & _MASKED:
            return _NO_FRAME
        if opcode in (_CLOSE, _PING, _PONG):
            return 0 if is_last and length <= _MOST_CONTROL else _NO_FRAME
        if opcode == _TEXT:
            return _NOT_TAKEN
        # A message begins with _BINARY, its further frames are _CONTINUED.
        if opcode not in (_CONTINUED, _BINARY) or self._is_open == (opcode == _BINARY):
            return _NO_FRAME
        if length > _TWO_BYTES:
            return _TOO_BIG
        self._is_open = not is_last
        return 0

    def _take_piece(self, buf: bytearray, at: int, count: int, to: int) -> int:
        """Read part of a frame's payload: `count` bytes of buf from `at` on.

        A message's bytes are moved to index `to` of buf. Returns how many these are: 0 for a
        control frame, of which a ping's or pong's payload is stored with its mask.
        """
        opcode = self._head[0] & _OPCODE
        if opcode in (_PING, _PONG):
            self._control[self._done : self._done + count] = buf[at : at + count]
        elif opcode < _CLOSE:
            return unmask(buf, at, count, to, self._head, self._wanted - _MASK, self._done)
        return 0

    def _end_frame(self) -> None:
        """Handle a complete frame: close, note a ping to answer, or count what a pong has
        proved."""
        opcode, control = self._head[0] & _OPCODE, self._control
        if opcode == _CLOSE:
            self._fail(_GOOD_BYE)
        elif opcode > _CLOSE:
            unmask(control, 0, self._done, 0, self._head, self._wanted - _MASK, 0)
            if opcode == _PING:
                self._pong = self._done  # of several pings the last is answered
            elif self._covered and control[: self._done] == self._chance:
                self.unproved -= self._covered
                self._covered = 0
        self._have = self._done = 0
        self._wanted = 2

    # Out

    def _frame(self, opcode: int, data: "bytes | bytearray | memoryview", count: int) -> None:
        """Put the first `count` bytes of data into the frame to send. Only if the one before has
        been sent."""
        out, start = self._out, 2
        out[0] = _LAST | opcode
        if count < _TWO_BYTES:
            out[1] = count
        else:
            out[1] = _TWO_BYTES
            out[2] = count >> 8
            out[3] = count & 0xFF
            start = 4
        out[start : start + count] = data[:count]
        self._at = 0
        self._end = start + count
        self.unproved += max(self._end, _SEGMENT)

    def _flush(self) -> bool:
        """Send the rest of the frame, then pings, pongs and news that are due. Returns whether all
        frames were sent: then another one may be made. Above _UNPROVED pongs and news wait."""
        while True:
            while self._at < self._end:
                sent = self._conn.write(memoryview(self._out)[self._at : self._end])
                if not sent:
                    return False
                self._at += sent
            if self._over:
                return True
            if self.unproved and not self._covered:  # no ping is under way
                self._chance = os.urandom(_CHANCE)
                self._frame(_PING, self._chance, _CHANCE)
                self._covered = self.unproved
            elif self.unproved > _UNPROVED:
                return True
            elif self._pong >= 0:
                count, self._pong = self._pong, -1
                self._frame(_PONG, self._control, count)
            elif self.news:
                self._frame(_TEXT, self.news, len(self.news))
                self.news = b""
            else:
                return True

    def _fail(self, code: int) -> None:
        """End the connection: send a last frame with the code, if there is space for it."""
        if not self._over and self._flush():
            self._frame(_CLOSE, bytes((code >> 8, code & 0xFF)), 2)
            self._over = code
            self._flush()
        self._over = code
