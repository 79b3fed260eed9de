"""Pins of m: outputs and inputs that the board file names, for handlers of custom.py.

Every call looks first whether a reset has come: a handler that has swallowed it once comes no
further.
"""

from base import state as st
from base.float32 import truncate
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import Any

    from talk.controller import Controller

_ALWAYS = const(65535)  # the width of a pulse that does not end
_LOWEST_HZ = const(20)
_HIGHEST_HZ = const(40000)
_SERVO_HZ = const(50)


class Stopped(BaseException):
    """There is an alarm, or a reset: the handler has come to its end. No Exception, for a handler
    that catches those is to end, too."""


class PinApi:
    """The part of the API that knows pins. outputs, inputs: by their names."""

    def __init__(
        self, machine: "Controller", outputs: "dict[str, int]", inputs: "dict[str, int]"
    ) -> None:
        self._machine = machine
        self._state = machine.state
        self._outputs = list(outputs)
        self._inputs = list(inputs)
        self._levels = 0
        self._hz = [0] * len(outputs)  # of outputs that make pulses
        self._since_ms = 0
        self.slow_ms = 0  # the longest that a handler has taken without a call of these
        self.may_move = False  # the handler that runs now

    # For custom.py's keeper

    def begin_handler(self, may_move: bool) -> bool:
        """A handler begins. Returns whether the one that it interrupts may move."""
        outer = self.may_move
        self.may_move = may_move
        self.restart_clock()
        return outer

    def restart_clock(self) -> None:
        """From now on time counts as the handler's own."""
        self._since_ms = self._machine.port.ticks_ms()

    def check_stopped(self) -> None:
        """See whether a handler is to end, and how long it has taken."""
        if self._state.pending[st.RESET] or self._state.alarm:
            raise Stopped
        self.slow_ms = max(self.slow_ms, self._machine.port.elapsed_ms(self._since_ms))

    def clear_requests(self) -> None:
        """A reset has set all outputs to rest."""
        self._levels = 0

    # Pins

    def out(self, name: str, on: "Any") -> None:
        """Switch an output that the board file names, behind what the handler has moved. Off it
        goes also where the handler has to end, so that a finally can do it."""
        index = _index(self._outputs, name, "output")
        if self._hz[index]:
            self.pwm(name, 1 if on else 0, self._hz[index])
        else:
            self._set_level(index, bool(on))
            self._machine.port.drive(self._levels)
            self.check_stopped()

    def pwm(
        self,
        name: str,
        share: float,
        hz: float = 1000,
    ) -> None:
        """Have an output make pulses, hz of them in a second, on for that share of the time, from
        0 to 1. For the rest it is as m.out()."""
        if not (0 <= share <= 1 and _LOWEST_HZ <= hz <= _HIGHEST_HZ):
            raise ValueError("m.pwm: a share from 0 to 1, at 20 to 40000 Hz")
        index = _index(self._outputs, name, "output")
        hz = truncate(hz + 0.5)  # the numbers of a line are floats, which PWM does not take
        self._set_level(index, share > 0)
        self._machine.port.pulse(index, hz, truncate(share * _ALWAYS + 0.5))
        self._hz[index] = hz
        self.check_stopped()

    def servo(self, name: str, us: float) -> None:
        """Turn a servo at an output: pulses of so many microseconds, 50 in a second; 0 lets it
        go."""
        self.pwm(name, us * _SERVO_HZ / 1000000, _SERVO_HZ)

    def _set_level(self, index: int, on: bool) -> None:
        if on:
            self.check_stopped()
        if self.may_move and not (self._state.pending[st.RESET] or self._state.alarm):
            self._machine.canon.synchronise()
            self.restart_clock()
        self._levels = self._levels | 1 << index if on else self._levels & ~(1 << index)

    def is_on(self, name: str) -> bool:
        """Whether an output that the board file names has been switched on."""
        return bool(self._levels >> _index(self._outputs, name, "output") & 1)

    def pin(self, name: str) -> bool:
        """Whether an input that the board file names is closed: pulled to ground."""
        bit = _index(self._inputs, name, "input")
        return not self._machine.port.sense() >> bit & 1


def _index(names: "list[str]", name: str, kind: str) -> int:
    if name not in names:
        raise ValueError("the board file names no %s %s" % (kind, name))
    return names.index(name)
