"""Coolant: two outputs, flood and mist."""

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from base.state import State
    from interfaces import Port

OFF = const(0)
FLOOD = const(1)
MIST = const(2)


class Coolant:
    """The outputs. Whoever changes them synchronises first (canon.py)."""

    def __init__(self, port: "Port", state: "State") -> None:
        self._port = port
        self._state = state
        self.mask = OFF

    def set(self, mask: int) -> None:
        """Switch now."""
        self.mask = mask
        self._port.coolant(mask)
        self._state.override_countdown = 0

    def stop(self) -> None:
        """Off; safe in an interrupt."""
        self.mask = OFF
        self._port.coolant(OFF)
