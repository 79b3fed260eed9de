"""The whole firmware on an emulated board, and a sender at its other end."""

import re
from abc import ABC, abstractmethod
from array import array
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING
from unittest.mock import patch

from chips import CHIP, Edge, power_up
from motion.layout import ROW_AXES, ROW_DIRS, ROW_STRIDE
from ugrbl.boardfile.files import load_board
from ugrbl.compiling import build, freeze
from ugrbl.compiling.freeze import Frozen
from ugrbl.image import contents
from ugrbl.paths import BOARDS
from ugrbl.run import machine
from ugrbl.run.program import ProgramLink
from ugrbl.sim.engine import step_tick

if TYPE_CHECKING:
    from pico import Pico

# The usual board of the chip that tests run on.
BOARD_FILE = BOARDS / f"{CHIP.board}.py"

STEP = (2, 3, 4)
DIR = (5, 6, 7)
ENABLE = 8
LIMIT = (9, 10, 11)
PROBE = 12
RESET, HOLD, START = 13, 14, 15
SPINDLE_PWM = 16
# No board is wired to its inputs: they have pull-ups, which the emulator does not know.
INPUTS = (*LIMIT, PROBE, RESET, HOLD, START, 22)

_BOOT_US = 3_000_000
_ANSWER_US = 2_000_000


@cache
def firmware(frozen: "Frozen | None" = None) -> "Mapping[str, bytes]":
    """What `ugrbl deploy` puts on a Pico, by path. frozen: what its MicroPython has of it."""
    return freeze.beside(build.for_board(BOARD_FILE), frozen).files


@cache
def frozen_in(uf2: Path) -> "Frozen | None":
    """Our firmware in that image."""
    return contents.read(uf2).frozen


def build_id() -> str:
    """What the firmware of the usual board tells of its build."""
    return build.id_of(load_board(CHIP.board).MPY_ARCH)


def for_this_chip(board: Path, more: str = "") -> Path:
    """One of our boards with the chip that tests run on in place of its own, and more lines."""
    chip = re.findall(r"^(?:CHIP|MPY_ARCH) = .*$", BOARD_FILE.read_text("utf-8"), re.MULTILINE)
    made = Path(mkdtemp()) / board.name
    made.write_text("\n".join((board.read_text("utf-8"), *chip, more)), "utf-8")
    return made


@cache
def files_of(board: str) -> "Mapping[str, bytes | None]":
    """What makes one of our boards of what is on a Pico: changes for Board()."""
    files = build.for_board(for_this_chip(BOARDS / f"{board}.py")).files
    return {**dict.fromkeys(firmware()), **files}


def altered(old: str, new: str) -> "Mapping[str, bytes]":
    """The same, where one text in one of its sources reads otherwise."""
    read = build._text
    found = set()

    def text(source: str) -> str:
        there = read(source)
        if old in there:
            found.add(source)
        return there.replace(old, new)

    with patch.object(build, "_text", text):
        files = build.for_board(BOARD_FILE).files
    assert len(found) == 1, f"{old!r} is in {sorted(found)}"
    return files


class Sender(ABC):
    """A sender at an emulated board, which runs while something is waited for."""

    @property
    @abstractmethod
    def said(self) -> str:
        """All that the board has said since it was cleared last."""

    @abstractmethod
    def forget(self) -> None:
        """Clear what has been said."""

    @abstractmethod
    def wait_for(self, text: str, limit_us: float = _ANSWER_US) -> str:
        """Let the chip run until it has said the text; returns all it has said."""

    @abstractmethod
    def send(self, text: "str | bytes") -> None:
        """Bytes from the sender."""

    def ask(self, line: str, until: str = "ok\r\n", limit_us: float = _ANSWER_US) -> str:
        """Send a line and return its answer."""
        self.forget()
        self.send(line + "\n")
        return self.wait_for(until, limit_us)

    def status(self) -> "dict[str, str]":
        """The fields of a status report; the state under "state"."""
        self.forget()
        self.send("?")
        report = self.wait_for(">\r\n").partition("<")[2].partition(">")[0]
        state, *fields = report.split("|")
        return {"state": state, **dict(field.split(":", 1) for field in fields)}

    def python(self, code: str, prompt: str = "Here is the REPL") -> str:
        """Ask for MicroPython's prompt and run code in it; returns what it prints."""
        self.send("\x03\x03\x03")
        self.wait_for(prompt)
        self.send("\x01")
        self.wait_for("raw REPL; CTRL-B to exit\r\n>")
        return self.python_again(code)

    def python_again(self, code: str) -> str:
        """The same at the prompt."""
        self.forget()
        self.send(code + "\x04")
        self.wait_for("\x04>", 10_000_000)
        return self.said.removeprefix("OK").partition("\x04")[0]


class Board(Sender):
    """A Pico with the firmware on it. changes: files in place of, or besides, the usual ones.
    cache: with the model of the flash cache (xip.py)."""

    def __init__(
        self,
        uf2: Path,
        changes: "Mapping[str, bytes | None] | None" = None,
        cache: bool = False,
    ) -> None:
        files = {**firmware(frozen_in(uf2)), **(changes or {})}
        there = {name: data for name, data in files.items() if data is not None}
        self.pico = power_up(uf2, there, cache)
        for pin in INPUTS:
            self.pico.drive(pin, 1)

    def boot(self, until: str = "Grbl 1.1h") -> "Board":
        """Run until the welcome; returns self."""
        self.wait_for(until, _BOOT_US)
        return self

    def settled(self) -> "Board":
        """Run until a first start is through; returns self."""
        self.wait_for("[MSG:First start: factory settings]\r\n")
        self.ask("")
        return self

    @property
    def said(self) -> str:
        """All that has come over USB since it was cleared last."""
        return self.pico.usb.received.decode("latin-1")

    def forget(self) -> None:
        """Clear what has been said."""
        self.pico.usb.received.clear()

    def wait_for(self, text: str, limit_us: float = _ANSWER_US) -> str:
        """Let the chip run until it has said the text; returns all it has said."""
        found = self.pico.run_until(lambda: text in self.said, limit_us)
        assert found, f"no {text!r} in {self.said!r}"
        return self.said

    def send(self, text: "str | bytes") -> None:
        """Bytes from the sender."""
        self.pico.usb.send(text.encode() if isinstance(text, str) else text)

    def until_idle(self, limit_us: float = 10_000_000) -> None:
        """Let the machine finish. As with Grbl, a ? right behind an answer may be ahead of the
        start of what the line has planned, so there is a pause before the first."""
        end = self.pico.us + limit_us
        self.pico.run_us(5_000)
        while self.status()["state"] != "Idle":
            assert self.pico.us < end, f"not idle: {self.said}"
            self.pico.run_us(20_000)


def steps(edges: "list[Edge]", axis: int) -> "list[tuple[float, int]]":
    """(us, +1 or -1) of every step of an axis in recorded edges."""
    found = []
    sign = 1
    for edge in edges:
        if edge.pin == DIR[axis]:
            sign = -1 if edge.level else 1
        elif edge.pin == STEP[axis] and edge.level:
            found.append((edge.ns / 1000, sign))
    return found


class Odometer:
    """Steps made by every motor since then, out of the recorded edges and the levels of DIR."""

    def __init__(
        self, pico: "Pico", step: "tuple[int, ...]" = STEP, direction: "tuple[int, ...]" = DIR
    ) -> None:
        self._pico = pico
        self._step, self._direction = step, direction
        self._signs = [1 for _ in step]
        self._steps = [0 for _ in step]

    def read(self) -> "list[int]":
        """Take in the edges there are, and clear them."""
        for edge in self._pico.edges:
            if edge.pin in self._direction:
                self._signs[self._direction.index(edge.pin)] = -1 if edge.level else 1
            elif edge.pin in self._step and edge.level:
                motor = self._step.index(edge.pin)
                self._steps[motor] += self._signs[motor]
        self._pico.edges.clear()
        return list(self._steps)


def planned(
    lines: "Sequence[str]", settings: "Sequence[str]", board: str = "sim"
) -> "list[list[tuple[float, int]]]":
    """The same of a program in the simulator."""

    def script(link: ProgramLink) -> "Iterator[tuple[int, bytes] | None]":
        for setting in settings:
            yield 0, setting.encode()
            yield None
        for number, line in enumerate(lines, 1):
            yield number, line.encode()
        yield None

    def trace(start: int, row: "array[int]") -> None:
        for axis, track in enumerate(tracks):
            base = ROW_AXES + ROW_STRIDE * axis
            sign = -1 if row[ROW_DIRS] >> axis & 1 else 1
            for k in range(row[base]):
                track.append(((start + step_tick(row, base, k)) * us, sign))

    tracks: list[list[tuple[float, int]]] = [[], [], []]
    rig = machine.build(board, lambda rig: ProgramLink(rig, script))
    us = 1e6 / rig.engine.tick_hz
    rig.engine.trace = trace
    machine.run(rig)
    assert not rig.link.result.errors
    return tracks
