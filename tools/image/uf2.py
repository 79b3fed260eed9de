"""UF2: flash as a file, which a chip's boot ROM accepts as a USB mass storage device.

A block of 512 bytes has a page of 256 and its address. The RP2040's ROM erases a sector of 4 KiB
at the first of each 16 blocks, by their numbers, and nowhere else (erratum RP2040-E14). Therefore
blocks are numbered consecutively, and each sector that is touched is complete.
"""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

PAGE = 256
SECTOR = 4096
_BLOCK = 512
_HEAD = struct.Struct("<8I")
_MAGIC = (0x0A324655, 0x9E5D5157)
_MAGIC_END = 0x0AB16F30
_HAS_FAMILY = 0x2000

RP2040 = 0xE48BFF56
RP2350 = 0xE48BFF59  # ARM, secure
CHIPS = {RP2040: "RP2040", RP2350: "RP2350"}


class Uf2Error(ValueError):
    """The file is not UF2, or is for another chip."""


@dataclass
class Flash:
    """Pages of 256 bytes by their address. family: of the chip, one of CHIPS.

    others: blocks of other families, unchanged: a file for RP2350 begins with one that works
    around an erratum of its ROM.
    """

    family: int
    pages: dict[int, bytes] = field(default_factory=dict)
    others: list[bytes] = field(default_factory=list)

    @property
    def start(self) -> int:
        """Return the address of the first page."""
        return min(self.pages, default=0)

    @property
    def end(self) -> int:
        """Return the address after the last page."""
        return max(self.pages, default=-PAGE) + PAGE

    def read(self, address: int, size: int) -> bytes:
        """Return bytes, possibly from several pages; 0xFF where there is no page."""
        first = address - address % PAGE  # the page in which it begins
        pages = range(first, address + size, PAGE)
        content = b"".join(self.pages.get(page, b"\xff" * PAGE) for page in pages)
        return content[address - first : address - first + size]

    def put(self, address: int, sector: bytes) -> None:
        """Add a sector."""
        for at in range(0, SECTOR, PAGE):
            self.pages[address + at] = sector[at : at + PAGE]


def read(data: bytes) -> Flash:
    """Return the content of a file. Uf2Error if it is not a UF2 file, or for none of CHIPS."""
    if not data or len(data) % _BLOCK:
        raise Uf2Error("it is no UF2 file: those are made of blocks of 512 bytes")
    flashes: dict[int, Flash] = {}
    others = []
    blocks = 0  # how many the file should have, as each of them says
    for number, begin in enumerate(range(0, len(data), _BLOCK)):
        block = data[begin : begin + _BLOCK]
        *magic, flags, address, size, _number, count, family = _HEAD.unpack_from(block)
        if tuple(magic) != _MAGIC or block[-4:] != _MAGIC_END.to_bytes(4, "little"):
            raise Uf2Error(f"it is no UF2 file: block {number} is damaged; download it again")
        if family not in CHIPS or not flags & _HAS_FAMILY:
            others.append(block)
        elif size != PAGE or address % PAGE:
            raise Uf2Error(f"block {number} is no page of flash; download it again")
        else:
            blocks = max(blocks, count)
            flash = flashes.setdefault(family, Flash(family))
            flash.pages[address] = block[_HEAD.size : _HEAD.size + PAGE]
    if len(flashes) != 1:
        raise Uf2Error(f"it is not for one of {' and '.join(CHIPS.values())}")
    (flash,) = flashes.values()
    if len(flash.pages) < blocks:
        present = f"{len(flash.pages)} of its {blocks} blocks are there"
        raise Uf2Error(f"it is cut off: {present}; download it again")
    flash.others = others
    return flash


def write(flash: Flash) -> bytes:
    """Return the file: blocks of other families first, then a block for each page, of complete
    sectors. A page that is missing in its sector is 0xFF."""
    addresses = [address for sector in _sectors(flash.pages) for address in sector]
    blocks = list(flash.others)
    for number, address in enumerate(addresses):
        head = _HEAD.pack(
            *_MAGIC, _HAS_FAMILY, address, PAGE, number, len(addresses), flash.family
        )
        page = flash.pages.get(address, b"\xff" * PAGE)
        blocks.append((head + page).ljust(_BLOCK - 4, b"\0") + _MAGIC_END.to_bytes(4, "little"))
    return b"".join(blocks)


def _sectors(pages: Mapping[int, bytes]) -> Iterator[range]:
    """Yield the page addresses of each sector that has a page."""
    for sector in sorted({address - address % SECTOR for address in pages}):
        yield range(sector, sector + SECTOR, PAGE)
