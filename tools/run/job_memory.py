"""The jobs of a machine that is only looked at: in memory, none at first, and gone with it.

A board's file names a folder (JOBS), which for the simulator would be one of this computer: a
program that deletes a job, or takes one, would do so to the user's own files.
"""

import binascii
from collections.abc import Callable
from io import BytesIO
from types import ModuleType
from typing import IO, Any

from ports.storage import job_files

_FILES = "_job_files"  # under which a board has them
_ROOM_KB = 1024
_folder_of_board = job_files.of_board


def _nothing() -> None:
    """Where nobody else has to have a turn."""


class MemoryFiles:
    """As ports.storage.job_files.JobFiles has them."""

    def __init__(self) -> None:
        self._kept: dict[str, bytes] = {}
        self.is_name = job_files.JobFiles("").is_name
        self.on_progress: Callable[[], object] = _nothing

    def connect(self, store: Any, link: Any) -> None:
        """No flash is written."""

    def mount(self) -> None:
        """They are there."""

    def lose(self) -> bool:
        """They cannot be taken out."""
        return False

    def files(self) -> list[tuple[str, int]]:
        """Names and sizes, in order."""
        return [(name, len(data)) for name, data in sorted(self._kept.items())]

    def size(self, name: str) -> int:
        """Bytes; -1 where there is none of that name."""
        return len(self._kept[name]) if name in self._kept else -1

    def open(self, name: str) -> IO[bytes]:
        """To be read. OSError where there is none."""
        if name not in self._kept:
            raise OSError(f"there is no job {name}")
        return BytesIO(self._kept[name])

    def free_kb(self) -> int:
        """As on a board with much of it."""
        return _ROOM_KB

    def delete(self, name: str) -> None:
        """Take one away."""
        del self._kept[name]

    def begin(self, name: str) -> IO[bytes]:
        """Where to write what is to be called so."""
        return BytesIO()

    def append(self, file: IO[bytes], piece: bytes | bytearray) -> None:
        """Write the next piece."""
        file.write(piece)

    def finish(self, name: str, file: IO[bytes], checksum: int) -> bool:
        """Have it take its place; False where it is not what was sent."""
        file.seek(0)
        data = file.read()
        if binascii.crc32(data) != checksum:
            return False
        self._kept[name] = data
        return True

    def drop(self, name: str, file: IO[bytes]) -> None:
        """What has come is not wanted."""


def _of_board(board: ModuleType) -> Any:
    """In the place of job_files.of_board."""
    return vars(board).get(_FILES) or _folder_of_board(board)


def keep_in_memory(board: Any) -> None:
    """Have a machine of that board keep its jobs so. The board is changed: let it be a copy."""
    vars(board)[_FILES] = MemoryFiles()
    job_files.of_board = _of_board
