"""Wi-Fi in addition to the cable: the link of a board whose LINK is "wifi" or "uart_wifi".

The module is imported at start and unloaded again. The network is the one that `$NET` has stored;
without one, or if the radio fails, there is only the cable.
"""

from micropython import const

from ports.net.net_link import NetLink
from ports.storage.flash_store import FlashStore

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from interfaces import BoardLink


def beside(cable: "BoardLink", with_page: bool = False) -> "BoardLink":
    """Return the cable's link with the network around it. with_page: it also serves the page. If
    no network is stored or the radio fails, only the cable works, and status() says why."""
    stored: "dict[str, str]" = {}  # by name; SSID and PASS are in hex digits
    for line in FlashStore().load("network") or []:
        name, _, value = line.partition("=")
        stored[name] = value
    if not stored.get("SSID"):
        return NetLink(cable, None)
    try:
        from ports.net import tcp
        from ports.net.radio import Radio

        host = stored.get("HOST", "ugrbl")
        radio = Radio(
            bytes.fromhex(stored["SSID"]),
            bytes.fromhex(stored.get("PASS", "")),
            host,
            stored.get("MODE", "") != "ap",
        )
        calls = tcp.Calls(int(stored.get("PORT", "23")))
        if with_page:
            from ports.net import page_link

            link: NetLink = page_link.beside(cable, calls, host)
        else:
            link = NetLink(cable, calls)
    except (OSError, ValueError) as fault:
        link = NetLink(cable, None)
        why = "the Wi-Fi radio failed: %s" % fault
        link.status = lambda: why
        return link
    link.radio = radio
    link.status = radio.status
    return link
