"""Job files: programs that are kept on the board, in a folder of its flash, or on an SD card.

Names are as lines bring them, in capitals: letters, digits, and `.`, `_`, `-`. A file that comes
over the line is written beside the old one, read back, and takes its place: a power cut leaves the
old file or the new. In flash that is one step. On a card it is a copy, begun anew behind a cut:
FAT's renaming, cut short, leaves two names for the same blocks, and who takes away one of them
spoils the other.
"""

import binascii
import os

from base.text import text_of
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType
    from typing import IO, Any

    from interfaces import Card, Link, Store

# Behind the name of a file: it comes; it has come whole, and is to be copied. No job is called so.
_NEW = "~NEW"
_WHOLE = "~WHOLE"
_SIGNS = b"ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._-"
_LONGEST = const(32)  # name
# In what os.stat() returns; a folder has this mode.
_MODE_AT = const(0)
_SIZE_AT = const(6)
_FOLDER = const(0x4000)
_KB = const(1024)
# A file system wants some of its own, and settings are to find room after all.
_SPARE_KB = const(32)
_PIECE = const(512)


def of_board(board: "ModuleType") -> "JobFiles":
    """Those of a board file that names JOBS, their folder: in flash, or on the card at SD_CARD."""
    option = board.__dict__.get
    folder, pins = option("JOBS", ""), option("SD_CARD", ())
    if not pins:
        return JobFiles(folder)
    from ports.storage.sd_card import SdCard

    return JobFiles(folder, SdCard("/" + folder, pins))


def _nothing() -> None:
    """On a desktop nothing has to be."""


def _called(name: bytes) -> str:
    """What a file of that name is called as a job; "" where none is. Names that computers write
    have whatever signs."""
    upper = name.upper()
    fits = 0 < len(upper) <= _LONGEST and upper[:1] != b"." and all(c in _SIGNS for c in upper)
    return text_of(upper) if fits else ""


def _coming(name: bytes, end: str) -> str:
    """The job that a file of ours with that end belongs to; "" where it is another file."""
    job = name[: -len(end)] if name.endswith(end.encode()) else b""
    return text_of(job) if _called(job) else ""


class JobFiles:
    """The folder. card: what is mounted there, and can be taken out."""

    def __init__(self, folder: str, card: "Card | None" = None) -> None:
        self._folder = folder
        self._card = card
        # Called again and again while files are gone through.
        self.on_progress: "Callable[[], object]" = _nothing

    def connect(self, store: "Store", link: "Link") -> None:
        """Flash is written with all that the store has around its own writing; a card tells the
        supervisor that it answers. In the simulator they are in the folder, card or not."""
        self._store: "Any" = store
        shared = getattr(link, "shared", None)
        if self._card and shared is not None:
            self._card.shared = shared
            self._folder = self._card.folder
        else:
            self._card = None

    def mount(self) -> None:
        """Have the card there that is in its holder now, if they are on one. OSError where it
        cannot be read. Only where none is open."""
        if self._card:
            self._around(self._card.mount)
            for name in self._names():
                job = _coming(name, _WHOLE)
                if job:
                    self._copy(job)

    def lose(self) -> bool:
        """Behind an OSError: look for the card anew next time. Returns whether they are on one."""
        if self._card:
            self._card.unmount()
        return self._card is not None

    def _around(self, work: "Callable[[], Any]") -> "Any":
        getattr(self._store, "before", _nothing)()
        try:
            return work()
        finally:
            getattr(self._store, "after", _nothing)()

    def _path(self, name: str) -> str:
        return self._folder + "/" + name

    def _names(self) -> "list[bytes]":
        """Of all there is, in order."""
        try:
            names = self._around(lambda: os.listdir(self._folder.encode()))
        except OSError:
            if self._card:
                raise
            return []  # nothing has ever been put there
        if self._card:
            self._card.check()  # a list that cannot be read ends early
        return sorted(names)

    def _found(self, name: str) -> "tuple[str, int]":
        """The name as it is written, whatever its capitals, and bytes; "" and -1 without one."""
        for there in self._names():
            if _called(there) == name:
                written = text_of(there)
                size = self._size(written)
                if size >= 0:
                    return written, size
        return "", -1

    def _size(self, name: str) -> int:
        """Bytes; -1 for a folder."""
        about: "Any" = os.stat(self._path(name))
        return -1 if about[_MODE_AT] & _FOLDER else int(about[_SIZE_AT])

    def is_name(self, name: str) -> bool:
        """Whether a file may be called so."""
        return _called(name.encode()) == name

    def files(self) -> "list[tuple[str, int]]":
        """Names and sizes, in order."""
        found = []
        for name in [text_of(there) for there in self._names() if _called(there)]:
            self.on_progress()
            size = self._size(name)
            if size >= 0:
                found.append((name, size))
        return found

    def size(self, name: str) -> int:
        """Bytes; -1 where there is none of that name."""
        return self._found(name)[1]

    def open(self, name: str) -> "IO[bytes]":
        """To be read. OSError where there is none, or it cannot be."""
        return open(self._path(self._found(name)[0] or name), "rb")

    def free_kb(self) -> int:
        """What still fits; on a card a file comes and is copied."""
        try:
            found = self._around(lambda: os.statvfs(self._folder))
        except OSError:
            if self._card:
                raise
            found = os.statvfs(".")  # nothing has ever been put there
        room_kb: int = max(found[0] * found[3] // _KB - _SPARE_KB, 0)
        return room_kb // 2 if self._card else room_kb

    def delete(self, name: str) -> None:
        """Take a file away. OSError where that cannot be."""
        self._remove(self._found(name)[0] or name)

    def _remove(self, name: str) -> None:
        self._around(lambda: os.remove(self._path(name)))

    # A file that comes in pieces

    def begin(self, name: str) -> "IO[bytes]":
        """Where to write what is to be called so. OSError where that cannot be."""
        if not self._is_there():
            self._around(lambda: os.mkdir(self._folder))
        for left in self._names():
            job = _coming(left, _NEW)
            if job:  # of a transfer that a power cut has ended
                self._remove(job + _NEW)
        return self._create(name + _NEW)

    def _create(self, name: str) -> "IO[bytes]":
        made: "IO[bytes]" = self._around(lambda: open(self._path(name), "wb"))
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
        if self._checksum(self._path(name + _NEW)) != checksum:
            self._remove(name + _NEW)
            return False
        if self._card:
            self._around(self._create(name + _WHOLE).close)
            self._copy(name)
            return True
        old, _ = self._found(name)
        self._around(lambda: os.rename(self._path(name + _NEW), self._path(name)))
        if old and old != name:  # in other capitals
            self._remove(old)
        return True

    def _copy(self, name: str) -> None:
        """What has come whole takes its place, now or behind a power cut."""
        file = self._create(name)
        try:
            self._pieces(self._path(name + _NEW), lambda piece: self.append(file, piece))
        finally:
            self._around(file.close)
        self._remove(name + _WHOLE)
        self._remove(name + _NEW)

    def drop(self, name: str, file: "IO[bytes]") -> None:
        """What has come is not wanted."""
        self._around(file.close)
        self._remove(name + _NEW)

    def _checksum(self, path: str) -> int:
        checksum = 0

        def add(piece: bytes) -> None:
            nonlocal checksum
            checksum = binascii.crc32(piece, checksum)

        self._pieces(path, add)
        return checksum

    def _pieces(self, path: str, use: "Callable[[bytes], None]") -> None:
        with open(path, "rb") as file:
            while True:
                piece = file.read(_PIECE)
                if not piece:
                    return
                use(piece)
                self.on_progress()
