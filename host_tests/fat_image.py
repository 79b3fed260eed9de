"""For the desktop's MicroPython: FAT file systems as a computer makes them, and what is in them.

Usage: fat_image.py IMAGE make BLOCKS FOLDER, or IMAGE read FOLDER: files of a folder go into a new
image, those of an image into a folder.
"""

import os
import sys

import vfs

BLOCK = 512


class Blocks:
    """Of an image in memory. cut_at: the power goes as that block is to be written; nothing more
    is, and a file left open, which is collected later, is not told."""

    def __init__(self, image: bytearray, cut_at: int = -1) -> None:
        self.image = image
        self.cut_at = cut_at
        self.written = 0
        self.is_dead = False

    def readblocks(self, number: int, into: bytearray) -> None:
        if not self.is_dead:
            into[:] = self.image[number * BLOCK : number * BLOCK + len(into)]

    def writeblocks(self, number: int, data: bytearray) -> None:
        if self.is_dead:
            return
        for at in range(0, len(data), BLOCK):
            if self.written == self.cut_at:
                self.is_dead = True
                raise OSError(5)
            self.written += 1
            place = number * BLOCK + at
            self.image[place : place + BLOCK] = data[at : at + BLOCK]

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
