"""A simulated machine that serves its page, and browsers: their requests and frames."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from net_bench import Door, NetBench, Pipe
from ugrbl.boardfile import page_files
from ugrbl.run.tcp_link import LOOPBACK

# Chromium's request headers.
_USUAL = (
    "User-Agent: Mozilla/5.0 (X11; Linux x86_64) AppleWebKit/537.36 (KHTML, like Gecko) "
    "Chrome/140.0.0.0 Safari/537.36\r\nAccept: */*\r\nAccept-Encoding: gzip, deflate\r\n"
    "Accept-Language: en-GB,en;q=0.9,de;q=0.8\r\nCookie: other=1\r\n"
)
_KEY = "dGhlIHNhbXBsZSBub25jZQ=="  # from RFC 6455, with its answer
_ACCEPTED = b"s3pPLMBiTxaQ9kYGzzhZRbK+xOo="
WS_UPGRADE = {
    "Connection": "keep-alive, Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Key": _KEY,
    "Sec-WebSocket-Version": "13",
    "Origin": "http://ugrbl.local",
}
MASK = bytes((0x11, 0x22, 0x33, 0xFE))
TEXT, BINARY, CLOSE, PING, PONG = 1, 2, 8, 9, 10


def request(path: str, method: str = "GET", **fields: str) -> bytes:
    """Return a request with changed fields; an empty text removes a field."""
    there = {"Host": "ugrbl.local", **{name.replace("_", "-"): fields[name] for name in fields}}
    lines = "".join(f"{name}: {value}\r\n" for name, value in there.items() if value)
    return f"{method} {path} HTTP/1.1\r\n{lines}{_USUAL}\r\n".encode()


def frame(data: "str | bytes", opcode: int = BINARY, last: bool = True) -> bytes:
    """Return a frame as a browser sends it."""
    data = data.encode("latin-1") if isinstance(data, str) else data
    size = len(data)
    head = [size | 0x80] if size < 126 else [126 | 0x80, size >> 8, size & 0xFF]
    masked = bytes(byte ^ MASK[i % 4] for i, byte in enumerate(data))
    return bytes((0x80 * last | opcode, *head)) + MASK + masked


class Frames:
    """The frames received on a websocket."""

    def __init__(self, pipe: Pipe) -> None:
        self.pipe = pipe
        self.messages: list[tuple[int, bytes]] = []
        self.reads = True

    def look(self) -> None:
        got = self.pipe.got
        while len(got) >= 2:
            start, size = (2, got[1]) if got[1] < 126 else (4, got[2] << 8 | got[3])
            if len(got) < start + size:
                return
            self.messages.append((got[0], bytes(got[start : start + size])))
            self._answer(*self.messages[-1])
            del got[: start + size]

    def _answer(self, opcode: int, data: bytes) -> None:
        """Answer like a browser."""
        if opcode == 0x80 | PING and self.reads:
            self.pipe.send(frame(data, PONG))

    def all(self, opcode: int) -> "list[bytes]":
        self.look()
        return [data for head, data in self.messages if head == 0x80 | opcode]

    def said(self) -> str:
        return b"".join(self.all(BINARY)).decode("latin-1")

    def news(self) -> str:
        return self.all(TEXT)[-1].decode() if self.all(TEXT) else ""


class PageBench(NetBench):
    """A machine that serves its page from that folder, with visitors in memory.

    more, visits: further clients by TCP and by HTTP."""

    def __init__(
        self,
        monkeypatch: Any,
        folder: Path,
        settings: "dict[int, float] | None" = None,
        more: Any = None,
        visits: Any = None,
    ) -> None:
        page_files.save(folder)
        self.visits = Door(visits)
        super().__init__(monkeypatch, settings, more, (self.visits, f"{folder}/"))

    def visit(self, address: str = LOOPBACK) -> Pipe:
        pipe = Pipe()
        self.visits.waiting.append((pipe, address))
        return pipe

    def next(self, head: bytes, body: bytes) -> str:
        """Return the path of the next piece: from the head, or from the first page."""
        at = body.find(b"/0?")
        found = head.partition(b"Next: ")[2].partition(b"\r\n")[0] or body[at : at + 7]
        return found.decode()

    def answer(self, pipe: Pipe, ms: float = 30_000) -> "Iterator[Any]":
        """Return head and body of the next answer."""
        yield from self.until(lambda: b"\r\n\r\n" in pipe.got, ms)
        head, _, _ = bytes(pipe.got).partition(b"\r\n\r\n")
        size = int(head.partition(b"Content-Length: ")[2].split(b"\r\n")[0] or b"0")
        start = len(head) + 4
        yield from self.until(lambda: len(pipe.got) >= start + size)
        body = bytes(pipe.got[start : start + size])
        del pipe.got[: start + size]
        return head, body

    def get(self, data: bytes, address: str = LOOPBACK) -> "Iterator[Any]":
        """Connect and send one request."""
        pipe = self.visit(address)
        pipe.send(data)
        head, body = yield from self.answer(pipe)
        return pipe, head, body

    def open(self, address: str = LOOPBACK, **fields: str) -> "Iterator[Any]":
        """Open a page's websocket; return its frames after the welcome and the first state
        message."""
        pipe, head, _ = yield from self.get(request("/ws", **{**WS_UPGRADE, **fields}), address)
        assert head.startswith(b"HTTP/1.1 101 ") and _ACCEPTED in head, head
        frames = Frames(pipe)
        yield from self.until(lambda: "Grbl 1.1h" in frames.said() and bool(frames.news()))
        return frames

    def say(self, page: Frames, line: str, ms: float = 30_000) -> "Iterator[Any]":
        """Send a line from a page; return its answer."""
        before = len(page.said())
        page.pipe.send(frame(line + "\n"))

        def is_answered() -> bool:
            new = page.said()[before:]
            return "ok\r\n" in new or "error:" in new or page.pipe.is_closed

        yield from self.until(is_answered, ms)
        yield self.rig.ms(20)
        return page.said()[before:]
