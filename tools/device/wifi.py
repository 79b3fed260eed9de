"""Set up the Wi-Fi of a board over its cable by `$NET` (firmware/extras/net/net_access.py).

Names and passwords are sent as hexadecimal digits, because a line of Grbl's has neither lower-case
letters nor spaces. The board's replies have neither, too.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from .connection import Connection, SendError

_HOST = re.compile(r"[A-Za-z0-9][A-Za-z0-9-]{0,30}")
_LONGEST_NAME = 32
_SHORTEST_PASSWORD, _LONGEST_PASSWORD = 8, 63
_PIECE = 32  # bytes of a password per line
_PREFIX = "[MSG:"
_STATUS = "[MSG:Network: "
_KEY = "[MSG:Network key: "


@dataclass(frozen=True)
class Wanted:
    """The changes to make; None leaves a value unchanged."""

    name: str | None = None
    password: str | None = None
    is_station: bool | None = None
    host: str | None = None
    port: int | None = None


def orders(wanted: Wanted) -> Iterator[str]:
    """Yield the lines that make these changes; None: no change. ValueError if a value is not
    possible.

    At no time is there an access point without a password, because the board refuses that.
    """
    if wanted.is_station:
        yield "$NET/MODE=STATION"
    if wanted.name is not None:
        yield "$NET/SSID=" + _hex("the network's name", wanted.name, 1, _LONGEST_NAME)
    if wanted.password is not None:
        fewest = _SHORTEST_PASSWORD if wanted.password else 0  # "": an open network
        digits = _hex("the password", wanted.password, fewest, _LONGEST_PASSWORD)
        # A line has space for _PIECE bytes, two digits each; PASS+ adds the others.
        yield "$NET/PASS=" + digits[: 2 * _PIECE]
        if digits[2 * _PIECE :]:
            yield "$NET/PASS+" + digits[2 * _PIECE :]
    if wanted.is_station is False:
        yield "$NET/MODE=AP"
    if wanted.host is not None:
        if not _HOST.fullmatch(wanted.host):
            raise ValueError("a host name may have letters, digits and -, 31 at the most")
        yield "$NET/HOST=" + wanted.host
    if wanted.port is not None:
        yield f"$NET/PORT={wanted.port}"


def _hex(what: str, text: str, fewest: int, most: int) -> str:
    """Return a text's bytes as hexadecimal digits. ValueError, which names it (what), if it has
    not `fewest` to `most` bytes."""
    data = text.encode()
    if not fewest <= len(data) <= most:
        raise ValueError(f"{what} has {len(data)} bytes, and may have {fewest} to {most}")
    return data.hex().upper()


def set_up(connection: Connection, lines: list[str]) -> None:
    """Send the lines. SendError, with the board's own words, if it refuses one."""
    for line in lines:
        _ask(connection, line)


def status(connection: Connection) -> str:
    """Return the board's description of its network."""
    return _text_after(_ask(connection, "$NET"), _STATUS)


def key(connection: Connection, new: bool) -> str:
    """Return the key that allows a sender to do more than read. new: create another key."""
    return _text_after(_ask(connection, "$NET/KEY=NEW" if new else "$NET/KEY"), _KEY)


def switch_off(connection: Connection) -> None:
    """Make the board forget the network's name and password."""
    _ask(connection, "$NET/OFF")


def _text_after(replies: list[str], prefix: str) -> str:
    """Return the text of the message that begins with a prefix; SendError if there is none."""
    for reply in replies:
        if reply.startswith(prefix):
            return reply[len(prefix) : -1]  # without the bracket at its end
    raise SendError(
        "this ugrbl does not know the board's answer: update ugrbl, or the board (ugrbl deploy)"
    )


def _ask(connection: Connection, line: str) -> list[str]:
    """Send a line and return its replies. SendError, with the board's reason, if it is refused."""
    replies = connection.ask(line)
    if replies[-1] == "ok":
        return replies
    why = [reply[len(_PREFIX) : -1] for reply in replies if reply.startswith(_PREFIX)]
    if why:
        raise SendError(f"the board refuses it: {why[-1]}")
    raise SendError(
        f'the board has no $NET ({replies[-1]}): its board file needs LINK = "wifi", '
        'or "uart_wifi" on an ESP32'
    )
