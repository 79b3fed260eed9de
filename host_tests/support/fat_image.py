"""For the desktop's MicroPython: make FAT file systems as a computer does, and read them back.

Usage: fat_image.py IMAGE make BLOCKS FOLDER, or IMAGE read FOLDER: copy the files of a folder into
a new image, or those of an image into a folder.
"""

import os
import sys

import vfs

BLOCK = 512


class Blocks:
    """Blocks of an image in memory.

    fault_at: from that block on, nothing is read or written. As with a card's, calls after end()
    do
    nothing and report success."""

    def __init__(self, image: bytearray) -> None:
        self.image = image
        self.fault_at = -1
        self.done = 0
        self.is_faulty = self._has_ended = False

    def end(self) -> None:
        """Make later calls do nothing."""
        self._has_ended = True

    def readblocks(self, number: int, into: bytearray) -> int:
        if self._has_ended:
            return 0
        if self._is_refused(len(into)):
            return -5
        into[:] = self.image[number * BLOCK : number * BLOCK + len(into)]
        return 0

    def writeblocks(self, number: int, data: bytearray) -> int:
        if self._has_ended:
            return 0
        if self._is_refused(len(data)):
            return -5
        self.image[number * BLOCK : number * BLOCK + len(data)] = data
        return 0

    def _is_refused(self, length: int) -> bool:
        if 0 <= self.fault_at <= self.done:
            self.is_faulty = True
        self.done += length // BLOCK
        return self.is_faulty

    def ioctl(self, what: int, _argument: int) -> int:
        if what == 4:
            return len(self.image) // BLOCK
        return BLOCK if what == 5 else 0


def _copy(names: "list[str]", source: str, target: str) -> None:
    for name in names:
        with open(source + "/" + name, "rb") as file:
            data = file.read()
        with open(target + "/" + name, "wb") as file:
            file.write(data)


def main(image: str, what: str, *rest: str) -> None:
    folder = rest[-1]
    if what == "make":
        blocks = Blocks(bytearray(int(rest[0]) * BLOCK))
        vfs.VfsFat.mkfs(blocks)
        vfs.mount(blocks, "/card")
        _copy(os.listdir(folder), folder, "/card")
        vfs.umount("/card")
        with open(image, "wb") as file:
            file.write(blocks.image)
        return
    with open(image, "rb") as file:
        vfs.mount(Blocks(bytearray(file.read())), "/card")
    _copy([entry[0] for entry in os.ilistdir("/card") if entry[1] != 0x4000], "/card", folder)


if __name__ == "__main__":
    main(*sys.argv[1:])
