"""A real board for the self-test: the device of `ugrbl deploy`, and its lines as they arrive.

PATIENCE lengthens time limits if the board is emulated, and slow.
"""

import contextlib
import time
from collections.abc import Callable, Iterator

from mpremote.transport import TransportError  # type: ignore[import-untyped]

from ..connection import Connection, SendError, broke
from ..deploy import DeployError
from ..deploy_device import PATIENCE, MpremoteDevice
from .session import WIRING, Wiring

_NAP_S = 0.05  # between two tries to connect
_BACK_S = 20.0 * PATIENCE  # time limit for the restart


class PromptBoard(MpremoteDevice):
    """A Board as in session.py. heard: called with each line that a script prints."""

    def __init__(self, port: str) -> None:
        self._port_name = port
        super().__init__(port)

    def wiring(self) -> Wiring | None:
        """Return the wiring in its board file; None without the firmware."""
        self._run(WIRING)
        found = self._evaluate("wiring()")
        return Wiring(*found) if found else None

    def run(self, script: str, heard: Callable[[str], None], seconds: float) -> str:
        """Run a script at the prompt and pass on each line. Returns its traceback, or "".
        seconds: the longest time without output."""
        lines = _Lines(heard)
        with self._convert_errors():
            self._transport.exec_raw_no_follow(script)
            _, traceback = self._transport.follow(seconds * PATIENCE, lines.receive)
            return bytes(traceback).decode("utf-8", "replace")

    def until_restart(self, script: str, heard: Callable[[str], None], seconds: float) -> bool:
        """Run a script that never ends, and pass on each line. Returns whether the firmware has
        restarted by itself."""
        lines = _Lines(heard)
        with self._convert_errors():
            self._transport.exec_raw_no_follow(script)
        until = time.monotonic() + seconds * PATIENCE
        has_hung = False  # the script has reported (say.py) that it hangs now
        with contextlib.suppress(OSError):  # USB disappears with the reset
            while time.monotonic() < until:
                lines.receive(self._arrived())
                has_hung = has_hung or b"= hang" in lines.last
                if has_hung and lines.last.startswith(b"Grbl"):  # the welcome after the reset
                    break
        self.close()
        return has_hung and self._is_back()

    def _is_back(self) -> bool:
        """Wait until a Grbl answers on the port again. Return False after _BACK_S."""
        until = time.monotonic() + _BACK_S
        while time.monotonic() < until:
            with contextlib.suppress(SendError, OSError):
                connection = Connection(self._port_name)
                try:
                    return connection.answers()
                finally:
                    connection.close()
            time.sleep(_NAP_S)
        return False

    def start(self) -> None:
        """Leave the prompt and start the firmware."""
        with self._convert_errors():
            self._leave_raw()
            self._transport.serial.write(b"\x04")

    @contextlib.contextmanager
    def _convert_errors(self) -> Iterator[None]:
        """Convert errors on the line to a DeployError, with the next step of a self-test."""
        todo = "unplug the board, plug it in and test again"
        try:
            yield
        except OSError as error:
            raise DeployError(broke(self._port_name), todo) from error
        except TransportError as error:
            raise DeployError(f"the board has stopped answering: {error}", todo) from error


class _Lines:
    """Converts bytes to complete lines. last: the last one."""

    def __init__(self, heard: Callable[[str], None]) -> None:
        self._heard = heard
        self._begun = b""  # bytes of a line that is not complete
        self.last = b""

    def receive(self, piece: bytes) -> None:
        """Pass on the lines that these bytes complete."""
        *whole, self._begun = (self._begun + piece).split(b"\n")
        for line in whole:
            self.last = line.strip()
            self._heard(self.last.decode("utf-8", "replace"))
