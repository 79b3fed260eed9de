"""Stream programs of real CAM software, as a sender with a window and a latency sees it.

The programs are in the project's shared folder (../shared/gcode, README.md there); without it this
part has no rows. Feed rates are replaced by one at which the machine would need so many lines per
second (ASKED), and the settings let it follow, so that the firmware is the limit. Lines that would
stop the machine, and the first ones of jscut and Fusion (a head, and helices), are left out.
"""

import re
from collections import deque
from collections.abc import Iterator
from itertools import cycle, islice
from math import dist
from pathlib import Path
from typing import NamedTuple

from bench_setup import Bench
from emulated import Board
from on_board import PLAIN
from rows import Row
from streaming import idle, stream
from wire import EmulatedWire, Talk

_FOLDER = Path(__file__).resolve().parents[3] / "shared" / "gcode"


class Program(NamedTuple):
    """A program; its first line that counts; lines per second asked for."""

    file: str
    first: int
    asked: float


PROGRAMS = {
    "jscut": Program("jscut_tball_pocket.gcode", 20, 2200),
    "Fusion": Program("fusion360_grbl_adaptive.nc", 695, 2200),
    "FreeCAD gear": Program("freecad_grbl_gear.nc", 0, 400),
    "CamBam panel": Program("cambam_panel.nc", 0, 1500),
}
_SETTINGS = (
    *("$0=3", "$1=255", "$10=3", "$11=0.5", "$100=40", "$101=40", "$102=40"),
    *("$110=360000", "$111=360000", "$112=360000"),
    *("$120=500000", "$121=500000", "$122=500000"),
)
_STOPS = re.compile(r"M0?[0126]\b|M30|G28|G53|^%|^T\d|G64|G40")
_COMMENT = re.compile(r"\(.*?\)|;.*")
_WORD = re.compile(r"([XYZ])(-?[\d.]+)")
_BLOCKS = 63
_QUERY_US = 199_700


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
    """Return the lines of a program that move, at the feed rate that asks for its lines/s."""
    file, first, asked = PROGRAMS[name]
    text = (_FOLDER / file).read_text("utf-8").splitlines()[first:]
    kept = [line.strip() for line in text if not _STOPS.search(_COMMENT.sub("", line))]
    kept = [line for line in kept if line]
    feed = f"F{60 * asked * _length_mm(kept) / len(kept):.0f}"
    return [f"G1{feed}", *(re.sub(r"F[\d.]+", feed, line) for line in kept)]


def _length_mm(lines: "list[str]") -> float:
    """Return the length of the path, with arcs as straight lines."""
    place, length = {"X": 0.0, "Y": 0.0, "Z": 0.0}, 0.0
    for line in lines:
        before = tuple(place.values())
        place.update((axis, float(mm)) for axis, mm in _WORD.findall(_COMMENT.sub("", line)))
        length += dist(before, place.values())
    return length


def programs(bench: Bench) -> Iterator[Row]:
    """Time these programs for 10 s each, with `?` each 0.2 s, for each kind of host."""
    if not (bench.emulated and _FOLDER.is_dir()):
        return
    for host in HOSTS:
        for name in PROGRAMS:
            yield from of_program(bench, name, host)


def of_program(bench: Bench, name: str, host: Host, seconds: float = 10) -> Iterator[Row]:
    """Yield the rows of one program and one kind of host."""
    board = bench.pico(PLAIN)
    talk = Talk(DistantWire(board, host.latency_us))
    for line in (*_SETTINGS, "G90", "G0X0Y0Z0"):
        talk.ask(line)
    idle(talk)
    sent = list(islice(cycle(program(name)), int(seconds * 2500)))
    figures = stream(talk, sent, _BLOCKS, _QUERY_US, host.window, seconds * 1e6)
    yield Row(f"{name}, {host}", figures.lines_s, "lines/s")
    yield Row(f"{name}, {host}: least blocks waiting", figures.waiting)
    talk.wire.send(b"\x18")
    talk.wait(b"Grbl")
    talk.pause_us(20_000)
    talk.ask("$X")
