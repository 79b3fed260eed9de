"""SD card: a folder that can be taken out."""

import gc
import os

import machine
from micropython import const

from ports.sd_blocks import SdBlocks

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from typing import Any

_ESP32_SLOT = const(2)  # over SPI, as 3 is


class SdCard:
    """The card of a holder. pins: clock, to the card, from the card, select; shared: with the
    supervisor."""

    def __init__(self, folder: str, pins: "tuple[int, ...]", shared: "array[int]") -> None:
        self.folder = folder
        self._pins = pins
        self._esp32: "Any" = getattr(machine, "SDCard", None)  # MicroPython's own
        self._blocks = None if self._esp32 else SdBlocks(pins, shared)
        self._mounted: "Any" = None

    def mount(self) -> None:
        """Have the card that is in the holder now in its folder. OSError where there is none, or
        none with a FAT file system. Only where no file of it is open."""
        blocks = self._blocks
        if self._mounted and blocks and blocks.is_there():
            return
        self.unmount()
        if blocks:
            blocks.begin()
        found = blocks or self._open()
        try:
            os.mount(found, self.folder)
        except OSError:
            self._close(found)
            raise
        self._mounted = found

    def unmount(self) -> None:
        """Forget what was known of it."""
        found, self._mounted = self._mounted, None
        if found:
            os.umount(self.folder)
            self._close(found)
            gc.collect()  # a file left open would be written to the next card else

    def _open(self) -> "Any":
        clock, to_card, from_card, select = [machine.Pin(pin) for pin in self._pins]
        return self._esp32(slot=_ESP32_SLOT, sck=clock, mosi=to_card, miso=from_card, cs=select)

    def _close(self, found: "Any") -> None:
        if self._blocks:
            self._blocks.end()
        else:
            found.deinit()
