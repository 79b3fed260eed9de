"""Jobs on a board: sent, listed, shown, started and deleted, over the serial line.

Upload: $FU=NAME,SIZE,CRC announces a file. The board asks for each piece by [FU:N], N being its
first byte; a piece is lines of base64, ended by an empty line. At the end the board answers ok.
"""

import base64
import re
import time
import zlib
from collections.abc import Callable, Iterator
from typing import NamedTuple

from ..grbl.gcode_file import is_answer
from ..grbl.messages import meaning
from .connection import Connection, SendError, way_out

# Bytes of a piece, and of a packed line, as firmware/extras/jobs/job_upload.py expects them.
_PIECE = 2048
_LINE = 256
_WINDOW_LOG2 = 10  # of the compression: what a board has memory for
_SILENCE_S = 12.0  # longer than a board takes to find free flash for a piece
# bytes per second; the board reads the complete file again, and copies it
_LOOKED_THROUGH_PER_S = 50_000
_BEGUN_S = 600.0  # to the first message: a scan of a long program, and its run in check mode
_FIRST_S = 0.5  # after each message: the first lines are refused within this time, if at all
_REFUSED = re.compile(r"refused with (\d+)")
_NAME = re.compile(r"[A-Z0-9_-][A-Z0-9._-]{0,31}")
_FILE = re.compile(r"\[FILE:/(.*)\|SIZE:(\d+)\]")
_MESSAGE = re.compile(r"\[(?:MSG:|(?!FILE:))(.*)\]")  # Grbl 0.9 has no MSG:
NO_JOBS = (
    'this machine stores no jobs; if it runs ugrbl, add the line JOBS = "jobs" to its board file, '
    "then run `ugrbl deploy`"
)


class File(NamedTuple):
    """A job on a board; size in bytes."""

    name: str
    size: int


def name_of(text: str) -> str:
    """Return the name of a file on a board. ValueError if the text cannot be a name."""
    name = text.upper()
    if not _NAME.fullmatch(name):
        words = "letters, digits, . _ -, 32 at most, and no dot at the beginning"
        raise ValueError(f"{text} is no name for a job ({words}): --name gives it another")
    return name


def push(connection: Connection, name: str, data: bytes, progress: Callable[[int], None]) -> None:
    """Send a file to the board; progress gets the number of bytes stored. SendError if the board
    refuses it; an older file of that name then stays unchanged."""
    if not data:
        raise SendError("the file is empty: there is nothing to store")
    connection.write(f"$FU={name},{len(data)},{zlib.crc32(data):x}\n".encode())
    replies = _Replies(connection)
    for start in range(0, len(data), _PIECE):
        replies.until(f"[FU:{start}]")
        progress(start)
        connection.write(b"".join(_lines(data[start : start + _PIECE])) + b"\n")
    replies.until("ok", _SILENCE_S + len(data) / _LOOKED_THROUGH_PER_S)
    progress(len(data))


def _lines(piece: bytes) -> Iterator[bytes]:
    """Yield the lines that carry a piece of a file: compressed (raw deflate), then base64."""
    packing = zlib.compressobj(9, zlib.DEFLATED, -_WINDOW_LOG2)  # negative: without a header
    packed = packing.compress(piece) + packing.flush()
    for start in range(0, len(packed), _LINE):
        yield base64.b64encode(packed[start : start + _LINE]) + b"\n"


def files(connection: Connection) -> tuple[list[File], str]:
    """Return all jobs, and the free space in words."""
    replies = _ask(connection, "$F")
    jobs = [File(match[1], int(match[2])) for line in replies if (match := _FILE.fullmatch(line))]
    return jobs, next((match[1] for line in replies if (match := _MESSAGE.fullmatch(line))), "")


def check_there(connection: Connection, name: str) -> None:
    """Raise SendError if the machine cannot store jobs, or has none of that name ("": any; it need
    not have one)."""
    jobs, _ = files(connection)  # raises SendError, too
    if name and name not in (job.name.upper() for job in jobs):
        raise SendError(f"There is no job {name}: `ugrbl job list` shows what there is")


def show(connection: Connection, name: str) -> str:
    """Return the text of a job."""
    return "\r\n".join(_ask(connection, f"$F<={name}")[:-1])


def delete(connection: Connection, name: str) -> None:
    """Delete a job."""
    _ask(connection, f"$FD={name}")


def button(connection: Connection, name: str) -> None:
    """Assign a job to the start button; an empty name removes the assignment."""
    _ask(connection, f"$FB={name}")


def start(connection: Connection, name: str, line: str = "") -> str:
    """Start a job, and return the machine's messages about it, one per line.

    line: "" starts at the first line, "@N" at line N (from 1), and "@" where the job was last held
    or stopped; then an empty name stands for that job. The first message may take _BEGUN_S,
    because the board scans the program first. Return when no other message has followed for
    _FIRST_S. SendError if there is no message, or if a line was refused.
    """
    if not connection.takes_overrides:  # Grbl 0.9, where @ opens the safety door
        line = line.replace("@", ",")
    _ask(connection, f"$F={name}{line}")
    messages: list[str] = []
    until = time.monotonic() + _BEGUN_S
    while time.monotonic() < until:
        for text in connection.lines():
            match = _MESSAGE.fullmatch(text)
            if match and match[1].startswith("Job "):
                messages.append(_REFUSED.sub(_with_meaning, match[1]))
                until = time.monotonic() + _FIRST_S  # then wait only for one more
    if not messages:
        raise SendError("the machine does not report that the job has begun; see `ugrbl console`")
    text = "\n".join(messages)
    if _REFUSED.search(text):
        raise SendError(text)
    return text


def _with_meaning(refused: re.Match[str]) -> str:
    """Return `refused with 20: ` and the meaning of that error."""
    return f"{refused[0]}: {meaning(f'error:{refused[1]}')}"


def _ask(connection: Connection, line: str) -> list[str]:
    """Send a line and return its replies, without status reports, which would appear within a
    file."""
    connection.write(line.encode() + b"\n")
    return _Replies(connection).until("ok")


class _Replies:
    """The lines received from the machine, without status reports."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._lines: list[str] = []

    def until(self, wanted: str, silence_s: float = _SILENCE_S) -> list[str]:
        """Return all lines up to the wanted one. SendError with the machine's message if it gives
        another answer, or if it is silent for too long."""
        last_received = time.monotonic()
        replies: list[str] = []
        while time.monotonic() - last_received < silence_s:
            if more := list(self._connection.lines()):
                last_received = time.monotonic()
                self._lines += [line for line in more if not line.startswith("<")]
            while self._lines:  # what follows the wanted line stays for the next call
                replies.append(self._lines.pop(0))
                if replies[-1] == wanted:
                    return replies
                if is_answer(replies[-1]):
                    raise SendError(_why(replies))
        state = self._connection.state()
        raise SendError(f"the machine does not answer in {state}: {way_out(state)}")


def _why(replies: list[str]) -> str:
    """Return why the machine has refused: its last message, or the meaning of its answer.

    replies: the lines received, the answer last.
    """
    messages = [match[1] for line in replies if (match := _MESSAGE.fullmatch(line))]
    if messages:
        return messages[-1]
    answer = replies[-1]
    if answer in ("error:3", "error:2"):  # as a Grbl answers that does not know the command
        return NO_JOBS
    return f"{answer}: {meaning(answer)}"
