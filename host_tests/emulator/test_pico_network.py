"""The network's link on the emulated Pico, which has no radio: files stand in for MicroPython's
network and socket. So nothing is said of Wi-Fi, lwIP and their interrupts.
"""

from pathlib import Path

import pytest
from emulated import Board, files_of

pytestmark = pytest.mark.xdist_group("pico network")

_HEAP = 88_000  # of a Pico's, which has 41,672 bytes more of it than a Pico W

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

# Who calls says these lines, one behind the answer to the one before; what he hears is in `heard`.
_SOCKET = b"""
import io

AF_INET = SOCK_STREAM = SOL_SOCKET = SO_REUSEADDR = TCP_NODELAY = 0
heard = bytearray()
says = []


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


class socket(io.IOBase):
    def __init__(self, *given):
        self.called = False

    def ioctl(self, request, given):
        return 0 if self.called or not says or request != 3 else 1

    def accept(self):
        self.called = True
        return Caller(), ("10.0.0.1", 4711)

    setsockopt = bind = listen = setblocking = lambda self, *given: None
"""

_MAIN = b"""
import gc
import sys

import no_network
import no_socket as socket

sys.modules["network"], sys.modules["usocket"] = no_network, socket
from boot import power_up
import ports

store = ports.FlashStore()
if not store.load("network"):
    store.save("network", ["SSID=4142", "PASS=4142434445464748", "KEY=23456789"])
socket.says += [(0, b"G1X1F600\\n"), (1, b"$NET/KEY=23456789\\n"), (2, b"G1X2F600\\n")]
power = power_up.build()
commands = power[0].commands
usual = commands.whose


def whose(line, length):
    if line[1] == 77:
        gc.collect()
        commands._report.message("free %d." % gc.mem_free())
    elif line[1] == 85:
        commands._report.message("heard %s." % bytes(socket.heard))
    else:
        return usual(line, length)
    return lambda line, length: None


commands.whose = whose
machine = power_up.live(power)
"""


@pytest.fixture(scope="module")
def machine(uf2: Path) -> Board:
    files = {
        **files_of("pico_w_wifi"),
        "no_network.py": _NETWORK,
        "no_socket.py": _SOCKET,
        "main.py": _MAIN,
    }
    board = Board(uf2, files).boot()
    board.wait_for("[MSG:First start: factory settings]\r\n")
    return board


def test_who_calls_drives_with_the_key_and_memory_is_left(machine: Board) -> None:
    """He says his lines, nobody else has; the cable may when he has been silent."""
    machine.pico.run_us(1_300_000)
    machine.forget()
    machine.send("?")
    assert "MPos:2.000,0.000,0.000" in machine.wait_for(">")
    machine.pico.run_us(3_000_000)
    free = int(machine.ask("$M").partition("free ")[2].partition(".")[0])
    print("free:", free)
    assert free >= _HEAP
