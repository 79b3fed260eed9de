"""Stream programs of real CAM software, as a sender with a window and a latency sees it.

The programs are in the project's shared folder (../shared/gcode, README.md there); without it this
part has no rows. Feed rates are replaced by one that no line reaches, and the settings let the
machine follow, so that the firmware is the limit and not the motion. Lines that would stop the
machine are left out.
"""

import re
from collections import deque
from collections.abc import Iterator
from itertools import cycle, islice
from pathlib import Path
from typing import NamedTuple

from bench_setup import Bench
from emulated import Board
from on_board import PLAIN
from rows import Row
from streaming import idle, stream
from wire import EmulatedWire, Talk

_FOLDER = Path(__file__).resolve().parents[3] / "shared" / "gcode"
_LINES = {
    "jscut": ("jscut_tball_pocket.gcode", 1),
    "Fusion": ("fusion360_grbl_adaptive.nc", 1),
}
_ARCS = {
    "FreeCAD gear": ("freecad_grbl_gear.nc", 1),
    "CamBam panel": ("cambam_panel.nc", 1),
}
_SETTINGS = (
    *("$0=3", "$1=255", "$10=3", "$11=0.5", "$100=80", "$101=80", "$102=80"),
    *("$110=180000", "$111=180000", "$112=180000"),
    *("$120=500000", "$121=500000", "$122=500000"),
)
_FEED = "F180000"
_STOPS = re.compile(r"M0?[0126]\b|M30|G28|G53|^%|^T\d|G64|G40")
_BLOCKS = 63
_QUERY_US = 199_700
_SECONDS = 10


class Host(NamedTuple):
    """A sender: bytes that it has under way at most, and its latency each way, in us."""

    window: int
    latency_us: float

    def __str__(self) -> str:
        return f"window {self.window}, {self.latency_us / 1000:.0f} ms each way"


HOSTS = (Host(255, 0), Host(127, 1000))


class DistantWire(EmulatedWire):
    """A Wire on which bytes take some time in both directions."""

    def __init__(self, board: Board, latency_us: float) -> None:
        super().__init__(board)
        self._latency_us = latency_us
        self._read = self.received
        self._under_way: deque[tuple[float, bytes]] = deque()
        self.received = bytearray()
        self.send = self._send

    def _send(self, data: bytes) -> None:
        pico = self.board.pico
        pico.at_us(self._latency_us, lambda: pico.usb.send(data))

    def turn(self) -> None:
        super().turn()
        now = self.now_us()
        if self._read:
            self._under_way.append((now + self._latency_us, bytes(self._read)))
            self._read.clear()
        while self._under_way and self._under_way[0][0] <= now:
            self.received += self._under_way.popleft()[1]


def program(name: str) -> "list[str]":
    """Return the lines of a program of _FOLDER that move, at a feed rate out of reach."""
    text = (_FOLDER / name).read_text("utf-8").splitlines()
    kept = (line.strip() for line in text if not _STOPS.search(re.sub(r"\(.*?\)", "", line)))
    return [re.sub(r"F[\d.]+", _FEED, line) for line in kept if line]


def programs(bench: Bench) -> Iterator[Row]:
    """Time these programs for 10 s each, with `?` each 0.2 s, for each kind of host."""
    if not (bench.emulated and _FOLDER.is_dir()):
        return
    for host in HOSTS:
        for name, (file, _) in {**_LINES, **_ARCS}.items():
            yield from _streamed(bench, name, file, host)


def _streamed(bench: Bench, name: str, file: str, host: Host) -> Iterator[Row]:
    board = bench.pico(PLAIN)
    talk = Talk(DistantWire(board, host.latency_us))
    for line in (*_SETTINGS, "G90", "G0X0Y0Z0"):
        talk.ask(line)
    idle(talk)
    sent = islice(cycle(program(file)), int(_SECONDS * 2500))
    made = stream(talk, list(sent), _BLOCKS, _QUERY_US, host.window, _SECONDS * 1e6)
    yield Row(f"{name}, {host}", made.lines_s, "lines/s")
    yield Row(f"{name}, {host}: least blocks waiting", made.waiting)
    talk.wire.send(b"\x18")
    talk.wait(b"Grbl")
    talk.pause_us(20_000)
    talk.ask("$X")
