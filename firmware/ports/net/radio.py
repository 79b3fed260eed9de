"""The radio of a Pico W or an ESP32: station of a network, or an access point of its own.

It is switched on before the machine is built, because that takes a second or two. After that
nothing here waits. A station that has lost its network tries to rejoin only while the machine is
idle, because that takes some tens of milliseconds. MicroPython itself answers to the host name, as
NAME.local (mDNS).
"""

import time

import network
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import Any

_AGAIN_MS = const(15000)  # between two attempts to join the network


class Radio:
    """The radio. name: of the network; password: empty for an open network; host: the board's
    name; is_station: join the network, else be its access point. _called_ms: time of the last
    attempt to join."""

    def __init__(self, name: bytes, password: bytes, host: str, is_station: bool) -> None:
        network.hostname(host)
        self._name = name
        self._password = password
        self._host = host
        self._is_station = is_station
        wlan: "Any" = network.WLAN
        self._wlan: "Any" = wlan(wlan.IF_STA if is_station else wlan.IF_AP)
        self._join: "Any" = self._wlan.connect
        self._called_ms = time.ticks_ms()
        if not is_station:
            self._wlan.config(
                ssid=name,
                key=password,
                security=wlan.SEC_WPA_WPA2 if password else wlan.SEC_OPEN,
            )
        self._wlan.active(True)
        self._wlan.config(pm=wlan.PM_NONE)  # power saving delays each answer by 100 ms
        if is_station:
            self._join(name, password)

    def poll_radio(self, at_rest: bool) -> None:
        """Try to rejoin the network if it is lost and the machine is idle (at_rest), at most once
        in _AGAIN_MS."""
        if not (self._is_station and at_rest) or self._wlan.isconnected():
            return
        now_ms = time.ticks_ms()
        if time.ticks_diff(now_ms, self._called_ms) >= _AGAIN_MS:
            self._called_ms = now_ms
            try:
                self._join(self._name, self._password)
            except OSError:
                return  # it is already trying

    def status(self) -> str:
        """Return the radio's state as text: kind, address, host name; the network's name and
        password are secret."""
        if self._is_station and not self._wlan.isconnected():
            return "station, not connected yet (status %d), %s.local" % (
                self._wlan.status(),
                self._host,
            )
        kind = "station" if self._is_station else "access point"
        return "%s, %s, %s.local" % (kind, self._wlan.ifconfig()[0], self._host)
