"""Upload: a file that comes over the sender's line, while real-time commands act as ever.

It comes as lines of base64, for nothing in them is a real-time command, in pieces of 2 kB: flash
stops the processor while it is written, and so the next one waits until `[FU:n]` says that n
bytes are there. `[FU:0]` asks for the first.
"""

import binascii

from base import errors
from base.errors import GrblError
from micropython import const
from talk.lines import LINE, TOO_LONG, LineReader, clean

from extras.job_shelf import shown

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import IO

    from extras.api import Cnc
    from extras.job_shelf import Shelf

_PIECE = const(2048)
_LINE_BYTES = const(344)  # 256 of the file
_RING = const(512)
_READ = const(128)
_SILENCE_MS = const(5000)
_DRAIN_MS = const(300)
_BASE64_KINDS = b"/abcdefghijklmnopqrstuvwxyz"
_AS_IT_IS = const(0)


def receive(cnc: "Cnc", shelf: "Shelf", name: str, size: int, checksum: int) -> None:
    """Take a file and put it on the shelf. GrblError where it does not come whole, OSError where
    flash does not take it: what was there is as it was."""
    upload = _Upload(cnc, size)
    file = shelf.begin(name)
    try:
        upload.run(shelf, file)
    except BaseException:
        shelf.drop(name, file)
        raise
    if not shelf.finish(name, file, checksum):
        raise upload.refusal("its checksum is another")


class _Upload:
    """What has come, and what is still to come."""

    def __init__(self, cnc: "Cnc", size: int) -> None:
        self._cnc = cnc
        machine = cnc.machine
        self._machine = machine
        self._link = machine.protocol.link
        self._size = size
        self._done = 0
        self._buffer = bytearray(_READ)
        self._reader = LineReader(_RING, _LINE_BYTES, machine.reader.post)
        self._memory = self._reader.memory()
        _, _, self._line, kinds = self._memory
        kinds[:] = machine.reader.memory()[3]
        for c in _BASE64_KINDS:
            kinds[c] = _AS_IT_IS

    def run(self, shelf: "Shelf", file: "IO[bytes]") -> None:
        """Take piece after piece."""
        while self._done < self._size:
            self._cnc.tell(b"[FU:%d]" % self._done)
            piece = self._piece(min(_PIECE, self._size - self._done))
            shelf.append(file, piece)
            self._done += len(piece)

    def _piece(self, size: int) -> bytes:
        piece = b""
        while len(piece) < size:
            length = self._next_line()
            try:
                piece += binascii.a2b_base64(bytes(self._line[:length]))
            except ValueError:
                raise self.refusal("it came damaged")
        if len(piece) > size:
            raise self.refusal("more came than was told")
        return piece

    def _next_line(self) -> int:
        """The length of the next line. Raises Abort after a reset."""
        port = self._machine.port
        since = port.ticks_ms()
        while True:
            count = self._link.read_into(self._buffer)
            if count:
                self._reader.feed(self._buffer, count)
                since = port.ticks_ms()
            self._machine.realtime.events()
            found = clean(*self._memory)
            if found & LINE and found >> 2:
                return found >> 2
            if found & TOO_LONG:
                raise self.refusal("it came damaged")
            if port.elapsed_ms(since) > _SILENCE_MS:
                raise self.refusal("it broke off")

    def refusal(self, why: str) -> GrblError:
        """Say so; what is still on its way is not to be taken for commands."""
        port = self._machine.port
        since = port.ticks_ms()
        while port.elapsed_ms(since) < _DRAIN_MS:
            if self._link.read_into(self._buffer):
                since = port.ticks_ms()
        self._cnc.message("Not taken: " + why)
        return GrblError(errors.INVALID_STATEMENT)


def order(text: str) -> "tuple[str, int, int]":
    """NAME,SIZE,CRC: the file's name, how long it is, and its CRC-32 in hexadecimal digits.
    GrblError where that is not what it says."""
    name, _, rest = text.partition(",")
    size, _, checksum = rest.partition(",")
    try:
        return name, int(size), int(checksum, 16)
    except ValueError:
        raise GrblError(errors.BAD_NUMBER_FORMAT)


def check(cnc: "Cnc", shelf: "Shelf", name: str, size: int) -> None:
    """GrblError where it cannot be taken, before anything is done."""
    room_kb = shelf.room_kb()
    if size <= 0 or size > room_kb * 1024:
        cnc.message("%s: %d bytes, and there is room for %d kB" % (shown(name), size, room_kb))
        raise GrblError(errors.INVALID_STATEMENT)
