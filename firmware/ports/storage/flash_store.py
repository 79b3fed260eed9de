"""Store in the board's flash: one text file per name, which survives a power cut at any byte.

A save writes a new file, reads it back, keeps the old one as the previous
copy and puts the new one in its place; littlefs makes each renaming happen
or not happen. A file's last line is the checksum of the others, and its bytes
are decoded only after that has been checked. Whoever saves sees to it that
the machine is at rest: flash stops the processor, up to 0.4 s for each of the
sectors it erases, and nothing is heard meanwhile.
"""

import binascii
import os

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

# In the order in which load() looks: the newest whole file counts.
_NOW = ".txt"
_NEW = ".new"
_OLD = ".old"
_CHECKSUM = b"#crc32="

_NO_SUCH_FILE = const(2)  # ENOENT
_NO_MEMORY = const(12)  # ENOMEM


def _nothing() -> None:
    """Where nobody has to be told."""


def _checksum(data: bytes) -> bytes:
    """The last line of a file."""
    return _CHECKSUM + b"%08x\n" % binascii.crc32(data)


class FlashStore:
    """A Store. folder: where the files are, with a slash at its end.

    before, after: called around each save, whatever becomes of it.
    """

    def __init__(self, folder: str = "/") -> None:
        self._folder = folder
        self.before: "Callable[[], None]" = _nothing
        self.after: "Callable[[], None]" = _nothing
        self.damaged: "dict[str, bool]" = {}

    def load(self, name: str) -> "list[str] | None":
        """The lines kept under that name: none where there never were any, None where no copy
        of them is whole. What is not the newest copy's is noted in `damaged`."""
        is_damaged = False
        for kind in (_NOW, _NEW, _OLD):
            lines, there = self._read(self._folder + name + kind)
            # A power cut leaves part of a new file, or all of it and none in its place; it neither
            # spoils the one in place nor leaves the previous copy alone.
            if kind == _OLD or (kind == _NOW and lines is None):
                is_damaged = is_damaged or there
            if lines is not None:
                if is_damaged:
                    self.damaged[name] = True
                return lines
        if is_damaged:
            self.damaged[name] = False
            return None
        return []

    def save(self, name: str, lines: "Iterable[str]") -> None:
        """Replace the lines at once or not at all. Raises OSError where flash is full or
        worn, or memory has no room for all of them."""
        kept = list(lines)
        self.before()
        try:
            self._write(self._folder + name, kept)
        except MemoryError:
            raise OSError(_NO_MEMORY)
        finally:
            self.after()

    def _write(self, path: str, kept: "list[str]") -> None:
        is_whole = self._read(path + _NOW)[0] is not None
        if not is_whole and self._read(path + _NEW)[0] is not None:
            os.rename(path + _NEW, path + _NOW)  # a power cut came before that
            is_whole = True
        data = "".join([line + "\n" for line in kept]).encode()
        with open(path + _NEW, "wb") as file:
            file.write(data)
            file.write(_checksum(data))
        if self._read(path + _NEW)[0] != kept:
            raise OSError("flash does not keep what is written")
        if is_whole:
            os.rename(path + _NOW, path + _OLD)
        os.rename(path + _NEW, path + _NOW)

    def _read(self, path: str) -> "tuple[list[str] | None, bool]":
        """The lines of a file, None where it is not whole; and whether there is one."""
        try:
            with open(path, "rb") as file:
                data = file.read()
        except OSError as reason:
            return None, reason.errno != _NO_SUCH_FILE
        kept = data[: max(data.rfind(_CHECKSUM), 0)]
        if data != kept + _checksum(kept):
            return None, True
        try:
            return kept.decode().split("\n")[:-1], True
        except ValueError:  # somebody else has written it
            return None, True
