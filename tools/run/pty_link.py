"""Wires to the simulator: a pseudo-terminal that any sender can open, or stdin and stdout."""

import os
import select
import sys
import termios
import time
import tty
from collections.abc import Callable
from pathlib import Path

from .. import paths
from .wire import Wire

# Prefix of a terminal's path in our links only, so that a leftover link can be recognised as ours.
_OURS = "/dev/./"  # a link's target begins so, to be recognised


class Pty(Wire):
    """A pseudo-terminal in raw mode."""

    def __init__(self) -> None:
        super().__init__()
        self._master, slave = os.openpty()  # our end, the senders' end
        tty.setraw(slave)
        self.name = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(self._master, False)
        self._link: Path | None = None

    def link(self, place: Path) -> None:
        """Create a symlink to the terminal. OSError if that is not possible, or if the path exists
        and is not a leftover of ours.

        The link of a simulator that was killed is replaced.
        """
        if not place.parent.is_dir():
            raise OSError(f"{place} cannot be made: there is no folder {place.parent}")
        if self._is_left_behind(place):
            place.unlink()
        try:
            place.symlink_to(self._target())
        except FileExistsError as error:
            why = f"{place} is there already; it is left as it is"
            is_ours = place.is_symlink() and os.readlink(place).startswith(_OURS)
            remedy = "; if no simulator runs there, remove it" if is_ours else ""
            raise FileExistsError(why + remedy) from error
        except OSError as error:
            raise OSError(f"{place} cannot be made: {paths.why(error)}") from error
        self._link = place

    def close(self) -> None:
        """Close the terminal and remove its link."""
        os.close(self._master)
        if self._link and self._link.is_symlink() and os.readlink(self._link) == self._target():
            self._link.unlink()

    def _is_left_behind(self, place: Path) -> bool:
        """Return whether a path is our link to a terminal that no longer exists, or to this
        one."""
        if not place.is_symlink():
            return False
        target = os.readlink(place)
        is_dead = target.startswith(_OURS) and not place.exists()
        return is_dead or target == self._target()

    def _target(self) -> str:
        """Return the terminal's path with our prefix, for a link."""
        return self.name.replace("/dev/", _OURS, 1)

    def _take(self, limit: int) -> bytes | None:
        """Return received bytes; None if no sender is connected."""
        try:
            return os.read(self._master, limit)
        except BlockingIOError:
            return b""
        except OSError:  # EIO: no sender has it open
            return None

    def _put(self, data: bytes) -> int:
        return os.write(self._master, data)

    def _wait_to_put(self, seconds: float) -> None:
        select.select([], [self._master], [], seconds)

    def _wait_to_take(self, seconds: float) -> None:
        select.select([self._master], [], [], seconds)

    def _note_disconnect(self) -> None:
        """Discard what the last sender did not read, so that the next one does not get it."""
        super()._note_disconnect()
        slave = os.open(self.name, os.O_RDWR | os.O_NOCTTY)
        termios.tcflush(slave, termios.TCIOFLUSH)
        os.close(slave)


class Stdio:
    """Standard input and output. The end of input closes the wire."""

    closed = False
    on_open: Callable[[], None]  # never called, because there is only one sender

    def read(self, limit: int) -> bytes:
        """Return received bytes; b"" if there are none."""
        if self.closed or not select.select([0], [], [], 0)[0]:
            return b""
        data = os.read(0, limit)
        self.closed = not data  # the end of input
        return data

    def write(self, data: bytes) -> None:
        """Send bytes."""
        sys.stdout.buffer.write(data)
        sys.stdout.buffer.flush()

    def wait(self, seconds: float) -> None:
        """Wait until bytes arrive, or the time is over."""
        if self.closed:
            time.sleep(seconds)
        else:
            select.select([0], [], [], seconds)

    def close(self) -> None:
        """Do nothing: the streams belong to the process."""
