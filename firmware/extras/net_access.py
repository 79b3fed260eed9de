"""The network beside the cable, as far as it is the machine's: `$NET`, its key, and who drives.

LINK = "wifi" or "uart_wifi" in the board file asks for it. What is kept is written at rest, by
lines that come over the cable only, and holds from the next start on: ports/wifi.py reads it.
Names and passwords come as hexadecimal digits, for a line has neither small letters nor spaces;
they are told to nobody. docs/network.md has the words.
"""

from base import errors
from base.errors import GrblError
from base.text import text_of
from micropython import const
from talk.lines import COMPLETE, END, HEAD, LENGTH, SKIPPING, TAIL

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array

    from interfaces import NetworkLink
    from talk.lines import LineReader

    from extras.api import Cnc

_FILE = "network"
_KEY_LENGTH = const(8)
# No letter that makes a word which senders take for an answer.
_KEY_SIGNS = "23456789ABCDFGHJKLMNPQRSTVWXYZ"
_DIGITS = "0123456789"
_LETTERS = "abcdefghijklmnopqrstuvwxyz"
_HOST_SIGNS = _LETTERS + _DIGITS + "-"
_LONGEST_HOST = const(31)
_LONGEST_NAME = const(32)
_SHORTEST_PASSWORD = const(8)
_LONGEST_PASSWORD = const(63)
_HIGHEST_PORT = const(65535)


def has_half(ring: bytearray, at: "array[int]", kinds: bytearray) -> bool:
    """Whether a line has begun and not ended."""
    head = at[HEAD]
    if head != at[TAIL]:
        return kinds[ring[head - 1]] != END
    return bool(at[LENGTH] or at[SKIPPING]) and not at[SKIPPING] & COMPLETE


def drop_half(ring: bytearray, at: "array[int]", kinds: bytearray) -> None:
    """Forget the line that has begun and not ended, and nothing before it."""
    head = at[HEAD]
    while head != at[TAIL] and kinds[ring[head - 1]] != END:
        head = (head or len(ring)) - 1
    at[HEAD] = head
    if head == at[TAIL] and not at[SKIPPING] & COMPLETE:
        at[LENGTH] = at[SKIPPING] = 0


class Network:
    """`$NET`, and what it keeps. link: None where the simulator has no network."""

    def __init__(self, cnc: "Cnc", link: "NetworkLink | None") -> None:
        machine = cnc.machine
        self._cnc = cnc
        self._link = link
        self._saves = machine.saves
        self._reader: "LineReader" = machine.reader
        self._kept: "dict[str, str]" = {}
        for line in machine.saves.load(_FILE) or []:
            name, _, self._kept[name] = line.partition("=")
        self._is_new = link is not None and "KEY" not in self._kept
        if self._is_new:
            self._kept["KEY"] = self._new_key()
            self._keep()
        self._know()
        if link:
            link.control.drop_half = lambda: drop_half(*self._received())
            link.control.has_half = lambda: has_half(*self._received())

    def _new_key(self) -> str:
        """One that nobody can guess: 39 bits of the chip's own noise."""
        noise = self._link.access.noise(_KEY_LENGTH) if self._link else b""
        return "".join([_KEY_SIGNS[byte % len(_KEY_SIGNS)] for byte in noise])

    def _know(self) -> None:
        if self._link:
            self._link.access.secret = self._kept["KEY"]

    def _keep(self) -> None:
        self._saves.save(_FILE, ["%s=%s" % row for row in sorted(self._kept.items())])

    # The machine's turns

    def between(self) -> None:
        """Between two lines."""
        link = self._link
        if link and link.control.ending and not self._reader.has_line():
            link.control.done()

    def greet(self) -> None:
        """Behind the welcome, at the first start."""
        if self._is_new:
            self._is_new = False
            self._tell_key()

    def _received(self) -> "tuple[bytearray, array[int], bytearray]":
        ring, at, _, kinds = self._reader.memory()
        return ring, at, kinds

    def _tell_key(self) -> None:
        if self._link:
            line = b"[MSG:Network key: %s]\r\n" % self._kept["KEY"].encode()
            self._link.tell_cable(line)

    # The command

    def command(self, rest: bytes) -> None:
        """$NET, and $NET/… as lines come, without the slash. Raises GrblError."""
        name, sign, text = _parted(text_of(rest))
        link = self._link
        if not rest:
            count = link.callers() if link else 0
            status = link.status() if link else "no network is set up"
            self._cnc.message("Network: %s; connected: %d" % (status, count))
            return
        if link is None:
            self._refuse("There is no network here")
        elif not link.by_cable():
            if name != "KEY":  # a sender may say its key each time
                self._refuse("That is set up at the cable")
            return
        if name == "KEY" and not sign:
            self._tell_key()
            return
        self._set(name, sign, text)
        self._keep()
        self._know()
        if name != "KEY":
            self._cnc.message("Network: holds from the next start on")

    def _set(self, name: str, sign: str, text: str) -> None:
        kept = self._kept
        if name == "KEY" and text == "NEW":
            kept["KEY"] = self._new_key()
            if self._link:
                self._link.expel()
            self._tell_key()
        elif name == "OFF" and not sign:
            for one in ("SSID", "PASS"):
                kept.pop(one, None)
        elif name == "SSID" and sign == "=":
            kept["SSID"] = self._hex(text, 1, _LONGEST_NAME)
        elif name == "PASS" and sign:
            before = kept.get("PASS", "") if sign == "+" else ""
            kept["PASS"] = self._hex(before + text, 0, _LONGEST_PASSWORD)
        elif name == "MODE" and text in ("STATION", "AP"):
            if text == "AP" and len(kept.get("PASS", "")) < 2 * _SHORTEST_PASSWORD:
                self._refuse("An access point has a password of 8 letters or more, first")
            kept["MODE"] = text.lower()
        elif name == "HOST" and sign == "=":
            kept["HOST"] = self._host(text.lower())
        elif name == "PORT" and sign == "=":
            kept["PORT"] = self._port(text)
        else:
            self._refuse("$NET/SSID= PASS= MODE=STATION MODE=AP HOST= PORT= KEY OFF")

    def _refuse(self, why: str) -> None:
        self._cnc.message(why)
        raise GrblError(errors.INVALID_STATEMENT)

    def _hex(self, text: str, fewest: int, most: int) -> str:
        try:
            count = len(bytes.fromhex(text))
        except ValueError:
            count = -1
        if not fewest <= count <= most:
            self._refuse("That is %d to %d bytes, as hexadecimal digits" % (fewest, most))
        return text

    def _host(self, text: str) -> str:
        if not _is_of(text, _HOST_SIGNS) or text[0] == "-" or len(text) > _LONGEST_HOST:
            self._refuse("A host name has letters, digits and -, at most 31")
        return text

    def _port(self, text: str) -> str:
        if not (_is_of(text, _DIGITS) and 0 < int(text) <= _HIGHEST_PORT):
            self._refuse("A port is a number from 1 to 65535")
        return text


def _parted(text: str) -> "tuple[str, str, str]":
    """Name, sign and value of `NAME=VALUE`, `NAME+VALUE` or `NAME`."""
    for sign in "=+":
        name, found, value = text.partition(sign)
        if found and _is_of(name.lower(), _LETTERS):
            return name, sign, value
    return text, "", ""


def _is_of(text: str, signs: str) -> bool:
    """There is text, of no other signs. What Python has for it would take names of MicroPython's
    that others are called by: compiling/shorten.py."""
    return bool(text) and not [sign for sign in text if sign not in signs]


def install(cnc: "Cnc") -> None:
    """Have the machine know its network."""
    link = cnc.machine.protocol.link
    network = Network(cnc, link if hasattr(link, "by_cable") else None)  # type: ignore[arg-type]
    cnc.before_lines(network.between)
    cnc.behind_reset(network.greet)
    cnc.add_command(b"NET", network.command)
