# mypy: disable-error-code=arg-type
"""A caller: one of those who may drive the machine, at the cable or over the network.

Nobody is ever waited for. What is to be sent is kept here, and goes in pieces that lwIP has room
for: where its memory is full, MicroPython 1.28 waits up to ten seconds in a write, also for a
socket that is not to block (extmod/modlwip.c, lwip_tcp_send). So no more is on its way to a caller
than _CREDIT bytes at once and so many in all, until something comes from him, which tells that
what was sent before has arrived; and what is said in one turn goes in one piece.
"""

import time

import micropython
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from interfaces import Connection

_QUESTION = const(0x3F)
_SAID = const(256)  # twice what a sender that counts has under way
_PIECE = const(64)
_OUT = const(512)
_CREDIT = const(800)
_SEGMENT = const(100)  # what a write counts for at the least: lwIP has 32 segments for all
# Senders ask for a report a few times a second: who is silent for so long is not there.
_GONE_MS = const(3000)
_CREDIT_MS = const(250)  # then what was sent has arrived, where there is anybody
UNHEARD = const(2400)  # three callers fill 7200 of lwIP's 8000 bytes


@micropython.viper
def asks(data: ptr8, count: int) -> int:
    """Whether there is a ? among the bytes."""
    for i in range(count):
        if data[i] == _QUESTION:
            return 1
    return 0


class Caller:
    """A place for one. conn: None where it is free. trusted: may do more than read. most: bytes
    that may be on their way to who is not heard of."""

    def __init__(self, most: int = UNHEARD) -> None:
        self._most = most
        self.conn: "Connection | None" = None
        self.address = ""
        self.trusted = False
        self.asked = False  # for a status report that he has not got yet
        self.heard_ms = 0
        self.spoke_ms = 0  # when his last line came
        # What has come and is not the machine's yet: up to `ready` it may be.
        self.said = bytearray(_SAID)
        self.length = 0
        self.ready = 0
        self.is_too_long = False
        self._out = bytearray(_OUT)
        self._waiting = 0
        self._credit = 0
        self._unheard = 0
        self._sent_ms = 0

    def begin(self, conn: "Connection", address: str, trusted: bool, now_ms: int) -> None:
        """Somebody has called."""
        self.conn = conn
        self.address = address
        self.trusted = trusted
        self.asked = False
        self.spoke_ms = now_ms
        self._waiting = 0
        self.forget()
        self.hear(now_ms)

    def end(self) -> None:
        """Hang up."""
        conn, self.conn = self.conn, None
        self.forget()
        if conn:
            conn.close()

    def forget(self) -> None:
        """What has come is not wanted."""
        self.length = self.ready = 0
        self.is_too_long = False

    def hear(self, now_ms: int) -> None:
        """Something has come: he is there, and what was sent has arrived."""
        self.heard_ms = now_ms
        self._credit = _CREDIT
        self._unheard = 0

    def is_gone(self, now_ms: int) -> bool:
        """Nothing is heard of him, over the network."""
        return bool(self.conn) and time.ticks_diff(now_ms, self.heard_ms) >= _GONE_MS

    def read(self, buf: bytearray) -> int:
        """What has come; -1 where he has gone."""
        try:
            count = self.conn.readinto(buf) if self.conn else 0
        except OSError:
            return -1
        if count is None:
            return 0
        return count or -1

    def has_room(self) -> bool:
        """Whether more may be read. Who may only read waits for each of his lines to be done."""
        return self.length <= _SAID - _PIECE if self.trusted else not self.ready

    def keep(self, byte: int) -> None:
        """One more byte of what he says."""
        if self.length < _SAID:
            self.said[self.length] = byte
            self.length += 1
        else:
            self.is_too_long = True

    def end_line(self, byte: int, now_ms: int) -> None:
        """A line of his is whole, and is the machine's."""
        self.keep(byte)
        self.ready = self.length
        self.spoke_ms = now_ms

    def pour(self, buf: bytearray, at: int) -> int:
        """Move what may be the machine's into buf, from there on. Returns where it ends."""
        count = min(self.ready, len(buf) - at)
        if count > 0:
            buf[at : at + count] = self.said[:count]
            left = self.length - count
            self.said[:left] = self.said[count : self.length]
            self.length = left
            self.ready -= count
        return at + count

    def put(self, data: "bytes | bytearray | memoryview") -> bool:
        """Say something to him, soon. False where he takes too little: he is to go."""
        count = len(data)
        if self._waiting + count > _OUT and not self.send(True):
            return False
        if self._waiting + count > _OUT:
            return False
        self._out[self._waiting : self._waiting + count] = data
        self._waiting += count
        return True

    def send(self, at_once: bool = False) -> bool:
        """Have sent what waits, as far as it may be. at_once: there is no room for more of it.
        False where he is gone, or takes nothing."""
        if not self._waiting or not self.conn:
            return True
        now_ms = time.ticks_ms()
        if self._credit <= 0:
            if self._unheard >= self._most:
                return False
            if not at_once and time.ticks_diff(now_ms, self._sent_ms) < _CREDIT_MS:
                return True
            self._credit = _CREDIT
        count = min(self._waiting, self._credit)
        try:
            sent = self.conn.write(memoryview(self._out)[:count]) or 0
        except OSError:
            return False
        self._waiting -= sent
        self._out[: self._waiting] = self._out[sent : sent + self._waiting]
        cost = max(sent, _SEGMENT)
        self._credit -= cost
        self._unheard += cost
        self._sent_ms = now_ms
        return True
