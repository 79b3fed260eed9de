# mypy: disable-error-code=arg-type
"""A client: one of those who may control the machine, at the cable or over the network.

Nothing here waits. Output is queued and sent in pieces that lwIP has memory for: where that is
used up, MicroPython 1.28 waits up to ten seconds in a write, also for a socket that is not to
block (extmod/modlwip.c, lwip_tcp_send). Its memory is 8000 bytes and 32 segments for all, and what
a closed connection has not acknowledged stays there for ten seconds. Memory counts all of it.

Bytes that arrive prove that the client is alive, not that it has read our output. With the key
they are taken as proof. Without it a websocket proves it (web_socket.py), and raw TCP cannot: such
a client gets a fixed number of bytes, and no answers after them, until it says the key.
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
_SEGMENT = const(100)  # what a write counts for at the least
MEMORY = const(7200)  # a third for each client
_CLOSED_MS = const(10_000)
# Senders ask for a report a few times a second: a client silent for so long has gone.
_GONE_MS = const(3000)
# So long a client may keep its place where others want one: without the key from when it came,
# with it from when it was last heard, for senders wait for the end of a long move.
_STRANGER_MS = const(250)
_LOST_MS = const(600_000)
_TRIES = const(3)  # wrong keys


@micropython.viper
def asks(data: ptr8, count: int) -> int:
    """Whether there is a ? among the bytes."""
    for i in range(count):
        if data[i] == _QUESTION:
            return 1
    return 0


class Memory:
    """Bytes that lwIP may hold for all connections, those that are closed included. Clients
    without the key have a third of it, all together."""

    def __init__(self, most: int = MEMORY) -> None:
        self.share = most // 3
        self.held = 0
        self._most = most
        self._closed: "list[tuple[int, int]]" = []  # when, and how many bytes

    def space(self, trusted: bool) -> int:
        """Bytes that may be sent."""
        return (self._most if trusted else self.share) - self.held

    def leave(self, count: int) -> None:
        """So many bytes are held for a connection that has been closed."""
        if count:
            self._closed.append((time.ticks_ms(), count))

    def forget(self, now_ms: int) -> None:
        """Those that MicroPython has given up are free."""
        while self._closed and time.ticks_diff(now_ms, self._closed[0][0]) >= _CLOSED_MS:
            self.held -= self._closed.pop(0)[1]


class Client:
    """A place for one. conn: None where it is free. trusted: has said the key."""

    def __init__(self, memory: Memory) -> None:
        self._memory = memory
        self.conn: "Connection | None" = None
        self.address = ""
        self.trusted = False
        self.asked = False  # for a status report that it has not got yet
        self.tries = _TRIES
        self.heard_ms = 0
        self.spoke_ms = 0  # when its last line came; without the key, when it came itself
        # Received and not yet passed to the machine: up to `ready` it may be.
        self.said = bytearray(_SAID)
        self.length = 0
        self.ready = 0
        self.is_too_long = False
        self._out = bytearray(_OUT)
        self._waiting = 0
        self._held = 0  # of memory
        self._proves = False

    def begin(self, conn: "Connection", address: str, now_ms: int) -> None:
        """A new connection."""
        self.conn = conn
        self.address = address
        self.trusted = False
        self.asked = False
        self.tries = _TRIES
        self.spoke_ms = self.heard_ms = now_ms
        self._waiting = 0
        self._proves = hasattr(conn, "unproved")
        self.forget()

    def end(self) -> None:
        """Hang up."""
        conn, self.conn = self.conn, None
        self.forget()
        self._memory.leave(self._held)
        self._held = 0
        if conn:
            conn.close()

    def forget(self) -> None:
        """Drop what was received."""
        self.length = self.ready = 0
        self.is_too_long = False

    def note_received(self, now_ms: int) -> None:
        """Something has arrived: the client is alive."""
        self.heard_ms = now_ms
        if self.trusted and not self._proves:
            self._hold(0)

    def _hold(self, count: int) -> None:
        self._memory.held += count - self._held
        self._held = count

    def is_gone(self, now_ms: int) -> bool:
        """Nothing is heard of it, over the network."""
        return bool(self.conn) and time.ticks_diff(now_ms, self.heard_ms) >= _GONE_MS

    def overdue_ms(self, now_ms: int) -> int:
        """How much longer than it may it has kept its place."""
        if self.trusted:
            return time.ticks_diff(now_ms, self.heard_ms) - _LOST_MS
        return time.ticks_diff(now_ms, self.spoke_ms) - _STRANGER_MS

    def read(self, buf: bytearray) -> int:
        """What has arrived; -1 where the client has gone."""
        try:
            count = self.conn.readinto(buf) if self.conn else 0
        except OSError:
            self._hold(0)  # lwIP has dropped all of it
            return -1
        if count is None:
            return 0
        return count or -1

    def has_room(self) -> bool:
        """Whether more may be read. Without the key each line waits for the one before."""
        return self.length <= _SAID - _PIECE if self.trusted else not self.ready

    def keep(self, byte: int) -> None:
        """One more byte received."""
        if self.length < _SAID:
            self.said[self.length] = byte
            self.length += 1
        else:
            self.is_too_long = True

    def end_line(self, byte: int, now_ms: int) -> None:
        """A line is whole, and is the machine's."""
        self.keep(byte)
        self.ready = self.length
        if self.trusted:
            self.spoke_ms = now_ms

    def move_lines(self, buf: bytearray) -> int:
        """Move what may be the machine's into buf. Returns how many bytes."""
        count = min(self.ready, len(buf))
        buf[:count] = self.said[:count]
        left = self.length - count
        self.said[:left] = self.said[count : self.length]
        self.length = left
        self.ready -= count
        return count

    def may_hear(self) -> bool:
        """Whether an answer would be sent: there is memory for it."""
        return self.space() >= _SEGMENT

    def space(self) -> int:
        """Bytes that may be sent now."""
        if self._proves:
            self._hold(self.conn.unproved)  # type: ignore[union-attr]  # WebSocket's
        return min(self._memory.share - self._held, self._memory.space(self.trusted))

    def put(self, data: "bytes | bytearray | memoryview") -> bool:
        """Queue output. False where the client reads too little: it has to go."""
        count = len(data)
        if self._waiting + count > _OUT and not self.send():
            return False
        if self._waiting + count > _OUT:
            return False
        self._out[self._waiting : self._waiting + count] = data
        self._waiting += count
        return True

    def send(self) -> bool:
        """Send as much queued output as there is memory for. False where the client is gone."""
        if not self._waiting or not self.conn:
            return True
        space = self.space()
        if space < _SEGMENT:
            if not (self.trusted or self._proves):
                self._waiting = 0  # no more answers
            return True
        try:
            sent = self.conn.write(memoryview(self._out)[: min(self._waiting, space)]) or 0
        except OSError:
            self._hold(0)
            return False
        self._waiting -= sent
        self._out[: self._waiting] = self._out[sent : sent + self._waiting]
        self._hold(self._held + max(sent, _SEGMENT))
        return True


def slot_for(address: str, clients: "list[Client]", at_rest: bool, now_ms: int) -> "Client | None":
    """A free place, or the one most overdue, for a new connection. While the machine works none of
    those with the key is. Without the key a computer takes no other's place where it has one."""
    found = own = None
    most_ms = 0
    for client in clients:
        if not client.conn:
            return client
        overdue_ms = client.overdue_ms(now_ms)
        if not client.trusted and client.address == address:
            own = client
        if overdue_ms > most_ms and (at_rest or not client.trusted):
            found, most_ms = client, overdue_ms
    if own:
        return own if own.overdue_ms(now_ms) > 0 else None
    return found
