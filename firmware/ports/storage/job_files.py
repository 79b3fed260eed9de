"""Job files: programs stored on the board, in a folder of its flash or on an SD card.

Names are those that lines carry, in capitals: letters, digits, and `.`, `_`, `-`. A file that is
sent over the line is written under another name, read back, and then replaces the old one: a power
cut leaves the old file or the new. In flash the replacement is one step, a renaming. On a card it
is a copy, which is started again after a power cut: a FAT renaming that is cut short leaves two
names for the same blocks, and deleting one of them damages the other.
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

# Suffixes of file names that no job has.
_RECEIVED = "~NEW"  # suffix of a file being received
_TO_COPY = "~WHOLE"  # suffix of an empty file: the received file is complete and must be copied
_NAME_CHARS = b"ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._-"
_LONGEST = const(32)  # bytes of a name
_STAT_MODE = const(0)  # index in the result of os.stat()
_STAT_SIZE = const(6)  # index there: bytes
_FOLDER_BIT = const(0x4000)  # in the mode: a folder
_STATVFS_BLOCK_BYTES = const(0)  # index in the result of os.statvfs()
_STATVFS_FREE_BLOCKS = const(3)  # index there
_KB = const(1024)
_RESERVED_KB = const(32)  # for the file system itself, and for settings
_PIECE_BYTES = const(512)  # of one read


def of_board(board: "ModuleType") -> "JobFiles":
    """Return the job files of a board file that names JOBS, their folder: in flash, or on the card
    at SD_CARD."""
    option = board.__dict__.get
    folder, pins = option("JOBS", ""), option("SD_CARD", ())
    if not pins:
        return JobFiles(folder)
    from ports.storage.sd_card import SdCard

    return JobFiles(folder, SdCard("/" + folder, pins))


def _nothing() -> None:
    """Do nothing: the default of on_progress, and of before() and after() on a desktop."""


def _job_name(name: bytes) -> str:
    """Return the job name of a file name, "" if it cannot be a job's. Computers may write names
    with any characters."""
    upper = name.upper()
    may_be_job = 0 < len(upper) <= _LONGEST and upper[:1] != b"."
    is_job = may_be_job and all(c in _NAME_CHARS for c in upper)
    return text_of(upper) if is_job else ""


def _job_of(name: bytes, suffix: str) -> str:
    """Return the job that a file name with this suffix (_RECEIVED or _TO_COPY) belongs to, "" for
    other file names."""
    job = name[: -len(suffix)] if name.endswith(suffix.encode()) else b""
    return text_of(job) if _job_name(job) else ""


class JobFiles:
    """The folder of job files. card: a removable card that is mounted there, None in flash.
    on_progress: called repeatedly while files are read."""

    def __init__(self, folder: str, card: "Card | None" = None) -> None:
        self._folder = folder
        self._card = card
        self.on_progress: "Callable[[], object]" = _nothing

    def connect(self, store: "Store", link: "Link") -> None:
        """Set the store, whose before() and after() are called around flash writes, and share the
        supervisor's memory with the card. Without a card, or with a link that has no such memory
        (the simulator's without a network), the files are in the folder."""
        self._store: "Any" = store
        shared = getattr(link, "shared", None)
        if self._card and shared is not None:
            self._card.shared = shared
            self._folder = self._card.folder
        else:
            self._card = None

    def mount(self) -> None:
        """Mount the card that is in the holder now, if the files are on a card, and finish a
        replacement that a power cut has interrupted there. OSError if the card cannot be read.
        Call it only while no file is open."""
        if self._card:
            self._with_store(self._card.mount)
            names = self._names()
            for name in names:
                job = _job_of(name, _TO_COPY)
                received = name[: -len(_TO_COPY)] + _RECEIVED.encode()
                if job and received in names:  # else it was deleted on a computer
                    self._copy(job)

    def lose(self) -> bool:
        """Unmount the card after an OSError; the next mount() looks for it again. Returns whether
        the files are on a card."""
        if self._card:
            self._card.unmount()
        return self._card is not None

    def _with_store(self, work: "Callable[[], Any]") -> "Any":
        """Return the result of work(), which may write to flash: the store's before() and after(),
        which a desktop's store has not, are called around it."""
        getattr(self._store, "before", _nothing)()
        try:
            return work()
        finally:
            getattr(self._store, "after", _nothing)()

    def _path(self, name: str) -> str:
        """Return the path of a file of the folder."""
        return self._folder + "/" + name

    def _names(self) -> "list[bytes]":
        """Return the names of all files in the folder, sorted; OSError if a card cannot be
        read."""
        try:
            names = self._with_store(lambda: os.listdir(self._folder.encode()))
        except OSError:
            if self._card:
                raise
            return []  # nothing has ever been put there
        if self._card:
            self._card.check()  # a fault ends the list without an exception
        return sorted(names)

    def _find_job(self, name: str) -> "tuple[str, int]":
        """Return a job's file name as it is written, in whatever case, and its bytes; "" and -1 if
        there is none."""
        for file in self._names():
            if name and _job_name(file) == name:  # no job's name is empty
                file_name = text_of(file)
                size = self._size(file_name)
                if size >= 0:  # not a folder
                    return file_name, size
        return "", -1

    def _size(self, name: str) -> int:
        """Return a file's bytes; -1 for a folder."""
        about: "Any" = os.stat(self._path(name))
        return -1 if about[_STAT_MODE] & _FOLDER_BIT else int(about[_STAT_SIZE])

    def is_name(self, name: str) -> bool:
        """Return whether a job may have this name."""
        return _job_name(name.encode()) == name

    def files(self) -> "list[tuple[str, int]]":
        """Return the jobs' names, as their files are written, and sizes in bytes, sorted."""
        jobs = []
        for name in [text_of(file) for file in self._names() if _job_name(file)]:
            self.on_progress()
            size = self._size(name)
            if size >= 0:  # not a folder
                jobs.append((name, size))
        return jobs

    def size(self, name: str) -> int:
        """Return a job's bytes; -1 if there is none of that name."""
        _, size = self._find_job(name)
        return size

    def open(self, name: str) -> "IO[bytes]":
        """Open a job to read it. OSError if there is none, or it cannot be read."""
        return open(self._path(self._find_job(name)[0] or name), "rb")

    def free_kb(self) -> int:
        """Return the kB that fit. On a card it is half the free space, because a file is received
        and then copied."""
        try:
            about = self._with_store(lambda: os.statvfs(self._folder))
        except OSError:
            if self._card:
                raise
            about = os.statvfs(".")  # nothing has ever been put there
        block_bytes, free_blocks = about[_STATVFS_BLOCK_BYTES], about[_STATVFS_FREE_BLOCKS]
        free_kb: int = max(block_bytes * free_blocks // _KB - _RESERVED_KB, 0)
        return free_kb // 2 if self._card else free_kb

    def delete(self, name: str) -> None:
        """Delete a job. OSError if that fails."""
        self._remove(self._find_job(name)[0] or name)

    def _remove(self, name: str) -> None:
        """Delete a file. OSError if that fails."""
        self._with_store(lambda: os.remove(self._path(name)))

    # Files received in pieces

    def begin(self, name: str) -> "IO[bytes]":
        """Create the file into which a job is received, and return it; files left by earlier
        transfers are deleted. OSError if that fails."""
        if not self._folder_exists():
            self._with_store(lambda: os.mkdir(self._folder))
        for file in self._names():
            job = _job_of(file, _RECEIVED)
            if job:  # left by a transfer that a power cut has ended
                self._remove(job + _RECEIVED)
        return self._create(name + _RECEIVED)

    def _create(self, name: str) -> "IO[bytes]":
        """Open an empty file to write it."""
        file: "IO[bytes]" = self._with_store(lambda: open(self._path(name), "wb"))
        return file

    def _folder_exists(self) -> bool:
        """Return whether the folder exists."""
        try:
            os.stat(self._folder)
            return True
        except OSError:
            return False

    def append(self, file: "IO[bytes]", piece: "bytes | bytearray") -> None:
        """Write the next piece to a file from begin(). OSError if no space is free."""
        self._with_store(lambda: file.write(piece))

    def finish(self, name: str, file: "IO[bytes]", checksum: int) -> bool:
        """Close the received file and replace the job by it. Returns False if its CRC-32 is
        another than the sender's (checksum); the old job is then kept."""
        self._with_store(file.close)
        if self._checksum(self._path(name + _RECEIVED)) != checksum:
            self._remove(name + _RECEIVED)
            return False
        if self._card:
            self._with_store(self._create(name + _TO_COPY).close)  # see _copy()
            self._copy(name)
            return True
        old, _ = self._find_job(name)
        self._with_store(lambda: os.rename(self._path(name + _RECEIVED), self._path(name)))
        if old and old != name:  # in another case
            self._remove(old)
        return True

    def _copy(self, name: str) -> None:
        """Copy a complete received file to its job, now or after a power cut; only on a card. The
        file with the suffix _TO_COPY says until the end that the copy is to be made."""
        file = self._create(name)
        try:
            received = self._path(name + _RECEIVED)
            self._read_in_pieces(received, lambda piece: self.append(file, piece))
        finally:
            self._with_store(file.close)
        self._remove(name + _TO_COPY)
        self._remove(name + _RECEIVED)

    def drop(self, name: str, file: "IO[bytes]") -> None:
        """Close and delete a received file, whose transfer has failed."""
        self._with_store(file.close)
        self._remove(name + _RECEIVED)

    def _checksum(self, path: str) -> int:
        """Return the CRC-32 of a file."""
        checksum = 0

        def add(piece: bytes) -> None:
            """Add a piece of the file to the checksum."""
            nonlocal checksum
            checksum = binascii.crc32(piece, checksum)

        self._read_in_pieces(path, add)
        return checksum

    def _read_in_pieces(self, path: str, use: "Callable[[bytes], None]") -> None:
        """Read a file in pieces, and pass each to use()."""
        with open(path, "rb") as file:
            while True:
                piece = file.read(_PIECE_BYTES)
                if not piece:
                    return
                use(piece)
                self.on_progress()
