"""`make bench-board`: what a board can do, as a table. UGRBL_UF2 names an image, or PORT a board.

Emulated times are those of the emulated chip; on hardware they are this computer's, USB included,
and what has to be looked at from inside or at the pins is left out.
"""

import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

_HERE = Path(__file__).resolve().parent
sys.path[:0] = [
    str(_HERE),
    str(_HERE.parent / "emulator"),
    str(_HERE.parent / "shim"),
    str(_HERE.parent.parent / "firmware"),
]

from emulated import Board  # noqa: E402
from streaming import (  # noqa: E402
    SETTINGS,
    arcs,
    figures,
    idle,
    query_idle_us,
    raster,
    short_moves,
    stream,
)
from wire import EmulatedWire, SerialWire, Talk  # noqa: E402

Row = tuple[str, float, str]

_ASKED = 700  # lines/s that the feed of the short moves makes of them
_CHORD_MM = 0.05
_BLOCKS = 15

# Commands of the benchmark's own, in the main.py of the emulated board.
MAIN = b"""
import gc
import time

import commands
import power_up

usual = commands.Commands.execute


def execute(self, line, length):
    what = bytes(line[1:length])
    if what == b"FREE":
        since = time.ticks_us()
        gc.collect()
        self._report.message("%d %d." % (gc.mem_free(), time.ticks_us() - since))
    elif what == b"ALLOC":
        self._report.message("%d 0." % gc.mem_alloc())
    elif what == b"COUNT":
        count = 0
        since = time.ticks_us()
        while time.ticks_diff(time.ticks_us(), since) < 100000:
            count += 1
        self._report.message("%d 0." % count)
    else:
        usual(self, line, length)


commands.Commands.execute = execute
power_up.main()
"""

# Moves that go on for longer than they are looked at.
_LONG = {
    "1 axis, 1 kHz": ("G91 G1 X100 F240",),
    "1 axis, 100 kHz": ("G91 G1 X100 F24000",),
    "3 axes, 70 kHz": ("G91 G1 X100 Y90 Z80 F29000",),
    "50 blocks/s": ("G91", *(f"G1 X0.4 Y{0.3 + 0.01 * (k % 3):.2f} F1500" for k in range(14))),
}


def inside(talk: Talk, command: str) -> tuple[int, int]:
    """Two numbers that a command of our own has found."""
    said = talk.ask(command).partition("[MSG:")[2].partition(".")[0]
    first, second = said.split()
    return int(first), int(second)


def memory(talk: Talk) -> Iterator[Row]:
    """Heap while the machine runs."""
    free, us = inside(talk, "$FREE")
    yield "memory free", free / 1000, "kB"
    yield "a collection", us / 1000, "ms"


def share(talk: Talk) -> Iterator[Row]:
    """What the pulse engine's interrupt takes of the processor."""
    idle(talk)
    at_rest, _ = inside(talk, "$COUNT")
    for name, lines in _LONG.items():
        for line in lines:
            talk.ask(line)
        talk.pause_us(30_000)
        moving, _ = inside(talk, "$COUNT")
        yield f"interrupt's share, {name}", 100 * (1 - moving / at_rest), "%"
        _stop(talk)


def _stop(talk: Talk) -> None:
    talk.wire.received.clear()
    talk.wire.send(b"!")
    talk.pause_us(60_000)
    talk.wire.send(b"\x18")
    talk.wait(b"Grbl")
    talk.pause_us(20_000)
    talk.ask("$X")


def queries(talk: Talk) -> Iterator[Row]:
    """Status reports at rest."""
    mean, worst = figures(query_idle_us(talk, 8))
    yield "? at rest, mean", mean, "ms"
    yield "? at rest, worst", worst, "ms"


def lines(talk: Talk) -> Iterator[Row]:
    """Streams."""
    feed = f"F{_ASKED * _CHORD_MM * 60:.0f}"
    moves = [line.replace("F9000", feed) for line in short_moves(200)]
    for line in ("G90", "G0X10Y10"):
        talk.ask(line)
    idle(talk)
    made = stream(talk, moves, _BLOCKS)
    yield f"short moves, {_ASKED} asked", made.lines_s, "lines/s"
    idle(talk)
    made = stream(talk, moves, _BLOCKS, query_every_us=40_000)
    yield "short moves with ? every 40 ms", made.lines_s, "lines/s"
    yield "least blocks in the planner then", made.waiting, ""
    yield "? while streaming, mean", figures(made.query_us)[0], "ms"
    yield "? while streaming, worst", figures(made.query_us)[1], "ms"
    idle(talk)
    talk.ask("$C")
    yield "short moves, check mode", stream(talk, moves, _BLOCKS).lines_s, "lines/s"
    talk.wire.send(b"$C\n")
    talk.wait(b"Grbl")
    talk.pause_us(20_000)


def special_lines(talk: Talk) -> Iterator[Row]:
    """A laser's raster, and arcs."""
    for line in ("$32=1", "M4S0", "G90G1X10Y10F4000"):
        talk.ask(line)
    idle(talk)
    yield "raster, G1 X S in M4", stream(talk, list(raster(120)), _BLOCKS).lines_s, "lines/s"
    talk.ask("G0X10Y10")
    idle(talk)
    yield "half circles of 1 mm", stream(talk, list(arcs(8)), _BLOCKS).lines_s, "lines/s"


def measure(show: Callable[[Row], None]) -> None:
    """All of it."""
    port = os.environ.get("PORT")
    if port:
        talk = Talk(SerialWire(port))
        talk.wire.send(b"\x18")
        talk.wait(b"Grbl")
        parts = (queries, lines, special_lines)
    else:
        board = Board(Path(os.environ["UGRBL_UF2"]), {"main.py": MAIN}).boot()
        show(("power-up to welcome, first start", board.pico.us / 1000, "ms"))
        talk = Talk(EmulatedWire(board.settled()))
        parts = (memory, queries, lines, special_lines, share)
    print(talk.wire.kind)
    for setting in SETTINGS:
        talk.ask(setting)
    for part in parts:
        for row in part(talk):
            show(row)


def main() -> None:
    """Print rows as they come."""
    if not os.environ.get("PORT") and not os.environ.get("UGRBL_UF2"):
        sys.exit("which board? UGRBL_UF2=RPI_PICO-….uf2 make bench-board, or PORT=/dev/ttyACM0")
    measure(lambda row: print(f"{row[0]:<36}{row[1]:10.1f} {row[2]}", flush=True))


if __name__ == "__main__":
    main()
