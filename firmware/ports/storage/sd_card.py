"""SD card: a folder on a removable card."""

import errno
import os

import machine
from micropython import const

from ports.storage.sd_blocks import SdBlocks

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from typing import Any

_ESP32_SLOT = const(2)  # over SPI, like slot 3


class SdCard:
    """The card in a holder. folder: where its files appear; pins: numbers of clock, to the card,
    from the card, select. _mounted: the block device of the mounted card, or None."""

    shared: "array[int]"  # shared with the supervisor

    def __init__(self, folder: str, pins: "tuple[int, ...]") -> None:
        self.folder = folder
        self._pins = pins
        self._mounted: "Any" = None

    def mount(self) -> None:
        """Mount the card that is in the holder now, unless it is mounted and works. OSError if
        there is no card, or none with a FAT file system. Call it only while no file of the card is
        open."""
        # Only SdBlocks can check that; with an ESP32's driver the card is mounted anew.
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
        """Unmount the card."""
        blocks, self._mounted = self._mounted, None
        if blocks:
            os.umount(self.folder)
            _end(blocks)

    def check(self) -> None:
        """Raise OSError if a read or write has failed since the card was mounted; the driver of an
        ESP32 raises by itself."""
        if isinstance(self._mounted, SdBlocks) and self._mounted.is_faulty:
            raise OSError(errno.EIO)

    def _begin(self) -> "Any":
        """Return the card's block device, started. OSError if there is no card."""
        driver_class: "Any" = getattr(machine, "SDCard", None)
        if driver_class:  # an ESP32's MicroPython has its own driver
            clock, to_card, from_card, select = (machine.Pin(pin) for pin in self._pins)
            return driver_class(
                slot=_ESP32_SLOT, sck=clock, mosi=to_card, miso=from_card, cs=select
            )
        blocks = SdBlocks(self._pins, self.shared)
        blocks.begin()
        return blocks


def _end(blocks: "Any") -> None:
    """Detach the blocks, so that a file still open cannot write to another card."""
    if isinstance(blocks, SdBlocks):
        blocks.end()
    else:
        blocks.deinit()
