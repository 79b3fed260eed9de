# mypy: disable-error-code=arg-type
"""A websocket (RFC 6455) as a Connection: the bytes of the link, in binary messages both ways.

Nothing is kept of what comes but the head of a frame and a ping: a message may be as long as it
likes, in as many parts. What is no frame of a browser's ends the connection, with a code that says
why. Text goes out only: the latest of what is to be told.

What is sent is followed by a ping with four bytes of chance: the pong that brings them back proves
that all before it has been read. Until then it counts as unproved, for client.py.
"""

import binascii
import hashlib
import os

import micropython
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from interfaces import Connection

_GUID = b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
_CONTINUED = const(0)
_TEXT = const(1)
_BINARY = const(2)
_CLOSE = const(8)
_PING = const(9)
_PONG = const(10)
_LAST = const(0x80)  # of the first byte: the message ends with this frame
_RESERVED = const(0x70)
_MASKED = const(0x80)  # of the second byte
_TWO_BYTES = const(126)  # of length follow; more than that: eight
_MOST_CONTROL = const(125)
_MASK = const(4)
_HEAD = const(8)  # first bytes, length, mask
_PAYLOAD = const(512)  # of a frame that is sent
_CHANCE = const(4)
_READS = const(4)  # in a row: a pong delays no message behind it
_SEGMENT = const(100)  # what a frame counts for at the least, as in client.py
_UNPROVED = const(1600)  # with more than that neither pongs nor news are sent

_GOOD_BYE = const(1000)
_GOING_AWAY = const(1001)
_NO_FRAME = const(1002)
_NOT_TAKEN = const(1003)
_TOO_BIG = const(1009)


def accepted(key: bytes) -> bytes:
    """What the handshake answers to a Sec-WebSocket-Key."""
    return binascii.b2a_base64(hashlib.sha1(key + _GUID).digest())[:-1]


@micropython.viper
def unmask(data: ptr8, at: int, count: int, to: int, head: ptr8, mask: int, phase: int) -> int:
    """Move so many bytes down, from one place to another, without their mask. Returns how many."""
    for i in range(count):
        data[to + i] = data[at + i] ^ head[mask + ((phase + i) & 3)]
    return count


class WebSocket:
    """A Connection. conn: behind the handshake; OSError comes of it."""

    def __init__(self, conn: "Connection") -> None:
        self._conn = conn
        self.told = -1  # how things stood when that was said last, see page.py
        self.news = b""  # what is to be said of it
        self.unproved = 0  # bytes sent that may not have been read
        self._covered = 0  # how many of them the ping that is under way will prove
        self._chance = b""
        # In: the frame that comes.
        self._head = bytearray(_HEAD)
        self._have = 0  # bytes of its head
        self._wanted = 2
        self._left = 0  # bytes of it that are to come
        self._done = 0
        self._is_open = False  # a message has begun and not ended
        self._control = bytearray(_MOST_CONTROL)
        self._pong = -1  # bytes of a ping to answer
        # Out: the frame that goes.
        self._out = bytearray(_HEAD + _PAYLOAD)
        self._at = self._end = 0
        self._over = 0  # code of the end, where it has come

    # The Connection seam

    def readinto(self, buf: bytearray) -> "int | None":
        """Move what has come into buf; None where nothing has, 0 at the end."""
        self._flush()
        if self._over:
            return 0
        for _ in range(_READS):
            count = self._conn.readinto(buf)
            if not count:
                return count
            found = self._decode(buf, count)
            if found:
                return found
        return None

    def write(self, data: "bytes | bytearray | memoryview") -> "int | None":
        """Send as much as goes into a frame; None while another one is on its way."""
        if self._over or not self._flush():
            return None
        count = min(len(data), _PAYLOAD)
        self._frame(_BINARY, data, count)
        self._flush()
        return count

    def close(self) -> None:
        """Hang up, and say so where there is room for it."""
        try:
            self._fail(_GOING_AWAY)
        except OSError:
            self._over = _GOING_AWAY  # he has been quicker
        self._conn.close()

    # In

    def _decode(self, buf: bytearray, count: int) -> int:
        """What is the machine's of bytes that have come, at the beginning of the same buf."""
        found = at = 0
        while at < count and not self._over:
            if self._have < self._wanted:
                self._head[self._have] = buf[at]
                self._have += 1
                at += 1
                self._read_head()
                continue
            piece = min(self._left, count - at)
            found += self._take_piece(buf, at, piece, found)
            at += piece
            self._left -= piece
            self._done += piece
            if not self._left:
                self._end_frame()
        return found

    def _read_head(self) -> None:
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
                if length < _TWO_BYTES:
                    self._fail(_NO_FRAME)
            self._left = length
            self._done = 0
            if not length:
                self._end_frame()

    def _fault(self, first: int, second: int, length: int) -> int:
        """Why such a frame cannot be; 0 where it can."""
        opcode = first & 0x0F
        is_last = first & _LAST
        if first & _RESERVED or not second & _MASKED:
            return _NO_FRAME
        if opcode in (_CLOSE, _PING, _PONG):
            return 0 if is_last and length <= _MOST_CONTROL else _NO_FRAME
        if opcode == _TEXT:
            return _NOT_TAKEN
        if opcode not in (_CONTINUED, _BINARY) or self._is_open == (opcode == _BINARY):
            return _NO_FRAME
        if length > _TWO_BYTES:
            return _TOO_BIG
        self._is_open = not is_last
        return 0

    def _take_piece(self, buf: bytearray, at: int, count: int, to: int) -> int:
        """Part of a frame's payload. Returns how much of it is the machine's."""
        opcode = self._head[0] & 0x0F
        if opcode in (_PING, _PONG):
            self._control[self._done : self._done + count] = buf[at : at + count]
        elif opcode < _CLOSE:
            return unmask(buf, at, count, to, self._head, self._wanted - _MASK, self._done)
        return 0

    def _end_frame(self) -> None:
        opcode, control = self._head[0] & 0x0F, self._control
        if opcode == _CLOSE:
            self._fail(_GOOD_BYE)
        elif opcode > _CLOSE:
            unmask(control, 0, self._done, 0, self._head, self._wanted - _MASK, 0)
            if opcode == _PING:
                self._pong = self._done  # of several the last is answered
            elif self._covered and control[: self._done] == self._chance:
                self.unproved -= self._covered
                self._covered = 0
        self._have = self._done = 0
        self._wanted = 2

    # Out

    def _frame(self, opcode: int, data: "bytes | bytearray | memoryview", count: int) -> None:
        """The next one to go. Only where the one before has gone."""
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
        """Have sent what is on its way, then what is due. Whether all has gone."""
        while True:
            while self._at < self._end:
                sent = self._conn.write(memoryview(self._out)[self._at : self._end])
                if not sent:
                    return False
                self._at += sent
            if self._over:
                return True
            if self.unproved and not self._covered:
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
        """The last frame, where there is room for one."""
        if not self._over and self._flush():
            self._frame(_CLOSE, bytes((code >> 8, code & 0xFF)), 2)
            self._over = code
            self._flush()
        self._over = code
