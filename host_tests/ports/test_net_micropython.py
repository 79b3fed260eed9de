"""The network link, and the page, under the desktop MicroPython with its sockets and real
clients."""

import gzip
import http.client
import json
import random
import re
import socket
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from micropython_runner import needs_micropython, placed_firmware, run_micropython
from page_bench import PING, PONG, WS_UPGRADE, frame, request
from sim_bench import free_port
from ugrbl.boardfile import page_files
from ugrbl.paths import FIRMWARE

pytestmark = [needs_micropython, pytest.mark.thorough]

_LINES = 120  # sent by the client with the key
_LONGEST_US = 100_000  # one turn, on a computer that also does other things
_STEP_S = 0.003  # between two connections of a storm

# A machine that answers each line, and a "?" with a report; it ends after a line END.
_MACHINE = """
import json, sys, time
from array import array
from ports.net.net_link import NetLink
from ports.net.tcp import Calls


class Cable:
    shared = array("i", (0, 0, 0))
    poll_reset = None
    is_slow = False

    def read_into(self, buf):
        return 0

    def write(self, data):
        pass


if len(sys.argv) > 2:
    from ports.net.page import Page
    from ports.net.page_link import PageLink

    page = Page(Calls(int(sys.argv[1])), Calls(int(sys.argv[2])), "ugrbl", sys.argv[3])
    link = PageLink(Cable(), page, "ugrbl")
else:
    link = NetLink(Cable(), Calls(int(sys.argv[1])))
link.access.secret = "23456789"
buf = bytearray(64)
heard = b""
longest = turns = 0
lines = []
begun = time.ticks_ms()
while b"END" not in lines and time.ticks_diff(time.ticks_ms(), begun) < 50000:
    before = time.ticks_us()
    count = link.read_into(buf)
    for byte in buf[:count]:
        if byte == 63:
            link.write(b"<Idle|MPos:0.000,0.000,0.000|FS:0,0>\\r\\n")
        elif byte == 10:
            lines.append(heard)
            heard = b""
            link.write(b"ok\\r\\n")
        elif byte < 128:
            heard += bytes([byte])
    if not count:
        link.control.done()
    turns += 1
    longest = max(longest, time.ticks_diff(time.ticks_us(), before))
    if not count:
        time.sleep_ms(1)
print(json.dumps([longest, turns, [line.decode() for line in lines]]))
"""


class Board:
    """Run the machine above, listening for clients until it reads END.

    listening: the port to wait for; arguments: its TCP port, or TCP and HTTP port and the folder
    of the page."""

    def __init__(self, listening: int, *arguments: object) -> None:
        placed_firmware()  # may take long: do it before a client waits
        pool = ThreadPoolExecutor(1)
        self.ended = pool.submit(run_micropython, _MACHINE, *arguments, paths=[FIRMWARE])
        pool.shutdown(wait=False)
        while not self._listens(listening):
            assert not self.ended.done(), self.ended.result()
            time.sleep(0.05)

    def _listens(self, port: int) -> bool:
        """Return whether a connection to this port of the board is accepted."""
        with socket.socket() as connection:
            return connection.connect_ex(("127.0.0.1", port)) == 0

    def check(self, answers: list[str]) -> None:
        """Check the machine's result: every line came once, in order, was answered (answers:
        the client's), and that no turn of its loop took long."""
        longest_us, turns, lines = json.loads(self.ended.result(60))
        assert lines == [*(f"G1X{number}" for number in range(_LINES)), "END"]
        assert answers.count("ok") >= _LINES + 1 and "error:9" not in answers  # 1: the key
        assert turns > _LINES and longest_us < _LONGEST_US


@pytest.fixture
def port() -> int:
    return free_port()


_RUBBISH = (b"?" * 99, b"G1X9\n", bytes(range(256)))


def storm(port: int, over: threading.Event, rubbish: "tuple[bytes, ...]" = _RUBBISH) -> None:
    """Connect, send rubbish, read nothing, hang up or reset, again and again."""
    chance = random.Random(port)
    connections: list[socket.socket] = []
    while not over.is_set():
        time.sleep(_STEP_S)
        connection = socket.socket()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
        connection.setblocking(False)
        connection.connect_ex(("127.0.0.1", port))
        connections.append(connection)
        try:
            chance.choice(connections).send(chance.choice(rubbish))
        except OSError:
            pass  # the board has closed the connection, as it should
        while len(connections) > 8:
            closing = connections.pop(chance.randrange(len(connections)))
            if chance.random() < 0.5:  # a reset, not an orderly end
                closing.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
            closing.close()


def drive(port: int, out: list[str]) -> None:
    """Send the key, then lines, each after the answer to the one before, with "?" in between."""
    connection = connected(port)
    answers = lines_of(connection)
    for line in ["$NET/KEY=23456789", *(f"G1X{number}" for number in range(_LINES)), "END"]:
        connection.sendall(b"?" + line.encode() + b"\n")
        for answer in answers:
            if answer == "ok" or answer.startswith("error:"):
                out.append(answer)
                break
    connection.close()


def lines_of(connection: socket.socket) -> Iterator[str]:
    """Yield the lines received, without their ends, until the board closes the connection."""
    incomplete = ""
    while data := connection.recv(999):
        incomplete += data.decode("latin-1")
        *lines, incomplete = incomplete.split("\r\n")
        yield from lines


@pytest.mark.sampled(1)
@pytest.mark.parametrize("stormy", [False, True], ids=["quiet", "storm"])
def test_lines_arrive_complete_and_in_order_and_no_turn_blocks(port: int, stormy: bool) -> None:
    """A client with the key drives the machine by TCP; stormy: while others send rubbish."""
    board = Board(port, port)
    over, answers = threading.Event(), list[str]()
    threads = [threading.Thread(target=drive, args=(port, answers))]
    if stormy:
        threads.append(threading.Thread(target=storm, args=(port, over)))
    threads[0].start()
    time.sleep(0.5)  # connect before the storm takes all places
    for thread in threads[1:]:
        thread.start()
    threads[0].join(60)
    over.set()
    for thread in threads:
        thread.join(30)
    board.check(answers)


# The page

_OF_VISITORS = (
    *(request(f"/{path}") for path in ("", "0", "9", "x" * 5000)),
    request("/ws", **WS_UPGRADE),
    request("/0")[:70],
    frame("$X\n"),
    bytes(range(256)),
)


def _get(connection: http.client.HTTPConnection, path: str) -> "tuple[bytes, str]":
    """Return the content at a path, and the path of the next piece."""
    connection.request("GET", path)
    answer = connection.getresponse()
    assert answer.status == 200
    return answer.read(), answer.headers.get("Next", "")


def whole_page(port: int) -> bytes:
    """Fetch all pieces as the first page does; return the HTML. Each answer names the next
    piece."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    first, _ = _get(connection, "/")
    path = first[first.index(b"/0?") :][:7].decode()  # "/0?" and four random digits
    pieces = list[bytes]()
    while path:
        piece, path = _get(connection, path)
        pieces.append(piece)
    return gzip.decompress(b"".join(pieces))


def connected(port: int) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), 20)


def heard_by_browser(connection: socket.socket) -> bytes:
    """Return the bytes received; answer each ping. The board sends each frame in one piece."""
    received = connection.recv(999)
    for ping in re.findall(b"\x89\x04(....)", received, re.DOTALL):
        connection.sendall(frame(ping, PONG))
    return received


def drive_by_page(port: int, out: list[str]) -> None:
    """Do the same as drive(), with some messages in several frames."""
    connection, chance = connected(port), random.Random(port)
    host = f"127.0.0.1:{port}"
    connection.sendall(request("/ws", **{**WS_UPGRADE, "Host": host, "Origin": f"http://{host}"}))
    text = ""
    while "Grbl 1.1h" not in text:
        text += heard_by_browser(connection).decode("latin-1")
    assert text.startswith("HTTP/1.1 101 ")
    for line in ["$NET/KEY=23456789", *(f"G1X{number}" for number in range(_LINES)), "END"]:
        data = f"?{line}\n".encode()
        cut = chance.randrange(len(data))
        # Two frames of one message (opcode 0 continues it) with a ping between them.
        parts = frame(data[:cut], last=False) + frame(b"", PING) + frame(data[cut:], opcode=0)
        connection.sendall(parts if cut % 2 else frame(data))
        text = ""
        while not re.search("ok\r\n|error:", text):
            received = heard_by_browser(connection)
            if not received:
                return  # the machine has ended
            text += received.decode("latin-1")
        out.append("ok" if "error:" not in text else text)
    connection.close()


@pytest.mark.parametrize("stormy", [False, True], ids=["quiet", "storm"])
def test_a_page_is_loaded_and_drives_and_no_turn_blocks(stormy: bool, tmp_path: Path) -> None:
    """The page is loaded by HTTP, and a browser drives by its websocket; stormy: while others
    send rubbish to both ports."""
    page_files.save(tmp_path)
    by_tcp, by_http = free_port(), free_port()
    board = Board(by_http, by_tcp, by_http, f"{tmp_path}/")
    html = page_files.page(from_board=True).encode()
    assert whole_page(by_http) == html
    over, answers = threading.Event(), list[str]()
    driver = threading.Thread(target=drive_by_page, args=(by_http, answers))
    driver.start()
    time.sleep(0.5)  # connect before the storm takes all places
    storms = [
        threading.Thread(target=storm, args=asked)
        for asked in ((by_tcp, over), (by_http, over, _OF_VISITORS))
        if stormy
    ]
    for thread in storms:
        thread.start()
    driver.join(60)
    over.set()
    for thread in storms:
        thread.join(60)
    board.check(answers)
    assert set(answers) == {"ok"}
