"""Access: which clients of the network may do more than read."""

import os

from base import errors
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from ports.net.client import Client

# Lines that change nothing, in the form that plain() returns.
READ_ONLY_LINES = (b"", b"$", b"$$", b"$#", b"$G", b"$I", b"$I+", b"$N", b"$NET")
_KEY_LINE = b"$NETKEY="  # $NET/KEY= in the form that plain() returns
OK = b"ok\r\n"
REFUSED = b"error:%d\r\n"
_LOCKED = REFUSED % errors.SYSTEM_GC_LOCK
_MSG_KEY_NEEDED = b"[MSG:Read only: send the network's key first, $NET/KEY=...]\r\n" + _LOCKED
_MSG_WRONG_KEY = b"[MSG:Wrong network key]\r\n" + _LOCKED
MSG_TAKEN = b"[MSG:Another has control]\r\n"
TAKEN = MSG_TAKEN + _LOCKED
# The first bytes of HTTP requests and of TLS. No line for Grbl begins with two such letters.
_LETTERS = const(2)  # bytes to compare
_BROWSERS = (b"GE", b"PO", b"PU", b"HE", b"OP", b"PA", b"DE", b"CO", b"TR", b"PR", b"\x16\x03")


def plain(received: bytearray) -> bytes:
    """Return a line in capitals, without spaces, slashes, ? and its end: the form to compare."""
    line = bytes(received).upper()
    for sign in (b" ", b"/", b"?", b"\r", b"\n"):
        line = line.replace(sign, b"")
    return line


def is_browser(received: bytearray, count: int) -> bool:
    """Return whether a line with this beginning is a browser's: any web page can send one here.

    count: stored bytes, with those of lines that wait. False unless they are two.
    """
    return count == _LETTERS and bytes(received[:count]) in _BROWSERS


class Access:
    """The access check. secret: the key in capitals, "" if there is none. No address is trusted,
    because a sender shares its address with every page open in a browser on the same computer."""

    def __init__(self) -> None:
        self.secret = ""

    def random_bytes(self, count: int) -> bytes:
        """Return so many random bytes from the chip."""
        return os.urandom(count)

    def answer(self, client: "Client", line: bytes) -> bytes:
        """Return the answer to a client's line if the line must not be executed: one with the key,
        or one that the client may not send; else b"". line: as plain() returns it.

        The right key makes the client trusted; a wrong one costs one of its tries. There is no
        delay after a wrong key, for which other clients would wait: there are 30 ** 8 keys.
        """
        if not line.startswith(_KEY_LINE):
            return b"" if client.trusted or line in READ_ONLY_LINES else _MSG_KEY_NEEDED
        if self.secret and line[len(_KEY_LINE) :] == self.secret.encode():
            client.trusted = True
            return OK
        client.tries -= 1
        return _MSG_WRONG_KEY
