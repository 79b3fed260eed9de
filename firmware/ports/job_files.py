"""Job files: programs that are kept on the board, in a folder of its flash, or on an SD card.

Names are as lines bring them, in capitals: letters, digits, and `.`, `_`, `-`. A file that comes
over the line is written beside the old one, read back, and takes its place in one step: a power
cut leaves the old file or the new. A card's file system has no such step, so the old one is put
aside, and put back where the new one is not there.
"""

import binascii
import os

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import IO, Any

    from interfaces import Card, Store

_NEW = ".PART"
_OLD = ".OLD" + _NEW
_LONGEST = const(32)  # name
_OTHERS = "._-"
# In what os.stat() returns; a folder has this mode.
_MODE_AT = const(0)
_SIZE_AT = const(6)
_FOLDER = const(0x4000)
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

    def connect(self, store: "Store", card: "Card | None") -> None:
        """Flash is written with all that the store has around its own writing. card: they are
        there and not in flash."""
        self._store: "Any" = store
        self._card = card
        if card:
            self._folder = card.folder

    def mount(self) -> None:
        """Have the card there that is in its holder now, if they are on one. OSError where it
        cannot be read. Only where none is open."""
        if self._card:
            self._around(self._card.mount)

    def lose(self) -> bool:
        """Behind an OSError: look for the card anew next time. Returns whether they are on one."""
        if self._card:
            self._card.unmount()
        return self._card is not None

    def _around(self, write: "Callable[[], Any]") -> "Any":
        getattr(self._store, "before", _nothing)()
        try:
            return write()
        finally:
            getattr(self._store, "after", _nothing)()

    def _path(self, name: str) -> str:
        return self._folder + "/" + name

    def _found(self, name: str) -> "tuple[str, int]":
        """The name as it is written, whatever its capitals, and bytes; "" and -1 without one."""
        for there, size in self.files():
            if there.upper() == name:
                return there, size
        return "", -1

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
            if self._card:
                raise
            return []  # nothing has ever been put there
        found = []
        for name in [self._put_back(name, names) for name in names]:
            if self.is_name(name.upper()):
                about: "Any" = os.stat(self._path(name))
                if not about[_MODE_AT] & _FOLDER:
                    found.append((name, int(about[_SIZE_AT])))
        return found

    def _put_back(self, name: str, names: "list[str]") -> str:
        """Where a power cut has come before another has taken its place, give a file its name
        again. Returns what is called so now."""
        whole = name[: -len(_OLD)]
        if name != whole + _OLD or whole in names:
            return name
        self._around(lambda: os.rename(self._path(name), self._path(whole)))
        return whole

    def size(self, name: str) -> int:
        """Bytes; -1 where there is none of that name."""
        return self._found(name)[1]

    def open(self, name: str) -> "IO[bytes]":
        """To be read. OSError where there is none, or it cannot be."""
        return open(self._path(self._found(name)[0] or name), "rb")

    def room_kb(self) -> int:
        """What still fits."""
        try:
            found = os.statvfs(self._folder)
        except OSError:
            if self._card:
                raise
            found = os.statvfs(".")
        return max(found[0] * found[3] // _KB - _SPARE_KB, 0)

    def delete(self, name: str) -> None:
        """Take a file away. OSError where that cannot be."""
        self._around(lambda: os.remove(self._path(self._found(name)[0] or name)))

    # A file that comes in pieces

    def begin(self, name: str) -> "IO[bytes]":
        """Where to write what is to be called so. OSError where that cannot be."""

        def make() -> "IO[bytes]":
            if not self._is_there():
                os.mkdir(self._folder)
            self.files()  # puts back what is to be
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
        old, _ = self._found(name)
        aside = old and (old != name or self._card is not None)

        def put() -> None:
            if aside:
                os.rename(self._path(old), self._path(name + _OLD))
            os.rename(new, self._path(name))
            if aside:
                os.remove(self._path(name + _OLD))

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
