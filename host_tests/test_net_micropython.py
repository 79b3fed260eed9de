"""The network's link under the desktop MicroPython, with its sockets and real callers."""

import json
import random
import socket
import threading
import time
from collections.abc import Iterator

import pytest
from micropython_runner import needs_micropython, run_micropython
from ugrbl.paths import FIRMWARE

pytestmark = needs_micropython

_LINES = 120
_LONGEST_US = 100_000  # a turn, on a computer that does other things as well
_STEP_S = 0.003

# A machine that answers each line, and a question with a report; ends with a line END.
_MACHINE = """
import json, sys, time
from array import array
from ports.net_link import NetLink
from ports.tcp import Calls


class Cable:
    shared = array("i", (0, 0, 0))
    look = None
    is_slow = False

    def read_into(self, buf):
        return 0

    def write(self, data):
        pass


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
        link.done()
    turns += 1
    longest = max(longest, time.ticks_diff(time.ticks_us(), before))
    if not count:
        time.sleep_ms(1)
print(json.dumps([longest, turns, [line.decode() for line in lines]]))
"""


@pytest.fixture
def port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def storm(port: int, over: threading.Event) -> None:
    """Connect, say rubbish, read nothing, hang up or reset, again and again."""
    chance = random.Random(port)
    there: list[socket.socket] = []
    while not over.is_set():
        time.sleep(_STEP_S)
        made = socket.socket()
        made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
        made.setblocking(False)
        made.connect_ex(("127.0.0.1", port))
        there.append(made)
        try:
            chance.choice(there).send(chance.choice((b"?" * 99, b"G1X9\n", bytes(range(256)))))
        except OSError:
            pass  # the board has hung up, as it should
        while len(there) > 8:
            gone = there.pop(chance.randrange(len(there)))
            if chance.random() < 0.5:
                gone.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
            gone.close()


def drive(port: int, out: list[str]) -> None:
    """Say the key, then lines, each when the one before is answered, with questions between."""
    for _ in range(200):
        try:
            caller = socket.create_connection(("127.0.0.1", port), 20)
            break
        except OSError:
            time.sleep(0.05)
    answers = lines_of(caller)
    for line in ["$NET/KEY=23456789", *(f"G1X{number}" for number in range(_LINES)), "END"]:
        caller.sendall(b"?" + line.encode() + b"\n")
        for answer in answers:
            if answer == "ok" or answer.startswith("error:"):
                out.append(answer)
                break
    caller.close()


def lines_of(caller: socket.socket) -> Iterator[str]:
    text = ""
    while data := caller.recv(999):
        text += data.decode("latin-1")
        *lines, text = text.split("\r\n")
        yield from lines


@pytest.mark.parametrize("stormy", [False, True], ids=["quiet", "storm"])
def test_lines_arrive_whole_and_in_order_and_no_turn_waits(port: int, stormy: bool) -> None:
    over, answers = threading.Event(), list[str]()
    threads = [threading.Thread(target=drive, args=(port, answers))]
    if stormy:
        threads.append(threading.Thread(target=storm, args=(port, over)))
    told: list[str] = []
    machine = threading.Thread(
        target=lambda: told.append(run_micropython(_MACHINE, port, paths=[FIRMWARE]))
    )
    machine.start()
    threads[0].start()
    time.sleep(0.5)  # in front of the storm it finds a place
    for thread in threads[1:]:
        thread.start()
    machine.join(60)
    over.set()
    for thread in threads:
        thread.join(30)
    longest, turns, lines = json.loads(told[0])
    assert lines == [*(f"G1X{number}" for number in range(_LINES)), "END"]
    assert answers.count("ok") >= _LINES + 1 and "error:9" not in answers
    assert turns > _LINES and longest < _LONGEST_US
