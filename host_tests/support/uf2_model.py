"""The RP2040's boot ROM, as far as it writes UF2 files to flash, and a chip for it to write to.

As bootrom's virtual_disk.c: blocks of a family are identified by their numbers. The first block
that arrives of each 16 erases the sector of its address; no other block erases. Programming can
only clear bits.
"""

import struct

BASE = 0x10000000
PAGE, SECTOR = 256, 4096
RP2040 = 0xE48BFF56


def load(flash: bytearray, data: bytes, chip: int = RP2040) -> None:
    """Drag the file onto the chip with that flash; chip: the family of its blocks."""
    erased: set[int] = set()
    for at in range(0, len(data), 512):
        _, _, _, address, size, number, _, family = struct.unpack_from("<8I", data, at)
        if family != chip:
            continue
        place = address - BASE
        if number // 16 not in erased:
            erased.add(number // 16)
            sector = place - place % SECTOR
            flash[sector : sector + SECTOR] = b"\xff" * SECTOR
        for i in range(size):
            flash[place + i] &= data[at + 32 + i]
