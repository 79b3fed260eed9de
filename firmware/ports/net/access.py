"""Access: which clients of the network may do more than read."""

import os

from base import errors
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from ports.net.client import Client

# Lines that change nothing, as plain() has them.
READING = (b"", b"$", b"$$", b"$#", b"$G", b"$I", b"$I+", b"$N", b"$NET")
_KEY = b"$NETKEY="
OK = b"ok\r\n"
REFUSED = b"error:%d\r\n"
_LOCKED = REFUSED % errors.SYSTEM_GC_LOCK
_MSG_KEY = b"[MSG:Read only: the network's key comes first, $NET/KEY=...]\r\n" + _LOCKED
_MSG_WRONG = b"[MSG:Wrong network key]\r\n" + _LOCKED
MSG_TAKEN = b"[MSG:Somebody else drives]\r\n"
TAKEN = MSG_TAKEN + _LOCKED
# How requests of HTTP begin, and TLS: no line for a Grbl begins with two letters like these.
_LETTERS = const(2)
_OF_BROWSERS = (b"GE", b"PO", b"PU", b"HE", b"OP", b"PA", b"DE", b"CO", b"TR", b"PR", b"\x16\x03")


def plain(said: bytearray) -> bytes:
    """A line in capitals, without spaces and slashes, its end, and what asks for a report."""
    line = bytes(said).upper()
    for sign in (b" ", b"/", b"?", b"\r", b"\n"):
        line = line.replace(sign, b"")
    return line


def is_browser(said: bytearray, count: int) -> bool:
    """Whether a line that begins like this is a browser's, which any page can have sent here."""
    return count == _LETTERS and bytes(said[:count]) in _OF_BROWSERS


class Access:
    """secret: the key; "" is nobody's. No address is trusted: a sender shares its own with every
    page that is open in a browser beside it."""

    def __init__(self) -> None:
        self.secret = ""

    def random_bytes(self, count: int) -> bytes:
        """So many bytes of the chip's own."""
        return os.urandom(count)

    def answer(self, client: "Client", line: bytes) -> bytes:
        """What becomes of a client's line, if it is not to be done: a key, or more than it may.
        Each key costs the same, and nobody waits for another's: there are 30 ** 8."""
        if not line.startswith(_KEY):
            return b"" if client.trusted or line in READING else _MSG_KEY
        if self.secret and line[len(_KEY) :] == self.secret.encode():
            client.trusted = True
            return OK
        client.tries -= 1
        return _MSG_WRONG
