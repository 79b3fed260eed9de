"""The page from the board itself: HTTP, as far as a static file needs it, and websockets.

It is an Incoming around another: a websocket's client is treated like a TCP client. The page lies
in flash, compressed (NAME). A browser's first request returns a few lines (FIRST) that fetch the
page piece by piece. Each piece names the next one with four random hex digits (`Next:`, in FIRST a
path), so the request for the next one proves that all before it has been read, and its part of
lwIP's memory is free (client.py). A visitor that finds no memory waits, and nothing else waits for
it.

Only a page that came from here may open a websocket, and only under a name of the board, so that
no other site in a browser can (DNS rebinding). Keys are sent on the link: access.py.
"""

import binascii
import os
import time

from micropython import const

from ports.net import web_socket
from ports.net.client import Memory
from ports.net.web_socket import WebSocket

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from interfaces import Connection, Incoming

FIRST = "page.html"  # file names
NAME = "page.gz"
PIECE = const(672)  # bytes; with its head it fits one segment of lwIP
_HEAD = const(512)  # bytes that a head may have
_READ = const(256)  # bytes of one read
_LONGEST = const(4096)  # longest request, in bytes
_VISITORS = const(2)
_SILENT_MS = const(2000)  # a request that is not complete by then is dropped
_MEMORY = const(2400)  # bytes of lwIP's memory: three pieces
_SEGMENT = const(800)  # bytes of it that a piece with its head counts for
_SHORT = const(300)  # an answer without a piece; a websocket's, with its last frame
_SMALLEST = const(150)  # what any answer counts for, at least
_CHANCE = const(2)  # random bytes in a path

_KEY_LENGTH = const(24)
_LONGEST_HOST = const(21)  # longest numeric host, with its port
_DIGITS = const(5)  # a piece's number has fewer
# The constants are in few tuples, because a garbage collection can keep track of 60 objects of a
# module at once.
# Fields of a request that are read, the first line being "", and their indices.
_FIELDS = (
    b"",
    b"host",
    b"origin",
    b"upgrade",
    b"sec-websocket-key",
    b"sec-websocket-version",
    b"content-length",
    b"transfer-encoding",
)
_LINE = const(0)
_HOST = const(1)
_ORIGIN = const(2)
_UPGRADE = const(3)
_KEY = const(4)
_VERSION = const(5)
_LENGTH = const(6)
_ENCODING = const(7)
# Values that some fields must have, used by their indices.
_WORDS = (b"GET", b"HTTP/1.1", b"websocket", b"13")
_NAMES = (b"localhost", b".local")
_SIGNS = b".0123456789"
# Statuses and texts of refusals.
_REFUSALS = (
    (b"400 Bad Request", b"this is not an HTTP/1.1 request"),
    (b"405 Method Not Allowed", b"only GET requests are answered"),
    (b"403 Forbidden", b"unknown host name: use the IP address"),
    (b"403 Forbidden", b"pages of other sites may not use the machine"),
    (b"404 Not Found", b"the page is at /"),
    (b"404 Not Found", b"the page is not on the board: ugrbl deploy puts it there"),
    (b"400 Bad Request", b"this address is a websocket: open / in a browser"),
    (b"426 Upgrade Required", b"websocket version 13 is needed"),
)
_NO_REQUEST = const(0)  # indices into _REFUSALS
_NO_READING = const(1)
_OTHER_NAME = const(2)
_OTHER_PAGE = const(3)
_NOT_HERE = const(4)
_NO_PAGE = const(5)
_NO_SOCKET = const(6)
_OTHER_VERSION = const(7)
_GOOD = const(-1)  # the request is not refused
# An answer's head; its end; the policy, by which no site may hold our page in a frame and have its
# buttons clicked unseen; the answer to a handshake; the header of the next piece; paths of pieces.
_FORMS = (
    b"HTTP/1.1 %s\r\nContent-Type: %s\r\nContent-Length: %d\r\nCache-Control: no-store\r\n",
    b"Connection: close\r\n",
    b"Content-Security-Policy: default-src 'self' 'unsafe-inline' data: blob:;"
    b" connect-src 'self' ws://%s; frame-ancestors 'none'\r\n",
    b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Accept: %s\r\n\r\n",
    b"Next: %s\r\n",
    b"/0?0000",
    b"/%d?%s",
)
_ANSWER = const(0)  # indices into _FORMS
_AND_CLOSE = const(1)
_POLICY = const(2)
_ACCEPTED = const(3)
_NEXT = const(4)
_FIRST_PATH = const(5)  # the path in FIRST
_PATH = const(6)
# Content types, and their indices.
_KINDS = (b"text/plain", b"text/html", b"application/octet-stream")
_SENTENCE = const(0)
_HTML = const(1)
_PIECE = const(2)


class Visitor:
    """A place for an HTTP connection. conn: None if the place is free.

    owes: bytes sent that may not have been read; proof: the path whose request proves that they
    have. begun_ms: start of the present request, or of the wait for one. asks: fields of the
    request that waits for its answer, None if none does. Of the request being received _rest is
    the unfinished line, _size the number of bytes so far, _fields the fields by index.
    """

    def __init__(self) -> None:
        self.conn: "Connection | None" = None
        self.address = ""
        self.owes = 0
        self.proof = b""
        self.begun_ms = 0
        self.asks: "dict[int, bytes] | None" = None
        self._rest = b""
        self._size = 0
        self._fields: "dict[int, bytes]" = {}

    def begin(self, conn: "Connection", address: str, now_ms: int) -> None:
        """Assign the place to a new connection."""
        self.conn = conn
        self.address = address
        self.owes = 0
        self.proof = b""
        self.asks = None
        self.begun_ms = now_ms
        self._forget()

    def _forget(self) -> None:
        """Forget the request; the next one may begin."""
        self._rest = b""
        self._size = 0
        self._fields = {}

    def hear(self, data: bytes) -> "dict[int, bytes] | None":
        """Add bytes of the request. Returns its fields by index (_LINE, _HOST, …) once it is
        complete, None before; {} if it is malformed or too long."""
        self._size += len(data)
        lines = (self._rest + data).split(b"\n")
        self._rest = lines.pop()
        fields = self._fields
        while lines:
            line = lines.pop(0).strip()
            if not line and fields:  # bytes after it were sent before our answer
                is_last = not (lines or self._rest)
                self._forget()
                return fields if is_last else {}
            # The first line has no name: it is stored under "".
            name, _, value = line.partition(b":") if fields else (b"", b"", line)
            name = name.lower()
            if name not in _FIELDS:
                continue
            index = _FIELDS.index(name)
            if index in fields:
                return {}  # given twice
            fields[index] = value.strip()
        return {} if self._size > _LONGEST else None


class Page:
    """An Incoming. calls: new connections by TCP; visits: by HTTP; host: the board's name; folder:
    where the page lies, with a slash at its end. _memory: a share of lwIP's. _out: the answer
    being sent, _read: the bytes just read."""

    def __init__(self, calls: "Incoming", visits: "Incoming", host: str, folder: str = "") -> None:
        self._calls = calls
        self._visits = visits
        self._host = host.encode()
        self._folder = folder
        self._visitors = [Visitor() for _ in range(_VISITORS)]
        self._memory = Memory(_MEMORY)
        self._out = bytearray(_HEAD + PIECE)
        self._read = bytearray(_READ)

    def next(self) -> "tuple[Connection, str] | None":
        """Serve all visitors. Returns a visitor that has opened a websocket, or else a new TCP
        client, with its address; None without either."""
        now_ms = time.ticks_ms()
        self._memory.forget(now_ms)
        for visitor in self._visitors:
            if not visitor.conn:
                new = self._visits.next()
                if new:
                    conn, address = new
                    visitor.begin(conn, address, now_ms)
                continue
            try:
                websocket = self._serve(visitor, now_ms)
            except Exception:  # OSError; and nothing that a visitor sends may stop the machine
                self._owe(visitor, 0)  # lwIP has freed all of it
                self._end(visitor)
                continue
            if websocket:
                return websocket, visitor.address
        return self._calls.next()

    def close(self) -> None:
        """Stop listening; close all connections."""
        for visitor in self._visitors:
            self._end(visitor)
        self._visits.close()
        self._calls.close()

    # Requests

    def _serve(self, visitor: Visitor, now_ms: int) -> "WebSocket | None":
        """Read more of the request; answer it once it is complete. Return an opened websocket,
        else None. OSError if the connection has failed."""
        count = visitor.conn.readinto(self._read) if visitor.conn else 0
        if count is None:  # nothing has arrived
            if visitor.asks:
                return self._answer(visitor, visitor.asks, now_ms)
            if time.ticks_diff(now_ms, visitor.begun_ms) >= _SILENT_MS:
                self._end(visitor)
            return None
        if not count or visitor.asks:  # it has closed, or does not wait for the answer
            self._end(visitor)
            return None
        fields = visitor.hear(bytes(memoryview(self._read)[:count]))
        return None if fields is None else self._answer(visitor, fields, now_ms)

    def _owe(self, visitor: Visitor, count: int) -> None:
        """Set the bytes of lwIP's memory that this visitor's answers take."""
        self._memory.held += count - visitor.owes
        visitor.owes = count

    def _answer(
        self, visitor: Visitor, fields: "dict[int, bytes]", now_ms: int
    ) -> "WebSocket | None":
        """Answer a request: refuse it, send a piece, or return a websocket that it has opened.

        fields: by index, {} if it was malformed. It waits in visitor.asks if there is no memory
        for a piece now.
        """
        words = fields.get(_LINE, b"").split(b" ")  # method, path, version
        if visitor.proof and visitor.proof in words:  # all before has been read
            self._owe(visitor, 0)
        why = self._refusal(fields, words)
        if why >= 0:
            self._refuse(visitor, why)
            return None
        visitor.asks = fields
        if self._memory.space(True) < _SEGMENT:
            return None
        visitor.asks = None
        visitor.begun_ms = now_ms
        if words[1] == b"/ws":
            return self._open(visitor, fields)
        elif words[1] == b"/":
            self._piece(visitor, _HTML, 0, _FORMS[_POLICY] % fields[_HOST])
        else:
            self._piece(visitor, _PIECE, _number(words[1]), b"")
        return None

    def _refusal(self, fields: "dict[int, bytes]", words: "list[bytes]") -> int:
        """Return why a request is refused, an index into _REFUSALS; _GOOD if it is not. fields: by
        index; words: of its first line, which should be method, path and version."""
        if len(words) != 3 or words[2] != _WORDS[1]:  # HTTP/1.1
            return _NO_REQUEST
        if words[0] != _WORDS[0] or _LENGTH in fields or _ENCODING in fields:  # GET, no body
            return _NO_READING
        host = fields.get(_HOST, b"").lower()
        if not self._is_ours(host):
            return _OTHER_NAME
        own_origin = b"http://" + host  # of our page; a browser sends that of the page that asks
        if fields.get(_ORIGIN, own_origin).lower() != own_origin:
            return _OTHER_PAGE
        path = words[1]
        return _GOOD if path in (b"/", b"/ws") or _number(path) >= 0 else _NOT_HERE

    def _is_ours(self, host: bytes) -> bool:
        """Return whether a request's Host (lower case) is a name of the board or a number. Numbers
        are safe: they cannot resolve to another address later, as a name from elsewhere can."""
        name, _, port = host.partition(b":")
        if len(port) <= _DIGITS and name in (self._host, self._host + _NAMES[1], _NAMES[0]):
            return True
        return _is_of(name, _SIGNS) and len(host) <= _LONGEST_HOST

    def _open(self, visitor: Visitor, fields: "dict[int, bytes]") -> "WebSocket | None":
        """Answer the handshake and return the websocket, which takes over the connection; None if
        it is refused or the connection has failed."""
        key = fields.get(_KEY, b"")
        if fields.get(_UPGRADE, b"").lower() != _WORDS[2] or len(key) != _KEY_LENGTH:  # websocket
            self._refuse(visitor, _NO_SOCKET)
            return None
        if fields.get(_VERSION) != _WORDS[3]:  # 13
            self._refuse(visitor, _OTHER_VERSION)
            return None
        conn, answer = visitor.conn, _FORMS[_ACCEPTED] % web_socket.accepted(key)
        if conn is None or conn.write(answer) != len(answer):
            self._end(visitor)
            return None
        visitor.conn = None  # so that _end() frees the place and closes nothing
        self._owe(visitor, visitor.owes + _SHORT)
        self._end(visitor)
        return WebSocket(conn)

    # Answers

    def _refuse(self, visitor: Visitor, why: int) -> None:
        """Answer with a text of _REFUSALS (why: its index) and end the connection. Without an
        answer if no memory for a piece would remain: pieces for other visitors have priority."""
        status, text = _REFUSALS[why]
        head = _FORMS[_ANSWER] % (status, _KINDS[_SENTENCE], len(text) + 1) + _FORMS[_AND_CLOSE]
        if self._memory.space(True) >= _SEGMENT + _SHORT:  # True: all of it, not a client's share
            self._put(visitor, memoryview(head + b"\r\n" + text + b"\n"))
        self._end(visitor)

    def _piece(self, visitor: Visitor, kind: int, number: int, more: bytes) -> None:
        """Send piece `number` of a file: FIRST if kind is _HTML, else NAME.

        After the last piece comes an empty one, and the connection ends. more: further header
        lines. out has the head, which ends at _HEAD, and the piece after it. The path of the
        request that is to follow is random: it becomes visitor.proof.
        """
        out = memoryview(self._out)
        name = self._folder + (FIRST if kind == _HTML else NAME)
        try:
            with open(name, "rb") as file:
                file.seek(number * PIECE)
                count = file.readinto(out[_HEAD:])
        except OSError:
            self._refuse(visitor, _NO_PAGE)
            return
        head = _FORMS[_ANSWER] % (b"200 OK", _KINDS[kind], count) + more
        chance = binascii.hexlify(os.urandom(_CHANCE))
        if kind == _HTML:  # the file's text has a path to replace
            visitor.proof = _FORMS[_PATH] % (0, chance)
            path_at = bytes(out[_HEAD:]).find(_FORMS[_FIRST_PATH]) + _HEAD
            out[path_at : path_at + len(visitor.proof)] = visitor.proof
        elif count:
            visitor.proof = _FORMS[_PATH] % (number + 1, chance)
            head += _FORMS[_NEXT] % visitor.proof
        head += (b"" if count else _FORMS[_AND_CLOSE]) + b"\r\n"
        start = _HEAD - len(head)
        out[start:_HEAD] = head
        self._put(visitor, out[start : _HEAD + count])
        if not count:
            self._end(visitor)

    def _put(self, visitor: Visitor, data: memoryview) -> None:
        """Send all of data at once, or end the connection: lwIP should have memory for it."""
        self._owe(visitor, visitor.owes + max(len(data), _SMALLEST))
        if visitor.conn and visitor.conn.write(data) != len(data):
            self._end(visitor)

    def _end(self, visitor: Visitor) -> None:
        """End the connection. Bytes that it may not have read stay in lwIP's memory for a
        while."""
        conn, visitor.conn = visitor.conn, None
        self._memory.leave(visitor.owes)
        visitor.owes = 0
        if conn:
            conn.close()


def _number(path: bytes) -> int:
    """Return the number of a path: 12 of `/12` or `/12?ab34`; -1 of anything else."""
    text = path[1:].split(b"?")[0]
    return int(text) if _is_of(text, _SIGNS[1:]) and len(text) < _DIGITS else -1


def _is_of(text: bytes, allowed: bytes) -> bool:
    """Return whether the text is not empty and has only these characters."""
    return bool(text) and not [character for character in text if character not in allowed]
