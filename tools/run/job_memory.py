"""Jobs of a machine in memory: none at first, and lost with the machine.

A board's file names a folder (JOBS), which in the simulator would be a folder of this computer. A
program that deletes or stores a job would then change the user's own files.
"""

import binascii
from collections.abc import Callable
from io import BytesIO
from types import ModuleType
from typing import IO, Any

from ports.storage import job_files

_FILES = "_job_files"  # the board's attribute for its jobs
_ROOM_KB = 1024
_folder_of_board = job_files.of_board


def _nothing() -> None:
    """Do nothing."""


class MemoryFiles:
    """Jobs in memory, with the interface of ports.storage.job_files.JobFiles."""

    def __init__(self) -> None:
        self._kept: dict[str, bytes] = {}
        self.is_name = job_files.JobFiles("").is_name
        self.on_progress: Callable[[], object] = _nothing

    def connect(self, store: Any, link: Any) -> None:
        """Do nothing: no flash is written."""

    def mount(self) -> None:
        """Do nothing: there is no card to mount."""

    def lose(self) -> bool:
        """Return False: there is no card that can be removed."""
        return False

    def files(self) -> list[tuple[str, int]]:
        """Return names and sizes, sorted."""
        return [(name, len(data)) for name, data in sorted(self._kept.items())]

    def size(self, name: str) -> int:
        """Return the size in bytes; -1 if there is no such job."""
        return len(self._kept[name]) if name in self._kept else -1

    def open(self, name: str) -> IO[bytes]:
        """Open a job for reading. OSError if there is no such job."""
        if name not in self._kept:
            raise OSError(f"there is no job {name}")
        return BytesIO(self._kept[name])

    def free_kb(self) -> int:
        """Return the free space, as on a board with much of it."""
        return _ROOM_KB

    def delete(self, name: str) -> None:
        """Delete a job."""
        del self._kept[name]

    def begin(self, name: str) -> IO[bytes]:
        """Return a file for a new job's content."""
        return BytesIO()

    def append(self, file: IO[bytes], piece: bytes | bytearray) -> None:
        """Write the next piece."""
        file.write(piece)

    def finish(self, name: str, file: IO[bytes], checksum: int) -> bool:
        """Store the new job. Returns False if the checksum does not match."""
        file.seek(0)
        data = file.read()
        if binascii.crc32(data) != checksum:
            return False
        self._kept[name] = data
        return True

    def drop(self, name: str, file: IO[bytes]) -> None:
        """Discard the new content."""


def _of_board(board: ModuleType) -> Any:
    """Replace job_files.of_board."""
    return vars(board).get(_FILES) or _folder_of_board(board)


def keep_in_memory(board: Any) -> None:
    """Make a machine of that board store its jobs in memory. The board is changed, so pass a
    copy."""
    vars(board)[_FILES] = MemoryFiles()
    job_files.of_board = _of_board
