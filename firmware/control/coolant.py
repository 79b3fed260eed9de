"""Coolant: two outputs, flood and mist."""

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from base.state import State
    from interfaces import Port

OFF = const(0)
FLOOD = const(1)  # bits of a mask
MIST = const(2)


class Coolant:
    """The outputs. The caller must wait for the end of planned motion before it changes them
    (Canon.cool()). mask: those that are on."""

    def __init__(self, port: "Port", state: "State") -> None:
        self._port = port
        self._state = state
        self.mask = OFF

    def set(self, mask: int) -> None:
        """Switch the outputs of the mask on, the others off, at once."""
        self.mask = mask
        self._port.coolant(mask)
        self._state.override_countdown = 0  # the next status report shows it

    def stop(self) -> None:
        """Switch off at once; safe in an interrupt."""
        self.mask = OFF
        self._port.coolant(OFF)
