"""Binary info: what a program for RP2040 or RP2350 says about itself, for tools that read its
file.

Near its beginning are two marks, and between them the position of a list of pointers. Each points
to a type, a tag, and data (pico-sdk, src/common/pico_binary_info).
"""

import struct
from collections.abc import Iterator
from typing import NamedTuple

from .uf2 import Flash, Uf2Error

_FLASH = 0x10000000  # its address
_MARKS = (0x7188EBF2, 0xE71AA390)
_SEARCHED = 4096  # bytes; the marks follow 256 bytes of boot stage on RP2040, 1 KiB on RP2350
_MOST_ENTRIES = 1000
_ID_AND_STRING, _BLOCK_DEVICE = 6, 7
_NAME, _VERSION = 0x02031C86, 0x11A9BC3A


class About(NamedTuple):
    """What a MicroPython says about itself. start, size: of its file system, address and bytes."""

    name: str
    version: str
    start: int
    size: int


def about(flash: Flash) -> About:
    """Return the info; Uf2Error if it is not a MicroPython with an empty file system in flash.

    An entry has its type and tag, then for a text its id and address, for a block device, after
    another word, its address in flash and its size.
    """
    texts: dict[int, str] = {}  # by id
    devices: list[tuple[int, int]] = []  # address, size
    for entry in _entries(flash):
        kind, _tag = struct.unpack("<2H", flash.read(entry, 4))
        if kind == _ID_AND_STRING:
            number, pointer = struct.unpack("<2I", flash.read(entry + 4, 8))
            # At most 64 bytes, up to a zero.
            texts[number] = flash.read(pointer, 64).split(b"\0")[0].decode("ascii", "replace")
        elif kind == _BLOCK_DEVICE:
            devices.append(struct.unpack("<2I", flash.read(entry + 8, 8)))
    if texts.get(_NAME) != "MicroPython" or not devices:
        raise Uf2Error(
            "it is no MicroPython with a file system: take one from micropython.org/download"
        )
    start, size = devices[0]
    if flash.end > start:  # the file has pages in its file system
        raise Uf2Error("its file system already has files: use an unchanged MicroPython")
    return About(texts[_NAME], texts.get(_VERSION, ""), start, size)


def _entries(flash: Flash) -> Iterator[int]:
    """Yield the addresses of the entries in the list between the two marks."""
    words = struct.unpack(f"<{_SEARCHED // 4}I", flash.read(_FLASH, _SEARCHED))
    for i in range(len(words) - 4):
        if (words[i], words[i + 4]) == _MARKS:
            first, end = words[i + 1], words[i + 2]  # addresses of the list
            for address in range(first, min(end, first + 4 * _MOST_ENTRIES), 4):
                yield from struct.unpack("<I", flash.read(address, 4))  # one pointer
            return
