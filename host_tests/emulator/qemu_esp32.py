"""Run a real MicroPython image on an ESP32 in QEMU.

The emulator is a process. Its time is that of the executed instructions, so the result does not
depend on how busy this computer is. UGRBL_QEMU_ESP32 names it: qemu-system-xtensa of
lcgamboa/qemu, with these faults corrected: inputs are low in spite of their pull-ups, RMT does not
take the time of its pulses, its cores take turns of milliseconds, each core has a PSRAM of its
own, and all flash is read again after each access. It also has to write the changes of pins to
the file that UGRBL_PINS names: "G ns changed levels" for pins 0 to 31, "R ns channel word
divider" when a channel begins to send. There is no I2S and no PCNT.
"""

import os
import re
import subprocess
import time
from collections.abc import Mapping
from pathlib import Path
from tempfile import mkdtemp
from typing import NamedTuple

from emulated import Sender
from serial import Serial
from ugrbl.image.file_system import make as sectors_of

_QEMU = "UGRBL_QEMU_ESP32"
IMAGE = "UGRBL_ESP32_BIN"
_IMAGE_AT, _FILES_AT, _FLASH = 0x1000, 0x200000, 4 << 20
_PATIENCE_S = 600.0  # on a computer with other work to do
# An instruction takes 4 ns, as at 240 MHz.
_CLOCK = "shift=2,align=off,sleep=off"


def lacks() -> str:
    """Return why the emulator cannot run here, or an empty text."""
    named = os.environ.get(_QEMU, "")
    if not named:
        return f"{_QEMU} names no emulator: qemu-system-xtensa, see qemu_esp32.py"
    if not Path(named).is_file():
        return f"{_QEMU}: there is no file {named}"
    named = os.environ.get(IMAGE, "")
    if not named:
        return f"{IMAGE} names no image: ESP32_GENERIC-SPIRAM-….bin of micropython.org/download"
    return "" if Path(named).is_file() else f"{IMAGE}: there is no file {named}"


class Step(NamedTuple):
    """A step pulse begins on this channel of RMT while these pins (a mask) are high."""

    us: float
    channel: int
    levels: int


class Esp32(Sender):
    """An emulated ESP32, not powered yet.

    files: its file system at first power-up, by path. psram: whether its module has 4 MB of it.
    """

    def __init__(self, image: Path, files: "Mapping[str, bytes]", psram: bool = True) -> None:
        self._folder = Path(mkdtemp())
        self._psram = psram
        self._process: subprocess.Popen[str] | None = None
        self.port: Serial
        self.received = bytearray()
        flash = bytearray(b"\xff" * _FLASH)
        there = image.read_bytes()
        flash[_IMAGE_AT : _IMAGE_AT + len(there)] = there
        for place, sector in sectors_of(files, _FLASH - _FILES_AT).items():
            flash[_FILES_AT + place : _FILES_AT + place + len(sector)] = sector
        (self._folder / "flash").write_bytes(flash)

    # Power

    def power_on(self) -> "Esp32":
        """Start the emulator and open its UART, a pseudo-terminal, with pyserial; return self."""
        drive = f"file={self._folder / 'flash'},if=mtd,format=raw"
        memory = ("-m", "4M") if self._psram else ()
        command = [os.environ[_QEMU], "-machine", "esp32", *memory, "-icount", _CLOCK]
        command += ["-drive", drive, "-display", "none", "-monitor", "none", "-serial", "pty"]
        self._process = subprocess.Popen(
            command,
            env={**os.environ, "UGRBL_PINS": str(self._folder / "pins")},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        assert self._process.stdout
        for line in self._process.stdout:
            if terminal := re.search(r"/dev/\S+", line):
                self.port = Serial(terminal[0], timeout=0.1)
                return self
        raise AssertionError("the emulator has ended")

    def power_off(self) -> None:
        """Cut the power at once."""
        if self._process:
            self._process.kill()
            self._process.wait()
            self._process = None
            self.port.close()
            self.received.clear()

    __del__ = power_off

    # The serial line

    @property
    def output(self) -> str:
        return self.received.decode("latin-1")

    def clear_output(self) -> None:
        self.received.clear()

    def send(self, text: "str | bytes") -> None:
        self.port.write(text.encode("latin-1") if isinstance(text, str) else text)

    def wait_for(self, text: str, limit_us: float = 0) -> str:
        """Wait as a Board does, but with a limit in this computer's time; limit_us is ignored."""
        end = time.monotonic() + _PATIENCE_S
        while text not in self.output:
            assert time.monotonic() < end, f"no {text!r} in {self.output!r}"
            self.received += self.port.read(max(1, self.port.in_waiting))
        return self.output

    def boot(self) -> "Esp32":
        """Run until it answers; a first start stores the factory settings. Return self."""
        self.wait_for("Grbl 1.1h")
        self.ask("")
        return self

    def wait_for_state(self, state: str) -> "dict[str, str]":
        """Let the machine run until it is in this state; return the report."""
        end = time.monotonic() + _PATIENCE_S
        while (report := self.status())["state"] != state:
            assert time.monotonic() < end, f"not {state}: {report}"
        return report

    # Pins

    def steps(self) -> "list[Step]":
        """Return the step pulses that RMT has sent so far: the rises of its level."""
        found = []
        levels = 0
        ends: dict[int, float] = {}
        for line in (self._folder / "pins").read_text().splitlines():
            kind, *numbers = line.split()
            if kind == "G":
                levels = int(numbers[2])
                continue
            ns, channel, word, divider = map(int, numbers)
            at = max(ns / 1000, ends.get(channel, 0.0))
            for half in (word & 0xFFFF, word >> 16):
                if half >> 15:
                    found.append(Step(at, channel, levels))
                at += (half & 0x7FFF) * divider / 80
            ends[channel] = at
        return found
