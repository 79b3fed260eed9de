"""Prepared pages: a block of flash that is erased in advance, for records that cannot wait.

To save a file a file system may have to erase a block, which takes up to 0.4 s. A record here is
programmed into a page that is erased already: 0.4 to 3 ms (data sheet), one call. For this a file
of one block is written beforehand: 16 bytes by which the block is found, and 0xFF, as which erased
flash reads. littlefs puts such a file into one block and leaves it there; it has no checksum of
the content. So the pages of that block may be programmed without the file system. Only bits that
are 1 change.
"""

import binascii
import os
import struct
import sys

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import Any

    from interfaces import Store

_FILE = "/pages"
_NEW = "/pages.new"
_BLOCK_BYTES = const(4096)
_PAGE_BYTES = const(256)
_PAGES_OF_BLOCK = const(16)  # page 0 has the mark, the others records
_MARK_BYTES = const(16)  # bytes at the beginning of the block: the name, then random ones
_MARK_NAME = b"page"
_BLANK = const(0xFF)  # a byte of erased flash
_NOT_FOUND = const(-1)  # as _block: it was not found
_ASK_COUNT = const(4)  # request to ioctl() of a block device: its number of blocks
_HEAD_FORMAT = "<HI"  # a page begins with the record's length and its CRC-32
_HEAD_BYTES = const(6)  # then comes the record


def flash_of_chip() -> "Any":
    """Return the block device on which the chip's file system is; None on a desktop."""
    try:
        if sys.platform == "esp32":
            from flashbdev import bdev  # type: ignore[import-not-found]

            return bdev
        from _rp2 import Flash  # type: ignore[import-not-found]

        return Flash()
    except ImportError:
        return None


def _nothing() -> None:
    """Do nothing: before() and after() of a store on a desktop."""


class PreparedPages:
    """The pages. All calls only while no motor moves; find() and erase() take time.

    _flash: the chip's block device; _store: see connect(). _block: number of the block there,
    _NOT_FOUND if it was not found; _next_page: number of the next page to write, _PAGES_OF_BLOCK
    if none is free. _is_foreign: the file system does not keep the file as one block. _data: a
    page's bytes.
    """

    def __init__(self) -> None:
        self._flash: "Any" = None
        self._store: "Any" = None
        self._block = _NOT_FOUND
        self._next_page = _PAGES_OF_BLOCK
        self._is_foreign = False
        self._data = bytearray(_PAGE_BYTES)

    def connect(self, store: "Store") -> None:
        """Set the store, whose before() and after() are called around flash writes."""
        self._store = store

    def is_fresh(self) -> bool:
        """Return whether all pages are free."""
        return self._block != _NOT_FOUND and self._next_page == 1

    def find(self) -> None:
        """Find the file's block on the chip by its mark, and the first free page in it. Without
        success write() returns False."""
        self._block, self._next_page = _NOT_FOUND, 1
        if self._flash is None:
            self._flash = flash_of_chip()
        if self._flash is None:
            return
        try:
            with open(_FILE, "rb") as file:
                mark = file.read(_MARK_BYTES)
                is_whole = file.seek(0, 2) == _BLOCK_BYTES  # its end: the file's size
        except OSError:
            return
        if not is_whole or mark[: len(_MARK_NAME)] != _MARK_NAME:
            return
        blocks = self._find_blocks(mark)
        self._is_foreign = not blocks  # the file system has not stored it as one block
        if len(blocks) == 1:  # two of them: the file system has moved it
            self._block = blocks[0]
            blank = bytes([_BLANK]) * _PAGE_BYTES
            while self._next_page < _PAGES_OF_BLOCK and self._read_page(self._next_page) != blank:
                self._next_page += 1

    def _find_blocks(self, mark: bytes) -> "list[int]":
        """Return the numbers of the chip's blocks that begin with the mark."""
        begin = bytearray(_MARK_BYTES)
        numbers = []
        for block in range(self._flash.ioctl(_ASK_COUNT, 0)):
            self._flash.readblocks(block, begin, 0)
            if begin == mark:
                numbers.append(block)
        return numbers

    def _read_page(self, page: int) -> bytearray:
        """Return a page (number) of the block, in an array that the next call changes."""
        self._flash.readblocks(self._block, self._data, _PAGE_BYTES * page)
        return self._data

    def erase(self) -> bool:
        """Replace the file by a new one without records. Return whether all its pages are free.

        A power cut leaves the old file or the new one.
        """
        if self._flash is None or self._is_foreign:
            return False
        try:
            self._with_store(self._make)
        except OSError:
            return False
        self.find()
        return self.is_fresh()

    def _make(self) -> None:
        """Write a new file of one block, with another mark, and put it in the place of the old
        one. OSError if that fails."""
        blank = bytes([_BLANK]) * _PAGE_BYTES
        with open(_NEW, "wb") as file:
            mark = _MARK_NAME + os.urandom(_MARK_BYTES - len(_MARK_NAME))
            file.write(mark + blank[_MARK_BYTES:])
            for _ in range(_PAGES_OF_BLOCK - 1):
                file.write(blank)
        os.rename(_NEW, _FILE)

    def _with_store(self, work: "Any") -> None:
        """Call work(), which writes to flash, between the store's before() and after()."""
        getattr(self._store, "before", _nothing)()
        try:
            work()
        finally:
            getattr(self._store, "after", _nothing)()

    def write(self, record: "bytes | bytearray") -> bool:
        """Program a record of up to 250 bytes into the next free page. Returns whether it can be
        read back.

        If it cannot, the next page is tried; False if none is left.
        What follows the record in its page has no meaning.
        """
        data = self._data
        while self._block != _NOT_FOUND and self._next_page < _PAGES_OF_BLOCK:
            struct.pack_into(_HEAD_FORMAT, data, 0, len(record), binascii.crc32(record))
            data[_HEAD_BYTES : _HEAD_BYTES + len(record)] = record
            self._with_store(self._program)
            self._next_page += 1
            if self._read_record(self._next_page - 1) == record:
                return True
        return False

    def _program(self) -> None:
        """Program _data into the next page."""
        self._flash.writeblocks(self._block, self._data, _PAGE_BYTES * self._next_page)

    def records(self) -> "Iterator[bytes]":
        """Yield the records that are whole, the newest first."""
        for page in range(self._next_page - 1, 0, -1):
            record = self._read_record(page)
            if record is not None:
                yield record

    def _read_record(self, page: int) -> "bytes | None":
        """Return the record of a page (number); None if its checksum is wrong."""
        data = self._read_page(page)
        length, checksum = struct.unpack_from(_HEAD_FORMAT, data, 0)
        record = bytes(data[_HEAD_BYTES : _HEAD_BYTES + length])
        return record if binascii.crc32(record) == checksum else None
