"""Run a real MicroPython image on a Raspberry Pi Pico 2 in the emulator rp2350js.

The emulator is a process (rp2350_bench.js) that reads one command a line, so this is as
synchronous and deterministic as pico.py. UGRBL_RP2350JS names its folder: a copy in which these
faults of 2.0.1 are corrected. ADD with PC and a high register is 2 off; registers of the pins'
interrupts and instructions of the GPIO coprocessor are decoded wrongly; floats are not rounded
(VRINT, so floor() is wrong); edges are recorded that did not occur, and none for an input that
IRQOVER inverts; flash cannot be written; core 1 cannot be restarted; pads have no pull-ups; the
watchdog's clock is twice as fast, and its reset leaves the peripherals unchanged. Cores and PIO
are stepped at 150 MHz. Flash takes no time and has no cache, so counts, order and PIO's times are
exact, lines/s less so.
"""

import json
import os
import subprocess
from base64 import b64decode, b64encode
from collections.abc import Callable, Mapping
from heapq import heappop, heappush
from pathlib import Path
from shutil import which
from typing import Any

from chips import Bench, Edge, file_system

_BENCH = Path(__file__).with_name("rp2350_bench.js")
_FOLDER = "UGRBL_RP2350JS"
_DTR_RTS = 3


def lacks() -> str:
    """Return why the emulator cannot run here, or an empty text."""
    folder = os.environ.get(_FOLDER, "")
    if not folder:
        return f"{_FOLDER} names no folder: a built rp2350js, see pico2.py"
    if not (Path(folder) / "dist" / "cjs" / "index.js").is_file():
        return f"{_FOLDER}: there is no dist/cjs/index.js in {folder}"
    if "flashChip" not in (Path(folder) / "dist/cjs/peripherals/xip_rp2350.js").read_text():
        return f"{_FOLDER}: flash cannot be written in {folder}, as in rp2350js as it comes"
    return "" if which("node") else "there is no node to run rp2350js"


class _Process:
    """The emulator's process. Its commands are in rp2350_bench.js."""

    def __init__(self, uf2: Path) -> None:
        command = ["node", str(_BENCH), os.environ[_FOLDER], str(uf2)]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def ask(self, *command: object) -> Any:
        """Send a command and return its answer."""
        assert self._process.stdin and self._process.stdout
        self._process.stdin.write(json.dumps(command).encode() + b"\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        assert line, f"the emulator has ended at {command[0]!r}: see its output above"
        return json.loads(line)

    def __del__(self) -> None:
        self._process.kill()
        self._process.wait()


class _Usb:
    """The host's end of the serial line over USB."""

    def __init__(self, ask: "Callable[..., Any]") -> None:
        self._ask = ask
        self.received = bytearray()
        self.connected = 0  # how often the chip has been enumerated
        self.queued = 0

    def send(self, data: bytes) -> None:
        self._ask("send", b64encode(data).decode())
        self.queued += len(data)

    def open_port(self, is_open: bool) -> None:
        """Open or close the port as a program does, which sets DTR."""
        self._ask("line_state", _DTR_RTS if is_open else 0)

    def ask(self, line_state: "int | None") -> None:
        """Send a control request: SET_CONTROL_LINE_STATE (1: DTR, 2: RTS), or SET_LINE_CODING."""
        if line_state is None:
            self._ask("line_coding")
        else:
            self._ask("line_state", line_state)

    def read(self, on: bool) -> None:
        """Let the host read the chip's output, or leave it unread."""
        self._ask("read", on)

    def waiting(self) -> int:
        """Return the number of bytes that the chip has not read yet."""
        return self.queued


class Pico2(Bench):
    """An emulated Pico 2. files: its file system at first power-up, by path."""

    def __init__(self, uf2: Path, files: "Mapping[str, bytes] | None" = None) -> None:
        self.ask = _Process(uf2).ask
        self.usb = _Usb(self.ask)
        self.edges: list[Edge] = []
        self.power_writes: list[tuple[float, int]] = []
        self.on_erase: Callable[[], None] = lambda: None  # a sector of flash
        self._ns = 0.0
        self._actions: list[tuple[float, int, Callable[[], None]]] = []
        if files is not None:
            self.put_file_system(file_system(files))

    # Time

    @property
    def us(self) -> float:
        """Return the emulated microseconds since power-up."""
        return self._ns / 1000

    def run_us(self, us: float) -> None:
        """Let the chip run for this time."""
        end = self._ns + us * 1000
        while self._ns < end:
            self._run_to(min(end, self._actions[0][0]) if self._actions else end)
            while self._actions and self._actions[0][0] <= self._ns:
                heappop(self._actions)[2]()

    def _run_to(self, ns: float) -> None:
        """Run to this time, or to the next erasure of a sector."""
        done = self.ask("run", ns)
        self._ns = done["nanos"]
        self.usb.received += b64decode(done["said"])
        self.usb.connected, self.usb.queued = done["connected"], done["waiting"]
        self.edges += [Edge(*each) for each in done["edges"]]
        self.power_writes += [(ns / 1000, level) for ns, level in done["powers"]]
        for _ in range(done["erased"]):
            self.on_erase()
        assert not done["writtenInMotion"], "flash is written while motors turn"

    def at_us(self, delay_us: float, action: "Callable[[], None]") -> None:
        """Call action after this time."""
        due = self._ns + delay_us * 1000
        heappush(self._actions, (due, len(self._actions), action))

    # Pins

    def record(self, pins: "list[int]") -> None:
        """Log the edges of these pins from now on in self.edges."""
        for pin in pins:
            self.ask("record", pin)

    def drive(self, pin: int, level: "int | None") -> None:
        """Drive an input from outside; None lets it float."""
        self.ask("drive", pin, level)

    def level(self, pin: int) -> "int | None":
        """Return the level of an output; None if the pin is not an output."""
        level: int | None = self.ask("level", pin)
        return level

    def watch_power(self, pin: int) -> "list[tuple[float, int]]":
        """Return a list that collects (us, level) of writes to the pin's PWM compare register."""
        self.ask("watch_power", pin)
        return self.power_writes

    def moving(self) -> bool:
        """Return whether a PIO machine is busy: all of ours wait for a word while motors stand."""
        return bool(self.ask("moving"))

    # Memory

    def erase_takes_us(self, us: float) -> None:
        """Let every later erasure of a sector take this time: the emulator takes none."""
        self.ask("erase_takes", us * 1000)

    def read_flash(self, at: int, size: int) -> bytes:
        """Return the content of flash."""
        return b64decode(self.ask("read_flash", at, size))

    def write_flash(self, at: int, data: bytes) -> None:
        """Write flash as a programmer does, without the chip."""
        self.ask("write_flash", at, b64encode(data).decode())

    def read_word(self, address: int) -> int:
        """Read a word of the chip's memory or registers."""
        return int(self.ask("read_word", address))

    def write_word(self, address: int, value: int) -> None:
        """Write a word of the chip's memory or registers."""
        self.ask("write_word", address, value)

    def stack(self) -> "tuple[int, int]":
        """Return the stack pointer, and the number of the running interrupt, or 0."""
        pointer, number = self.ask("core")
        return pointer, number
