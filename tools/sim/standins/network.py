"""Stand-in for MicroPython's network: a radio, and the networks within its range.

A test determines the result of connect(): it puts a name and a password into `in_reach`. A network
that is removed from it is lost.
"""

_host = ["PicoW"]
in_reach: "dict[bytes, bytes]" = {}  # the password of each network, by its name

_LONGEST_HOST = 32
_IDLE = 0
_NO_NETWORK = -2
_WRONG_PASSWORD = -3
_GOT_IP = 3


def hostname(name: "str | None" = None) -> str:
    """Return or set this board's name in the network."""
    if name is not None:
        if len(name) > _LONGEST_HOST:
            raise ValueError("hostname too long")
        _host[0] = name
    return _host[0]


class WLAN:
    """One of the radio's two interfaces."""

    IF_STA = 0
    IF_AP = 1
    SEC_OPEN = 0
    SEC_WPA_WPA2 = 0x00400006
    PM_NONE = 16

    def __init__(self, side: int) -> None:
        self._side = side
        self._active = False
        self._wanted: "tuple[bytes, bytes] | None" = None  # name and password given to connect()
        self.asked: "dict[str, object]" = {}  # parameters given to config()
        self.calls = 0  # number of calls of connect()

    def config(self, **asked: object) -> None:
        """Set parameters of the radio."""
        unknown = asked.keys() - {"ssid", "key", "security", "pm"}
        if unknown:
            raise ValueError("unknown config param")
        self.asked.update(asked)

    def active(self, on: bool) -> None:
        """Switch the interface on or off."""
        self._active = on

    def connect(self, name: bytes, password: bytes) -> None:
        """Connect to a network; status() reports the result."""
        if not self._active:
            raise OSError("not active")
        self.calls += 1
        self._wanted = name, password

    def status(self) -> int:
        """Return the state of the connection."""
        if self._wanted is None:
            return _IDLE
        name, password = self._wanted
        if name not in in_reach:
            return _NO_NETWORK
        return _GOT_IP if in_reach[name] == password else _WRONG_PASSWORD

    def isconnected(self) -> bool:
        """Return whether there is a network, and an address in it."""
        return self._side == self.IF_AP or self.status() == _GOT_IP

    def ifconfig(self) -> "tuple[str, str, str, str]":
        """Return address, mask, gateway, name server."""
        here = "192.168.4.1" if self._side == self.IF_AP else "192.168.1.7"
        return here, "255.255.255.0", "192.168.1.1", "192.168.1.1"
