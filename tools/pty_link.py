"""Wires to the simulator: a pseudo-terminal that any sender can open, or stdin and stdout."""

import os
import select
import sys
import termios
import time
import tty
from pathlib import Path

# A sender that has not taken a byte for so long does not listen: what follows is lost on it.
_DEAF_S = 0.5
# What is kept for the first sender to come: the banner.
_KEPT = 1024


class Pty:
    """A pseudo-terminal in raw mode. It outlives its senders."""

    closed = False

    def __init__(self) -> None:
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self.name = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(self._master, False)
        self._link: Path | None = None
        self._connected = False
        self._early = b""
        self._first = True
        self._deaf = False

    def link(self, place: Path) -> None:
        """Put a symlink to it there; one that is there already is replaced, a file is not."""
        if place.exists() and not place.is_symlink():
            raise FileExistsError(f"{place} is there already and is no link")
        new = place.with_name(f".{place.name}.{os.getpid()}")
        new.symlink_to(self.name)
        new.replace(place)
        self._link = place

    def read(self, limit: int) -> bytes:
        """What has come from the sender."""
        try:
            data = os.read(self._master, limit)
        except BlockingIOError:
            data = b""
        except OSError:  # EIO: nobody has it open
            self._set_connected(False)
            return b""
        self._set_connected(True)
        return data

    def write(self, data: bytes) -> None:
        """Send; without a sender, or to one that does not read, the bytes are lost."""
        if not self._connected:
            if self._first:
                self._early = (self._early + data)[-_KEPT:]
            return
        until = time.monotonic() + (0 if self._deaf else _DEAF_S)
        while data:
            try:
                data = data[os.write(self._master, data) :]
                self._deaf = False
            except BlockingIOError:
                select.select([], [self._master], [], max(0.0, until - time.monotonic()))
                if time.monotonic() >= until:
                    self._deaf = True
                    return
            except OSError:
                return

    def wait(self, seconds: float) -> None:
        """Sleep until bytes come; with nobody there, for the time given."""
        if self._connected:
            select.select([self._master], [], [], seconds)
        else:
            time.sleep(seconds)

    def close(self) -> None:
        """Take the terminal and its link away."""
        os.close(self._master)
        if self._link and self._link.is_symlink() and os.readlink(self._link) == self.name:
            self._link.unlink()

    def _set_connected(self, connected: bool) -> None:
        if connected == self._connected:
            return
        self._connected = connected
        if connected:
            self._first = False
            early, self._early = self._early, b""
            self.write(early)
        else:
            self._deaf = False
            self._forget()

    def _forget(self) -> None:
        """What the last sender did not read is not for the next one."""
        slave = os.open(self.name, os.O_RDWR | os.O_NOCTTY)
        termios.tcflush(slave, termios.TCIOFLUSH)
        os.close(slave)


class Stdio:
    """Standard input and output. Input that ends closes the wire."""

    closed = False

    def read(self, limit: int) -> bytes:
        """What has come."""
        if self.closed or not select.select([0], [], [], 0)[0]:
            return b""
        data = os.read(0, limit)
        self.closed = not data
        return data

    def write(self, data: bytes) -> None:
        """Send."""
        sys.stdout.buffer.write(data)
        sys.stdout.buffer.flush()

    def wait(self, seconds: float) -> None:
        """Sleep until something comes."""
        if self.closed:
            time.sleep(seconds)
        else:
            select.select([0], [], [], seconds)

    def close(self) -> None:
        """Nothing to take away."""
