"""The page served by the board: HTTP and websockets, with valid and with invalid requests.

The page is sent compressed, in pieces of PIECE bytes: "/" is a short first page, "/0" the first
piece. Each answer's head names the next piece by a path with a random number ("/1?3f2a"), which
only a reader can know; one is proof of reading. bench.visit() connects a browser, bench.get() also
sends a request, bench.open() opens a page's websocket, bench.say() sends a line on it. A page
receives the machine's answers, page.said(), and JSON about the connection, page.news(). Clients
are on this computer, which needs no key, unless an address is given. Times are ms of simulated
time; bench.steps(): motor steps, 250 per mm."""

import gzip
from pathlib import Path

import pytest
from net_bench import HOST, KEY
from page_bench import BINARY, CLOSE, MASK, PING, PONG, TEXT, WS_UPGRADE, PageBench, frame, request
from ports.net.page import PIECE
from ugrbl.boardfile import page_files

WHOLE = page_files.page(from_board=True).encode()


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> PageBench:
    return PageBench(monkeypatch, tmp_path)


# HTTP


def test_the_first_page_fits_into_one_piece() -> None:
    assert len(page_files.made()["page.html"]) <= PIECE


def test_a_request_for_the_next_piece_proves_that_the_last_was_read(bench) -> None:
    def script(bench):
        """Load the page: all pieces arrive without a wait, each after the request for it."""
        pipe, head, first = yield from bench.get(request("/"))
        assert head.startswith(b"HTTP/1.1 200 OK\r\n") and b"frame-ancestors 'none'" in head
        assert b"connect-src 'self' ws://ugrbl.local;" in head and b"page" in first
        compressed, path = b"", bench.next(head, first)
        while True:
            pipe.send(request(path))
            head, body = yield from bench.answer(pipe)
            path = bench.next(head, b"")
            if not body:
                break
            assert len(head) + len(body) + 4 <= 800, "fits a TCP segment"
            compressed += body
        assert gzip.decompress(compressed) == WHOLE
        assert b"Connection: close" in head and pipe.is_closed

    bench.run(script)


@pytest.mark.parametrize(
    ("status", "data"),
    [
        (404, request("/favicon.ico")),
        (404, request("/page.gz")),
        (404, request("/00001")),
        (404, request("/-1")),
        (404, request("/../board.py")),
        (404, request("//")),
        (403, request("/", Host="evil.example")),
        (403, request("/", Host="10.0.0.1.evil.example")),
        (403, request("/", Host="ugrbl.local.evil.example")),
        (403, request("/", Host="")),
        (403, request("/", Host="1" * 300)),
        (403, request("/", Host="ugrbl.local:" + "8" * 400)),
        (403, request("/", Origin="http://evil.example")),
        (403, request("/", Origin="null")),
        (403, request("/", Origin="https://ugrbl.local")),
        (405, request("/", "POST", Content_Length="9")),
        (405, request("/", "DELETE")),
        (405, request("/", Content_Length="5")),
        (405, request("/", Transfer_Encoding="chunked")),
        (400, request("/0", Cookie="more") + request("/1")),
        (400, request("/", Host="ugrbl\r\nHost: ugrbl")),
        (400, b"G1X9F900\n$X\n\n"),
        (400, b"GET / HTTP/1.0\r\nHost: ugrbl\r\n\r\n"),
        (400, b"GET  /  HTTP/1.1\r\nHost: ugrbl\r\n\r\n"),
        (400, b"\x16\x03\x01\x02\x00\x01\x00\n\n"),
        (400, b"x" * 5000),
        (400, request("/", Cookie="y" * 5000)),
        (400, request("/ws")),
        (400, request("/ws", **{**WS_UPGRADE, "Sec-WebSocket-Key": "short"})),
        (400, request("/ws", **{**WS_UPGRADE, "Upgrade": "h2c"})),
        (403, request("/ws", **{**WS_UPGRADE, "Origin": "http://evil.example"})),
        (403, request("/ws", **{**WS_UPGRADE, "Host": "evil.example"})),
        (426, request("/ws", **{**WS_UPGRADE, "Sec-WebSocket-Version": "8"})),
    ],
)
def test_an_invalid_request_is_refused_with_a_sentence(bench, status: int, data: bytes) -> None:
    def script(bench):
        """An invalid request (data) is answered with its status and an explanation, and closed."""
        pipe, head, body = yield from bench.get(data)
        assert head.startswith(f"HTTP/1.1 {status} ".encode()), head
        assert len(body) > 10 and body.endswith(b"\n")
        yield from bench.until(lambda: pipe.is_closed)
        assert bench.rig.link.client_count() == 0  # none of them takes a place of a client

    bench.run(script)
    assert bench.rows == []


@pytest.mark.parametrize("host", ["ugrbl", "UGRBL.local:80", "192.168.1.7", "10.0.0.1:8080"])
def test_host_names_of_the_board_and_addresses_are_accepted(bench, host: str) -> None:
    def script(bench):
        _, head, _ = yield from bench.get(request("/", Host=host))
        assert head.startswith(b"HTTP/1.1 200 ")
        yield from bench.open(Host=host, Origin=f"http://{host}")

    bench.run(script)


def test_a_missing_page_is_reported(bench, tmp_path: Path) -> None:
    """The message says how to store the page on the board."""
    (tmp_path / "page.gz").unlink()

    def script(bench):
        _, head, body = yield from bench.get(request("/0"))
        assert head.startswith(b"HTTP/1.1 404 ") and b"ugrbl deploy" in body

    bench.run(script)


def test_a_slow_request_is_served_and_an_endless_one_is_dropped(
    bench,
) -> None:
    def script(bench):
        """Two requests arrive in small parts; one of them never ends and is dropped after 2 s."""
        slow, endless = bench.visit(), bench.visit()
        complete_request = request("/3")
        for start in range(0, len(complete_request), 4):
            slow.send(complete_request[start : start + 4])
            endless.send("x: y\r\n")
            yield from bench.wait(10)
        _, body = yield from bench.answer(slow)
        assert len(body) == PIECE
        for _ in range(30):
            if not endless.is_closed:
                endless.send("x: y\r\n")
            yield from bench.wait(50)
        assert endless.is_closed
        yield from bench.until(lambda: slow.is_closed, 5000)

    bench.run(script)


def test_visitors_without_proof_of_reading_get_three_pieces_in_ten_seconds(bench) -> None:
    def script(bench):
        """40 visitors request more without reading, say nothing, hang up, or guess the random
        number: in 10 s they get three pieces, 2400 bytes with their heads."""
        visitors = []
        for number in range(40):
            visitors.append(bench.visit())
            for path in ("/", "/0", "/1", "/2?0000", "/favicon.ico"):
                visitors[-1].send(request(path))
                yield from bench.wait(30)
            visitors[-1].has_hung_up = number % 2 == 1
            yield from bench.wait(50)
        assert sum(len(pipe.got) for pipe in visitors) <= 2400

    bench.run(script)


def test_a_visitor_with_proof_of_reading_is_served_whatever_others_do(bench) -> None:
    def script(bench):
        """Another visitor has used all memory that visitors without proof of reading may use."""
        pipe, head, _ = yield from bench.get(request("/0"))
        unproved = bench.visit()
        for path in ("/", "/0", "/1", "/2"):
            unproved.send(request(path))
            yield from bench.wait(30)
        for _ in range(20):
            pipe.send(request(bench.next(head, b"")))
            head, body = yield from bench.answer(pipe, 100)
            assert len(body) == PIECE

    bench.run(script)


def test_memory_of_a_reset_connection_is_free_at_once(bench) -> None:
    def script(bench):
        """Ten pieces are sent within less than 10 s; without the resets only three would be."""
        for _ in range(10):
            pipe = bench.visit()
            pipe.send(request("/0"))
            yield from bench.until(lambda pipe=pipe: b" 200 " in pipe.got, 100)
            pipe.is_broken = True
        yield from bench.get(request("/0"))

    bench.run(script)


# The websocket


def test_a_page_controls_like_a_sender_over_tcp(bench) -> None:
    def script(bench):
        """A page sends lines. "driver": it controls; "drivers", "watchers": how many clients
        do, and only read."""
        page = yield from bench.open()
        assert page.news() == (
            '{"link":{"name":"ugrbl","open":true},"driver":false,"drivers":0,"watchers":1,'
            '"key":false}'
        )
        assert (yield from bench.say(page, "G1X2F600")) == "ok\r\n"
        assert '"driver":true,"drivers":1,"watchers":0' in page.news()
        yield from bench.wait(3000)
        page.pipe.send(frame("?"))
        yield from bench.until(lambda: "MPos:2.000,0.000" in page.said())
        answer = yield from bench.say(page, "$$")
        assert answer.count("$") >= 34 and answer.endswith("ok\r\n")

    bench.run(script)
    assert bench.steps() == [500, 0, 0]  # X2


def test_one_of_two_pages_controls_and_both_are_notified(bench) -> None:
    def script(bench):
        """The second page is refused, and takes control once the first has sent no command for
        5 s."""
        first, second = (yield from bench.open()), (yield from bench.open())
        assert (yield from bench.say(first, "G1X1F600")) == "ok\r\n"
        yield from bench.wait(50)
        assert '"driver":false,"drivers":1,"watchers":1' in second.news()
        assert (yield from bench.say(second, "G1X2")).endswith("error:9\r\n")
        for _ in range(6):
            first.pipe.send(frame("?"))  # not a command
            yield from bench.wait(1000)
        assert (yield from bench.say(second, "$NET")).endswith("ok\r\n")
        assert (yield from bench.say(second, "G4P0.01")).endswith("ok\r\n")
        yield from bench.wait(50)
        assert '"driver":true' in second.news() and '"driver":false' in first.news()
        first.pipe.send(frame("", CLOSE))
        yield from bench.until(lambda: first.pipe.is_closed)
        yield from bench.wait(50)
        assert '"driver":true,"drivers":1,"watchers":0' in second.news()

    bench.run(script)


def test_a_page_without_the_key_may_only_read(bench) -> None:
    def script(bench):
        """A page from another computer ("key":true: it must ask for the key) reads, is refused,
        sends a wrong key, then the right one."""
        page = yield from bench.open("10.0.0.1")
        assert '"key":true' in page.news()
        assert (yield from bench.say(page, "$$")).endswith("ok\r\n")
        assert (yield from bench.say(page, "G1X1F600")).endswith("error:9\r\n")
        page.pipe.send(frame("!\x18~\x84\x90"))  # hold, reset, start, door, override: ignored
        assert (yield from bench.say(page, "$NET/KEY=22222222")).endswith("error:9\r\n")
        assert (yield from bench.say(page, f"$NET/KEY={KEY}")) == "ok\r\n"
        yield from bench.wait(50)
        assert '"key":false' in page.news()
        assert (yield from bench.say(page, "G1X1F600")) == "ok\r\n"
        yield from bench.wait(1000)
        assert KEY not in "".join(map(repr, page.messages))  # the machine never sends it

    bench.run(script)
    assert bench.steps() == [250, 0, 0]


def test_a_message_may_come_in_any_parts(bench) -> None:
    def script(bench):
        """One message in four frames (opcode 0 continues it), with a ping and a pong between them,
        arrives byte by byte: "G9" "1" "" "G1X1F600". The second, "X2", is relative as well."""
        page = yield from bench.open()
        parts = frame("G9", last=False) + frame("hello", PING) + frame("1", opcode=0, last=False)
        parts += frame("", opcode=0, last=False) + frame("G1X1F600\n", opcode=0)
        parts += frame("x" * 40, PONG)
        for byte in parts + frame("X2\n"):
            page.pipe.send(bytes((byte,)))
            yield from bench.wait(2)
        yield from bench.until(lambda: page.said().count("ok\r\n") == 2)
        page.pipe.send(frame("\n" * 300) + frame("?"))
        yield from bench.until(lambda: page.said().count("ok\r\n") == 302)
        yield from bench.wait(1000)
        assert page.all(PONG) == [b"hello"]

    bench.run(script)
    assert bench.steps() == [750, 0, 0]  # X1 and X2, relative


def test_a_pong_before_the_answer_to_a_ping_does_not_change_it(bench) -> None:
    def script(bench):
        """Both frames arrive at once."""
        page = yield from bench.open()
        page.pipe.send(frame("hello", PING) + frame("other", PONG))
        yield from bench.wait(1000)
        assert page.all(PONG) == [b"hello"]

    bench.run(script)


@pytest.mark.parametrize(
    ("code", "data"),
    [
        (1002, b"\x82\x05G1X9\n"),  # not masked
        (1002, frame("G1X9\n", BINARY | 0x40)),  # a reserved bit is set
        (1002, frame("G1X9\n", 3)),  # reserved opcodes: 3 and 11
        (1002, frame("G1X9\n", 11)),
        (1002, frame("G1X9\n", 0)),  # continuation without a beginning
        (1002, frame("G", last=False) + frame("1X9\n")),  # a message within another
        (1002, frame("x", PING, last=False)),  # a ping in several frames
        (1002, frame("x" * 126, PING)),  # a ping of more than 125 bytes
        # 5 bytes, in the long form of a length
        (1002, bytes((0x82, 0xFE, 0, 5)) + MASK + b"G1X9\n"),
        (1009, bytes((0x82, 0xFF)) + bytes(8) + MASK),  # a length of 64 bits
        (1003, frame('{"drive":true}', TEXT)),  # text; a page sends binary messages only
        (1003, frame(b"\xc3\x28", TEXT)),  # no UTF-8
        (1000, frame(b"\x03\xe8", CLOSE)),  # an orderly end, with and without a code
        (1000, frame(b"", CLOSE)),
        (1002, b"GET / HTTP/1.1\r\nHost: ugrbl\r\n\r\n"),
    ],
)
def test_an_invalid_frame_closes_the_connection_and_moves_nothing(
    bench, code: int, data: bytes
) -> None:
    def script(bench):
        """An invalid frame (data) is answered by a close frame with this code (RFC 6455,
        7.4.1)."""
        page = yield from bench.open()
        page.pipe.send(data + frame("G1X9F900\n"))
        yield from bench.until(lambda: page.pipe.is_closed, 200)
        assert page.all(CLOSE) == [bytes((code >> 8, code & 0xFF))]
        assert bench.rig.link.client_count() == 0
        yield from bench.open()  # another client

    bench.run(script)
    assert bench.rows == []


def test_a_page_that_does_not_read_is_dropped_without_blocking_others(bench) -> None:
    def script(bench):
        """A page requests 40 long answers, but its connection takes 100 bytes only."""
        page = yield from bench.open()
        page.pipe.room = 100
        before = bench.rig.now
        for _ in range(40):
            page.pipe.send(frame("$$\n") + frame("x" * 99, PING))
            yield from bench.wait(10)
        yield from bench.until(lambda: page.pipe.is_closed, 5000)
        assert bench.rig.now - before < bench.rig.ticks_per_ms * 3000  # dropped within 3 s
        yield from bench.sender.wait("ok", "\n")

    bench.run(script)


@pytest.mark.thorough
def test_output_to_a_silent_page_stays_within_memory(
    bench,
) -> None:
    def script(bench):
        """The page stops answering the machine's pings, which would prove that it reads. It is
        dropped after at most 2000 bytes."""
        page = yield from bench.open()
        page.look()  # read what has arrived so far
        page.reads = False  # it answers no ping
        for _ in range(12):  # up to ten seconds: a handshake waits for memory of those before
            yield from bench.sender.wait("ok", "M30\n")  # its message goes to all
            other = yield from bench.open()  # it changes the state sent to all pages
            other.pipe.has_hung_up = True
            page.pipe.send(frame("?") + frame("x" * 99, PING) + frame("abcd", PONG))
            yield from bench.wait(20)
        assert page.pipe.is_closed and 800 < len(page.pipe.got) <= 2000

    bench.run(script)


@pytest.mark.thorough
def test_a_page_of_the_board_gives_the_same_motion_as_the_cable(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    bench = PageBench(monkeypatch, tmp_path, {110: 6000, 111: 6000, 120: 2000, 121: 2000})
    lines = [f"G1X{i % 7}Y{i % 3}F3000" for i in range(200)]

    def script(bench):
        """Stream a long program with character counting, in messages as the page sends them."""
        page = yield from bench.open()
        lines_left, lengths_sent, answered = list(lines), [], 0
        while lines_left or lengths_sent:
            total = page.said().count("ok\r\n")
            lengths_sent, answered = lengths_sent[total - answered :], total
            batch = ""
            while lines_left and sum(lengths_sent) + len(lines_left[0]) + 1 <= 127:
                lengths_sent.append(len(lines_left[0]) + 1)
                batch += lines_left.pop(0) + "\n"
            if batch:
                page.pipe.send(frame(batch))
            yield bench.rig.ms(1)
        yield from bench.wait(5000)
        assert "error" not in page.said()

    bench.run(script)
    assert bench.steps() == [250 * (199 % 7), 250 * (199 % 3), 0]  # the target of the last line


def test_the_prompt_closes_all_network_connections(bench) -> None:
    def script(bench):
        """close() is called before the MicroPython prompt takes over: it closes a browser that
        has sent nothing yet (visitor), and a page."""
        visitor = bench.visit()
        yield from bench.wait(50)
        page = yield from bench.open()
        bench.rig.link.cable.close = lambda: None  # the simulated cable has none
        bench.rig.link.close()
        assert page.pipe.is_closed and visitor.is_closed

    bench.run(script)


def test_the_page_uses_the_boards_default_host_name() -> None:
    assert HOST == "ugrbl"
