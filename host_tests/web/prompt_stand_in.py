"""Stand in for a board with MicroPython's prompt and files, on the wire of bridge.py.

For tests of the setup. The desktop's MicroPython runs the Python code in a folder that stands for
the board's flash. The start is the firmware's own code: it imports board.py, checks the options
and reports faults in its own words. The machine that runs afterwards is the simulator. The
prompt's output follows MicroPython's shared/runtime/pyexec.c.
host_tests/emulator/test_page_emulated.py tests the real prompt.
"""

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bridge import _BINARY, Machine, Socket
from micropython_runner import MICROPYTHON, placed_firmware

PICO = "Raspberry Pi Pico with RP2040"
_BANNER = b"\r\nMicroPython v1.28.0 on 2026-01-01; " + PICO.encode() + b"\r\n>>> "
_RAW = b"raw REPL; CTRL-B to exit\r\n>"
# Runs scripts one after the other in one interpreter; prints \x04, the traceback, \x04 after each.
_DRIVER = """
import io, sys
machine, has = sys.argv[1:3]
if has.startswith("frozen"):
    import base.frozen
    base.frozen.ABOUT = "ugrbl frozen: 0123abcd" + has[len("frozen"):]
names = {"__name__": "__main__"}
while True:
    line = sys.stdin.readline()
    if not line:
        break
    code = sys.stdin.buffer.read(int(line)).decode().replace('"/', '"./')
    code = code.replace('getattr(sys.implementation, "_machine", "")', repr(machine))
    fault = ""
    try:
        exec(compile(code, "<stdin>", "exec"), names)
    except BaseException as error:
        said = io.StringIO()
        sys.print_exception(error, said)
        fault = said.getvalue()
    print("\\x04" + fault.replace("\\n", "\\r\\n") + "\\x04", end="")
"""
# Prints nothing if the firmware starts, else its message.
_START = """
import sys
sys.path.insert(0, "./")
from boot.power_up import _text
try:
    import board
    from boot.options import Options
    Options(board)
except Exception as fault:
    print(_text(fault), end="")
"""


class PromptBoard:
    """Replace a Machine. has: how ugrbl is installed, "frozen", "frozen 0.0.1" (with its version),
    "files" or "nothing"."""

    def __init__(
        self, folder: Path, make_machine: Callable[[], Machine], has: str = "frozen"
    ) -> None:
        self.folder = folder
        self.machine: "Machine | None" = None
        self.damage = b""  # bytes lost on the way to the board
        self.sent = bytearray()
        self._make_machine = make_machine
        self._has = has
        self._firmware = placed_firmware()  # no later start waits for it
        self._mode = "friendly"
        self._line = bytearray()
        self._message = b""
        self._escapes = 0
        self._sinks: "list[Socket]" = []
        self._python: "subprocess.Popen[bytes] | None" = None
        if has == "files":
            (folder / "main.py").write_text("# ugrbl")

    # The interface that bridge.py uses

    def attach(self, sink: Socket) -> None:
        self._sinks.append(sink)
        if self.machine:
            self.machine.attach(sink)

    def detach(self, sink: Socket) -> None:
        self._sinks.remove(sink)

    def write(self, data: bytes) -> None:
        self.sent += data
        if self.damage:
            data = data.replace(self.damage, b"")
        if self._mode == "machine":
            self._to_machine(data)
        else:
            for byte in data:
                self._byte(bytes([byte]))

    def close(self) -> None:
        if self.machine:
            self.machine.close()
        self._end_python()

    def power_up(self) -> None:
        """Start as after plugging in."""
        self._start()

    def cut_power(self) -> None:
        """Stop everything at once, and close the connections, as after unplugging."""
        if self.machine:
            self.machine.close()
            self.machine = None
        for sink in self._sinks:
            sink.close()

    # The prompt

    def _say(self, data: bytes) -> None:
        for sink in list(self._sinks):
            sink.send(_BINARY, data)

    def _byte(self, byte: bytes) -> None:
        if self._mode == "stuck":
            self._say(self._message)
            if byte == b"\x03":
                self._prompt()
        elif self._mode == "raw":
            self._raw(byte)
        else:
            self._friendly(byte)

    def _prompt(self) -> None:
        self._mode = "friendly"
        self._line.clear()
        self._say(_BANNER)

    def _friendly(self, byte: bytes) -> None:
        if byte == b"\x01":
            self._mode = "raw"
            self._line.clear()
            self._say(_RAW)
        elif byte == b"\x02":
            self._prompt()
        elif byte in (b"\x03", b"\r"):
            self._line.clear()
            self._say(b"\r\n>>> ")
        elif byte == b"\x04" and not self._line:
            self._end_python()
            self._say(b"\r\nMPY: soft reboot\r\n")
            self._start()
        else:
            self._line += byte
            self._say(byte)

    def _raw(self, byte: bytes) -> None:
        if byte == b"\x02":
            self._prompt()
        elif byte == b"\x03":
            self._line.clear()
        elif byte == b"\x01":
            self._say(_RAW)
        elif byte != b"\x04":
            self._line += byte
        elif not self._line:
            self._end_python()
            self._say(b"OK\r\nMPY: soft reboot\r\n" + _RAW)
        else:
            code = self._line.decode()
            self._line.clear()
            self._say(b"OK" + self.run(code) + b">")

    def run(self, code: str) -> bytes:
        """Return a script's output, \\\\x04, its traceback, \\\\x04."""
        if self._python is None:
            self._python = self._interpreter(_DRIVER, PICO, self._has)
        put: Any = self._python.stdin
        took: Any = self._python.stdout
        put.write(b"%d\n%s" % (len(code), code.encode()))
        put.flush()
        said = b""
        while said.count(b"\x04") < 2:
            piece = took.read1(4096)
            assert piece, "the desktop's MicroPython has ended"
            said += piece
        return said

    def _interpreter(self, script: str, *words: str) -> "subprocess.Popen[bytes]":
        assert MICROPYTHON
        return subprocess.Popen(
            [MICROPYTHON, "-X", "heapsize=16M", "-c", script, *words],
            cwd=self.folder,
            env={"MICROPYPATH": f"{self._firmware}:.frozen"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )

    def _end_python(self) -> None:
        if self._python:
            self._python.kill()
            self._python.communicate()
        self._python = None

    # The machine

    def _start(self) -> None:
        if self._has == "nothing":
            self._prompt()
            return
        said = self._interpreter(_START).communicate()[0]
        if said:
            self._message = b"[MSG:" + said + b"]\r\n"
            self._say(self._message)
            # main.py ends if no link is known yet; otherwise it repeats the message for ever.
            has_link = b"'board'" not in said and b"Syntax" not in said
            self._mode = "stuck" if has_link else "friendly"
            if not has_link:
                self._prompt()
            return
        self._mode = "machine"
        if self.machine:
            self.machine.close()
        self.machine = self._make_machine()
        self._say(bytes(self.machine.said))  # output received before the sockets were attached
        for sink in self._sinks:
            self.machine.attach(sink)

    def _to_machine(self, data: bytes) -> None:
        assert self.machine
        for byte in data:
            self._escapes = self._escapes + 1 if byte == 3 else 0
            if self._escapes == 3:
                self._escapes = 0
                self.machine.close()
                self.machine = None
                self._say(b"[MSG:Here is the REPL]\r\n")
                self._prompt()
                return
            if byte != 3:
                self.machine.write(bytes([byte]))
