# mypy: disable-error-code=arg-type
"""A client that may control the machine, at the cable or over the network.

Nothing here waits. Output is queued and sent in pieces that lwIP has memory for. If that memory is
used up, MicroPython 1.28 waits up to ten seconds in a write, even on a non-blocking socket
(extmod/modlwip.c, lwip_tcp_send). lwIP's memory is 8000 bytes and 32 segments for all connections,
and what a closed connection has not acknowledged stays there for ten seconds. Memory counts all of
it.

Bytes that arrive prove that the client is alive, not that it has read our output. From a client
with the key they are accepted as that proof. Without the key a websocket proves it
(web_socket.py), and raw TCP cannot: such a client is sent a fixed number of bytes, and no answers
after them, until it sends the key.
"""

import time

import micropython
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from interfaces import Connection

_QUESTION = const(0x3F)  # the character ?
_RECEIVED_BYTES = const(256)  # twice the bytes that a sender that counts has under way
_READ_BYTES = const(64)  # bytes of one read
_OUT_BYTES = const(512)  # bytes of output that may be queued
_LEAST_WRITE_BYTES = const(100)  # that a write counts for, at least: lwIP's own data about it
MEMORY = const(7200)  # bytes; a client may use a third
_CLOSED_MS = const(10_000)  # for so long lwIP keeps the output of a closed connection
# Senders request a report a few times a second: a client silent for so long has gone.
_GONE_MS = const(3000)
# How long a client may keep its place if another client needs one. With the key it is long,
# because senders wait for the end of a long move.
_STRANGERS_PLACE_MS = const(250)  # without the key, since it connected
_SILENT_PLACE_MS = const(600_000)  # with the key, since its last bytes
_TRIES = const(3)  # wrong keys that are allowed

_FIRST_OF_ALARM = const(0x41)  # A of ALARM:
_FIRST_OF_BANNER = const(0x0D)  # CR: it begins with an empty line
_FIRST_OF_BRACKET = const(0x5B)  # [ of [MSG: and of answers to $ commands
_SECOND_OF_MESSAGE = const(0x4D)  # M of [MSG:


@micropython.viper
def asks(data: ptr8, count: int) -> int:
    """Return 1 if there is a ? among the first `count` bytes of data, else 0."""
    for i in range(count):
        if data[i] == _QUESTION:
            return 1
    return 0


def is_for_all(data: "bytes | bytearray | memoryview") -> bool:
    """Return whether output (not empty) is sent to all clients: an alarm, a message or the banner.
    An answer or a report is not."""
    first = data[0]
    if first == _FIRST_OF_BRACKET:
        return data[1] == _SECOND_OF_MESSAGE
    return first <= _FIRST_OF_BANNER or first == _FIRST_OF_ALARM  # <=: or LF


class Memory:
    """Bytes that lwIP may hold for all connections, including closed ones: `most` in all. held:
    bytes counted as in use; share: a third, for one client, and for all clients without the key
    together."""

    def __init__(self, most: int = MEMORY) -> None:
        self.share = most // 3
        self.held = 0
        self._most = most
        self._closed: "list[tuple[int, int]]" = []  # time of closing, in ms, and bytes held

    def space(self, trusted: bool) -> int:
        """Return how many bytes may be sent, below 0 if too many are in use. trusted: to a client
        with the key; all others have only the share."""
        return (self._most if trusted else self.share) - self.held

    def leave(self, count: int) -> None:
        """Note that a connection has been closed; lwIP still holds so many bytes for it, which
        stay counted until forget()."""
        if count:
            self._closed.append((time.ticks_ms(), count))

    def forget(self, now_ms: int) -> None:
        """Stop counting the bytes of connections that were closed _CLOSED_MS ago: lwIP has freed
        them."""
        while self._closed and time.ticks_diff(now_ms, self._closed[0][0]) >= _CLOSED_MS:
            self.held -= self._closed.pop(0)[1]


class Client:
    """A place for a client. conn: None if the place is free, and always for the client at the
    cable. trusted: the client has sent the key.

    asked: it requested a status report that it has not been sent. tries: wrong keys still allowed.
    last_bytes_ms: time of its last bytes; last_line_ms: of its last line or, without the key, of
    its connection. received: bytes received and not yet passed to the machine, `length` of them,
    of which the first `ready` may be passed; is_too_long: the line after those did not fit. _out:
    queued output, _out_length bytes of at most out_bytes. _held: bytes of lwIP's memory that count
    as this client's. _counts_unread: the connection (a websocket) counts by itself the bytes sent
    and not yet read.
    """

    def __init__(self, memory: Memory, out_bytes: int = _OUT_BYTES) -> None:
        self._memory = memory
        self.conn: "Connection | None" = None
        self.address = ""
        self.trusted = False
        self.asked = False
        self.tries = _TRIES
        self.last_bytes_ms = 0
        self.last_line_ms = 0
        self.received = bytearray(_RECEIVED_BYTES)
        self.length = 0
        self.ready = 0
        self.is_too_long = False
        self._out = bytearray(out_bytes)
        self._out_length = 0
        self._held = 0
        self._counts_unread = False

    def begin(self, conn: "Connection", address: str, now_ms: int) -> None:
        """Assign the place to a new connection."""
        self.conn = conn
        self.address = address
        self.trusted = False
        self.asked = False
        self.tries = _TRIES
        self.last_line_ms = self.last_bytes_ms = now_ms
        self._out_length = 0
        self._counts_unread = hasattr(conn, "unproved")  # a websocket
        self.forget()

    def end(self) -> None:
        """Close the connection and free the place; its output stays counted for a while."""
        conn, self.conn = self.conn, None
        self.forget()
        self._memory.leave(self._held)
        self._held = 0  # without _set_held(): the bytes stay counted in Memory
        if conn:
            conn.close()

    def forget(self) -> None:
        """Drop the bytes received."""
        self.length = self.ready = 0
        self.is_too_long = False

    def note_received(self, now_ms: int) -> None:
        """Note that bytes arrived: the client is alive and, with the key, is assumed to have read
        all output before, so that none counts as held. A websocket counts what was read."""
        self.last_bytes_ms = now_ms
        if self.trusted and not self._counts_unread:
            self._set_held(0)

    def _set_held(self, count: int) -> None:
        """Set the bytes of lwIP's memory that count as this client's."""
        self._memory.held += count - self._held
        self._held = count

    def is_gone(self, now_ms: int) -> bool:
        """Return whether a network client has been silent for _GONE_MS."""
        return bool(self.conn) and time.ticks_diff(now_ms, self.last_bytes_ms) >= _GONE_MS

    def overdue_ms(self, now_ms: int) -> int:
        """Return how many ms the client has kept its place beyond its time; below 0 before."""
        if self.trusted:
            return time.ticks_diff(now_ms, self.last_bytes_ms) - _SILENT_PLACE_MS
        return time.ticks_diff(now_ms, self.last_line_ms) - _STRANGERS_PLACE_MS

    def read(self, buf: bytearray) -> int:
        """Read the bytes received into buf and return how many; -1 if the client has gone."""
        try:
            count = self.conn.readinto(buf) if self.conn else 0
        except OSError:
            self._set_held(0)  # lwIP has dropped all of it
            return -1
        if count is None:  # none have arrived
            return 0
        return count or -1  # 0 bytes: the other end has closed

    def may_read(self) -> bool:
        """Return whether more bytes may be read while the client's lines are executed: with the
        key, if there is space for them. Without it not before these are answered: else a flood of
        lines would hold the machine."""
        return self.trusted and self.length < _RECEIVED_BYTES - _READ_BYTES

    def keep(self, byte: int) -> None:
        """Store a received byte; one that does not fit is lost, and the line is then too long. One
        byte stays free for the line's end."""
        if self.length < _RECEIVED_BYTES - 1:
            self.received[self.length] = byte
            self.length += 1
        else:
            self.is_too_long = True

    def end_line(self, byte: int, now_ms: int) -> None:
        """Store the end of a line (byte: CR or LF), which may be passed to the machine then."""
        if self.length < _RECEIVED_BYTES:
            self.received[self.length] = byte
            self.length += 1
        self.ready = self.length
        if self.trusted:
            self.last_line_ms = now_ms

    def move_lines(self, buf: bytearray) -> int:
        """Move bytes that may be passed to the machine into buf. Returns how many."""
        count = min(self.ready, len(buf))
        buf[:count] = self.received[:count]
        remaining = self.length - count
        self.received[:remaining] = self.received[count : self.length]
        self.length = remaining
        self.ready -= count
        return count

    def can_be_answered(self) -> bool:
        """Return whether an answer would be sent: there is memory for it."""
        return self.space() >= _LEAST_WRITE_BYTES

    def space(self) -> int:
        """Return how many bytes may be sent now, of the client's share and of all memory."""
        if self._counts_unread:
            self._set_held(self.conn.unproved)  # type: ignore[union-attr]  # WebSocket's
        return min(self._memory.share - self._held, self._memory.space(self.trusted))

    def put(self, data: "bytes | bytearray | memoryview") -> bool:
        """Queue output. False if the client reads too slowly; it must be dropped then."""
        count = len(data)
        if self._out_length + count > _OUT_BYTES and not self.send():
            return False
        if self._out_length + count > _OUT_BYTES:  # still no space
            return False
        self._out[self._out_length : self._out_length + count] = data
        self._out_length += count
        return True

    def send(self) -> bool:
        """Send as much queued output as lwIP has memory for. False if the connection has failed.
        A client that cannot prove that it reads (TCP without the key) loses the rest."""
        if not self._out_length or not self.conn:
            return True
        space = self.space()
        if space < _LEAST_WRITE_BYTES:
            if not (self.trusted or self._counts_unread):
                self._out_length = 0  # no more answers
            return True
        try:
            sent = self.conn.write(memoryview(self._out)[: min(self._out_length, space)]) or 0
        except OSError:
            self._set_held(0)  # lwIP has dropped all of it
            return False
        self._out_length -= sent
        self._out[: self._out_length] = self._out[sent : sent + self._out_length]
        self._set_held(self._held + max(sent, _LEAST_WRITE_BYTES))
        return True


def slot_for(address: str, clients: "list[Client]", at_rest: bool, now_ms: int) -> "Client | None":
    """Return the place for a new connection: a free one, or one whose client is overdue; None if
    there is none.

    address: of the new connection; at_rest: the machine is idle. Of overdue clients the one most
    overdue loses its place, during motion only one without the key. But an address that has a
    place without the key gets no other client's: only that one, once overdue.
    """
    most_overdue = own = None  # own: a place without the key from the same address
    most_ms = 0  # by how much most_overdue is
    for client in clients:
        if not client.conn:
            return client
        overdue_ms = client.overdue_ms(now_ms)
        if not client.trusted and client.address == address:
            own = client
        if overdue_ms > most_ms and (at_rest or not client.trusted):
            most_overdue, most_ms = client, overdue_ms
    if own:
        return own if own.overdue_ms(now_ms) > 0 else None
    return most_overdue
