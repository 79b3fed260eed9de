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
_HEAD_BYTES = const(512)  # bytes that a head may have
_READ_BYTES = const(256)  # bytes of one read
_LONGEST_REQUEST = const(4096)  # longest request, in bytes
_VISITORS = const(2)
_SILENT_MS = const(2000)  # a request that is not complete by then is dropped
_MEMORY_BYTES = const(2400)  # bytes of lwIP's memory: three pieces
_PIECE_COUNTS = const(800)  # bytes of that memory that a piece with its head counts for
_REFUSAL_COUNTS = const(300)  # an answer without a piece; a websocket's, with its last frame
_LEAST_COUNTS = const(150)  # what any answer counts for, at least
_RANDOM_BYTES = const(2)  # random bytes in a path

_KEY_BYTES = const(24)
_LONGEST_HOST = const(21)  # longest numeric host, with its port
_DIGITS = const(5)  # a port has at most so many, a piece's number fewer
# The constants are in few tuples, because a garbage collection can keep track of 60 objects of a
# module at once.
# Fields of a request that are read, the first line being "", and their indices.
_FIELD_NAMES = (
    b"",
    b"host",
    b"origin",
    b"upgrade",
    b"sec-websocket-key",
    b"sec-websocket-version",
    b"content-length",
    b"transfer-encoding",
)
_LINE = const(0)  # the request's first line: method, path, version
_HOST = const(1)
_ORIGIN = const(2)  # the site of the page that sends the request
_UPGRADE = const(3)
_KEY = const(4)  # Sec-WebSocket-Key
_VERSION = const(5)  # Sec-WebSocket-Version
_LENGTH = const(6)  # Content-Length
_ENCODING = const(7)  # Transfer-Encoding
_WORDS = (b"GET", b"HTTP/1.1", b"websocket", b"13")  # values that some fields must have
_NAMES = (b"localhost", b".local")  # a whole host name; what may follow the board's name
_NUMBER_CHARS = b".0123456789"  # of an IP address; without the first one, of a number
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
_NOT_HTTP = const(0)  # index into _REFUSALS, from here on
_NOT_A_GET = const(1)
_UNKNOWN_HOST = const(2)
_OTHER_SITE = const(3)
_NO_SUCH_PATH = const(4)
_PAGE_NOT_STORED = const(5)
_NOT_A_WEBSOCKET = const(6)
_OTHER_VERSION = const(7)
_NOT_REFUSED = const(-1)  # the request is not refused
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
_ANSWER_HEAD = const(0)  # index into _FORMS: status, content type, length
_CLOSE_HEADER = const(1)  # the connection ends after this answer
_POLICY_HEADER = const(2)  # with the Host of the request
_HANDSHAKE = const(3)  # with the accepted key
_NEXT_HEADER = const(4)  # with a path by _PIECE_PATH
_PATH_IN_FIRST = const(5)  # the text in FIRST that a path replaces, of the same length
_PIECE_PATH = const(6)  # number and random hex digits
# Content types, and their indices.
_KINDS = (b"text/plain", b"text/html", b"application/octet-stream")
_TEXT_KIND = const(0)  # index into _KINDS: of a refusal's text
_HTML_KIND = const(1)  # index into _KINDS: of FIRST
_BINARY_KIND = const(2)  # index into _KINDS: of a piece of NAME


class Visitor:
    """A place for an HTTP connection. conn: None if the place is free.

    owes: bytes sent that may not have been read; proof: the path whose request proves that they
    have. begun_ms: start of the present request, or of the wait for one. waiting_request: fields
    of the request that waits for its answer, None if none does. Of the request being received
    _unfinished_line is the unfinished line, _request_bytes the number of bytes so far, _fields the
    fields by index.
    """

    def __init__(self) -> None:
        self.conn: "Connection | None" = None
        self.address = ""
        self.owes = 0
        self.proof = b""
        self.begun_ms = 0
        self.waiting_request: "dict[int, bytes] | None" = None
        self._unfinished_line = b""
        self._request_bytes = 0
        self._fields: "dict[int, bytes]" = {}

    def begin(self, conn: "Connection", address: str, now_ms: int) -> None:
        """Assign the place to a new connection."""
        self.conn = conn
        self.address = address
        self.owes = 0
        self.proof = b""
        self.waiting_request = None
        self.begun_ms = now_ms
        self._begin_request()

    def _begin_request(self) -> None:
        """Forget the request; the next one may begin."""
        self._unfinished_line = b""
        self._request_bytes = 0
        self._fields = {}

    def add_bytes(self, data: bytes) -> "dict[int, bytes] | None":
        """Add bytes of the request. Returns its fields by index (_LINE, _HOST, …) once it is
        complete, None before; {} if it is malformed or too long."""
        self._request_bytes += len(data)
        lines = (self._unfinished_line + data).split(b"\n")
        self._unfinished_line = lines.pop()
        fields = self._fields
        while lines:
            line = lines.pop(0).strip()
            if not line and fields:  # bytes after it were sent before our answer
                is_last = not (lines or self._unfinished_line)
                self._begin_request()
                return fields if is_last else {}
            # The first line has no name: it is stored under "".
            name, _, value = line.partition(b":") if fields else (b"", b"", line)
            name = name.lower()
            if name not in _FIELD_NAMES:
                continue
            index = _FIELD_NAMES.index(name)
            if index in fields:
                return {}  # given twice
            fields[index] = value.strip()
        return {} if self._request_bytes > _LONGEST_REQUEST else None


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
        self._memory = Memory(_MEMORY_BYTES)
        self._out = bytearray(_HEAD_BYTES + PIECE)
        self._read = bytearray(_READ_BYTES)

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
                self._set_owed(visitor, 0)  # lwIP has freed all of it
                self._end_visit(visitor)
                continue
            if websocket:
                return websocket, visitor.address
        return self._calls.next()

    def close(self) -> None:
        """Stop listening; close all connections."""
        for visitor in self._visitors:
            self._end_visit(visitor)
        self._visits.close()
        self._calls.close()

    # Requests

    def _serve(self, visitor: Visitor, now_ms: int) -> "WebSocket | None":
        """Read more of the request; answer it once it is complete. Return an opened websocket,
        else None. OSError if the connection has failed."""
        count = visitor.conn.readinto(self._read) if visitor.conn else 0
        if count is None:  # nothing has arrived
            if visitor.waiting_request:
                return self._answer(visitor, visitor.waiting_request, now_ms)
            if time.ticks_diff(now_ms, visitor.begun_ms) >= _SILENT_MS:
                self._end_visit(visitor)
            return None
        if not count or visitor.waiting_request:  # closed, or it sends before we have answered
            self._end_visit(visitor)
            return None
        fields = visitor.add_bytes(bytes(memoryview(self._read)[:count]))
        return None if fields is None else self._answer(visitor, fields, now_ms)

    def _set_owed(self, visitor: Visitor, count: int) -> None:
        """Set the bytes of lwIP's memory that this visitor's answers take."""
        self._memory.held += count - visitor.owes
        visitor.owes = count

    def _answer(
        self, visitor: Visitor, fields: "dict[int, bytes]", now_ms: int
    ) -> "WebSocket | None":
        """Answer a request: refuse it, send a piece, or return a websocket that it has opened.

        fields: by index, {} if it was malformed. They wait in visitor.waiting_request if there is
        no memory for a piece now.
        """
        words = fields.get(_LINE, b"").split(b" ")  # method, path, version
        if visitor.proof and visitor.proof in words:  # the path: all before has been read
            self._set_owed(visitor, 0)
        why = self._refusal(fields, words)
        if why >= 0:
            self._refuse(visitor, why)
            return None
        visitor.waiting_request = fields
        if self._memory.space(True) < _PIECE_COUNTS:  # next() tries again
            return None
        visitor.waiting_request = None
        visitor.begun_ms = now_ms
        if words[1] == b"/ws":
            return self._open_websocket(visitor, fields)
        elif words[1] == b"/":
            self._send_piece(visitor, _HTML_KIND, 0, _FORMS[_POLICY_HEADER] % fields[_HOST])
        else:
            self._send_piece(visitor, _BINARY_KIND, _number(words[1]), b"")
        return None

    def _refusal(self, fields: "dict[int, bytes]", words: "list[bytes]") -> int:
        """Return why a request is refused, an index into _REFUSALS; _NOT_REFUSED if it is not.
        fields: by index; words: of its first line, which should be method, path and version."""
        if len(words) != 3 or words[2] != _WORDS[1]:  # HTTP/1.1
            return _NOT_HTTP
        if words[0] != _WORDS[0] or _LENGTH in fields or _ENCODING in fields:  # GET, no body
            return _NOT_A_GET
        host = fields.get(_HOST, b"").lower()
        if not self._is_own_host(host):
            return _UNKNOWN_HOST
        own_origin = b"http://" + host  # of our page; a browser sends that of the page that asks
        if fields.get(_ORIGIN, own_origin).lower() != own_origin:
            return _OTHER_SITE
        path = words[1]
        return _NOT_REFUSED if path in (b"/", b"/ws") or _number(path) >= 0 else _NO_SUCH_PATH

    def _is_own_host(self, host: bytes) -> bool:
        """Return whether a request's Host (lower case) is a name of the board or a number. Numbers
        are safe: they cannot resolve to another address later, as a name from elsewhere can."""
        name, _, port = host.partition(b":")
        if len(port) <= _DIGITS and name in (self._host, self._host + _NAMES[1], _NAMES[0]):
            return True
        return _has_only(name, _NUMBER_CHARS) and len(host) <= _LONGEST_HOST

    def _open_websocket(self, visitor: Visitor, fields: "dict[int, bytes]") -> "WebSocket | None":
        """Answer the handshake and return the websocket, which takes over the connection; None if
        it is refused or the connection has failed."""
        key = fields.get(_KEY, b"")
        if fields.get(_UPGRADE, b"").lower() != _WORDS[2] or len(key) != _KEY_BYTES:  # websocket
            self._refuse(visitor, _NOT_A_WEBSOCKET)
            return None
        if fields.get(_VERSION) != _WORDS[3]:  # 13
            self._refuse(visitor, _OTHER_VERSION)
            return None
        conn, answer = visitor.conn, _FORMS[_HANDSHAKE] % web_socket.accepted(key)
        if conn is None or conn.write(answer) != len(answer):
            self._end_visit(visitor)
            return None
        visitor.conn = None  # so that _end_visit() frees the place and closes nothing
        self._set_owed(visitor, visitor.owes + _REFUSAL_COUNTS)
        self._end_visit(visitor)
        return WebSocket(conn)

    # Answers

    def _refuse(self, visitor: Visitor, why: int) -> None:
        """Answer with a text of _REFUSALS (why: its index) and end the connection. Without an
        answer if no memory for a piece would remain: pieces for other visitors have priority."""
        status, text = _REFUSALS[why]
        head = _FORMS[_ANSWER_HEAD] % (status, _KINDS[_TEXT_KIND], len(text) + 1)
        head += _FORMS[_CLOSE_HEADER]
        space = self._memory.space(True)  # True: all of it, not a client's share
        if space >= _PIECE_COUNTS + _REFUSAL_COUNTS:
            self._send_all(visitor, memoryview(head + b"\r\n" + text + b"\n"))
        self._end_visit(visitor)

    def _send_piece(self, visitor: Visitor, kind: int, number: int, more: bytes) -> None:
        """Send piece `number` of a file: FIRST if kind is _HTML_KIND, else NAME.

        After the last piece comes an empty one, and the connection ends. more: further header
        lines. In out the head ends at _HEAD_BYTES, where the piece begins. The path of the
        request that is to follow is random: it becomes visitor.proof.
        """
        out = memoryview(self._out)
        name = self._folder + (FIRST if kind == _HTML_KIND else NAME)
        try:
            with open(name, "rb") as file:
                file.seek(number * PIECE)
                count = file.readinto(out[_HEAD_BYTES:])
        except OSError:
            self._refuse(visitor, _PAGE_NOT_STORED)
            return
        head = _FORMS[_ANSWER_HEAD] % (b"200 OK", _KINDS[kind], count) + more
        random_hex = binascii.hexlify(os.urandom(_RANDOM_BYTES))
        if kind == _HTML_KIND:  # the file's text has a path to replace
            visitor.proof = _FORMS[_PIECE_PATH] % (0, random_hex)  # NAME's first piece
            path_at = bytes(out[_HEAD_BYTES:]).find(_FORMS[_PATH_IN_FIRST]) + _HEAD_BYTES
            out[path_at : path_at + len(visitor.proof)] = visitor.proof
        elif count:
            visitor.proof = _FORMS[_PIECE_PATH] % (number + 1, random_hex)
            head += _FORMS[_NEXT_HEADER] % visitor.proof
        head += (b"" if count else _FORMS[_CLOSE_HEADER]) + b"\r\n"
        start = _HEAD_BYTES - len(head)
        out[start:_HEAD_BYTES] = head
        self._send_all(visitor, out[start : _HEAD_BYTES + count])
        if not count:
            self._end_visit(visitor)

    def _send_all(self, visitor: Visitor, data: memoryview) -> None:
        """Send all of data at once, or end the connection: lwIP should have memory for it."""
        self._set_owed(visitor, visitor.owes + max(len(data), _LEAST_COUNTS))
        if visitor.conn and visitor.conn.write(data) != len(data):
            self._end_visit(visitor)

    def _end_visit(self, visitor: Visitor) -> None:
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
    return int(text) if _has_only(text, _NUMBER_CHARS[1:]) and len(text) < _DIGITS else -1


def _has_only(text: bytes, allowed: bytes) -> bool:
    """Return whether the text is not empty and has only these characters."""
    return bool(text) and not [character for character in text if character not in allowed]
