"""Names of our engines, links and extras in board files, from the firmware's tables."""

from collections.abc import Iterable
from typing import NamedTuple

from .. import paths

# Engine of the simulator's boards; not one of the firmware's.
SIMULATOR = "sim"
# Links with a network, by the link of their cable.
WIRELESS = {"usb": "wifi", "uart": "uart_wifi"}


class Oldest(NamedTuple):
    """The oldest MicroPython for an engine on a chip (in MicroPython's words), and the reason."""

    chip: str
    version: tuple[int, int]
    why: str


class Engine(NamedTuple):
    """A row of firmware/boot/parts.py, except the function that makes the engine."""

    needed: tuple[str, ...]  # options that are required
    pins: tuple[str, ...]  # options with pins of the chip for motors
    most_hz: int
    oldest: tuple[Oldest, ...]

    def runs_on(self, processor: str) -> bool:
        """Return whether it is made for a processor; an ESP32S3 is an ESP32 too."""
        return any(row.chip in processor for row in self.oldest)


def engines() -> dict[str, Engine]:
    """Return every engine by its name."""
    paths.use_firmware()
    from boot import parts

    return {
        name: Engine(needed, pins, most_hz, tuple(Oldest(*row) for row in oldest))
        for name, (_make, needed, pins, most_hz, oldest) in parts._ENGINES.items()
    }


def links() -> Iterable[str]:
    """Return the values of LINK."""
    paths.use_firmware()
    from boot import parts

    return parts._LINKS


def dialects() -> Iterable[str]:
    """Return the values of DIALECT."""
    paths.use_firmware()
    from boot import select_extras

    return select_extras.WORDS["DIALECT"]


def tools() -> Iterable[str]:
    """Return the values of TOOL."""
    paths.use_firmware()
    from boot import select_extras

    return select_extras.WORDS["TOOL"]
