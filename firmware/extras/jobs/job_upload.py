"""Upload: a file received from the sender, while real-time commands work.

It is sent in pieces of 2 kB, because flash stops the processor while it is written. The next piece
waits for `[FU:n]`, which reports that n bytes are stored; `[FU:0]` asks for the first. A piece is
deflated, because a byte takes 10 us and more on its way, and then encoded as lines of base64,
because these contain no real-time commands. An empty line ends it.
"""

import binascii
import io

import deflate
from base import errors
from base.errors import GrblError
from base.faults import sanitize
from micropython import const
from talk.lines import LINE, TOO_LONG, LineReader, clean

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from interfaces import JobFiles

    from extras.api import Cnc

_PIECE = const(2048)
_LINE_BYTES = const(256)  # bytes packed in one line
_WINDOW_LOG2 = const(10)
_READ = const(128)
_SILENCE_MS = const(5000)
_QUIET_MS = const(300)
_LOWER_CASE = b"abcdefghijklmnopqrstuvwxyz"
_SLASH = const(47)
_AS_IT_IS = const(0)


class Upload:
    """Receives files. No other part uses `reader` meanwhile."""

    def __init__(self, cnc: "Cnc", files: "JobFiles", reader: LineReader) -> None:
        machine = cnc.machine
        self._cnc = cnc
        self._machine = machine
        self._files = files
        self._link = machine.protocol.link
        self._buffer = bytearray(_READ)
        self._reader = reader

    def receive_file(self, order: str) -> None:
        """Receive a file. order: NAME,SIZE,CRC, with the CRC-32 in hexadecimal digits.

        GrblError if it cannot be accepted, before anything is written, or if it is damaged.
        OSError if flash cannot store it. In all these cases an existing file stays as it was.
        """
        name, _, rest = order.partition(",")
        size_text, _, checksum_text = rest.partition(",")
        try:
            size, checksum = int(size_text), int(checksum_text, 16)
        except ValueError:
            raise GrblError(errors.BAD_NUMBER_FORMAT)
        self._check(name, size)
        self._reader.clear()
        kinds = self._reader.memory()[3]
        before = bytes(kinds)
        for c in _LOWER_CASE:
            kinds[c] = _AS_IT_IS
        kinds[_SLASH] = _AS_IT_IS
        try:
            self._write_file(name, size, checksum)
        finally:
            kinds[:] = before

    def _check(self, name: str, size: int) -> None:
        if not self._files.is_name(name):
            self._refuse("A job is called so: letters, digits, . _ -, at most 32")
        room_kb = self._files.free_kb()
        if size <= 0 or size > room_kb * 1024:
            text = "%s: %d bytes, and there is room for %d kB"
            self._refuse(text % (sanitize(name), size, room_kb))

    def _refuse(self, why: str) -> None:
        self._cnc.message(why)
        raise GrblError(errors.INVALID_STATEMENT)

    def _write_file(self, name: str, size: int, checksum: int) -> None:
        files = self._files
        file = files.begin(name)
        try:
            done = 0
            while done < size:
                self._cnc.write_line(b"[FU:%d]" % done)
                piece = self._piece(min(_PIECE, size - done))
                files.append(file, piece)
                done += len(piece)
        except BaseException:
            files.drop(name, file)
            raise
        if not files.finish(name, file, checksum):
            self._drain("its checksum is another")

    def _piece(self, size: int) -> bytearray:
        piece = bytearray(size)
        if self._unpack(piece) != size:
            self._drain("it came damaged")
        return piece

    def _unpack(self, piece: bytearray) -> int:
        """Fill the piece with the data up to an empty line. Return the number of bytes."""
        packed = b""
        length = self._next_line()
        try:
            while length and len(packed) <= _PIECE + _LINE_BYTES:
                packed += binascii.a2b_base64(bytes(self._reader.line[:length]))
                length = self._next_line()
            return deflate.DeflateIO(io.BytesIO(packed), deflate.RAW, _WINDOW_LOG2).readinto(piece)
        except (ValueError, OSError, EOFError):
            return 0

    def _next_line(self) -> int:
        """Return the length of the next line. Raises Abort after a reset."""
        port = self._machine.port
        since = port.ticks_ms()
        while True:
            if self._receive():
                since = port.ticks_ms()
            found = clean(*self._reader.memory())
            if found & LINE:
                return found >> 2
            if found & TOO_LONG:
                self._drain("it came damaged")
            if port.elapsed_ms(since) > _SILENCE_MS:
                self._drain("it broke off")

    def _receive(self) -> bool:
        """Read received bytes and handle real-time commands. Return whether there were more."""
        reader, free = self._reader, self._reader.free()
        count = self._link.read_into(self._buffer)
        if count:
            reader.feed(self._buffer, count)
        self._machine.realtime.handle_events()
        return reader.free() != free

    def _drain(self, why: str) -> None:
        """Drop the rest, which must not be read as commands, until the sender is quiet for
        _QUIET_MS, or for _SILENCE_MS at the most; then report why."""
        port = self._machine.port
        begun = since = port.ticks_ms()
        while port.elapsed_ms(since) < _QUIET_MS and port.elapsed_ms(begun) < _SILENCE_MS:
            if self._receive():
                since = port.ticks_ms()
            self._reader.clear()
        self._refuse("Not taken: " + why)
