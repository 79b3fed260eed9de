"""Programs on a card: FAT cannot replace one file by another in a single step.

The script runs under MicroPython on FAT images in memory, whose blocks fail or vanish at every
possible block access while a file is replaced."""

from micropython_runner import needs_micropython, run_micropython
from ugrbl.paths import FIRMWARE

_HERE = FIRMWARE.parent / "host_tests" / "support"
_SCRIPT = """
import binascii
import os

import vfs
from fat_image import BLOCK, Blocks
from ports.storage.job_files import JobFiles

OLD = bytes(range(256)) * 6
NEW = b"G1X%d" * 700
OTHER = b"G0Y1 " * 900


class Card:
    # A card in memory, with the interface that JobFiles uses.
    folder = "/card"
    shared = None

    def __init__(self, image):
        self.image = image
        self.blocks = Blocks(image)
        vfs.mount(self.blocks, "/card")

    def mount(self):
        if self.blocks.is_faulty:
            self.unmount()
            self.blocks = Blocks(self.image)
            vfs.mount(self.blocks, "/card")

    def unmount(self):
        vfs.umount("/card")
        self.blocks.end()

    def check(self):
        if self.blocks.is_faulty:
            raise OSError(5)


class Store:
    pass


class Link:
    shared = bytearray(1)


def files_on(card):
    files = JobFiles("jobs", card)
    files.connect(Store(), Link())
    return files


def put(files, name, data):
    # Receive a program in pieces of 2048 bytes, as from a sender.
    files.mount()
    file = files.begin(name)
    for at in range(0, len(data), 2048):
        files.append(file, data[at : at + 2048])
    assert files.finish(name, file, binascii.crc32(data))


def content(files, name):
    with files.open(name) as file:
        return file.read()


def card_with(called, others):
    # Return the image of a card as a computer makes it, with an umlaut in one name. called: name
    # of the file that is replaced later; others: numbers of further, empty files.
    image = bytearray(4096 * BLOCK)
    vfs.VfsFat.mkfs(Blocks(image))
    card = Card(image)
    os.mkdir("/card/DCIM")
    for name, data in [("a naXe.nc", b""), (called, OLD)] + [("T%d.NC" % i, b"") for i in others]:
        with open("/card/" + name, "wb") as file:
            file.write(data)
    card.unmount()
    # MicroPython cannot write the umlaut: put it into the stored UTF-16 name, for the X.
    image[image.find(b"n\\0a\\0X\\0e") + 4] = 0xF6
    return image


def count(image):
    # Count the blocks read and written while the new file is saved.
    card = Card(bytearray(image))
    files = files_on(card)
    files.mount()
    assert files.size("PART.NC") == len(OLD)
    assert content(files, "PART.NC") == OLD
    card.blocks.done = 0
    put(files, "PART.NC", NEW)
    card.unmount()
    return card.blocks.done


def after_fault(image, fault_at, is_cut):
    # Return the content of PART.NC after a fault at block access number fault_at; then check that
    # files can be written. is_cut: power is cut there, else the card is pulled and put back.
    card = Card(bytearray(image))
    files = files_on(card)
    card.blocks.done, card.blocks.fault_at = 0, fault_at
    try:
        put(files, "PART.NC", NEW)
    except OSError:
        pass
    if is_cut:
        card.unmount()
        files = files_on(Card(card.image))
    else:
        files.lose()
        card.blocks = Blocks(card.image)
        vfs.mount(card.blocks, "/card")
    files.mount()
    content_after_fault = content(files, "PART.NC")
    put(files, "OTHER.NC", OTHER)
    assert content(files, "PART.NC") == content_after_fault
    put(files, "PART.NC", NEW)
    assert content(files, "PART.NC") == NEW and content(files, "OTHER.NC") == OTHER
    names = [name.decode() for name in os.listdir(b"/card") if b"~" not in name and name < b"a"]
    assert len(names) == len(image_names) + 1, names
    vfs.umount("/card")
    return content_after_fault


for called, others in (("part.nc", range(0)), ("PART.NC", range(14))):
    image = card_with(called, others)
    card = Card(image)
    image_names = [name for name in os.listdir(b"/card") if name < b"a"]
    card.unmount()
    blocks = count(image)
    for is_cut in (True, False):
        contents = {after_fault(image, fault_at, is_cut) for fault_at in range(blocks)}
        assert contents == {OLD, NEW}, contents
    print(blocks)
    # A computer has deleted the received file, and not the one that says to copy it.
    card = Card(bytearray(image))
    open("/card/PART.NC~WHOLE", "wb").close()
    files = files_on(card)
    files.mount()
    assert content(files, "PART.NC") == OLD
    card.unmount()
"""


@needs_micropython
def test_a_fault_at_any_block_leaves_the_old_or_the_new_file_and_all_others() -> None:
    """The script prints how many block accesses it takes to save the file: the faults it tried."""
    printed = run_micropython(_SCRIPT, paths=[_HERE, FIRMWARE])
    assert all(int(count) > 30 for count in printed.split())
