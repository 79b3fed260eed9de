"""Store in the board's flash: one text file per name, which survives a power cut at any byte.

A save writes a new file, reads it back, keeps the old one as the previous copy and puts the new
one in its place; littlefs makes each renaming atomic. A file's last line is the checksum of the
other lines; the bytes are decoded only after the checksum has been checked. The caller of save()
makes sure that the machine is idle: a flash write stops the processor, up to 0.4 s for each sector
that it erases, and no input is read meanwhile.
"""

import binascii
import gc
import os

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

# Suffixes of file names, in the order in which load() tries them: the first whole file is used.
_NOW = ".txt"  # suffix of the file in force,
_NEW = ".new"  # of the one being written,
_OLD = ".old"  # and of the older copy
_CHECKSUM = b"#crc32="  # with which the last line begins

_NO_SUCH_FILE = const(2)  # ENOENT
_NO_MEMORY = const(12)  # ENOMEM
_EXISTS = const(17)  # EEXIST


def _nothing() -> None:
    """Do nothing: the default of before() and after()."""


def _checksum(data: "bytes | memoryview") -> bytes:
    """Return the last line of a file with this data before it."""
    return _CHECKSUM + b"%08x\n" % binascii.crc32(data)


def _lines(data: bytes) -> "list[str] | None":
    """Return the lines of a file; None if it is not UTF-8: save() has not written it."""
    try:
        return data.decode().split("\n")[:-1]
    except ValueError:
        return None


class FlashStore:
    """A Store. folder: where the files are, with a slash at its end; save() makes it. Not the
    root: littlefs reads all changes of a folder at each look into it, and a start looks into the
    root several times for each module.

    before, after: called around each save, also if it fails. damaged: names whose file was
    damaged, with True if an older copy was used.
    """

    def __init__(self, folder: str = "/saved/") -> None:
        self._folder = folder
        self.before: "Callable[[], None]" = _nothing
        self.after: "Callable[[], None]" = _nothing
        self.damaged: "dict[str, bool]" = {}

    def load(self, name: str) -> "list[str] | None":
        """Return the lines stored under a name: [] if nothing was ever stored, None if no copy is
        whole. If an older copy is used, or none, the name is noted in `damaged`."""
        is_damaged = False  # a file that should be whole exists and is not
        for suffix in (_NOW, _NEW, _OLD):
            data, exists = self._read(self._folder + name + suffix)
            lines = None if data is None else _lines(data)
            # A power cut during a save leaves part of the new file, or all of it with no file in
            # force. So only these are damage: a bad file in force, and needing the older copy.
            if suffix == _OLD or (suffix == _NOW and lines is None):
                is_damaged = is_damaged or exists
            if lines is not None:
                if is_damaged:
                    self.damaged[name] = True
                return lines
        if is_damaged:
            self.damaged[name] = False
            return None
        return []

    def save(self, name: str, lines: "Iterable[str]") -> None:
        """Replace the lines stored under a name, atomically. Raises OSError if flash is full or
        worn, or memory cannot hold all lines."""
        kept = list(lines)
        self.before()
        try:
            try:
                os.mkdir(self._folder[:-1])
            except OSError as reason:
                if reason.errno != _EXISTS:
                    raise
            kept.append("")  # for the last line's end
            self._write(self._folder + name, "\n".join(kept).encode())
        except MemoryError:
            raise OSError(_NO_MEMORY)
        finally:
            self.after()
            # Files have buffers of 1 kB. As garbage they would fill the low addresses of memory,
            # and the next value of a setting would lie in the middle of the largest free piece.
            gc.collect()

    def _write(self, path: str, data: bytes) -> None:
        """Write a new file, read it back, and put it in the place of the old one, which becomes
        the older copy if it is whole.

        path: of the files, without suffix. OSError if that fails.
        """
        is_whole = self._read(path + _NOW)[0] is not None
        if not is_whole and self._read(path + _NEW)[0] is not None:
            os.rename(path + _NEW, path + _NOW)  # a power cut came before this step
            is_whole = True
        with open(path + _NEW, "wb") as file:
            file.write(data)
            file.write(_checksum(data))
        if self._read(path + _NEW)[0] != data:
            raise OSError("flash does not store what is written")
        if is_whole:
            os.rename(path + _NOW, path + _OLD)
        os.rename(path + _NEW, path + _NOW)

    def _read(self, path: str) -> "tuple[bytes | None, bool]":
        """Return two things: a file's bytes without its checksum, None if it cannot be read or the
        checksum is wrong; and whether the file exists."""
        try:
            with open(path, "rb") as file:
                data = file.read()
        except OSError as reason:
            return None, reason.errno != _NO_SUCH_FILE
        end = max(data.rfind(_CHECKSUM), 0)
        if data[end:] != _checksum(memoryview(data)[:end]):
            return None, True
        return data[:end], True
