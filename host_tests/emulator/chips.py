"""The chips that tests can run on, emulated: what differs between them stands in one table.

UGRBL_CHIP names one (`make test-emulator CHIP=rp2350`); a Pico's RP2040 where it does not. A bench
is the chip with what surrounds it: pico.py has that of the RP2040, pico2.py that of the RP2350,
and what tests use of either is the same. An "esp32" has a bench and tests of its own:
qemu_esp32.py.
"""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ugrbl.image import uf2
from ugrbl.image.file_system import make as sectors_of

if TYPE_CHECKING:
    from pico import Pico

BLOCK = 4096  # of flash, and of its file system


class Edge(NamedTuple):
    """A pin has changed."""

    ns: float
    pin: int
    level: int


class Chip(NamedTuple):
    """One of them."""

    name: str
    board: str  # of ours, in boards/: the usual pins
    image: str  # variable of the environment that names MicroPython's image
    download: str  # its name at micropython.org/download
    mhz: int
    file_system: int  # where in flash MicroPython 1.28 keeps it
    blocks: int  # that it has
    stack_top: int
    family: int  # of its blocks in UF2 files
    irqs: tuple[int, int, int]  # of the timer, of the engine's PIO 1, and of the pins

    @property
    def flash(self) -> int:
        """Bytes of flash on the board."""
        return self.file_system + BLOCK * self.blocks


CHIPS = {
    chip.name: chip
    for chip in (
        Chip(
            *("rp2040", "rpi_pico", "UGRBL_UF2", "RPI_PICO", 125),
            *(0xA0000, 352, 0x20042000, uf2.RP2040, (3, 9, 13)),
        ),
        Chip(
            *("rp2350", "rpi_pico2", "UGRBL_RP2350_UF2", "RPI_PICO2", 150),
            *(0x100000, 768, 0x20082000, uf2.RP2350, (3, 17, 21)),
        ),
    )
}
NAME = os.environ.get("UGRBL_CHIP") or "rp2040"
CHIP = CHIPS.get(NAME, CHIPS["rp2040"])


def file_system(files: "Mapping[str, bytes]") -> bytes:
    """A littlefs image for the board with these files, by path. Uf2Error where they do not fit."""
    image = bytearray(b"\xff" * (BLOCK * CHIP.blocks))
    for place, sector in sectors_of(files, len(image)).items():
        image[place : place + len(sector)] = sector
    return bytes(image)


def power_up(uf2: Path, files: "Mapping[str, bytes] | None" = None, cache: bool = False) -> "Pico":
    """A bench of the chip, as pico.py describes it; a Pico2 has the same but for its cache."""
    if CHIP.name == "rp2350":
        from pico2 import Pico2

        assert not cache, "there is no model of the RP2350's cache"
        return Pico2(uf2, files)
    from pico import Pico

    return Pico(uf2, files, cache)


class Bench:
    """What both benches have in common. us, run_us() and the flash are each one's own."""

    us: float  # emulated microseconds since power-up
    run_us: "Callable[[float], None]"
    read_flash: "Callable[[int, int], bytes]"
    write_flash: "Callable[[int, bytes], None]"

    def run_until(self, done: "Callable[[], bool]", limit_us: float, step_us: float = 500) -> bool:
        """Let the chip run until done() says so; returns False where it never does."""
        end = self.us + limit_us
        while not done():
            if self.us >= end:
                return False
            self.run_us(step_us)
        return True

    def put_file_system(self, image: bytes) -> None:
        """Replace the file system."""
        self.write_flash(CHIP.file_system, image)

    def flash_image(self) -> bytes:
        """The file system as it is now."""
        return self.read_flash(CHIP.file_system, BLOCK * CHIP.blocks)
