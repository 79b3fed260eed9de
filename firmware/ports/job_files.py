"""Job files: programs that are kept on the board, in a folder of its flash.

Names are as lines bring them, in capitals: letters, digits, and `.`, `_`, `-`. A file that comes
over the line is written beside the old one, read back, and takes its place in one step: a power
cut leaves the old file or the new.
"""

import binascii
import os

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import IO, Any

    from interfaces import Store

_NEW = ".PART"
_LONGEST = const(32)  # name
_OTHERS = "._-"
_SIZE_AT = const(6)  # in what os.stat() returns
_KB = const(1024)
# A file system wants some of its own, and settings are to find room after all.
_SPARE_KB = const(32)
_PIECE = const(512)


def _nothing() -> None:
    """On a desktop nothing has to be."""


class JobFiles:
    """The folder."""

    def __init__(self, folder: str) -> None:
        self._folder = folder

    def connect(self, store: "Store") -> None:
        """Flash is written with all that the store has around its own writing."""
        self._store: "Any" = store

    def _around(self, write: "Callable[[], Any]") -> "Any":
        getattr(self._store, "before", _nothing)()
        try:
            return write()
        finally:
            getattr(self._store, "after", _nothing)()

    def _path(self, name: str) -> str:
        return self._folder + "/" + name

    def _found(self, name: str) -> str:
        """The name as it is written, whatever its capitals; "" where there is none."""
        for there, _ in self.files():
            if there.upper() == name:
                return there
        return ""

    def is_name(self, name: str) -> bool:
        """Whether a file may be called so."""
        if not 0 < len(name) <= _LONGEST or name[0] == "." or name.endswith(_NEW):
            return False
        return all("A" <= c <= "Z" or "0" <= c <= "9" or c in _OTHERS for c in name)

    def files(self) -> "list[tuple[str, int]]":
        """Names and sizes, in order."""
        try:
            names = sorted(os.listdir(self._folder))
        except OSError:
            return []  # nothing has ever been put there
        found = [name for name in names if self.is_name(name.upper())]
        return [(name, self._size(name)) for name in found]

    def _size(self, name: str) -> int:
        return int(os.stat(self._path(name))[_SIZE_AT])

    def size(self, name: str) -> int:
        """Bytes; -1 where there is none of that name."""
        found = self._found(name)
        return self._size(found) if found else -1

    def open(self, name: str) -> "IO[bytes]":
        """To be read. OSError where there is none, or it cannot be."""
        return open(self._path(self._found(name) or name), "rb")

    def room_kb(self) -> int:
        """What still fits."""
        try:
            found = os.statvfs(self._folder)
        except OSError:
            found = os.statvfs(".")
        return max(found[0] * found[3] // _KB - _SPARE_KB, 0)

    def delete(self, name: str) -> None:
        """Take a file away. OSError where that cannot be."""
        self._around(lambda: os.remove(self._path(self._found(name) or name)))

    # A file that comes in pieces

    def begin(self, name: str) -> "IO[bytes]":
        """Where to write what is to be called so. OSError where that cannot be."""

        def make() -> "IO[bytes]":
            if not self._is_there():
                os.mkdir(self._folder)
            for left in os.listdir(self._folder):
                if left.endswith(_NEW):  # of a transfer that a power cut has ended
                    os.remove(self._path(left))
            return open(self._path(name + _NEW), "wb")

        made: "IO[bytes]" = self._around(make)
        return made

    def _is_there(self) -> bool:
        try:
            os.stat(self._folder)
            return True
        except OSError:
            return False

    def append(self, file: "IO[bytes]", piece: "bytes | bytearray") -> None:
        """Write the next piece. OSError where there is no room."""
        self._around(lambda: file.write(piece))

    def finish(self, name: str, file: "IO[bytes]", checksum: int) -> bool:
        """Have it take its place; False where it is not what was sent, which leaves the old."""
        self._around(file.close)
        new = self._path(name + _NEW)
        if self._checksum(new) != checksum:
            self._around(lambda: os.remove(new))
            return False
        old = self._found(name)

        def put() -> None:
            os.rename(new, self._path(name))
            if old and old != name:  # in other capitals
                os.remove(self._path(old))

        self._around(put)
        return True

    def drop(self, name: str, file: "IO[bytes]") -> None:
        """What has come is not wanted."""

        def remove() -> None:
            file.close()
            os.remove(self._path(name + _NEW))

        self._around(remove)

    def _checksum(self, path: str) -> int:
        checksum = 0
        with open(path, "rb") as file:
            while True:
                piece = file.read(_PIECE)
                if not piece:
                    return checksum
                checksum = binascii.crc32(piece, checksum)
