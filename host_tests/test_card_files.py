"""Programs on a card: FAT has no step in which one file takes another's place."""

from micropython_runner import needs_micropython, run_micropython
from ugrbl.paths import FIRMWARE

_HERE = FIRMWARE.parent / "host_tests"
_SCRIPT = """
import binascii
import os

import vfs
from fat_image import BLOCK, Blocks
from ports.job_files import JobFiles

OLD = bytes(range(256)) * 6
NEW = b"G1X%d" * 700


class Card:
    folder = "/card"

    def __init__(self, image, cut_at=-1):
        self.blocks = Blocks(image, cut_at)
        vfs.mount(self.blocks, "/card")


class Store:
    pass


def files_on(card):
    files = JobFiles("jobs")
    files.connect(Store(), card)
    return files


def put(files, name, data):
    file = files.begin(name)
    for at in range(0, len(data), 2048):
        files.append(file, data[at : at + 2048])
    assert files.finish(name, file, binascii.crc32(data))


def content(files, name):
    with files.open(name) as file:
        return file.read()


def card_with(called):
    # As a computer leaves it.
    image = bytearray(4096 * BLOCK)
    vfs.VfsFat.mkfs(Blocks(image))
    Card(image)
    os.mkdir("/card/DCIM")
    for name, data in (("a name.nc", b""), (called, OLD)):
        with open("/card/" + name, "wb") as file:
            file.write(data)
    vfs.umount("/card")
    return image


def writes(image):
    # Blocks written as the new one comes.
    card = Card(bytearray(image))
    files = files_on(card)
    ((name, size),) = files.files()
    assert size == files.size("PART.NC") == len(OLD)
    assert content(files, "PART.NC") == OLD
    put(files, "PART.NC", NEW)
    vfs.umount("/card")
    return card.blocks.written


def behind_cut(image, cut_at):
    # What is there when the power is back.
    image = bytearray(image)
    try:
        put(files_on(Card(image, cut_at)), "PART.NC", NEW)
        raise SystemExit("no cut at %d" % cut_at)
    except OSError:
        vfs.umount("/card")
    files = files_on(Card(image))
    ((name, size),) = files.files()
    there = content(files, "PART.NC")
    put(files, "PART.NC", NEW)
    assert content(files, "PART.NC") == NEW
    assert sorted(os.listdir("/card")) == ["DCIM", "PART.NC", "a name.nc"], os.listdir("/card")
    vfs.umount("/card")
    return there


for called in ("part.nc", "PART.NC"):
    image = card_with(called)
    count = writes(image)
    assert {behind_cut(image, cut_at) for cut_at in range(count)} == {OLD, NEW}
    print(count)
"""


@needs_micropython
def test_a_power_cut_at_any_block_leaves_the_old_file_or_the_new() -> None:
    printed = run_micropython(_SCRIPT, paths=[_HERE, FIRMWARE])
    assert all(int(count) > 12 for count in printed.split())
