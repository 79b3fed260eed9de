"""Access: which callers of the network may do more than read."""

import os
import time

from base import errors
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from ports.caller import Caller

_WRONG_MS = const(1000)  # after a wrong key no other is heard for so long
# Lines that change nothing; as they are when spaces and slashes are left out.
_READING = (b"", b"$", b"$$", b"$#", b"$G", b"$I", b"$I+", b"$N", b"$NET")
_KEY = b"$NETKEY="
OK = b"ok\r\n"
REFUSED = b"error:%d\r\n"
_LOCKED = REFUSED % errors.SYSTEM_GC_LOCK
_MSG_KEY = b"[MSG:Read only: the network's key comes first, $NET/KEY=...]\r\n" + _LOCKED
_MSG_WRONG = b"[MSG:Wrong network key]\r\n" + _LOCKED
MSG_TAKEN = b"[MSG:Somebody else drives]\r\n"
TAKEN = MSG_TAKEN + _LOCKED


class Access:
    """secret: the key; "" is nobody's. allowed: addresses of those who need none."""

    def __init__(self) -> None:
        self.secret = ""
        self.allowed: "list[str]" = []
        self._wrongs = 0
        self._wrong_ms = 0

    def noise(self, count: int) -> bytes:
        """So many bytes of the chip's own."""
        return os.urandom(count)

    def answer(self, caller: "Caller", line: bytes, now_ms: int) -> bytes:
        """What becomes of a caller's line, if it is not to be done: a key, or more than he may."""
        if line.startswith(_KEY):
            return self._check_key(caller, line[len(_KEY) :], now_ms)
        return b"" if caller.trusted or line in _READING else _MSG_KEY

    def _check_key(self, caller: "Caller", key: bytes, now_ms: int) -> bytes:
        if self._wrongs == 0 or time.ticks_diff(now_ms, self._wrong_ms) >= _WRONG_MS:
            if self.secret and key == self.secret.encode():
                caller.trusted = True
                if caller.address not in self.allowed:
                    self.allowed.append(caller.address)
                return OK
            self._wrongs += 1
            self._wrong_ms = now_ms
        return _MSG_WRONG
