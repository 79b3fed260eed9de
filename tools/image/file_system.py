"""The file system of a board, as MicroPython makes it on RP2040 and RP2350: littlefs."""

from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any

from littlefs import LittleFS, LittleFSError, UserContext

from .uf2 import SECTOR, Uf2Error

_PROG_SIZE = 256
_TEMPORARY = ".passing"
_DISK_VERSION = 0x00020000  # 2.0; every MicroPython reads this version


class _Chip(UserContext):
    """Flash that records which blocks were read."""

    def __init__(self, size: int) -> None:
        super().__init__(size)
        self.seen: set[int] = set()

    def read(self, cfg: Any, block: int, off: int, size: int) -> bytearray:
        """Read a block. Called by littlefs."""
        self.seen.add(block)
        found: bytearray = super().read(cfg, block, off, size)
        return found


def make(files: Mapping[str, bytes], size: int) -> dict[int, bytes]:
    """Return a file system of `size` bytes with these files, by path: its sectors of 4 KiB, by
    their offset. Uf2Error if they do not fit.

    Sectors that are never read are left out. Blank ones that are read are included: of the two
    blocks of each folder littlefs uses the newer, and that might otherwise be a leftover of an
    older file system.
    """
    chip = _Chip(size)
    disk = _littlefs(chip)
    disk.format()
    disk.mount()
    name = ""  # of the file that is being written
    try:
        for name, content in files.items():
            folder = PurePosixPath(name).parent
            if folder.name:
                disk.makedirs(str(folder), exist_ok=True)
            with disk.open(name, "wb") as file:
                file.write(content)
        _write_root_anew(disk, chip)
    except LittleFSError as error:
        raise Uf2Error(f"{name} does not fit into the {size // 1024} KiB of flash") from error
    disk.unmount()
    chip.seen.clear()
    _read_all(_littlefs(chip))  # the chip notes in `seen` the blocks that are read
    image = bytes(chip.buffer)
    offsets = sorted(SECTOR * block for block in chip.seen)
    return {offset: image[offset : offset + SECTOR] for offset in offsets}


def _write_root_anew(disk: LittleFS, chip: _Chip) -> None:
    """Rewrite the root folder until littlefs compacts it. A folder is a log that is read to its
    end for each name; the compacted one has only the final state of its entries.

    Creating and removing a file adds to the log, until it is compacted, with a new revision.
    """
    before = _revisions(chip)
    while _revisions(chip) == before:
        with disk.open(_TEMPORARY, "wb"):
            pass
        disk.remove(_TEMPORARY)


def _revisions(chip: _Chip) -> bytes:
    """Return the revisions of the root's two blocks, which alternate."""
    return bytes(chip.buffer[:4] + chip.buffer[SECTOR : SECTOR + 4])


def _littlefs(chip: _Chip) -> LittleFS:
    """Return littlefs on a chip, with MicroPython's block sizes, not mounted."""
    return LittleFS(
        context=chip,
        block_size=SECTOR,
        block_count=len(chip.buffer) // SECTOR,
        prog_size=_PROG_SIZE,
        read_size=_PROG_SIZE,
        disk_version=_DISK_VERSION,
        mount=False,
    )


def _read_all(disk: LittleFS) -> None:
    """Read every file, as a board may, so that the chip records all blocks in use."""
    disk.mount()
    for folder, _, names in disk.walk("/"):
        for name in names:
            with disk.open(f"{folder.rstrip('/')}/{name}", "rb") as file:
                file.read()
    disk.unmount()
