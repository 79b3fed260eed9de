"""The browser's side of `ugrbl web`, and boards for its other end."""

import asyncio
import functools
import json
import os
import queue
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import aiohttp
from ugrbl.web.access import Access
from ugrbl.web.board_link import Source
from ugrbl.web.server import Server

PATIENCE_S = 60.0
HTML = "<!doctype html><title>a page</title>"


def played(test: Callable[..., Awaitable[None]]) -> Callable[..., None]:
    """Run a test that is a coroutine."""

    @functools.wraps(test)
    def run(*arguments: Any, **named: Any) -> None:
        asyncio.run(asyncio.wait_for(test(*arguments, **named), 4 * PATIENCE_S))

    return run


class FakeBoard:
    """A board with scripted output that records its input."""

    name = "fake"

    def __init__(self) -> None:
        self.got = bytearray()
        self._said: queue.Queue[bytes] = queue.Queue()
        self._rest = b""
        self.stuck = False  # it accepts no bytes

    def open(self) -> "FakeBoard":
        return self

    def close(self) -> None:
        self._rest = b""

    def say(self, data: bytes) -> None:
        self._said.put(data)

    @property
    def in_waiting(self) -> int:
        return len(self._rest)

    def read(self, limit: int) -> bytes:
        if not self._rest:
            with suppress(queue.Empty):
                self._rest = self._said.get(timeout=0.02)
        data, self._rest = self._rest[:limit], self._rest[limit:]
        return data

    def write(self, data: bytes) -> None:
        while self.stuck:
            time.sleep(0.01)
        self.got += data

    async def wait_for(self, data: bytes) -> None:
        """Wait until the board has received this."""
        await until(lambda: data in self.got, f"{data!r} at the board")


async def until(done: Callable[[], Any], what: str, seconds: float = PATIENCE_S) -> None:
    """Wait until the condition holds."""
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, f"no {what}"
        await asyncio.sleep(0.01)


class Page:
    """One browser with everything it has received."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket = socket
        self.text = ""
        self.states: list[dict[str, Any]] = []
        self._reading = asyncio.create_task(self._read())

    async def _read(self) -> None:
        async for message in self.socket:
            if message.type is aiohttp.WSMsgType.BINARY:
                self.text += message.data.decode("latin-1")
            else:
                self.states.append(json.loads(message.data))

    async def send(self, data: bytes) -> None:
        await self.socket.send_bytes(data)

    async def drive(self, wanted: Any) -> None:
        await self.socket.send_str(json.dumps({"drive": wanted}))

    async def job(self, told: dict[str, Any], lines: str = "") -> None:
        await self.socket.send_str(json.dumps({"job": told, "lines": lines}))

    async def wait(self, what: str, seconds: float = PATIENCE_S) -> str:
        """Wait for a text; return everything up to its end."""
        await until(lambda: what in self.text, f"{what!r} in the page", seconds)
        before, _, self.text = self.text.partition(what)
        return before + what

    async def ask(self, line: str) -> str:
        self.text = ""
        await self.send(line.encode() + b"\n")
        await until(lambda: "ok\r\n" in self.text or "error:" in self.text, f"answer to {line}")
        return self.text

    async def report(self, state: str = "") -> str:
        """Return a status report; if a state is given, one of that state."""
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            await self.wait_quietly()
            await self.send(b"?")
            found = (await self.wait(">")).rpartition("<")[2]
            if found.startswith(state):
                return found
            await asyncio.sleep(0.05)
        raise AssertionError(f"never {state}")

    async def wait_quietly(self) -> None:
        """Let pending output arrive, and discard it."""
        await asyncio.sleep(0.02)
        self.text = ""

    async def told(self, **wanted: Any) -> None:
        """Wait until the last state message has these values."""

        def stands() -> bool:
            return bool(self.states) and {**self.states[-1], **wanted} == self.states[-1]

        await until(stands, f"{wanted} in {self.states[-1:]}")

    async def leave(self) -> None:
        await self.socket.close()

    def vanish(self) -> None:
        """Abort the connection, as in a crash."""
        self._transport().abort()

    def go_deaf(self) -> None:
        """Stop reading."""
        self._transport().pause_reading()

    def _transport(self) -> asyncio.Transport:
        connection = self.socket._response.connection
        assert connection and isinstance(connection.transport, asyncio.Transport)
        return connection.transport


class Site:
    """A running server."""

    def __init__(self, server: Server, access: Access, port: int, log: list[str]) -> None:
        self.server, self.access, self.port, self.log = server, access, port, log
        self.address = f"http://127.0.0.1:{port}"
        self.session = aiohttp.ClientSession()

    async def open(self, path: str = "/ws", **headers: str) -> Page:
        socket = await self.session.ws_connect(self.address + path, headers=headers)
        page = Page(socket)
        await until(lambda: page.states, "state of things")
        return page

    async def status(self, path: str, method: str = "GET", **headers: str) -> "tuple[int, str]":
        async with self.session.request(method, self.address + path, headers=headers) as got:
            return got.status, await got.text()

    async def job(self, program: Any = None) -> "tuple[int, Any]":
        """Share a program; without one, return the open program."""
        address = f"{self.address}/api/job"
        data = program if isinstance(program, bytes) else json.dumps(program).encode()
        asked = (
            self.session.get(address) if program is None else self.session.post(address, data=data)
        )
        async with asked as got:
            return got.status, await (got.json() if got.status == 200 else got.text())

    async def look(self, request: Any) -> "tuple[int, Any]":
        data = request if isinstance(request, bytes) else json.dumps(request).encode()
        async with self.session.post(f"{self.address}/api/look", data=data) as got:
            return got.status, await (got.json() if got.status == 200 else got.text())


@asynccontextmanager
async def served(
    source: Source, folder: Path, host: str = "127.0.0.1", longest_s: float = 60.0
) -> AsyncIterator[Site]:
    """Run a server for that board. Its simulators run as users have them, see as_users.py."""
    checked = os.environ.pop("UGRBL_VIPER", None)
    page = folder / "index.html"
    page.write_text(HTML)
    log: list[str] = []
    access = Access(host)
    server = Server(source, access, "sim", log.append, page.read_text, longest_s)
    try:
        site = Site(server, access, await server.start(host, 0), log)
        try:
            yield site
        finally:
            await site.session.close()
    finally:
        await server.stop()
        if checked is not None:
            os.environ["UGRBL_VIPER"] = checked
