"""The network of a simulated machine: the firmware's own link around a simulated cable."""

from array import array

from ports.net.net_link import NetLink
from ports.net.page_link import PageLink

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from interfaces import Incoming

    from .rig import Rig


class RigLink(NetLink):
    """A NetLink for a rig. Everything else that the rig and its users need belongs to the
    cable."""

    # Addresses whose clients need no key; none by default.
    trusts: "tuple[str, ...]" = ()
    # Attributes of the cable that are set from outside.
    _OF_CABLE = ("received", "stopping", "turn")

    def __init__(self, rig: "Rig", cable: "Any", calls: "Incoming | None", *more: "Any") -> None:
        # What a NetLink expects of a board's cable, here as of a UART: see UartLink.
        cable.shared = array("i", (0, 0, 0))
        cable.poll_reset = None
        cable.is_slow = False
        self.cable = cable
        super().__init__(cable, calls, *more)
        self._rig = rig
        # Not the controller's own method: it is built later, and again after each power cycle.
        self._at_rest = self._is_at_rest

    def _is_at_rest(self) -> bool:
        return self._rig.controller.at_rest()

    def _accept(self, conn: "Any", address: str, now_ms: int) -> None:
        """Accept a client; one at a trusted address needs no key."""
        super()._accept(conn, address, now_ms)
        for client in self._clients:
            if client.conn is conn and address in self.trusts:
                client.trusted = True

    def __getattr__(self, name: str) -> "Any":
        """Return an attribute of the cable."""
        return getattr(self.__dict__["cable"], name)

    def __setattr__(self, name: str, value: "Any") -> None:
        """Set an attribute, on the cable if it belongs there."""
        if name in self._OF_CABLE:
            setattr(self.cable, name, value)
        else:
            super().__setattr__(name, value)


class RigPageLink(RigLink, PageLink):
    """The same for a board that serves the page; its last argument is the board's name."""
