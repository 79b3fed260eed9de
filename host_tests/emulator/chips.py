"""Define the emulated chips that tests can run on: one table has their differences.

UGRBL_CHIP names one (`make test-emulator CHIP=rp2350`); the default is a Pico's RP2040. A bench is
the chip and its surroundings: pico.py is the RP2040's, pico2.py the RP2350's, and both have the
same interface for tests. An "esp32" has a bench and tests of its own: qemu_esp32.py.
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
    """A change of a pin."""

    ns: float
    pin: int
    level: int


class Chip(NamedTuple):
    """A chip, its image and its memory."""

    name: str
    board: str  # our board in boards/ with the common pins
    image: str  # environment variable that names MicroPython's image
    download: str  # its name at micropython.org/download
    mhz: int
    file_system: int  # place in flash, in MicroPython 1.28
    blocks: int  # size of the file system
    stack_top: int
    family: int  # family id of its UF2 blocks
    irqs: tuple[int, int, int]  # timer, the engine's PIO 1, and pins

    @property
    def flash(self) -> int:
        """Return the bytes of flash on the board."""
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
    """Return a littlefs image with these files, by path. Raise Uf2Error if they do not fit."""
    image = bytearray(b"\xff" * (BLOCK * CHIP.blocks))
    for place, sector in sectors_of(files, len(image)).items():
        image[place : place + len(sector)] = sector
    return bytes(image)


def power_up(uf2: Path, files: "Mapping[str, bytes] | None" = None, cache: bool = False) -> "Pico":
    """Return a bench of the chip, as in pico.py; a Pico2 has the same except for its cache."""
    if CHIP.name == "rp2350":
        from pico2 import Pico2

        assert not cache, "there is no model of the RP2350's cache"
        return Pico2(uf2, files)
    from pico import Pico

    return Pico(uf2, files, cache)


class Bench:
    """Common part of both benches; us, run_us() and access to flash are their own."""

    us: float  # emulated microseconds since power-up
    run_us: "Callable[[float], None]"
    read_flash: "Callable[[int, int], bytes]"
    write_flash: "Callable[[int, bytes], None]"

    def run_until(self, done: "Callable[[], bool]", limit_us: float, step_us: float = 500) -> bool:
        """Let the chip run until done() is true; return False after limit_us."""
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
        """Return the content of the file system."""
        return self.read_flash(CHIP.file_system, BLOCK * CHIP.blocks)
