"""A board with MicroPython on a serial port, accessed through mpremote."""

import contextlib
import functools
import io
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import serial
from mpremote.transport import TransportError  # type: ignore[import-untyped]
from mpremote.transport_serial import SerialTransport  # type: ignore[import-untyped]

from ..boardfile import hal_texts, page_files
from ..compiling import freeze
from .connection import Connection, SendError, broke, is_simulator, way_out
from .deploy import LIST, About, DeployError, Running

# An emulated board is slow: UGRBL_PATIENCE=5 makes all time limits five times as long.
PATIENCE = float(os.environ.get("UGRBL_PATIENCE", "1"))
# Time limits for a status report, the prompt, the start, an answer, and the raw prompt.
_STATUS_S = 2.0 * PATIENCE
_PROMPT_S = 5.0 * PATIENCE
_START_S = 15.0 * PATIENCE
_ANSWER_S = 5.0 * PATIENCE
_RAW_S = 10.0 * PATIENCE
_NAP_S = 0.01  # between two looks at the port
_PIECE = 1024  # bytes per write; the board reads them as text, up to 4 kB
_AT_REST = ("Idle", "Alarm")

_ESCAPE = b"\x03\x03\x03"  # Ctrl-C: opens MicroPython's prompt
_END = b"\x04"  # Ctrl-D at the prompt: a soft reset, which starts main.py
_PROMPT = re.compile(rb">>> $")
# A status report, whose state is the group; or a message in the fault state, or the prompt.
_STATE = re.compile(rb"<([A-Za-z]+)[^>]*>|\[MSG:|>>> ")
# The welcome, or instead of it a prompt or a message.
_STARTED = re.compile(rb"\r\n(Grbl(?:HAL)? \d[^\r\n]*)\r\n|>>> $|\[MSG:[^\]]*\]\r\n")
_BUILD = re.compile(rb"\[VER:([^\]]*)\]|\[(\d[^\]]*)\]")  # of Grbl 1.1, of 0.9
_ANSWERED = re.compile(rb"\]\r\nok\r\n")
_MESSAGE = re.compile(rb"\[MSG:([^\]]*)\]")

_NOT_STARTED = (
    "see what the board says when it starts: mpremote repl, Ctrl-D; deploy with a board file that "
    "is right, or report this"
)

_ABOUT = """(
    getattr(sys.implementation, "_mpy", 0),
    ".".join(map(str, sys.implementation[1][:3])),
    os.uname()[4],
    frozen,
)"""
# The firmware that is frozen in, whatever files the board has.
_FROZEN = """
path, sys.path[:] = sys.path[:], [".frozen"]
try:
    from base.frozen import ABOUT as frozen
except ImportError:
    frozen = ""
sys.path[:] = path
"""
_FREE = "(gc.collect(), gc.mem_free())[1] if globals().get('machine') else -1"
_NAMES = "os.listdir('/{folder}') if {folder!r} in [''] + os.listdir('/') else []"
_TRY_BOARD = """
try:
    import board
except ImportError:
    board = None
"""
_OPTIONS = """{
    "CUSTOM": getattr(board, "CUSTOM", "custom"),
    "OUTPUTS": getattr(board, "OUTPUTS", {}),
    "INPUTS": getattr(board, "INPUTS", {}),
} if board else None"""
_FILES = """
import binascii, hashlib, os
def checksum(path):
    made = hashlib.sha256()
    piece = memoryview(bytearray(512))
    with open(path, "rb") as file:
        while True:
            count = file.readinto(piece)
            if not count:
                return binascii.hexlify(made.digest()).decode()
            made.update(piece[:count])
for folder in {folders!r}:
    try:
        names = [entry[0] for entry in os.ilistdir("/" + folder) if entry[1] == 0x8000]
    except OSError:
        names = []
    for name in names:
        # A tuple here is for MicroPython from 1.25 on.
        if name.endswith(".py") or name.endswith(".mpy") or name in {names!r}:
            path = folder + "/" + name if folder else name
            print(checksum("/" + path), path)
"""


class MpremoteDevice:
    """A Device. Raises DeployError if the port cannot be opened."""

    def __init__(self, port: str) -> None:
        try:
            # For its error text, because mpremote does not give the cause.
            Connection(port).close()
            # On a pseudo-terminal mpremote waits for a byte without checking its own limits.
            self._transport: Any = SerialTransport(port, timeout=_RAW_S)
        except (SendError, TransportError) as error:
            why, _, todo = str(error).partition("; ")  # a SendError has the next step at its end
            raise DeployError(why, todo or "see that it is plugged in, and try again") from error
        # With our time limit for a script, because an emulated board is slow.
        self._transport.exec_raw = functools.partial(self._transport.exec_raw, timeout=_RAW_S)
        self._port = port
        self._received = b""  # by the last _exchange()
        self.told: list[str] = []  # messages of $I after a restart

    def close(self) -> None:
        """Close the port."""
        with contextlib.suppress(OSError):
            self._transport.close()

    # Entering

    def enter(self) -> None:
        """Enter MicroPython's raw prompt, after a soft reset that frees the memory. DeployError if
        the machine is in motion."""
        with self._convert_errors():
            found = self._exchange(b"?", _STATE, _STATUS_S)
            state = found[1].decode() if found and found[1] else ""  # "": no Grbl reports one
            if state and state not in _AT_REST:
                raise DeployError(
                    f"the machine on {self._port} is in {state}, and is not interrupted",
                    f"{way_out(state)}, then deploy again",
                )
            # A board that is silent is not waited for: mpremote tries it below.
            has_prompt = self._exchange(_ESCAPE, _PROMPT, _PROMPT_S if found else 0.0)
            if state and not has_prompt:
                raise self._why_no_prompt(state)
            try:
                self._enter_raw(soft_reset=True)
            except TransportError as error:
                raise self._why_no_prompt(state) from error

    def _why_no_prompt(self, state: str) -> DeployError:
        """Return why the prompt cannot be entered, with the next step. state: of a Grbl that
        answers, or ""."""
        if state and is_simulator(self._port):
            return DeployError(
                f"the simulator answers on {self._port}; it has no MicroPython",
                "name a board's port with --port; `ugrbl ports` lists the ports",
            )
        if state:
            return DeployError(
                f"a Grbl answers on {self._port}, but does not open MicroPython's prompt",
                "is it ugrbl? Hold its button at REPL_PIN, if any, while you plug it in; or "
                "put MicroPython on the board anew: micropython.org/download",
            )
        return DeployError(
            f"no MicroPython answers on {self._port}",
            "is this its port? Put MicroPython on the board (a Pico: hold BOOTSEL while you plug "
            "it in, copy the .uf2 from micropython.org/download); if it is there: plug the board "
            "in anew",
        )

    def about(self) -> About:
        """Return version and processor."""
        self._run("import os, sys" + _FROZEN)
        mpy, version, machine, frozen = self._evaluate(_ABOUT)
        return About(mpy, version, machine, freeze.read(frozen))

    # Files

    def files(self, folders: Iterable[str]) -> dict[str, str]:
        """Return checksums by path, computed on the board, of files of our kinds in these
        folders."""
        script = _FILES.format(
            folders=tuple(folders), names=(LIST, *page_files.names(), hal_texts.name())
        )
        rows = (line.split(" ", 1) for line in self._run(script).splitlines())
        return {path: checksum for checksum, path in rows}

    def read(self, path: str) -> bytes:
        """Return the content of a file."""
        with self._convert_errors():
            return bytes(self._transport.fs_readfile(f"/{path}"))

    def write(self, path: str, content: bytes, progress: Callable[[int], None]) -> None:
        """Create or replace a file. Raises OSError with MicroPython's error number."""
        reported = 0

        def report_piece(count: int, _total: int) -> None:
            """Convert mpremote's count of all bytes so far to those of the last piece."""
            nonlocal reported
            progress(count - reported)
            reported = count

        with self._convert_errors():
            self._transport.fs_writefile(f"/{path}", content, _PIECE, report_piece)

    def remove(self, path: str) -> None:
        """Remove a file, and folders that are then empty."""
        with self._convert_errors():
            self._transport.fs_rmfile(f"/{path}")
            with contextlib.suppress(OSError, TransportError):  # a folder that is not empty
                while path := path.rpartition("/")[0]:
                    self._transport.fs_rmdir(f"/{path}")

    def make_folder(self, path: str) -> None:
        """Create a folder; it may exist."""
        with self._convert_errors(), contextlib.suppress(FileExistsError):
            self._transport.fs_mkdir(f"/{path}")

    def names(self, folder: str) -> list[str]:
        """Return all names in a folder; none if it does not exist."""
        self._run("import os")
        found: list[str] = self._evaluate(_NAMES.format(folder=folder))
        return found

    def rename(self, pairs: "Iterable[tuple[str, str]]") -> None:
        """Rename files one after another, in one script on the board, so that a pulled cable
        cannot interrupt in between."""
        steps = "".join(f"os.rename({f'/{old}'!r}, {f'/{new}'!r})\n" for old, new in pairs)
        self._run(f"import os\n{steps}")

    def options(self) -> dict[str, Any]:
        """Return the options of its board file that concern custom.py and outputs."""
        self._run(_TRY_BOARD)  # board: its module, or None
        found: dict[str, Any] | None = self._evaluate(_OPTIONS)
        if found is None:
            raise DeployError("there is no board.py on it", "put the firmware there: ugrbl deploy")
        return found

    # Leaving

    def restart(self) -> Running:
        """Start the firmware and return what it reports. To measure the memory that the running
        machine leaves free it is ended and started once more (_free_bytes)."""
        with self._convert_errors():
            self._leave_raw()
            banner = self._start()
            build = self._build()
            self.told = [text.decode("latin-1") for text in _MESSAGE.findall(self._received)]
            return Running(banner, build, self._free_bytes())

    def _start(self) -> str:
        """Start main.py from the prompt, and return the welcome."""
        found = self._exchange(_END, _STARTED, _START_S)
        if not found or not found[1]:  # nothing; or a prompt or a message instead of the welcome
            raise DeployError(f"the firmware does not start{self._last_words()}", _NOT_STARTED)
        return found[1].decode("latin-1")

    def _last_words(self) -> str:
        """Return the last message or line received, for an error's text."""
        messages = _MESSAGE.findall(self._received)
        lines = [line for line in self._received.split(b"\r\n") if line.strip()]
        last = messages[-1:] or lines[-1:]
        return f": {last[0].decode('latin-1')}" if last else ": it sends nothing"

    def _build(self) -> str:
        """Return the build that the firmware reports in $I; "" if it does not."""
        if not self._exchange(b"$I\n", _ANSWERED, _ANSWER_S):
            return ""
        found = _BUILD.search(self._received)
        return (found[1] or found[2]).decode("latin-1") if found else ""

    def _free_bytes(self) -> int | None:
        """Return the memory that the machine leaves free, in bytes; None if that is not known.

        main.py keeps the machine while the prompt is open, so it is measured there. Then the
        firmware is started again.
        """
        if not self._exchange(_ESCAPE, _PROMPT, _PROMPT_S):
            return None
        self._enter_raw(soft_reset=False)
        self._run("import gc")
        free: int = self._evaluate(_FREE)  # -1: there is no machine
        self._leave_raw()
        self._start()
        return free if free >= 0 else None

    def _enter_raw(self, soft_reset: bool) -> None:
        """Enter the raw prompt, in which scripts are run."""
        with contextlib.redirect_stdout(io.StringIO()):  # mpremote also reports failures there
            self._transport.enter_raw_repl(soft_reset, _RAW_S)

    def _leave_raw(self) -> None:
        """Leave the raw prompt, and wait for the normal one."""
        self._transport.exit_raw_repl()
        self._exchange(b"", _PROMPT, _PROMPT_S)

    # The serial line

    def _exchange(
        self, sent: bytes, pattern: "re.Pattern[bytes]", seconds: float
    ) -> "re.Match[bytes] | None":
        """Send bytes, then read into _received until the pattern matches it, or the time is over.
        Returns the match."""
        self._received = b""
        until = time.monotonic() + seconds
        try:
            self._transport.serial.write(sent)
            while True:
                self._received += self._arrived()
                found = pattern.search(self._received)
                if found or time.monotonic() >= until:
                    return found
        except OSError as error:
            raise serial.SerialException(str(error)) from error

    def _arrived(self) -> bytes:
        """Return received bytes; b"" after a short wait if there are none."""
        port = self._transport.serial
        waiting = port.in_waiting
        if not waiting:
            time.sleep(_NAP_S)
            return b""
        return bytes(port.read(waiting))

    def _run(self, script: str) -> str:
        """Run a script at the prompt, and return what it prints."""
        with self._convert_errors():
            return bytes(self._transport.exec(script)).decode("utf-8")

    def _evaluate(self, expression: str) -> Any:
        """Return the value of an expression at the prompt."""
        with self._convert_errors():
            return self._transport.eval(expression)

    @contextlib.contextmanager
    def _convert_errors(self) -> Iterator[None]:
        """Convert errors on the line, within this context, to a DeployError."""
        try:
            yield
        except serial.SerialException as error:
            raise DeployError(
                broke(self._port),
                "plug the board in and deploy again: files already copied are not copied again",
            ) from error
        except TransportError as error:
            raise DeployError(
                f"MicroPython on the board has stopped answering as it should: {error}",
                "unplug the board, plug it in and deploy again",
            ) from error
