"""The law of the network and of the served page: motion does not depend on them.

All segments are the same, to the tick, whatever clients without the key do, and whatever clients
with the key do that are not in control, except stops. Lines that a controlling client sent before
its connection was lost are executed as if it were still there.

The simulated machine counts time in ticks of its step timer; rig.ms(n) is the time n ms from now,
and a script yields the time at which it is resumed. bench.rows: (start, segment) of each segment
executed; the first number of a segment is its length in ticks. bench.call() connects a client by
TCP, bench.visit() one by HTTP; both from this computer, which needs no key, unless an address is
given."""

import os
import random
import socket
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from net_bench import NetBench, Pipe
from page_bench import CLOSE, PING, TEXT, WS_UPGRADE, PageBench, frame, request
from ugrbl.run.tcp_link import HostCalls

# Many cases of each: the first ring runs a sample. Machines are compared to the tick.
pytestmark = [pytest.mark.sampled(2), pytest.mark.usefixtures("each_ms")]

FAST = {
    110: 3000,
    111: 3000,
    112: 3000,
    120: 200,
    121: 200,
    122: 200,
    21: 1,
}
PROGRAM = [
    "G21G91F2400",
    *(f"G1X{0.3 * (i % 5):.2f}Y{0.2 * (i % 3):.2f}" for i in range(60)),
    "G2X2I1",
    "M3S500",
    "G1X5Y3F900",
    "G4P0.05",
    *(f"G1X-{0.2 * (i % 4):.2f}Z0.1" for i in range(40)),
    "M5",
]
_WINDOW = 120  # bytes sent and not yet answered, at the most
_LATE_TICKS = 13_107  # one millisecond, a turn of the simulated loop
_RUBBISH = (
    b"\xff\xfb\x18\xff\xfd\x03",
    b"G1X9F9000\n",
    b"$J=G91X9F900\n!~\x18\x84\x85\x90\xa1",
    b"$X\n$H\n$RST=*\n",
    b"$NET/KEY=AAAAAAAA\n",
    b"GET / HTTP/1.1\r\nHost: ugrbl\r\n\r\n",
    b"?" * 300,
    b"(" * 4000,
    bytes(range(256)) * 8,
    b"$$\n$G\n?",
)
# Sent on connections to the page or to a websocket.
_OF_BROWSERS = (
    *(request(f"/{path}") for path in ("", "0", "17", "9999", "../board.py")),
    *(request("/ws", **WS_UPGRADE, Host=host) for host in ("ugrbl.local", "evil.example")),
    request("/0")[:60],
    request("/", Cookie="x" * 5000),
    *(frame(text) for text in ("G1X9F9000\n", "!\x18~\x84\x85", "$X\n$H\n$RST=*\n", "?" * 300)),
    frame("$$\n" * 9, last=False),
    frame("x" * 125, PING) * 9,
    frame(b"\x03\xe8", CLOSE),
    frame("{}", TEXT),
    b"\x82\x05G1X9\n",
    b"\x82\xff" + b"\xff" * 12,
    random.Random(1).randbytes(300),
)
_STOPS = b"!\x18\x84\x85"  # take effect if a client with the key sends them
_STRANGERS = range(2, 9)  # last numbers of addresses


class Storm:
    """Perform random acts of clients and page visitors without the key, at real sockets and in
    memory, and of one client with the key that stops nothing.

    ports: TCP, HTTP. open: connections, real sockets or Pipes (in memory). Pipe.room: bytes that
    it accepts from the machine before it is full. bench.door (TCP) and bench.visits (HTTP) accept
    a socket only if no Pipe waits there."""

    def __init__(self, bench: NetBench, ports: "tuple[int, int]", seed: int) -> None:
        self.random = random.Random(seed)
        self.bench = bench
        self.ports = ports
        self.open: list[Any] = []
        self.visitors: list[Pipe] = []
        self.watcher: Pipe | None = None  # has the key
        self.acts = 0

    def act(self) -> None:
        """Perform one random act; some are more frequent."""
        self.acts += 1
        often = (self.connect, self.say, self.go, self.call, self.visit)
        self.random.choice((*often, self.connect, self.say, self.watch))()

    def connect(self) -> None:
        """Connect a socket and never read: half-open, as far as the machine knows."""
        connection = socket.socket()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
        connection.setblocking(False)
        connection.bind((f"127.0.0.{self.random.choice(_STRANGERS)}", 0))
        # Mostly TCP, so that HTTP is reached in time although many wait there.
        tcp, http = self.ports
        connection.connect_ex(("127.0.0.1", self.random.choice((tcp, tcp, tcp, http))))
        self.add(connection)

    def add(self, connection: Any) -> None:
        """Keep at most 12 connections open."""
        self.open.append(connection)
        if len(self.open) > 12:
            self.go()

    def call(self) -> None:
        """Connect a client in memory that reads nothing, a little, or all."""
        if self.bench.door.waiting:  # one is enough, or no socket would be accepted
            self.go()
            return
        pipe = self.bench.call(f"10.0.0.{self.random.choice(_STRANGERS)}")
        pipe.room = self.random.choice((0, 50, 5000))  # bytes; it never reads more
        self.add(pipe)

    def watch(self) -> None:
        """Connect one client with the key; its place is never taken by another."""
        if self.watcher not in self.open and not self.bench.door.waiting:
            self.watcher = self.bench.call()
            self.watcher.room = self.random.choice((50, 5000, 50_000))  # bytes
            self.add(self.watcher)

    def visit(self) -> None:
        """Load the page again, or open its websocket again."""
        if self.bench.visits.waiting:  # as in call()
            self.go()
            return
        pipe = self.bench.visit(self.random.choice(("10.0.0.9", "10.0.0.1")))
        pipe.send(self.random.choice((request("/"), request("/ws", **WS_UPGRADE))))
        pipe.room = self.random.choice((50, 50, 5000, 50_000))
        self.visitors.append(pipe)
        self.add(pipe)

    def say(self) -> None:
        """Send rubbish or a browser's data on any connection; the one with the key sends no
        stop."""
        if not self.open:
            return
        connection = self.random.choice(self.open)
        text = self.random.choice((*_RUBBISH, *_OF_BROWSERS))
        if connection is self.watcher:
            text = text.translate(None, _STOPS)  # without these bytes
        try:
            connection.send(text)
        except OSError:
            self.open.remove(connection)

    def go(self) -> None:
        """Close a random connection: a reset, an orderly end, or neither (its client is just
        lost)."""
        if not self.open:
            return
        connection = self.open.pop(self.random.randrange(len(self.open)))
        if isinstance(connection, Pipe):
            # Memory of visitors that end in other ways stays reserved for ten seconds.
            broken_or_hung_up = (
                ((1, 0),) if connection in self.visitors else ((1, 0), (0, 1), (0, 0))
            )
            connection.is_broken, connection.has_hung_up = self.random.choice(broken_or_hung_up)
            return
        if self.random.random() < 0.5:  # a reset, not a normal end
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        connection.close()

    def end(self) -> None:
        for caller in self.open:
            if not isinstance(caller, Pipe):
                caller.close()


class Reloads:
    """Load a page again and again, each time to its end and to its websocket."""

    def __init__(self, bench: PageBench) -> None:
        self.bench = bench
        self.loads = 0
        self._begin()

    def _begin(self) -> None:
        self._pipe, self._next = self.bench.visit(), ""
        self._pipe.send(request("/"))

    def act(self) -> None:
        """Continue as far as answers have arrived: request the next piece, open the websocket
        after the last one, and begin again after its welcome."""
        head, _, body = bytes(self._pipe.got).partition(b"\r\n\r\n")
        if head.startswith(b"HTTP/1.1 101 "):  # the websocket is open
            self._pipe.has_hung_up = self._pipe.got.count(b"Grbl") > 0
            if self._pipe.is_closed:
                self.loads += 1
                self._begin()
        elif head and len(body) == int(head.partition(b"Length: ")[2].split(b"\r")[0]):
            self._next = self.bench.next(head, body)
            if b"close" in head:  # the last piece
                self._pipe = self.bench.visit()
                self._pipe.send(request("/ws", **WS_UPGRADE))
                return
            self._pipe.got.clear()
            self._pipe.send(request(self._next))


def stream(
    bench: NetBench,
    put: Any,
    answers: Any,
    events: "dict[int, str]",
    program: "list[str]" = PROGRAM,
) -> Iterator[Any]:
    """Stream the program with character counting, and end when it is done.

    put: sends a text; answers: returns the number of ok and error answers so far. events: what
    happens at that time, in ms from the start: the bytes to send, or "limit" for a closing limit
    switch. A reset (\\x18) or the limit switch ends the stream."""
    lines_left, lengths_sent = list(program), []
    begun, answered = bench.rig.now, 0
    due = [(bench.rig.ms(ms), event) for ms, event in sorted(events.items())]
    while lines_left or lengths_sent or due:
        while due and due[0][0] <= bench.rig.now:
            event = due.pop(0)[1]
            if event == "limit":
                bench.rig.port.push({"limit_x": True})
                return
            put(event)
            if event == "\x18":
                return
        total = answers()
        # those answered since the last turn are removed
        lengths_sent = lengths_sent[total - answered :]
        answered = total
        # 1: the line end
        while lines_left and sum(lengths_sent) + len(lines_left[0]) + 1 <= _WINDOW:
            line = lines_left.pop(0) + "\n"
            put(line)
            lengths_sent.append(len(line))
        assert bench.rig.now < begun + 60_000 * bench.rig.ticks_per_ms, "the program does not end"
        yield min(bench.rig.ms(1), due[0][0]) if due else bench.rig.ms(1)


def record(
    monkeypatch: pytest.MonkeyPatch,
    events: "dict[int, str]",
    *,
    by: str,
    seed: "int | None",
    each_ms: int = 2,
    reloads: bool = False,
) -> "tuple[Any, ...]":
    """Return all segments of the program, with their start in ticks, and the final state and motor
    positions.

    by: connection of the controlling client, "cable", "network" or "page". seed: of the storm,
    None without a storm. each_ms: time between two acts of the storm. reloads: load the page all
    the time."""
    tcp_sockets, http_sockets, folder = HostCalls(), HostCalls(), TemporaryDirectory()
    bench = PageBench(monkeypatch, Path(folder.name), FAST, tcp_sockets, http_sockets)
    storm = Storm(bench, (tcp_sockets.port, http_sockets.port), seed or 0)

    def script(bench: NetBench) -> Iterator[Any]:
        """Connect the controlling client (by), stream the program during the storm, and record
        the segments (rows) and the final state."""
        bench.rig.port.push({"limit_x": False})
        if by == "network":
            driver = bench.call()
            yield from bench.until(lambda: b"Grbl" in driver.got)
            yield from bench.ask(driver, "G21\n")
            # its bytes wake the simulated machine, as the cable's do
            bench.rig.link.driver = driver
            got = driver.got
            put, answers = driver.send, lambda: got.count(b"ok\r\n") + got.count(b"error:")
        elif by == "page":
            page = yield from bench.open()
            yield from bench.say(page, "G21")
            bench.rig.link.driver = page.pipe
            before = page.said().count("ok\r\n")

            def answers() -> int:
                said = page.said()
                return said.count("ok\r\n") + said.count("error:") - before

            def put(text: str) -> None:
                page.pipe.send(frame(text))
        else:
            heard: list[str] = []

            def answers() -> int:
                heard.extend(bench.sender.take())
                return heard.count("ok")

            def put(text: str) -> None:
                bench.rig.link.cable.send(text.encode("latin-1"))

        yield bench.rig.ms(100)  # all answers so far have arrived
        bench.rows.clear()
        begun = bench.rig.now
        running = stream(bench, put, answers, events)
        pages = [Reloads(bench)] if reloads else []
        for wake in running:
            for reload in pages:
                reload.act()
            if seed is not None and int(bench.rig.now / bench.rig.ticks_per_ms) % each_ms == 0:
                storm.act()
            yield wake
        assert not pages or pages[0].loads > 1  # at least two loads, or nothing was tested
        for ms in range(3000):  # the rest of the motion, without lines
            if seed is not None and ms % each_ms == 0:
                storm.act()
            if ms % 500 == 0:
                put("?")  # as senders do: a silent client loses control
            yield bench.rig.ms(1)
        rows.extend((start - begun, row) for start, row in bench.rows)
        state.append((bench.rig.controller.state.run, bench.steps()))

    rows: list[Any] = []
    state: list[Any] = []
    bench.run(script)
    storm.end()
    bench.page.close()
    folder.cleanup()
    if seed is not None:
        assert storm.acts > 500
        # Only a few: pieces that they have not read take the page's memory for ten seconds.
        assert len([1 for pipe in storm.visitors if pipe.got]) > 1
    return rows, state


def ended(recorded: "tuple[Any, ...]") -> int:
    """Return the end in ticks of the last segment that record() returned."""
    start, row = recorded[0][-1]
    return int(start + row[0])


def stretches(recorded: "tuple[Any, ...]") -> "tuple[Any, ...]":
    """Replace the start of each segment by whether it follows the one before without a pause.

    The length of a pause, as for M3, varies: after it, network data is read a turn of the main
    loop earlier or later."""
    rows, end = [], 0
    for start, row in recorded[0]:
        rows.append((start == end, row))
        end = start + row[0]
    return rows, recorded[1]


QUIET: "dict[Any, Any]" = {}


def quiet(monkeypatch: pytest.MonkeyPatch, events: "dict[int, str]", by: str) -> Any:
    """Return what is recorded without a storm; the same call is recorded once."""
    key = (*events.items(), by)
    if key not in QUIET:
        QUIET[key] = record(monkeypatch, events, by=by, seed=None)
    return QUIET[key]


EVENTS = [
    {},
    {150: "!", 700: "~", 800: "\x91", 900: "\x99"},
    {333: "!", 1100: "~", 1500: "\x85"},
    {410: "\x18"},
    {275: "limit"},
]


@pytest.mark.sampled(1, 8)
@pytest.mark.parametrize("events", EVENTS, ids=["through", "held", "late", "reset", "limit"])
@pytest.mark.parametrize("by", ["cable", "network", "page"])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_storm_of_clients_changes_no_segment(
    monkeypatch: pytest.MonkeyPatch, events: "dict[int, str]", by: str, seed: int
) -> None:
    """In a storm of clients the controlling client's program has the same segments as without.

    seed: of the storm, and ms between two of its acts."""
    expected = quiet(monkeypatch, events, by)
    assert len(expected[0]) > 20
    in_storm = record(monkeypatch, events, by=by, seed=seed, each_ms=seed)
    if "\x18" not in events.values():
        if by == "cable":  # each motion from rest begins in the same turn of the main loop
            starts = zip(in_storm[0], expected[0], strict=True)
            assert max(abs(one - other) for (one, _), (other, _) in starts) < _LATE_TICKS
        assert stretches(in_storm) == stretches(expected)
        assert abs(ended(in_storm) - ended(expected)) < 5 * _LATE_TICKS
        return
    # The reset comes after lines on the wire; when those were sent depends on the sender. So the
    # last two segments, which the reset cuts short, may differ.
    cut = min(len(in_storm[0]), len(expected[0])) - 2
    assert cut > 100 and in_storm[0][:cut] == expected[0][:cut]
    assert abs(ended(in_storm) - ended(expected)) < _LATE_TICKS


@pytest.mark.parametrize("by", ["cable", "network", "page"])
@pytest.mark.parametrize("events", EVENTS[:2], ids=["through", "held"])
def test_loading_pages_changes_no_segment(
    monkeypatch: pytest.MonkeyPatch, by: str, events: "dict[int, str]"
) -> None:
    while_loading = record(monkeypatch, events, by=by, seed=None, reloads=True)
    assert stretches(while_loading) == stretches(quiet(monkeypatch, events, by))


@pytest.mark.sampled(2, 12)
@pytest.mark.parametrize("lost_ms", [*range(0, 260, 13), 400, 700, 1100])
@pytest.mark.parametrize("how", ["silent", "reset", "end"])
def test_all_complete_lines_of_a_lost_client_are_executed(
    monkeypatch: pytest.MonkeyPatch, lost_ms: int, how: str
) -> None:
    """The client is lost lost_ms after it began. The result is as if it had sent exactly the lines
    up to then.

    how: it is lost silently, by a reset, or by an orderly end."""

    def run(lost: bool) -> "tuple[Any, ...]":
        """Return segments and motor steps. lost: else the client stays and sends no more."""
        bench = NetBench(monkeypatch, FAST)

        def script(bench: NetBench) -> Iterator[Any]:
            """Stream for lost_ms, lose the client if `lost`, and wait until all motion has
            ended."""
            driver = bench.call()
            yield from bench.until(lambda: b"Grbl" in driver.got)
            yield bench.rig.ms(100)
            bench.rows.clear()
            begun = bench.rig.now
            got = driver.got
            for wake in stream(bench, driver.send, lambda: got.count(b"ok\r\n"), events={}):
                if bench.rig.now >= begun + lost_ms * bench.rig.ticks_per_ms:
                    break  # a line is sent whole
                yield wake
            yield bench.rig.ms(12)  # the bytes sent have arrived
            if lost:
                driver.send("G1X9F9")  # half a line
                yield bench.rig.ms(12)
                driver.is_broken, driver.has_hung_up = how == "reset", how == "end"
            else:
                yield bench.rig.ms(12)
            yield bench.rig.ms(20_000)  # all motion has ended
            out.append(([(at - begun, row) for at, row in bench.rows], bench.steps()))

        out: list[Any] = []
        bench.run(script)
        return out[0]

    assert run(True) == run(False)


# The program from zero and back to it, so that each round has the same segments; the dwell is
# answered after all motion.
_ROUND = [*PROGRAM, "G90G1X0Y0Z0F3000", "G4P0.01"]
_ACT_MS = 50  # between two acts of the storm


@pytest.mark.thorough
@pytest.mark.timeout(0 if os.environ.get("UGRBL_SOAK_HOURS") else 600)
def test_a_soak_of_clients_changes_no_segment(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounds of one program for UGRBL_SOAK_HOURS of the machine's time, or for a minute."""
    limit_ms = float(os.environ.get("UGRBL_SOAK_HOURS", "0")) * 3_600_000 or 60_000
    tcp_sockets, http_sockets, folder = HostCalls(), HostCalls(), TemporaryDirectory()
    bench = PageBench(monkeypatch, Path(folder.name), FAST, tcp_sockets, http_sockets)
    storm = Storm(bench, (tcp_sockets.port, http_sockets.port), 1)
    rounds = 0

    def script(bench: NetBench) -> Iterator[Any]:
        """Stream the program at the cable round after round. The second round is the model for
        those with a storm of clients."""
        nonlocal rounds
        heard: list[str] = []

        def answers() -> int:
            heard.extend(line for line in bench.sender.take() if line == "ok")
            return len(heard)

        def put(text: str) -> None:
            bench.rig.link.cable.send(text.encode("latin-1"))

        bench.rig.port.push({"limit_x": False})
        quiet_round: Any = None
        while bench.rig.now < bench.rig.ticks_per_ms * limit_ms or rounds < 3:
            bench.rows.clear()
            heard.clear()
            for wake in stream(bench, put, answers, {}, _ROUND):
                # the first two rounds are without clients
                if rounds > 1 and int(bench.rig.now / bench.rig.ticks_per_ms) % _ACT_MS == 0:
                    storm.act()
                yield wake
            this_round = stretches((bench.rows, bench.steps()))
            if rounds == 1:  # a row keeps old ticks of motors without steps; the first have none
                quiet_round = this_round
            assert rounds < 2 or this_round == quiet_round, f"round {rounds}"
            rounds += 1

    bench.run(script)
    hours = bench.rig.now / bench.rig.ticks_per_ms / 3_600_000
    storm.end()
    bench.page.close()
    folder.cleanup()
    assert storm.acts > 500
    print(f"{hours:.2f} hours, {rounds} rounds, {storm.acts} acts of clients: the same segments")
