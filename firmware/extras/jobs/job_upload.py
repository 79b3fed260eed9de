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
from base.errors import Abort, GrblError
from base.text import sanitize
from micropython import const
from talk.lines import LINE, TOO_LONG, LineReader, clean

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from interfaces import JobFiles

    from extras.api import Cnc

_PIECE_BYTES = const(2048)  # of the file
_LINE_BYTES = const(256)  # bytes packed in one line
_WINDOW_LOG2 = const(10)  # of deflate
_READ_BYTES = const(128)  # of one read from the link
_SILENCE_MS = const(5000)  # a sender that is silent for so long has gone
_QUIET_MS = const(300)  # after a refusal, the sender has then stopped sending
_LOWER_CASE = b"abcdefghijklmnopqrstuvwxyz"
_SLASH = const(47)
_ORDINARY_KIND = const(0)  # of bytes that the reader keeps as they are


class Upload:
    """Receives files. No other part uses `reader` meanwhile."""

    def __init__(self, cnc: "Cnc", files: "JobFiles", reader: LineReader) -> None:
        machine = cnc.machine
        self._cnc = cnc
        self._machine = machine
        self._files = files
        self._link = machine.protocol.link
        self._buffer = bytearray(_READ_BYTES)
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
        kinds = self._reader.memory()[3]  # the kind of each byte value
        kinds_before = bytes(kinds)
        for c in _LOWER_CASE:  # base64 has them, and the slash
            kinds[c] = _ORDINARY_KIND
        kinds[_SLASH] = _ORDINARY_KIND
        try:
            self._write_file(name, size, checksum)
        finally:
            kinds[:] = kinds_before

    def _check(self, name: str, size: int) -> None:
        """Refuse a file by a message and GrblError if its name or size (bytes) is impossible."""
        if not self._files.is_name(name):
            self._refuse("A job name may have up to 32 letters, digits, . _ -")
        free_kb = self._files.free_kb()
        if size <= 0 or size > free_kb * 1024:
            text = "%s has %d bytes, but only %d kB are free"
            self._refuse(text % (sanitize(name), size, free_kb))

    def _refuse(self, why: str) -> None:
        """Send a message, and raise GrblError."""
        self._cnc.message(why)
        raise GrblError(errors.INVALID_STATEMENT)

    def _write_file(self, name: str, size: int, checksum: int) -> None:
        """Request all pieces, and write them. In case of an error the received file is deleted.
        GrblError if a piece or the CRC-32 (checksum) is wrong, OSError if flash is full."""
        files = self._files
        file = files.begin(name)
        try:
            piece = bytearray(_PIECE_BYTES)
            done = 0  # bytes written
            while done < size:
                self._cnc.write_line(b"[FU:%d]" % done)
                if size - done < _PIECE_BYTES:  # the last
                    piece = bytearray(size - done)
                if self._receive_data(piece) != len(piece):
                    self._drain_and_refuse("the data arrived damaged")
                self._wait_parked()
                files.append(file, piece)
                done += len(piece)
            self._wait_parked()
        except BaseException as reason:
            try:
                if not isinstance(reason, Abort):  # a reset has stopped the motors
                    self._wait_parked()
            finally:
                files.drop(name, file)
            raise
        if not files.finish(name, file, checksum):
            self._drain_and_refuse("the checksum does not match")

    def _wait_parked(self) -> None:
        """Wait until no parking move of the door is executed, because flash is written next."""
        while self._machine.state.system_motion:
            self._poll_link()

    def _receive_data(self, piece: bytearray) -> int:
        """Receive lines up to an empty one, and fill the piece with their data: base64 decoded,
        then inflated. Return the number of bytes; 0 if the data is damaged."""
        line = memoryview(self._reader.line)
        packed = io.BytesIO()
        length = self._next_line()
        try:
            while length and packed.tell() <= _PIECE_BYTES + _LINE_BYTES:  # more is damaged data
                packed.write(binascii.a2b_base64(line[:length]))
                length = self._next_line()
            packed.seek(0)
            return deflate.DeflateIO(packed, deflate.RAW, _WINDOW_LOG2).readinto(piece)
        except (ValueError, OSError, EOFError):
            return 0

    def _next_line(self) -> int:
        """Receive a line, which is then in the reader, and return its length. GrblError if it is
        too long or does not come in time, Abort after a reset."""
        port = self._machine.port
        last_byte_ms = port.ticks_ms()
        while True:
            if self._poll_link():
                last_byte_ms = port.ticks_ms()
            result = clean(*self._reader.memory())  # length << 2, and LINE or TOO_LONG
            if result & LINE:
                return result >> 2
            if result & TOO_LONG:
                self._drain_and_refuse("the data arrived damaged")
            if port.elapsed_ms(last_byte_ms) > _SILENCE_MS:
                self._drain_and_refuse("the sender stopped sending")

    def _poll_link(self) -> bool:
        """Read received bytes and handle real-time commands. Return whether the reader got bytes
        of a line."""
        reader, free_before = self._reader, self._reader.free()
        count = self._link.read_into(self._buffer)
        if count:
            reader.feed(self._buffer, count)
        self._machine.realtime.handle_events()
        self._machine.realtime.advance_suspension()  # a hold or the door switches the tool off
        return reader.free() != free_before

    def _drain_and_refuse(self, why: str) -> None:
        """Drop the rest, which must not be read as commands, until the sender is quiet for
        _QUIET_MS, or for _SILENCE_MS at the most; then report why, and raise GrblError."""
        port = self._machine.port
        start_ms = last_byte_ms = port.ticks_ms()
        while (
            port.elapsed_ms(last_byte_ms) < _QUIET_MS and port.elapsed_ms(start_ms) < _SILENCE_MS
        ):
            if self._poll_link():
                last_byte_ms = port.ticks_ms()
            self._reader.clear()
        self._refuse("Upload refused: " + why)
