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
_CONTINUED = const(0)  # opcode: a further frame of a message
_TEXT = const(1)  # opcode
_BINARY = const(2)  # opcode
_CLOSE = const(8)  # opcode; from here on control frames
_PING = const(9)  # opcode
_PONG = const(10)  # opcode
_IS_LAST = const(0x80)  # in the first byte: the message ends with this frame
_RESERVED = const(0x70)  # bits that must be 0
_OPCODE = const(0x0F)
_IS_MASKED = const(0x80)  # in the second byte
_LENGTH_FOLLOWS = const(126)  # as a length: two bytes of length follow; 127: eight
_MOST_CONTROL = const(125)  # bytes of a control frame's payload, at most
_MASK_BYTES = const(4)  # bytes of a mask
_HEAD_BYTES = const(8)  # bytes of a head: the first two, length, mask
_PAYLOAD = const(512)  # bytes of a frame sent, at most
_PING_BYTES = const(4)  # random bytes of a ping
_READS = const(4)  # reads in a row: a pong does not delay the message after it
_SEGMENT = const(100)  # what a frame counts for, at least, as in client.py
_MOST_UNPROVED = const(1600)  # bytes; with more neither pongs nor news are sent

_GOOD_BYE = const(1000)  # code of RFC 6455: the other end has closed
_GOING_AWAY = const(1001)  # code: we close
_BAD_FRAME = const(1002)  # code: against the protocol
_UNSUPPORTED = const(1003)  # code: text
_TOO_BIG = const(1009)  # code


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

    unproved: bytes sent that may not have been read; _ping_covers: how many of them the ping under
    way will prove, 0: none is under way; _ping_payload: its random bytes. news: text to send about
    control; told: the state that was sent last, see page_link.py. _end_code: code of the end; 0:
    open.

    The frame being received: _head_received of the _head_length bytes of its _head have come, 2
    before the length is known; then _payload_received bytes of its payload, and _payload_left are
    to come. _in_message: a message has begun and not ended. _control_payload: a ping's or pong's.

    The frame being sent: _out, of which the bytes from _out_at to _out_end must still be sent.
    _pong: the payload of the pong to send after it; None: none is due.
    """

    def __init__(self, conn: "Connection") -> None:
        self._conn = conn
        self.told = -1
        self.news = b""
        self.unproved = 0
        self._ping_covers = 0
        self._ping_payload = b""
        self._head = bytearray(_HEAD_BYTES)
        self._head_received = 0
        self._head_length = 2
        self._payload_left = 0
        self._payload_received = 0
        self._in_message = False
        self._control_payload = bytearray(_MOST_CONTROL)
        self._pong: "bytearray | None" = None
        self._out = bytearray(_HEAD_BYTES + _PAYLOAD)
        self._out_at = self._out_end = 0
        self._end_code = 0

    # The Connection interface

    def readinto(self, buf: bytearray) -> "int | None":
        """Move the bytes received into buf; return how many, None if there are none, 0 if the
        connection has ended."""
        self._flush()
        if self._end_code:
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
        if self._end_code or not self._flush():
            return None
        count = min(len(data), _PAYLOAD)
        self._put_frame(_BINARY, data, count)
        self._flush()
        return count

    def close(self) -> None:
        """Close the connection, with a last frame if there is space for it."""
        try:
            self._close_with(_GOING_AWAY)
        except OSError:
            self._end_code = _GOING_AWAY  # the other end has closed first
        self._conn.close()

    # In

    def _decode(self, buf: bytearray, count: int) -> int:
        """Read frames, or parts of them, from the first `count` bytes of buf. The messages' bytes,
        which are the machine's, are moved to the beginning of the same buf. Returns how many."""
        moved = at = 0  # bytes moved; index in buf of the next byte to read
        while at < count and not self._end_code:
            if self._head_received < self._head_length:
                self._head[self._head_received] = buf[at]
                self._head_received += 1
                at += 1
                self._read_head()
                continue
            piece = min(self._payload_left, count - at)
            moved += self._read_payload(buf, at, piece, moved)
            at += piece
            self._payload_left -= piece
            self._payload_received += piece
            if not self._payload_left:
                self._end_frame()
        return moved

    def _read_head(self) -> None:
        """Handle the head as far as it has come: after two bytes check them and set the head's
        length; once it is complete set the payload's length."""
        head, received = self._head, self._head_received
        if received < 2:
            return
        length = head[1] & ~_IS_MASKED
        if received == 2:
            fault = self._code_of_fault(head[0], head[1], length)
            if fault:
                self._close_with(fault)
                return
            length_bytes = 2 if length == _LENGTH_FOLLOWS else 0  # more was refused as too long
            self._head_length = 2 + length_bytes + _MASK_BYTES
        elif received == self._head_length:
            if length == _LENGTH_FOLLOWS:
                length = head[2] << 8 | head[3]
                if length < _LENGTH_FOLLOWS:  # it must be the shortest form
                    self._close_with(_BAD_FRAME)
            self._payload_left = length
            self._payload_received = 0
            if not length:
                self._end_frame()

    def _code_of_fault(self, first: int, second: int, length: int) -> int:
        """Return the code with which a frame that is not allowed ends the connection; 0 if it is
        allowed; note whether its message then goes on (_in_message). first, second: bytes of its
        head; length: the second without the mask bit."""
        opcode = first & _OPCODE
        is_last = first & _IS_LAST
        if first & _RESERVED or not second & _IS_MASKED:
            return _BAD_FRAME
        if opcode in (_CLOSE, _PING, _PONG):
            return 0 if is_last and length <= _MOST_CONTROL else _BAD_FRAME
        if opcode == _TEXT:
            return _UNSUPPORTED
        # A message begins with _BINARY, its further frames are _CONTINUED.
        is_begin = opcode == _BINARY
        if opcode not in (_CONTINUED, _BINARY) or is_begin == self._in_message:
            return _BAD_FRAME
        if length > _LENGTH_FOLLOWS:  # 127
            return _TOO_BIG
        self._in_message = not is_last
        return 0

    def _read_payload(self, buf: bytearray, at: int, count: int, to: int) -> int:
        """Read part of a frame's payload: `count` bytes of buf from `at` on.

        A message's bytes are moved to index `to` of buf. Returns how many these are: 0 for a
        control frame, of which a ping's or pong's payload is stored with its mask.
        """
        opcode = self._head[0] & _OPCODE
        if opcode in (_PING, _PONG):
            end = self._payload_received + count
            self._control_payload[self._payload_received : end] = buf[at : at + count]
        elif opcode < _CLOSE:
            mask_at = self._head_length - _MASK_BYTES  # the mask is the end of the head
            return unmask(buf, at, count, to, self._head, mask_at, self._payload_received)
        return 0

    def _end_frame(self) -> None:
        """Handle a complete frame: close, note a ping to answer, or count what a pong has
        proved."""
        opcode, control = self._head[0] & _OPCODE, self._control_payload
        if opcode == _CLOSE:
            self._close_with(_GOOD_BYE)
        elif opcode > _CLOSE:
            # In place, from its first byte on.
            mask_at = self._head_length - _MASK_BYTES
            unmask(control, 0, self._payload_received, 0, self._head, mask_at, 0)
            if opcode == _PING:
                # A copy, because a pong may come before it is sent. The last ping is answered.
                self._pong = control[: self._payload_received]
            elif self._ping_covers and control[: self._payload_received] == self._ping_payload:
                self.unproved -= self._ping_covers
                self._ping_covers = 0
        self._head_received = self._payload_received = 0  # the next frame's head may begin
        self._head_length = 2

    # Out

    def _put_frame(self, opcode: int, data: "bytes | bytearray | memoryview", count: int) -> None:
        """Put the first `count` bytes of data into the frame to send. Only if the one before has
        been sent."""
        out, start = self._out, 2
        out[0] = _IS_LAST | opcode
        if count < _LENGTH_FOLLOWS:
            out[1] = count  # without a mask: a server's frames have none
        else:
            out[1] = _LENGTH_FOLLOWS
            out[2] = count >> 8
            out[3] = count & 0xFF
            start = 4
        out[start : start + count] = data[:count]
        self._out_at = 0
        self._out_end = start + count
        self.unproved += max(self._out_end, _SEGMENT)

    def _flush(self) -> bool:
        """Send the rest of the frame, then pings, pongs and news that are due. Returns whether all
        frames were sent: then another one may be made. Above _MOST_UNPROVED pongs and news
        wait."""
        while True:
            while self._out_at < self._out_end:
                sent = self._conn.write(memoryview(self._out)[self._out_at : self._out_end])
                if not sent:
                    return False
                self._out_at += sent
            if self._end_code:
                return True
            if self.unproved and not self._ping_covers:  # no ping is under way
                self._ping_payload = os.urandom(_PING_BYTES)
                self._put_frame(_PING, self._ping_payload, _PING_BYTES)
                self._ping_covers = self.unproved
            elif self.unproved > _MOST_UNPROVED:
                return True
            elif self._pong is not None:
                self._put_frame(_PONG, self._pong, len(self._pong))
                self._pong = None
            elif self.news:
                self._put_frame(_TEXT, self.news, len(self.news))
                self.news = b""
            else:
                return True

    def _close_with(self, code: int) -> None:
        """End the connection: send a last frame with the code, if there is space for it."""
        if not self._end_code and self._flush():
            self._put_frame(_CLOSE, bytes((code >> 8, code & 0xFF)), 2)
            self._end_code = code
            self._flush()
        self._end_code = code
