"""Restrict access: only our own pages, under our own names, and with a token from the network.

Any page on the web may open a websocket to this computer, and a foreign name may resolve to it
(DNS rebinding); neither may move a machine. Programs other than browsers send no Origin and are
accepted, because they could open the port as well.
"""

import hmac
import ipaddress
import secrets
import socket
from collections.abc import Mapping
from urllib.parse import urlsplit

_TOKEN_BYTES = 16


class Access:
    """The conditions for a request to a server that is bound to host."""

    def __init__(self, host: str) -> None:
        self._bound = host.strip("[]").lower()  # [::1] has brackets
        self._own_name = socket.gethostname().lower()
        self.is_local = is_loopback(self._bound)
        self.token = "" if self.is_local else secrets.token_urlsafe(_TOKEN_BYTES)

    def refusal(self, headers: Mapping[str, str], query: Mapping[str, str]) -> str:
        """Return why a request is refused, in a sentence; "" if it is accepted."""
        host = headers.get("Host", "")
        if not self._is_own(_without_port(host)):
            return (
                f"this server is not called {host or 'nothing'}: use the address that it has "
                "printed at its start"
            )
        origin = headers.get("Origin")
        if origin is not None and _host_of_origin(origin) != host.lower():
            return (
                f"a page of {origin} may not talk to a machine here: open the page of this server"
            )
        token = query.get("token", "")
        # In constant time, so that its duration does not show how much of a guess is right.
        if self.token and not hmac.compare_digest(token.encode(), self.token.encode()):
            return "the token is missing or wrong: use the address that was printed at the start"
        return ""

    def _is_own(self, name: str) -> bool:
        """Return whether a browser may use that name.

        is_local: the server is bound to this computer only, and has no other name. From the
        network a number is accepted, because it cannot resolve to another address later, as a name
        can; also this computer's name, with any domain.
        """
        if is_loopback(name) or (name and name == self._bound):
            return True
        if self.is_local:
            return False
        return _is_number(name) or name.partition(".")[0] == self._own_name.partition(".")[0]


def is_loopback(host: str) -> bool:
    """Return whether only this computer can reach that host."""
    return host == "localhost" or (_is_number(host) and ipaddress.ip_address(host).is_loopback)


def _host_of_origin(origin: str) -> str:
    """Return host and port of an Origin; "" if it has none, as `null`."""
    try:
        return urlsplit(origin).netloc.lower()
    except ValueError:
        return ""


def _without_port(host: str) -> str:
    """Return a Host without its port."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _is_number(host: str) -> bool:
    """Return whether a host is an IP address in numbers."""
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True
