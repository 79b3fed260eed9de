"""A simulated machine with a network: clients in memory, or at real sockets."""

from collections.abc import Callable, Iterator
from typing import Any

from ports.net.page import Page
from ugrbl.boardfile.files import load_board
from ugrbl.run import board_modules
from ugrbl.run.tcp_link import LOOPBACK, HostCalls
from ugrbl.sim.link import SimLink
from ugrbl.sim.network import RigLink, RigPageLink
from ugrbl.sim.replay import factory_store
from ugrbl.sim.rig import Rig
from ugrbl.sim.sender import Sender

board_modules.complete()

KEY = "23456789"
HOST = "ugrbl"
WELCOME = "\r\nGrbl 1.1h ['$' for help]\r\n"
Script = Callable[["NetBench"], Iterator[Any]]


class Pipe:
    """A connection in memory. room: bytes accepted from the machine before the client reads."""

    def __init__(self) -> None:
        self.unread = bytearray()  # by the machine
        self.got = bytearray()
        self.room = 1 << 20
        self.is_closed = False  # by the machine
        self.has_hung_up = False
        self.is_broken = False

    def readinto(self, buf: bytearray) -> "int | None":
        if self.is_broken:
            raise OSError(104)
        count = min(len(buf), len(self.unread))
        if not count:
            return 0 if self.has_hung_up else None
        buf[:count] = self.unread[:count]
        del self.unread[:count]
        return count

    def write(self, data: "bytes | bytearray | memoryview") -> "int | None":
        if self.is_broken:
            raise OSError(104)
        count = min(len(data), self.room)
        self.room -= count
        self.got += bytes(data[:count])
        return count or None

    def close(self) -> None:
        self.is_closed = True

    def send(self, text: "str | bytes") -> None:
        self.unread += text.encode("latin-1") if isinstance(text, str) else text

    def take(self) -> str:
        """Return the text received since the last call."""
        text = self.got.decode("latin-1")
        self.got.clear()
        return text


class Door:
    """Clients in memory. more: another source, polled when nobody waits here."""

    def __init__(self, more: "HostCalls | None" = None) -> None:
        self.waiting: list[tuple[Pipe, str]] = []
        self.more = more

    def next(self) -> Any:
        if self.waiting:
            return self.waiting.pop(0)
        return self.more.next() if self.more else None

    def close(self) -> None:
        self.waiting.clear()


class _Link(RigLink):
    """Make `driver`'s bytes an event like those of the cable, so that the machine does not
    sleep."""

    driver: "Pipe | None" = None
    trusts = (LOOPBACK,)

    def next_event(self) -> "int | None":
        if self.driver and self.driver.unread:
            return int(self._rig.now)
        at: "int | None" = self.cable.next_event()
        return at


class _PageLink(_Link, RigPageLink):
    """The same with the page."""


class NetBench:
    """A machine with a sender at the cable, and network clients.

    more: further clients, see Door. page: the visitors' door and the folder of the served page."""

    def __init__(
        self,
        monkeypatch: Any,
        settings: "dict[int, float] | None" = None,
        more: Any = None,
        page: "tuple[Any, str] | None" = None,
        board: Any = None,
    ) -> None:
        board = board or load_board("sim_page" if page else "sim_wifi")
        store = factory_store(board)
        store.files["settings"] += [f"${n}={value}" for n, value in (settings or {}).items()]
        store.files["network"] = [f"KEY={KEY}"]
        self.door = Door(more)
        self.store = store
        self.rig: Any = None
        monkeypatch.setattr("time.ticks_ms", self._now_ms)
        self.page = Page(self.door, page[0], HOST, page[1]) if page else None
        self.rig = Rig(board, store, self._link)
        self.rig.engine.trace = lambda start, row: self.rows.append((start, tuple(row)))
        self.rows: list[tuple[int, tuple[int, ...]]] = []
        self.sender = Sender(self.rig)
        self.sender.allow(36_000_000)

    def _link(self, rig: Any) -> _Link:
        if self.page:
            return _PageLink(rig, SimLink(rig), self.page, HOST)
        return _Link(rig, SimLink(rig), self.door)

    def _now_ms(self) -> int:
        return int(self.rig.now / self.rig.ticks_per_ms) & 0x3FFFFFFF if self.rig else 0

    def call(self, address: str = LOOPBACK) -> Pipe:
        """Connect a client; this computer needs no key."""
        pipe = Pipe()
        self.door.waiting.append((pipe, address))
        return pipe

    def run(self, script: Script) -> None:
        """Run the script; raise its exception here."""
        failed: list[BaseException] = []

        def guarded() -> Iterator[Any]:
            try:
                yield from self.sender.wait("banner", "")
                self.sender.take()
                yield from script(self)
            except BaseException as fault:
                failed.append(fault)

        self.rig.run(guarded())
        if failed:
            raise failed[0]

    def wait(self, ms: float) -> Iterator[Any]:
        yield self.rig.ms(ms)

    def until(self, condition: Callable[[], bool], ms: float = 60_000) -> Iterator[Any]:
        """Wait until the condition holds."""
        end = self.rig.ms(ms)
        while not condition():
            assert self.rig.now < end, "the condition never holds"
            yield self.rig.ms(1)

    def ask(self, pipe: Pipe, text: str, ms: float = 30_000) -> Iterator[Any]:
        """Send a line; return its answers."""
        pipe.take()
        pipe.send(text)
        yield from self.until(
            lambda: b"ok\r\n" in pipe.got or b"error:" in pipe.got or pipe.is_closed, ms
        )
        yield self.rig.ms(20)
        return pipe.take()

    def steps(self) -> list[int]:
        self.rig.engine.physical(self.rig.scratch)
        return list(self.rig.scratch)


def connected(bench: NetBench, pipe: Pipe, welcome: str = WELCOME) -> Iterator[Any]:
    """Wait for a client's welcome."""
    yield from bench.until(lambda: welcome.encode() in pipe.got)
    pipe.take()


def joined(bench: NetBench) -> Iterator[Any]:
    """Connect a client and wait for its welcome."""
    pipe = bench.call()
    yield from connected(bench, pipe)
    return pipe
