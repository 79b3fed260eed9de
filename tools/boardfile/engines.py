"""Engines, links and extras of ours, as a board file calls them: out of the firmware's tables."""

from collections.abc import Iterable
from typing import NamedTuple

from .. import paths

# Who makes the pulses of the simulator's boards: none of the firmware's engines.
SIMULATOR = "sim"
# Links with a network, by that of the cable.
WIRELESS = {"usb": "wifi", "uart": "uart_wifi"}


class Oldest(NamedTuple):
    """Which MicroPython an engine wants on a chip, as MicroPython calls that, and what for."""

    chip: str
    version: tuple[int, int]
    why: str


class Engine(NamedTuple):
    """A row of firmware/boot/parts.py, but for the function that makes it."""

    needed: tuple[str, ...]  # options
    pins: tuple[str, ...]  # options that are the chip's, of its motors
    most_hz: int
    oldest: tuple[Oldest, ...]

    def runs_on(self, processor: str) -> bool:
        """Whether it is made for that; an ESP32S3 is an ESP32 too."""
        return any(row.chip in processor for row in self.oldest)


def engines() -> dict[str, Engine]:
    """Every engine by its name."""
    paths.use_firmware()
    from boot import parts

    return {
        name: Engine(needed, pins, hz, tuple(Oldest(*row) for row in oldest))
        for name, (_, needed, pins, hz, oldest) in parts._ENGINES.items()
    }


def links() -> Iterable[str]:
    """The words that LINK has."""
    paths.use_firmware()
    from boot import parts

    return parts._LINKS


def dialects() -> Iterable[str]:
    """The words that DIALECT has."""
    paths.use_firmware()
    from boot import select_extras

    return select_extras.WORDS["DIALECT"]


def tools() -> Iterable[str]:
    """The words that TOOL has."""
    paths.use_firmware()
    from boot import select_extras

    return select_extras.WORDS["TOOL"]
