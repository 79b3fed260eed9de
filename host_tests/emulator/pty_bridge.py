"""Connect an emulated Pico to a pseudo-terminal, for programs that need a serial port.

    python host_tests/emulator/pty_bridge.py RPI_PICO.uf2 /tmp/pico [FOLDER]
    ugrbl deploy --board rpi_pico --port /tmp/pico

Its flash holds the files of the folder, if one is named, and is lost at the end. Its time is
never ahead of real time, and lags while it computes.
"""

import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from chips import power_up
from ugrbl.run.pty_link import Pty

if TYPE_CHECKING:
    from pico import Pico

# Pins with pull-ups, which the emulator does not model: all inputs of rpi_pico.py.
_INPUTS = (9, 10, 11, 12, 13, 14, 15, 22)
_TURN_US = 2000
# Limit of bytes that wait for the chip; a real host's queue is not much longer.
_MOST_WAITING = 512
_NAP_S = 0.002


class _Port(Pty):
    """A pseudo-terminal that signals to the chip whether a program has it open."""

    def __init__(self, pico: "Pico") -> None:
        super().__init__()
        self._pico = pico

    def read(self, limit: int) -> bytes:
        before = self._connected
        data = super().read(limit)
        if self._connected != before and self._pico.usb.connected:
            self._pico.usb.open_port(self._connected)
        return data


class Bridge:
    """A pseudo-terminal connected to an emulated Pico."""

    def __init__(self, pico: "Pico", link: Path) -> None:
        self.stopping = False
        self._pico = pico
        self._port = _Port(pico)
        self._port.link(link)

    def run(self) -> None:
        """Run until stopping is set."""
        pico, port = self._pico, self._port
        begun = time.monotonic()
        while not self.stopping:
            ahead_s = pico.us / 1e6 - (time.monotonic() - begun)
            if ahead_s > 0:
                time.sleep(ahead_s)
            if pico.usb.waiting() < _MOST_WAITING:
                pico.usb.send(port.read(_MOST_WAITING))
            pico.run_us(_TURN_US)
            if pico.usb.received:
                port.write(bytes(pico.usb.received))
                pico.usb.received.clear()
        port.close()


def _files(folder: Path) -> "Iterator[tuple[str, bytes]]":
    for file in folder.rglob("*"):
        if file.is_file():
            yield file.relative_to(folder).as_posix(), file.read_bytes()


def main() -> None:
    """Run until a signal arrives."""
    image, link, *folders = (Path(word) for word in sys.argv[1:])
    pico = power_up(image, {name: data for folder in folders for name, data in _files(folder)})
    for pin in _INPUTS:
        pico.drive(pin, 1)
    bridge = Bridge(pico, link)

    def stop(number: int, frame: "FrameType | None") -> None:
        bridge.stopping = True

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    bridge.run()


if __name__ == "__main__":
    main()
