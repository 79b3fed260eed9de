"""Clients without the key: what they receive, what they cost, and that they displace nobody.

The machine has places for 3 clients, and 7200 bytes of output may wait in the network stack
(lwIP): a third of them, 2400, for all clients without the key together. A client without the key
keeps its place for 250 ms if another needs it; the one with the key for 10 minutes of silence.
bench.call(address) connects a client; without an address it is this computer, which needs no key.
Times of wait() and until() are ms of simulated time."""

import pytest
from net_bench import KEY, WELCOME, NetBench, Pipe, connected, joined
from ports.net.client import Client, Memory, slot_for


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> NetBench:
    return NetBench(monkeypatch)


def three(bench):
    """Connect as many clients with the key as there are places."""
    pipes = []
    for _ in range(3):
        pipes.append((yield from joined(bench)))
    return pipes


def test_wrong_keys_close_their_connection_and_lock_nobody_out(bench) -> None:
    """One address sends wrong keys 120 times; each time another address sends the right one."""
    allowed_tries = 3  # _TRIES in ports/net/client.py
    few_rounds_ms = 30  # the link polls its clients every 10 ms
    answer_ms = 100  # no wrong key may delay an answer for longer

    def script(bench):
        """Send wrong keys from one address, and each time the right one from another."""
        for number in range(40):  # many more than the 3 places
            wrong, right = bench.call("10.0.0.1"), bench.call(f"10.0.1.{number}")
            yield from bench.wait(few_rounds_ms)
            wrong.send("$NET/KEY=22222222\n" * allowed_tries)
            right.send(f"$NET/KEY={KEY}\n")
            yield from bench.until(lambda right=right: b"ok" in right.got, answer_ms)
            yield from bench.until(lambda wrong=wrong: wrong.is_closed, answer_ms)
            right.is_broken = True  # frees its place
            yield from bench.wait(few_rounds_ms)

    bench.run(script)


def test_clients_without_the_key_make_place_for_others(bench) -> None:
    def script(bench):
        """Three clients without the key have all places: a fourth is refused at once, but after
        250 ms takes the place of one of them."""
        first_clients = [bench.call(f"10.0.0.{n}") for n in (1, 2, 3)]
        for pipe in first_clients:
            yield from connected(bench, pipe)
        late = bench.call("10.0.0.4")
        yield from bench.until(lambda: late.is_closed)
        assert late.take() == ""
        yield from bench.wait(300)  # they have had their places for 250 ms
        for pipe in first_clients:
            pipe.send("?$G\n")  # their queries do not protect them
        yield from bench.wait(50)
        late = bench.call("10.0.0.4")
        yield from connected(bench, late)
        assert [pipe.is_closed for pipe in first_clients].count(True) == 1

    bench.run(script)


def test_a_computer_that_reconnects_again_and_again_takes_only_its_own_place(bench) -> None:
    def script(bench):
        """20 connections from the first address replace the one it has, never the others."""
        first_clients = [bench.call(f"10.0.0.{n}") for n in (1, 2, 3)]
        for pipe in first_clients:
            yield from connected(bench, pipe)
        for _ in range(20):
            yield from bench.wait(300)  # the other two could be replaced, too
            bench.call("10.0.0.1")
        yield from bench.wait(50)
        assert [pipe.is_closed for pipe in first_clients] == [True, False, False]

    bench.run(script)


def test_a_client_waiting_for_a_long_move_keeps_its_place(bench) -> None:
    def script(bench):
        """All three places have clients with the key; 150 clients without it call meanwhile."""
        waiting, watching, third = yield from three(bench)
        waiting.send("G1X20F60\nG4P0\n")  # 20 mm at 1 mm/s, then the answer
        for number in range(150):
            bench.call(f"10.0.{number % 7}.{number % 3}").send("?")
            yield from bench.wait(100)
        assert not (waiting.is_closed or watching.is_closed or third.is_closed)
        yield from bench.until(lambda: waiting.got.count(b"ok") == 2, 10_000)

    bench.run(script)


def test_a_lost_client_with_the_key_keeps_its_place_for_ten_minutes() -> None:
    """The places were taken 0, 1 and 2 ms after the start; the first one is free 600 s after
    that, while the machine is idle."""
    places = [Client(Memory()) for _ in range(3)]
    for started_ms, place in enumerate(places):
        place.begin(Pipe(), "10.0.0.1", started_ms)
        place.trusted = True
    assert slot_for("10.0.0.1", places, at_rest=True, now_ms=600_000) is None
    assert slot_for("10.0.0.1", places, at_rest=False, now_ms=600_001) is None, (
        "while the machine works"
    )
    assert slot_for("10.0.0.1", places, at_rest=True, now_ms=600_001) is places[0]


def flood(bench, pipe, ms):
    """Keep 64 bytes of read-only lines unread for so many ms."""
    end = bench.rig.ms(ms)
    while bench.rig.now < end:
        if len(pipe.unread) < 64:
            pipe.send("$G\n" * 21)
        yield bench.rig.ms(2)


@pytest.mark.parametrize("by", ["cable", "key"])
def test_a_flood_of_read_only_lines_delays_no_client_with_the_key(bench, by: str) -> None:
    def script(bench):
        """A client without the key sends read-only lines without end: the line of the cable, or
        of a client with the key (by), is executed within a second."""
        stranger, pipe = bench.call("10.0.0.66"), (yield from joined(bench))
        yield from flood(bench, stranger, 500)
        bench.sender.take()
        (bench.rig.link.cable if by == "cable" else pipe).send(b"G0X1\n")
        yield from flood(bench, stranger, 1000)
        assert (bench.sender.take() if by == "cable" else pipe.take().split()) == ["ok"]

    bench.run(script)
    assert bench.steps() == [250, 0, 0]


@pytest.mark.parametrize("by", ["cable", "key"])
def test_a_reset_ends_the_loan_of_a_client_without_the_key(bench, by: str) -> None:
    def script(bench):
        """The cable, or a client with the key (by), resets while the machine is lent to a client
        without it for 20 read-only lines: the rest is dropped, and a line after the reset is
        executed."""
        stranger, pipe = bench.call("10.0.0.66"), (yield from joined(bench))
        yield from bench.wait(50)
        stranger.take()
        stranger.send("$G\n" * 20)
        yield from bench.until(lambda: stranger.got)
        resetting = bench.rig.link.cable if by == "cable" else pipe
        resetting.send(b"\x18")
        yield from bench.wait(1000)
        assert stranger.take().count("ok") < 20
        bench.sender.take(), pipe.take()
        resetting.send(b"G0X1\n")
        yield from bench.wait(1000)
        assert (bench.sender.take() if by == "cable" else pipe.take().split()) == ["ok"]

    bench.run(script)
    assert bench.steps() == [250, 0, 0]


# Memory


def test_a_client_without_the_key_gets_a_limited_number_of_bytes(bench) -> None:
    def script(bench):
        """Two clients without the key ask again and again: they receive their share of memory.
        After it only the key is answered."""
        pipes = [bench.call(f"10.0.0.{n}") for n in (1, 2)]
        for pipe in pipes:
            yield from bench.until(lambda pipe=pipe: WELCOME.encode() in pipe.got)
        for _ in range(400):
            for pipe in pipes:
                pipe.send("?\n$$\nG1X1\n")
            yield from bench.wait(20)
        assert 1000 < sum(len(pipe.got) for pipe in pipes) <= 2400  # bytes for both together
        assert (yield from bench.ask(pipes[0], f"$NET/KEY={KEY}\n")).endswith("ok\r\n")
        assert (yield from bench.ask(pipes[0], "G1X1F600\n")).endswith("ok\r\n")

    bench.run(script)


@pytest.mark.parametrize("how", ["has_hung_up", "is_broken"])
def test_memory_of_closed_connections_counts_for_ten_seconds(bench, how: str) -> None:
    def script(bench):
        """60 clients connect and close one after another (how). After an orderly end lwIP keeps
        the output, so that together they receive 2400 bytes. After a reset (is_broken) it has
        freed the memory."""
        total_bytes = 0
        for number in range(60):
            pipe = bench.call(f"10.0.0.{number}")
            pipe.send("?\n\n?")
            yield from bench.wait(100)
            setattr(pipe, how, True)
            yield from bench.until(lambda pipe=pipe: pipe.is_closed)
            total_bytes += len(pipe.got)
        assert total_bytes > 4000 if how == "is_broken" else total_bytes <= 2400
        yield from bench.wait(10_000)  # then nothing counts any more
        late = bench.call("10.0.0.1")
        yield from connected(bench, late)

    bench.run(script)


def test_no_lwip_memory_is_counted_after_a_day_of_clients(bench) -> None:
    def script(bench):
        """50 clients with and without the key, browsers and silent ones, end in different ways:
        no byte stays counted by mistake."""
        for number in range(50):
            pipe = bench.call(f"10.0.0.{number}")
            pipe.send(("?$$\n", f"$NET/KEY={KEY}\n$$\n", "GET / HTTP/1.1\r\n", "")[number % 4])
            yield from bench.wait(70 * (number % 5))
            setattr(pipe, ("has_hung_up", "is_broken")[number % 2], True)
        yield from bench.wait(12_000)  # more than 10 s: lwIP has freed all of it
        assert bench.rig.link._memory.held == 0

    bench.run(script)


# Browsers


@pytest.mark.parametrize("address", ["10.0.0.1", "127.0.0.1"])
@pytest.mark.parametrize(
    "method",
    [
        "GET",
        "POST",
        "PUT",
        "HEAD",
        "OPTIONS",
        "PATCH",
        "DELETE",
        "CONNECT",
        "TRACE",
        "PRI",
        "\x16\x03\x01",
    ],
)
def test_browser_requests_are_closed_before_anything_acts(
    bench, method: str, address: str
) -> None:
    body = f"$NET/KEY={KEY}\n$J=G91X9F900\n"

    def script(bench):
        """A connection that begins with an HTTP method, or a TLS handshake, is closed although
        stops and lines follow: a web page may make a browser connect to this port."""
        pipe = bench.call(address)
        pipe.send(f"{method} /!\x18~ HTTP/1.1\r\nHost: ugrbl:23\r\n\r\n{body}")
        yield from bench.until(lambda: pipe.is_closed, 200)
        yield from bench.wait(1000)
        assert bench.rig.controller.state.run == 0

    bench.run(script)
    assert bench.rows == []
