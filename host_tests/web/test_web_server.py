"""Test `ugrbl web`: several browsers at one board, of which one controls it.

site.open() connects a browser. send() sends bytes to the board, drive(True) takes control,
told(...) waits until the server has reported these values (driver: whether this client controls;
drivers and watchers: how many there are; link: the name of the board and whether its port is open;
job: the shared program and its progress), wait(text) and ask(line) return what the board has
answered, leave() closes, vanish() breaks the connection as in a crash, go_deaf() stops reading. A
`FakeBoard` records its input in `got`; say() is its output, and `stuck = True` lets it accept
nothing. `site.log` are the lines of the server's log. @played makes a coroutine a plain function;
served() runs a server at a board.
"""

import asyncio
import json
import os
import subprocess
import sys
import tty
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import aiohttp
import pytest
from as_users import as_users
from ugrbl.run.program import run_program
from ugrbl.web import server
from ugrbl.web.board_link import SerialSource
from ugrbl.web.framing import Framing
from ugrbl.web.simulator import Simulator
from web_client import HTML, FakeBoard, Page, Site, played, served, until

pytestmark = [pytest.mark.xdist_group("web"), pytest.mark.thorough]


@pytest.fixture
def board() -> FakeBoard:
    return FakeBoard()


# Bytes


@played
async def test_all_clients_receive_and_controlling_client_sends(tmp_path: Path) -> None:
    """The first client controls the machine. What the machine sends reaches all clients."""
    async with served(Simulator("sim"), tmp_path) as site:
        first, second = await site.open(), await site.open()
        await first.told(link={"name": "sim", "open": True}, driver=True, drivers=1, watchers=1)
        await second.told(driver=False, drivers=1, watchers=1)
        assert "[GC:G0 G54 " in await first.ask("$G")
        await first.send(b"?")
        for page in (first, second):
            assert "|MPos:0.000,0.000,0.000|" in await page.wait(">")


@played
async def test_bytes_of_watcher_are_dropped(board: FakeBoard, tmp_path: Path) -> None:
    """What a client sends before it controls the machine never reaches the board."""
    async with served(board, tmp_path) as site:
        driver, watcher = await site.open(), await site.open()
        await watcher.send(b"G0 X5\n!\x18\x85")
        await watcher.drive(True)  # sent after the bytes, so those have been read
        await watcher.told(driver=True)
        await watcher.send(b"$G\n")
        await board.wait_for(b"$G\n")
        assert board.got == b"$G\n"
        assert driver.states[-1]["driver"] is False


@played
async def test_watcher_may_only_query_when_no_client_controls(
    board: FakeBoard, tmp_path: Path
) -> None:
    """While no client controls, any client may send single `?`, and nothing else.

    While one does, not even these.
    """
    async with served(board, tmp_path) as site:
        first, second = await site.open(), await site.open()
        await first.drive(False)  # gives up control
        await second.told(drivers=0)
        for data in (b"?", b"$G\n", b"!", b"?!", b"\x18", b"?"):
            await second.send(data)
        await second.send(b"?")
        # Of six messages and one more, the three that are just `?` have passed.
        await board.wait_for(b"???")
        await first.drive(True)
        await first.told(driver=True)
        await second.send(b"?")
        await second.drive(True)  # sent after the bytes, so those have been read
        await second.told(driver=True)
        await asyncio.sleep(0.1)
        assert board.got == b"???"


@played
async def test_every_byte_of_board_arrives_unchanged(board: FakeBoard, tmp_path: Path) -> None:
    """All 256 byte values, 100 times, reach the browser."""
    async with served(board, tmp_path) as site:
        page = await site.open()
        output = bytes(range(256)) * 100
        board.say(output)
        await until(lambda: len(page.text) == len(output), "all of it")
        assert page.text.encode("latin-1") == output


@pytest.mark.sampled(1)
def test_lines_go_whole_and_realtime_bytes_overtake_them() -> None:
    """Framing cuts a stream into whole lines and realtime bytes.

    A byte marked True does not wait for the end of its line.
    """
    framing = Framing()
    assert list(framing.take(b"G1 X")) == []
    assert list(framing.take(b"1?0!\r\n$G\nG9")) == [
        (b"?", True),
        (b"!", True),
        (b"G1 X10\r", False),
        (b"\n", False),
        (b"$G\n", False),
    ]
    # The reset (0x18) drops G90, the line before it that has not ended.
    assert list(framing.take(b"0\x18G91\n\x85")) == [
        (b"\x18", True),
        (b"G91\n", False),
        (b"\x85", True),
    ]
    # Drops the line that has begun.
    framing.forget()
    ((line, _),) = framing.take(b"(" + b"x" * 10_000 + b"\n")
    assert len(line) <= 4097, "far more than any Grbl takes, so it is refused all the same"


@played
async def test_only_protocol_bytes_reach_board(board: FakeBoard, tmp_path: Path) -> None:
    """Control characters are removed. Ctrl-C above all would interrupt the board's Python."""
    async with served(board, tmp_path) as site:
        page = await site.open()
        await page.send(b"\x03\x03\x03\r\x01\x04\x02")
        await page.send(bytes(range(0x20)) + b"G1\x03\x7f X1\n\x03" + b"\x03" * 9 + b"\n$G\n")
        await board.wait_for(b"$G\n")
        received = set(board.got)
        # Tab, line end, reset, and printable ASCII.
        assert received <= {*b"\t\n\r\x18", *range(0x20, 0x7F)}, sorted(received)
        assert b"G1 X1\n" in board.got


@played
async def test_stop_overtakes_lines_that_board_has_not_read(
    board: FakeBoard, tmp_path: Path
) -> None:
    """Hold and reset pass the lines that wait for the board.

    The reset also discards these lines.
    """
    async with served(board, tmp_path) as site:
        page = await site.open()
        board.stuck = True
        await page.send(b"G4 P1\n")
        await asyncio.sleep(0.2)  # it is being written
        await page.send(b"G1 X1\n" * 100 + b"!")
        await page.send(b"\x18$X\n")
        await asyncio.sleep(0.2)
        board.stuck = False
        await board.wait_for(b"$X\n")
        assert board.got == b"G4 P1\n!\x18$X\n", "lines before a reset are discarded"


# Control


@played
async def test_client_that_takes_over_controls_and_other_watches(
    board: FakeBoard, tmp_path: Path
) -> None:
    """After a takeover only the new client's bytes reach the board.

    Half a line of the client before is dropped.
    """
    async with served(board, tmp_path) as site:
        first, second = await site.open(), await site.open()
        await first.send(b"G91\nG1 X1")
        await board.wait_for(b"G91\n")
        await second.drive(True)
        await first.told(driver=False, drivers=1, watchers=1)
        await second.told(driver=True, drivers=1, watchers=1)
        await first.send(b"0\n!")  # ignored: it only watches now
        await second.send(b"$G\n")
        await board.wait_for(b"$G\n")
        assert board.got == b"G91\n$G\n", "nor is half a line of the other's before it"
        await second.drive(False)
        for page in (first, second):
            await page.told(driver=False, drivers=0, watchers=2)
        third = await site.open()
        # Nobody was in control, so a new client is.
        await third.told(driver=True, drivers=1, watchers=2)


@played
async def test_client_may_send_bytes_as_text(board: FakeBoard, tmp_path: Path) -> None:
    """A text message is taken as bytes.

    A character that is no byte, here the minus sign, is dropped.
    """
    async with served(board, tmp_path) as site:
        sender = await site.open()
        await sender.socket.send_str("G91 (− is no byte)\n\x85?")
        await board.wait_for(b"?")
        # Sorted, because realtime bytes overtake the line.
        assert sorted(board.got) == sorted(b"G91 ( is no byte)\n\x85?")


@pytest.mark.parametrize("words", ['{"drive": 0}', "{}", "{", '{"job": 1}', '{"job": {}}'])
@played
async def test_unknown_messages_are_ignored(words: str, board: FakeBoard, tmp_path: Path) -> None:
    """Such a message is logged, and control stays where it was."""
    async with served(board, tmp_path) as site:
        first, second = await site.open(), await site.open()
        await second.socket.send_str(words)
        await until(lambda: site.log, "log")
        assert "does not know; ignored" in site.log[0]
        await first.send(b"$G\n")
        await board.wait_for(b"$G\n")


LOSSES = ["closed", "crashed", "gave up", "server ended"]


@pytest.mark.parametrize("way_of_loss", LOSSES)
@pytest.mark.parametrize(
    ("state", "stop_bytes"),
    [("Run", b"!"), ("Jog", b"\x85"), ("Idle", b""), ("Hold:0", b""), ("Alarm", b"")],
)
@played
async def test_machine_of_lost_client_is_stopped_once(
    way_of_loss: str, state: str, stop_bytes: bytes, board: FakeBoard, tmp_path: Path
) -> None:
    """A running machine is held, and a jog cancelled, once when its client is lost.

    stop_bytes: what the board must have received then.
    """
    async with served(board, tmp_path) as site:
        driver, watcher = await site.open(), await site.open()
        board.say(f"<Run|MPos:0,0,0>\r\nok\r\n<{state}|MPos:0,0".encode())
        board.say(b",0|FS:0,0>\r\nok\r\n<Idle|")  # half a report does not count
        await watcher.wait("<Idle|")
        await driver.send(b"G1")  # an unfinished line, which is dropped
        await _lose_driver(way_of_loss, site, driver)
        if way_of_loss != "server ended":
            await watcher.told(drivers=0)
            watcher.vanish()
            await asyncio.sleep(0.1)
            # Later losses send nothing more: those of a watcher and of an idle client.
            await (await site.open()).leave()
            await asyncio.sleep(0.1)
    assert board.got == stop_bytes
    # The log names the state only if the machine was stopped.
    assert any(state in line for line in site.log) == bool(stop_bytes)


async def _lose_driver(way_of_loss: str, site: Site, driver: Page) -> None:
    """End the connection of the controlling client, or its control, in this way."""
    if way_of_loss == "closed":
        await driver.leave()
    elif way_of_loss == "crashed":
        driver.vanish()
    elif way_of_loss == "gave up":
        await driver.drive(False)
    else:
        await site.server.stop()


@played
async def test_client_whose_network_fails_is_lost_as_well(
    board: FakeBoard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A client that answers no ping is lost although its connection is still open."""
    monkeypatch.setattr(server, "_HEARTBEAT_S", 0.4)  # time between pings
    async with served(board, tmp_path) as site:
        driver, watcher = await site.open(), await site.open()
        board.say(b"<Run|MPos:0,0,0>\r\n")
        await driver.wait(">")
        driver.go_deaf()  # it answers no ping
        await watcher.told(drivers=0, watchers=1)
        await board.wait_for(b"!")  # a hold


@played
async def test_job_of_lost_client_is_held_and_continues_on_request(tmp_path: Path) -> None:
    """The machine is held where it was when its client was lost.

    Another client takes control and resumes it.
    """
    async with served(Simulator("sim"), tmp_path) as site:
        driver, watcher = await site.open(), await site.open()
        await driver.ask("G91")
        await driver.ask("M3 S1000")
        await driver.ask("G1 X20 F500")
        await driver.report("Run")
        driver.vanish()
        await watcher.told(drivers=0)
        assert "was in Run: the motion is held (!)" in site.log[-1]
        await watcher.drive(True)
        held_report = await watcher.report("Hold:0")
        # The X position.
        assert 0 <= float(held_report.partition("MPos:")[2].partition(",")[0]) < 20
        await asyncio.sleep(0.3)
        assert (await watcher.report()).partition("|FS")[0] == held_report.partition("|FS")[0]
        await watcher.send(b"~")  # cycle start
        assert "MPos:20.000," in await watcher.report("Idle")


PROGRAM = {"id": "one", "name": "x.nc", "program": "G1 X1\nG1 X2\n"}


@played
async def test_job_is_shared_and_may_be_continued_after_browser_is_lost(
    board: FakeBoard, tmp_path: Path
) -> None:
    """A program and its progress are shared with all clients.

    A client that takes over continues it; a reset of the machine ends it.
    """
    async with served(board, tmp_path) as site:
        driver, watcher = await site.open(), await site.open()
        assert (await site.job(PROGRAM))[0] == 200
        await watcher.told(job={"id": "one", "name": "x.nc"})
        # sent and made: number of lines sent to the machine, and executed.
        progress = {"id": "one", "sent": 1, "made": 1, "state": "running", "why": ""}
        await watcher.job({**progress, "made": 9}, "G1 X9\n")  # this client is not in control
        await driver.job(progress, "G1 X1\n")
        await watcher.told(job={**progress, "name": "x.nc"})
        await board.wait_for(b"G1 X1\n")
        assert board.got == b"G1 X1\n"
        assert (await site.job(PROGRAM))[0] == 409  # one runs already
        driver.vanish()
        await watcher.told(drivers=0)
        third = await site.open()
        await third.told(job={**progress, "name": "x.nc", "state": "left"})
        assert await site.job() == (200, PROGRAM)
        await third.job({**progress, "sent": 2}, "G1 X2\n")
        await board.wait_for(b"G1 X1\nG1 X2\n")
        board.say(b"Grbl 1.1h ['$' for help]\r\n")
        stopped = {"sent": 2, "state": "stopped", "why": "the machine was reset"}
        await watcher.told(job={**progress, "name": "x.nc", **stopped})


@played
async def test_queued_lines_count_as_sent_and_reach_board_after_takeover(
    board: FakeBoard, tmp_path: Path
) -> None:
    """Lines count as sent once the server has them.

    The client that continues a job leaves none out and sends none twice.
    """
    async with served(board, tmp_path) as site:
        driver, second = await site.open(), await site.open()
        await site.job(PROGRAM)
        board.stuck = True
        await driver.job({"id": "one", "sent": 2, "state": "running"}, "G1 X1\nG1 X2\n")
        await second.told(job={"id": "one", "name": "x.nc", "sent": 2, "state": "running"})
        await second.drive(True)
        await second.told(driver=True)
        board.stuck = False
        await board.wait_for(b"G1 X1\nG1 X2\n")


@pytest.mark.parametrize(
    "body",
    [
        *(b"", b"[]", b'{"id": "1", "name": "x"}', b'{"id": 1}'),
        *(
            b'{"id": 1, "name": "x", "program": "G1"}',
            b'{"id": "1", "name": null, "program": "G1"}',
        ),
    ],
)
@played
async def test_body_without_program_is_not_shared(
    body: bytes, board: FakeBoard, tmp_path: Path
) -> None:
    """A shared job needs id, name and program, all as text."""
    async with served(board, tmp_path) as site:
        status, words = await site.job(body)
        assert status == 400 and "the request needs a program" in words
        assert await site.job() == (200, {})  # no program is open


@played
async def test_jog_of_lost_client_ends(tmp_path: Path) -> None:
    """The jog of 100 mm is cancelled when its client leaves."""
    async with served(Simulator("sim"), tmp_path) as site:
        driver, watcher = await site.open(), await site.open()
        await driver.ask("$J=G91 X100 F500")
        await driver.report("Jog")
        await driver.leave()
        await watcher.told(drivers=0)
        await watcher.drive(True)
        last_report = await watcher.report("Idle")
        # The X position, in mm.
        assert 0 < float(last_report.partition("MPos:")[2].partition(",")[0]) < 50


@played
async def test_simulator_can_be_homed(tmp_path: Path) -> None:
    """The simulator of `ugrbl web` has switches, so $H succeeds. The settings make it quick."""
    async with served(Simulator("sim"), tmp_path) as site:
        page = await site.open()
        rates = ("$25=3000", "$24=600", "$110=3000", "$111=3000", "$112=3000")
        accelerations_and_travel = (
            "$120=500",
            "$121=500",
            "$122=500",
            "$130=8",
            "$131=8",
            "$132=8",
            "$22=1",
        )
        for setting in (*rates, *accelerations_and_travel):
            assert (await page.ask(setting)).endswith("ok\r\n")
        assert (await page.ask("$H")).endswith("ok\r\n")
        # 1 mm off the switches ($27).
        assert "MPos:-1.000,-1.000,-1.000|" in await page.report("Idle")


@played
async def test_board_with_coupled_motors_has_no_switches(tmp_path: Path) -> None:
    async with served(Simulator("sim_corexy"), tmp_path) as site:
        assert (await (await site.open()).ask("G91 G0 X1")).endswith("ok\r\n")


# Unplugging


class PtyBoard:
    """A port that can be unplugged and returns as another terminal."""

    def __init__(self, link: Path) -> None:
        self._link = link
        self._master = -1
        self.plug_in()

    def plug_in(self) -> None:
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self._link.symlink_to(os.ttyname(slave))
        os.close(slave)

    def pull(self) -> None:
        os.close(self._master)
        self._link.unlink()

    def say(self, data: bytes) -> None:
        os.write(self._master, data)

    def hear(self) -> bytes:
        return os.read(self._master, 4096)


@played
async def test_unplugging_is_reported_and_retried_while_browsers_stay(tmp_path: Path) -> None:
    """The port vanishes and returns.

    Browsers stay connected, learn of both, and control stays with the first.
    """
    port = tmp_path / "ttyACM0"
    plug = PtyBoard(port)
    async with served(SerialSource(lambda: str(port)), tmp_path) as site:
        pages = [await site.open(), await site.open()]
        plug.say(b"<Run|MPos:0.000,0.000,0.000>\r\n")
        await pages[1].wait(">")
        plug.pull()
        for page in pages:
            await page.told(link={"name": str(port), "open": False})
        await pages[0].send(b"G1 X100\n")  # lost
        await until(lambda: len(site.log) == 2, "log")
        assert "broke" in site.log[0] and "simulator run?; trying again" in site.log[1]
        plug.plug_in()
        await pages[0].told(link={"name": str(port), "open": True}, driver=True)
        await pages[0].send(b"?$G\n")
        # The new board gets no line from before; it may be read in two parts.
        assert await asyncio.to_thread(plug.hear) in (b"?", b"?$G\n")
        plug.say(b"ok\r\n")
        for page in pages:
            await page.wait("ok\r\n")
        assert site.log[-1].endswith("is there again")


@played
async def test_killed_simulator_is_restarted(tmp_path: Path) -> None:
    """The server notices the end of its simulator and starts another one."""
    simulator = Simulator("sim")
    async with served(simulator, tmp_path) as site:
        page = await site.open()
        assert simulator._process
        simulator._process.kill()  # as in a crash
        await page.told(link={"name": "sim", "open": False})
        await page.told(link={"name": "sim", "open": True})
        assert "[GC:" in await page.ask("$G")


# Access


@played
async def test_page_is_served_and_may_not_be_framed(board: FakeBoard, tmp_path: Path) -> None:
    """The page forbids to be shown within another page. Other addresses get an explanation."""
    async with served(board, tmp_path) as site:
        async with site.session.get(site.address) as got:
            assert (got.status, await got.text()) == (200, HTML)
            assert "frame-ancestors 'none'" in got.headers["Content-Security-Policy"]
        (tmp_path / "index.html").unlink()
        status, said = await site.status("/")
        assert status == 404 and "the page is missing" in said
        status, said = await site.status("/ws")
        assert status == 400 and "websocket" in said
        assert await site.status("/etc/passwd") == (
            404,
            "there is no /etc/passwd here: the page is at /\n",
        )


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:1", "http://localhost", "http://["]
)
@played
async def test_foreign_pages_are_refused(origin: str, board: FakeBoard, tmp_path: Path) -> None:
    """A page from another origin may neither open the websocket nor ask for previews."""
    async with served(board, tmp_path) as site:
        for path, method in (("/ws", "GET"), ("/api/look", "POST")):
            status, said = await site.status(path, method, Origin=origin)
            assert status == 403 and "may not talk to a machine here" in said
        with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
            await site.open(Origin=origin)
        await site.open(Origin=site.address)


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("evil.example", 403),
        ("127.0.0.1.evil.example", 403),
        ("localhost.evil.example:80", 403),
        ("192.168.1.7", 403),
        ("[", 403),
        ("localhost:8010", 200),
        ("[::1]:8010", 200),
        ("127.0.0.1", 200),
    ],
)
@played
async def test_foreign_host_names_are_refused(
    host: str, status: int, board: FakeBoard, tmp_path: Path
) -> None:
    """Only names of this computer are accepted as Host.

    A foreign name that leads here (DNS rebinding) is refused.
    """
    async with served(board, tmp_path) as site:
        received_status, said = await site.status("/", Host=host)
        assert received_status == status
        assert (host in said and "printed at its start" in said) == (status == 403)


@played
async def test_network_access_needs_token(board: FakeBoard, tmp_path: Path) -> None:
    """Without the right token every address is refused.

    With it, the Host name is checked all the same.
    """
    async with served(board, tmp_path, host="0.0.0.0") as site:
        token = site.access.token
        assert len(token) >= 20
        for wrong in ("", "?token=", "?token=x", f"?token={token}x", "?token=%C3%A4"):
            for path, method in (("/", "GET"), ("/ws", "GET"), ("/api/look", "POST")):
                status, said = await site.status(path + wrong, method)
                assert status == 403 and "the token is missing or wrong" in said
        assert await site.status(f"/?token={token}") == (200, HTML)
        assert (await site.status(f"/?token={token}", Host="evil.example"))[0] == 403
        await (await site.open(f"/ws?token={token}")).told(driver=True)


def test_every_start_has_new_token() -> None:
    from ugrbl.web.access import Access

    assert Access("0.0.0.0").token != Access("0.0.0.0").token
    assert not Access("localhost").token and not Access("::1").token


# Many clients, and slow ones


@played
async def test_client_that_does_not_read_is_dropped_and_delays_no_other(
    board: FakeBoard, tmp_path: Path
) -> None:
    """A client that does not read is disconnected once too much output waits for it."""
    async with served(board, tmp_path) as site:
        slow, quick = await site.open(), await site.open()
        slow.go_deaf()
        # 250 times 64 KiB, 16 MB in all.
        for _ in range(250):
            board.say(b"x" * 65_535 + b"\n")
            await quick.wait("\n")
        await quick.told(drivers=0, watchers=1)
        (line,) = site.log
        assert line.startswith("browser 127.0.0.1 does not receive")


@pytest.fixture
def recorded(tmp_path: Path) -> Iterator["tuple[str, Path, subprocess.Popen[str]]"]:
    """Start a simulator that writes its steps at the end.

    Yields its address, the report file, and the process.
    """
    report = tmp_path / "report.json"
    command = [sys.executable, "-m", "ugrbl.cli", "sim", "--tcp", "0", "--report", str(report)]
    process = subprocess.Popen(
        [*command, "--speed", "max"], stdout=subprocess.PIPE, env=as_users(), text=True
    )
    assert process.stdout
    # The line ends with HOST:PORT.
    place = process.stdout.readline().rpartition(" ")[2].strip()
    yield f"socket://{place}", report, process
    process.kill()
    process.wait()


@pytest.mark.thorough
@played
async def test_reloads_and_slow_readers_change_no_step(
    recorded: "tuple[str, Path, subprocess.Popen[str]]", tmp_path: Path
) -> None:
    """Other clients do not change the motion of a program that is being sent.

    Some come and go all the time and some read nothing; the steps are those of a run without a
    server.
    """
    port, report, process = recorded
    lines = [f"G1 X{n * 7 % 11} Y{n * 3 % 5} F{1000 + n % 9}".encode() for n in range(400)]
    async with served(SerialSource(lambda: port), tmp_path) as site:
        driver = await site.open()
        await driver.ask("G21 G90")
        reloading_clients = [
            asyncio.create_task(_reload(site, slow)) for slow in (True, False, False)
        ]
        await _stream(driver, lines)
        await driver.report("Idle")
        for client in reloading_clients:
            client.cancel()
        counts = await asyncio.gather(*reloading_clients, return_exceptions=True)
        assert all(isinstance(count, asyncio.CancelledError) for count in counts)
        assert not site.log
    process.terminate()
    process.communicate()
    made = json.loads(report.read_text())
    expected, _ = run_program([b"G21 G90", *lines])
    assert made["steps_made"] == expected.totals.steps_made
    assert made["final_position_mm"] == expected.totals.final_position_mm


async def _reload(site: Site, slow: bool) -> None:
    """Connect, send bytes that are dropped, and disconnect, in a loop; slow: also read nothing."""
    while True:
        page = await site.open()
        await page.send(b"G0 X99\n!\x18" * 10)
        if slow:
            page.go_deaf()
            await asyncio.sleep(0.2)
        page.vanish()
        await asyncio.sleep(0)


async def _stream(page: Page, lines: "list[bytes]") -> None:
    """Send the lines with at most 120 bytes unanswered.

    Every tenth line also requests a status report.
    """
    page.text = ""
    unanswered_sizes: deque[int] = deque()
    answered = 0
    for count, line in enumerate(lines):
        while sum(unanswered_sizes) + len(line) + 1 > 120:
            await until(lambda: page.text.count("ok\r\n") > answered, "answer")  # noqa: B023
            answered += 1
            unanswered_sizes.popleft()
        await page.send(line + b"\n" + (b"?" if count % 10 == 0 else b""))
        unanswered_sizes.append(len(line) + 1)
    await until(lambda: page.text.count("ok\r\n") == len(lines), "last answer")
    # At least half of the requested reports came.
    assert "error" not in page.text and page.text.count("<") > len(lines) // 20
