"""The network's link of a board that serves the page: it sends pages the state of control.

Clients have less of lwIP's memory here than elsewhere, because page.py needs the rest for pieces.
"""

from micropython import const

from ports.net.client import Memory
from ports.net.net_link import NetLink
from ports.net.page import Page
from ports.net.tcp import Calls
from ports.net.web_socket import WebSocket

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from interfaces import BoardLink, Incoming

_HTTP = const(80)
_MEMORY = const(4800)  # bytes
_JSON = (b"false", b"true")  # by truth
_STATE_JSON = b'{"link":{"name":"%s","open":true},"driver":%s,"drivers":%d,"watchers":%d,"key":%s}'


class PageLink(NetLink):
    """A NetLink. host: the board's name."""

    def __init__(self, cable: "BoardLink", calls: "Incoming | None", host: str) -> None:
        NetLink.__init__(self, cable, calls, Memory(_MEMORY))
        self._host = host

    def _serve_clients(self, now_ms: int) -> None:
        """Serve the clients, as NetLink does, and send a changed state of control to pages."""
        NetLink._serve_clients(self, now_ms)
        if not self._is_plain:
            self._send_control_state()

    def _send_control_state(self) -> None:
        """Send each page the state of control if it has changed, as `ugrbl web` does
        (docs/web.md); with "key": whether the client must send the key."""
        driver = self.control.owner  # docs/web.md calls the client in control so
        watchers = len([1 for client in self._clients if client.conn and client is not driver])
        for client in self._clients:
            socket = client.conn
            if not isinstance(socket, WebSocket):  # no page
                continue
            # A number that differs whenever the text differs; the websocket sends `news`.
            state = watchers * 8 + client.trusted * 4 + (client is driver) * 2 + (driver is None)
            if state != socket.told:
                socket.told = state
                socket.news = _STATE_JSON % (
                    self._host.encode(),
                    _JSON[client is driver],
                    driver is not None,
                    watchers,
                    _JSON[not client.trusted],
                )


def beside(cable: "BoardLink", calls: "Incoming", host: str) -> PageLink:
    """Return the cable's link, with the network and the page around it. calls: by TCP. OSError if
    the page's port cannot be opened."""
    return PageLink(cable, Page(calls, Calls(_HTTP), host), host)
