"""The whole firmware on an ESP32 board file and stand-ins: under either Python, in virtual time.

python esp_boot.py BOARD [ENGINE] — talks to it as a sender would and prints what comes back.
"""

import sys


def set_path() -> str:
    """Find the firmware and the stand-ins; returns the folder of the tree."""
    here = sys.argv[0].rsplit("/", 1)[0] if "/" in sys.argv[0] else "."
    root = here + "/.."
    if sys.implementation.name == "cpython":
        sys.path.insert(0, here + "/shim")
    sys.path.insert(0, root + "/firmware")
    sys.path.append(here + "/shim")
    sys.path.append(root)
    return root


set_path()

import esp_clock  # noqa: E402
import esp_machine  # noqa: E402

clock = esp_clock.clock


class _Time:
    """The ESP32's time module."""

    ticks_us = clock.ticks_us
    ticks_ms = clock.ticks_ms
    ticks_diff = clock.ticks_diff


sys.modules["machine"] = esp_machine
hidden = sys.modules.get("time")
sys.modules["time"] = _Time

import controller  # noqa: E402
from esp import i2s, rmt  # noqa: E402
from gpio_esp import EspPort  # noqa: E402

if hidden:
    sys.modules["time"] = hidden

_TURN_US = 400  # of the main loop


class Done(BaseException):
    """The conversation is over."""


class Sender:
    """A Link with a sender at its other end: says one thing, waits for an answer, and so on."""

    def __init__(self, lines: "list[tuple[str, str]]") -> None:
        self._lines = lines
        self._got = ""
        self._until = "Grbl "
        self._deadline = 0
        self.pins: "dict[str, int]" = {}

    def read_into(self, buf: bytearray) -> int:
        clock.advance(clock.us + _TURN_US)
        if clock.us > self._deadline + 60_000_000:
            raise AssertionError("no " + self._until + " in " + self._got)
        if self._until not in self._got or not self._got.endswith("\n"):
            return 0
        self._got = ""
        if not self._lines:
            raise Done
        text, self._until = self._lines.pop(0)
        self._deadline = clock.us
        if text.startswith("pin "):
            _, pin, level = text.split()
            esp_machine.Pin.pins[int(pin)].drive(int(level))
            return 0
        if text.startswith("ms "):
            clock.advance(clock.us + int(text[3:]) * 1000)
            self._got = "\n"
            return 0
        print("> " + text.strip())
        data = text.encode()
        buf[: len(data)] = data
        return len(data)

    def write(self, data: "bytes | bytearray | memoryview") -> None:
        clock.advance(clock.us + len(data) * 87)
        text = bytes(data).decode()
        self._got += text
        print(text.replace("\r", ""), end="")


class Store:
    """Nothing is kept."""

    def load(self, name: str) -> None:
        return None

    def save(self, name: str, lines: object) -> None:
        list(lines)


def machine(board: object, engine: str) -> "tuple[object, EspPort]":
    """Engine and port of a board file."""
    if engine == "i2s":
        made = i2s.I2sEngine(
            board.STEP, board.DIR, board.ENABLE, board.I2S, board.I2S_RATE_HZ, board.I2S_BUFFERS
        )
        return made, EspPort(board, made.enable)
    return rmt.RmtEngine(board.STEP, board.DIR), EspPort(board)


def main() -> None:
    name = sys.argv[1]
    board = getattr(__import__("boards." + name), name)
    sender = Sender(
        [
            ("$X\n", "ok"),
            ("$100=80\n", "ok"),
            ("$101=80\n", "ok"),
            ("$110=2000\n", "ok"),
            ("$110=1000000\n", "error:12"),
            ("G91 G1 X5 Y-3 F1200 M3 S500\n", "ok"),
            ("G0 X-2\n", "ok"),
            ("G4 P0.05\n", "ok"),
            ("?", ">"),
            ("$21=1\n", "ok"),
            ("G1 X20 F1200\n", "ok"),
            ("ms 300", ""),
            ("pin %d 0" % board.LIMIT[0], "ALARM:1"),
            ("\x18", "Grbl "),
        ]
    )
    for pin in board.LIMIT + board.NO_PULL_UP:  # resistors outside
        esp_machine.Pin(pin, esp_machine.Pin.IN).level = 1
    engine, port = machine(board, sys.argv[2] if len(sys.argv) > 2 else board.ENGINE)
    try:
        controller.build(board, sender, port, engine, Store()).run()
    except Done:
        print("done at %d ms" % (clock.us // 1000))


main()
