"""A flash chip with a littlefs, and a power cut at every write to it."""

from __future__ import annotations

import errno
import os
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable

littlefs = pytest.importorskip("littlefs")

BLOCK, BLOCKS, PAGE = 4096, 32, 256


class Flash(littlefs.UserContext):
    """A flash chip that records every operation that changes it."""

    def __init__(self, image: bytes | None = None) -> None:
        super().__init__(BLOCK * BLOCKS)
        if image is not None:
            self.buffer[:] = image
        self.log: list[tuple[int, bytes]] = []

    def prog(self, cfg: Any, block: int, off: int, data: bytes) -> int:
        self.log.append((block * cfg.block_size + off, bytes(data)))
        return super().prog(cfg, block, off, data)

    def erase(self, cfg: Any, block: int) -> int:
        self.log.append((block * cfg.block_size, b"\xff" * cfg.block_size))
        return super().erase(cfg, block)


def cut(image: bytes, log: list[tuple[int, bytes]], whole: int, torn: int) -> bytes:
    """Return the chip after `whole` complete operations and `torn` bytes of the next."""
    chip = bytearray(image)
    for at, data in log[:whole]:
        chip[at : at + len(data)] = data
    if whole < len(log):
        at, data = log[whole]
        chip[at : at + torn] = data[:torn]
    return bytes(chip)


class Files:
    """`os` and `open` for the store, on that chip."""

    def __init__(self, flash: Flash, fresh: bool) -> None:
        self.fs = littlefs.LittleFS(
            context=flash, block_size=BLOCK, block_count=BLOCKS, mount=False, prog_size=256
        )
        if fresh:
            self.fs.format()
        self.fs.mount()

    def open(self, path: str, mode: str = "r") -> Any:
        try:
            return self.fs.open(path, mode)
        except littlefs.LittleFSError as error:
            raise OSError(path) from error
        except FileNotFoundError as error:  # it has no errno here
            raise OSError(errno.ENOENT, path) from error

    def mkdir(self, path: str) -> None:
        try:
            self.fs.mkdir(path)
        except FileExistsError as error:
            raise OSError(errno.EEXIST, path) from error

    def rename(self, old: str, new: str) -> None:
        self.fs.rename(old, new)

    def urandom(self, size: int) -> bytes:
        return os.urandom(size)


class BlockDevice:
    """The same chip as MicroPython's rp2.Flash and esp32.Partition give it to Python."""

    def __init__(self, flash: Flash) -> None:
        self.flash = flash
        self.on_write: Callable[[], None] = lambda: None

    def ioctl(self, request: int, _: int) -> int:
        assert request == 4
        return BLOCKS

    def readblocks(self, block: int, data: bytearray, offset: int) -> None:
        at = BLOCK * block + offset
        data[:] = self.flash.buffer[at : at + len(data)]

    def writeblocks(self, block: int, data: bytearray, offset: int) -> None:
        """Program without erasing: bits can only become 0."""
        assert offset % PAGE == len(data) % PAGE == 0
        at = BLOCK * block + offset
        there = bytes(self.flash.buffer[at : at + len(data)])
        left = bytes(old & new for old, new in zip(there, data, strict=True))
        self.on_write()
        self.flash.log.append((at, left))
        self.flash.buffer[at : at + len(data)] = left
