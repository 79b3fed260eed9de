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
    """The outputs. The caller must synchronise before it changes them (canon.py)."""

    def __init__(self, port: "Port", state: "State") -> None:
        self._port = port
        self._state = state
        self.mask = OFF

    def set(self, mask: int) -> None:
        """Switch at once."""
        self.mask = mask
        self._port.coolant(mask)
        self._state.override_countdown = 0

    def stop(self) -> None:
        """Switch off at once; safe in an interrupt."""
        self.mask = OFF
        self._port.coolant(OFF)
