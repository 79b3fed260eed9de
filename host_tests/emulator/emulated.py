"""Run the whole firmware on an emulated board, with a sender at the other end."""

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
from ugrbl.image import contents
from ugrbl.paths import BOARDS
from ugrbl.run import machine
from ugrbl.run.program import ProgramLink
from ugrbl.sim.engine import step_tick

if TYPE_CHECKING:
    from pico import Pico

# The common board of the chip that tests run on.
BOARD_FILE = BOARDS / f"{CHIP.board}.py"

STEP = (2, 3, 4)
DIR = (5, 6, 7)
ENABLE = 8
LIMIT = (9, 10, 11)
PROBE = 12
RESET, HOLD, START = 13, 14, 15
SPINDLE_PWM = 16
# The inputs are not wired. The emulator does not model their pull-ups, so tests drive them high.
INPUTS = (*LIMIT, PROBE, RESET, HOLD, START, 22)

_BOOT_US = 3_000_000
_ANSWER_US = 2_000_000


@cache
def firmware(frozen: str = "") -> "Mapping[str, bytes]":
    """Return the files that `ugrbl deploy` copies to a Pico, by path.

    frozen: id of the firmware that its MicroPython contains.
    """
    return freeze.not_frozen(build.for_board(BOARD_FILE), frozen).files


@cache
def frozen_in(uf2: Path) -> str:
    """Return the id of our firmware that is frozen in that image, or ""."""
    return contents.read(uf2).frozen


def build_id() -> str:
    """Return the build id that the firmware of the common board reports."""
    return build.id_of(load_board(CHIP.board).MPY_ARCH)


def for_this_chip(board: Path, more: str = "") -> Path:
    """Return one of our board files for the chip that tests run on, with these lines added.

    A board with a radio gets the module with that chip and a radio.
    """
    text = board.read_text("utf-8")
    chip, arch = re.findall(
        r"^(?:CHIP|MPY_ARCH) = .*$", BOARD_FILE.read_text("utf-8"), re.MULTILINE
    )
    if arch not in text:
        radio = re.search(r'^CHIP = "\w+_w"', text, re.MULTILINE)
        text += "\n" + (chip[:-1] + '_w"' if radio else chip) + f"\n{arch}"
    made = Path(mkdtemp()) / board.name
    made.write_text(f"{text}\n{more}", "utf-8")
    return made


@cache
def files_of(board: str) -> "Mapping[str, bytes | None]":
    """Return the changes for Board() that turn a Pico into one of our boards."""
    files = build.for_board(for_this_chip(BOARDS / f"{board}.py")).files
    return {**dict.fromkeys(firmware()), **files}


def altered(old: str, new: str) -> "Mapping[str, bytes]":
    """Return the files of the firmware with one text replaced in exactly one of its sources."""
    read = build._text
    changed_sources = set()

    def text(source: str) -> str:
        content = read(source)
        if old in content:
            changed_sources.add(source)
        return content.replace(old, new)

    with patch.object(build, "_text", text):
        files = build.for_board(BOARD_FILE).files
    assert len(changed_sources) == 1, f"{old!r} is in {sorted(changed_sources)}"
    return files


class Sender(ABC):
    """A sender at an emulated board, which runs while the sender waits."""

    @property
    @abstractmethod
    def output(self) -> str:
        """Return the board's output since it was cleared."""

    @abstractmethod
    def clear_output(self) -> None:
        """Clear the output."""

    @abstractmethod
    def wait_for(self, text: str, limit_us: float = _ANSWER_US) -> str:
        """Let the chip run until its output contains the text; return the output."""

    @abstractmethod
    def send(self, text: "str | bytes") -> None:
        """Send bytes to the board."""

    def ask(self, line: str, until: str = "ok\r\n", limit_us: float = _ANSWER_US) -> str:
        """Send a line and return its answer."""
        self.clear_output()
        self.send(line + "\n")
        return self.wait_for(until, limit_us)

    def status(self) -> "dict[str, str]":
        """Return the fields of a status report; the state is under "state"."""
        self.clear_output()
        self.send("?")
        report = self.wait_for(">\r\n").partition("<")[2].partition(">")[0]
        state, *fields = report.split("|")
        return {"state": state, **dict(field.split(":", 1) for field in fields)}

    def python(self, code: str, prompt: str = "Here is the REPL") -> str:
        """Go to MicroPython's raw prompt (Ctrl-C, Ctrl-A), run code and return its output."""
        self.send("\x03\x03\x03")
        self.wait_for(prompt)
        self.send("\x01")
        self.wait_for("raw REPL; CTRL-B to exit\r\n>")
        return self.python_again(code)

    def python_again(self, code: str) -> str:
        """Run more code at the prompt and return its output."""
        self.clear_output()
        self.send(code + "\x04")
        self.wait_for("\x04>", 10_000_000)
        return self.output.removeprefix("OK").partition("\x04")[0]


class Board(Sender):
    """A Pico with the firmware on it.

    changes: files that replace or extend the common ones. cache: use the model of the flash cache
    (xip.py).
    """

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
        """Run until the welcome; return self."""
        self.wait_for(until, _BOOT_US)
        return self

    def settled(self) -> "Board":
        """Run until a first start is complete; return self."""
        self.wait_for("[MSG:First start: factory settings]\r\n")
        self.ask("")
        return self

    @property
    def output(self) -> str:
        """Return the bytes received over USB since they were cleared, as text."""
        return self.pico.usb.received.decode("latin-1")

    def clear_output(self) -> None:
        """Clear the output."""
        self.pico.usb.received.clear()

    def wait_for(self, text: str, limit_us: float = _ANSWER_US) -> str:
        """Let the chip run until its output contains the text; return the output."""
        has_come = self.pico.run_until(lambda: text in self.output, limit_us)
        assert has_come, f"no {text!r} in {self.output!r}"
        return self.output

    def send(self, text: "str | bytes") -> None:
        """Send bytes to the board."""
        self.pico.usb.send(text.encode() if isinstance(text, str) else text)

    def until_idle(self, limit_us: float = 10_000_000) -> None:
        """Wait until the machine is idle.

        As with Grbl, a ? right after an answer may be handled before the motion of that line
        starts, so there is a pause before the first one.
        """
        end = self.pico.us + limit_us
        self.pico.run_us(5_000)
        while self.status()["state"] != "Idle":
            assert self.pico.us < end, f"not idle: {self.output}"
            self.pico.run_us(20_000)


def steps(edges: "list[Edge]", axis: int) -> "list[tuple[float, int]]":
    """Return (us, +1 or -1) for every step of an axis in recorded edges."""
    found = []
    sign = 1
    for edge in edges:
        if edge.pin == DIR[axis]:
            sign = -1 if edge.level else 1
        elif edge.pin == STEP[axis] and edge.level:
            found.append((edge.ns / 1000, sign))
    return found


class Odometer:
    """Count the steps of every motor, from the recorded edges and the levels of DIR."""

    def __init__(
        self, pico: "Pico", step: "tuple[int, ...]" = STEP, direction: "tuple[int, ...]" = DIR
    ) -> None:
        self._pico = pico
        self._step, self._direction = step, direction
        self._signs = [1 for _ in step]
        self._steps = [0 for _ in step]

    def read(self) -> "list[int]":
        """Count the new edges and clear them; return the steps."""
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
    """Return the steps of a program in the simulator, in the form of steps()."""

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
