"""Test the network link on the emulated Pico, with files as MicroPython's network and socket.

The emulated Pico has no radio, so Wi-Fi, lwIP and their interrupts are not tested. The page is
tested here, too, although no Pico W serves it, because only this board has an emulator.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from chips import CHIP
from emulated import Board, files_of
from page_bench import PING, WS_UPGRADE, frame, request
from ugrbl.boardfile import page_files
from ugrbl.boardfile.files import load_board
from ugrbl.compiling import build
from ugrbl.paths import BOARDS

pytestmark = pytest.mark.xdist_group("pico network")

_HEAP = 55_000  # of a Pico, which has 41,672 bytes more of it than a Pico W
_HEAP_WITH_PAGE = 42_000  # no Pico W is built with the page: boardfile/board_check.py

_NETWORK = b"""
def hostname(name):
    pass


class WLAN:
    IF_STA = 0
    IF_AP = 1
    PM_NONE = 16

    def __init__(self, side):
        pass

    def active(self, on):
        pass

    config = connect = status = lambda self, *given, **named: 3

    def isconnected(self):
        return True

    def ifconfig(self):
        return ("192.168.1.7", "", "", "")
"""

# A caller sends each line of `says` after this number of answers; its received bytes are in
# `heard`. A visitor of the page sends each item of `asks` after the text in front of it.
_SOCKET = b"""
import io

AF_INET = SOCK_STREAM = SOL_SOCKET = SO_REUSEADDR = TCP_NODELAY = 0
heard = bytearray()
says = []
asks = []


def getaddrinfo(host, port):
    return [(0, 0, 0, "", (host, port))]


class Caller:
    def readinto(self, buf):
        if not says or heard.count(b"ok\\r\\n") + heard.count(b"error:") < says[0][0]:
            return None
        line = says.pop(0)[1]
        buf[: len(line)] = line
        return len(line)

    def write(self, data):
        heard.extend(data)
        return len(data)

    setblocking = setsockopt = close = lambda self, *given: None


class Visitor(Caller):
    left = b""

    def readinto(self, buf):
        if not self.left and asks and asks[0][0] in b"." + heard:
            self.left = asks.pop(0)[1]
            heard[:] = b""
        count = min(len(self.left), len(buf))
        buf[:count] = self.left[:count]
        self.left = self.left[count:]
        return count or None


class socket(io.IOBase):
    def __init__(self, *given):
        self.called = False

    def bind(self, place):
        self.said = says if place[1] == 23 else asks

    def ioctl(self, request, given):
        return 0 if self.called or not self.said or request != 3 else 1

    def accept(self):
        self.called = True
        return (Caller if self.said is says else Visitor)(), ("10.0.0.1", 4711)

    setsockopt = listen = setblocking = lambda self, *given: None
"""

_MAIN = b"""
import gc
import sys

import no_network
import no_socket as socket

sys.modules["network"], sys.modules["socket"] = no_network, socket
from boot import power_up
from ports.storage.flash_store import FlashStore

store = FlashStore()
if not store.load("network"):
    store.save("network", ["SSID=4142", "PASS=4142434445464748", "KEY=23456789"])
socket.SAYS
power = power_up.build()
commands = power[0].commands
hooks = power[0].state.hooks
usual = hooks.find_command


def find_command(line, length):
    if line[1] == 77:
        gc.collect()
        commands._report.message("free %d." % gc.mem_free())
    elif line[1] == 85:
        commands._report.message("heard %s." % bytes(socket.heard[-99:]))
    else:
        return usual(line, length)
    return lambda line, length: None


hooks.find_command = find_command
machine = power_up.run_machine(power)
"""


_SAYS = [(0, b"G1X1F600\n"), (1, b"$NET/KEY=23456789\n"), (2, b"G1X2F600\n")]
ASKS = [
    (b".", request("/1")),
    (b" 200 OK", request("/ws", **WS_UPGRADE)),
    (b"Grbl 1.1h", frame("$NET/KEY=2345", last=False) + frame("6789\n", 0)),
    (b"ok\r\n", frame("?", PING) + frame("G1X3F600\n")),
]


def started(uf2: Path, files: "Mapping[str, bytes | None]", says: str) -> Board:
    """Return a Pico with these files and a stand-in for its network, after its first start.

    says: code that appends to the stand-in's `says` and `asks`, the scripts of its clients.
    """
    main = _MAIN.replace(b"socket.SAYS", says.encode())
    stand_ins = {"no_network.py": _NETWORK, "no_socket.py": _SOCKET, "main.py": main}
    board = Board(uf2, {**files, **stand_ins}).boot()
    board.wait_for("[MSG:First start: factory settings]\r\n")
    return board


def free_bytes(machine: Board) -> int:
    free = int(machine.ask("$M").partition("free ")[2].partition(".")[0])
    print("free:", free)
    return free


@pytest.fixture
def machine(uf2: Path) -> Board:
    return started(uf2, files_of("pico_w_wifi"), f"socket.says += {_SAYS}")


@pytest.fixture
def with_page(uf2: Path) -> Board:
    """Start a Pico W with the page, which board_check would refuse."""
    if CHIP.name == "rp2350":
        pytest.skip("test_pico2_memory.py has the page of an RP2350")
    described: Any = load_board("pico_w_wifi")
    described.PAGE = True
    made = build.compile_all(described.MPY_ARCH, described)
    text = (BOARDS / "pico_w_wifi.py").read_bytes() + b"PAGE = True\n"
    files = {**files_of("pico_w_wifi"), **made.files, **page_files.made(), "board.py": text}
    return started(uf2, files, f"socket.asks += {ASKS}")


def test_caller_with_the_key_gains_control_and_heap_is_free(machine: Board) -> None:
    """The caller's line without the key is refused, the one after it moves X to 2 mm. After its
    silence the cable may send lines."""
    machine.pico.run_us(1_300_000)  # the caller's script, _SAYS
    machine.clear_output()
    machine.send("?")
    assert "MPos:2.000,0.000,0.000" in machine.wait_for(">")
    machine.pico.run_us(3_000_000)  # the silence
    assert free_bytes(machine) >= _HEAP


def test_page_is_served_and_gains_control_and_heap_is_free(with_page: Board) -> None:
    """A browser's script (ASKS): it loads the page, opens the WebSocket, sends the key in two
    frames, and moves X to 3 mm. Then the cable may send lines."""
    with_page.pico.run_us(2_500_000)  # the script
    with_page.clear_output()
    with_page.send("?")
    assert "MPos:3.000,0.000,0.000" in with_page.wait_for(">")
    with_page.pico.run_us(3_000_000)  # the browser's silence
    said = with_page.ask("$U")  # a command of _MAIN: the last bytes that the browser received
    assert "\\x8a\\x01?" in said and "ok\\r\\n" in said  # the pong, and the answer
    assert free_bytes(with_page) >= _HEAP_WITH_PAGE
