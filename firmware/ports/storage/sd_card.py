"""SD card: a folder that can be taken out."""

import errno
import os

import machine
from micropython import const

from ports.storage.sd_blocks import SdBlocks

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from typing import Any

_ESP32_SLOT = const(2)  # over SPI, as 3 is


class SdCard:
    """The card of a holder. pins: clock, to the card, from the card, select."""

    shared: "array[int]"  # with the supervisor

    def __init__(self, folder: str, pins: "tuple[int, ...]") -> None:
        self.folder = folder
        self._pins = pins
        self._mounted: "Any" = None

    def mount(self) -> None:
        """Have the card that is in the holder now in its folder. OSError where there is none, or
        none with a FAT file system. Only where no file of it is open."""
        if isinstance(self._mounted, SdBlocks) and self._mounted.is_there():
            return
        self.unmount()
        blocks = self._begin()
        try:
            os.mount(blocks, self.folder)
        except OSError:
            _end(blocks)
            raise
        self._mounted = blocks

    def unmount(self) -> None:
        """Forget what was known of it."""
        blocks, self._mounted = self._mounted, None
        if blocks:
            os.umount(self.folder)
            _end(blocks)

    def check(self) -> None:
        """OSError where something could not be read or written."""
        if isinstance(self._mounted, SdBlocks) and self._mounted.is_faulty:
            raise OSError(errno.EIO)

    def _begin(self) -> "Any":
        theirs: "Any" = getattr(machine, "SDCard", None)
        if theirs:  # an ESP32's MicroPython has its own
            clock, to_card, from_card, select = (machine.Pin(pin) for pin in self._pins)
            return theirs(slot=_ESP32_SLOT, sck=clock, mosi=to_card, miso=from_card, cs=select)
        blocks = SdBlocks(self._pins, self.shared)
        blocks.begin()
        return blocks


def _end(blocks: "Any") -> None:
    """A file that is still open writes to no other card."""
    if isinstance(blocks, SdBlocks):
        blocks.end()
    else:
        blocks.deinit()
