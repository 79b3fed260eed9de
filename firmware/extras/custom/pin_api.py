"""Pins of m: outputs and inputs that the board file names, for handlers of custom.py.

Every call checks for a reset first, so a handler that has caught Stopped ends at its next call.
"""

from base import state as st
from base.float32 import truncate
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import Any

    from talk.controller import Controller

_FULL_DUTY = const(65535)  # the port's duty for an output that stays on
_LOWEST_HZ = const(20)
_HIGHEST_HZ = const(40000)
_SERVO_HZ = const(50)


class Stopped(BaseException):
    """An alarm or a reset ends the handler.

    It is not an Exception, because a handler that catches those must end, too.
    """


class PinApi:
    """The API's pins. outputs, inputs: pins' numbers, by the names of the board file.

    _outputs, _inputs: the names, by index. _levels: bit i: output i is on. _hz: frequency of each
    output's pulses, 0 without pulses. may_move: the handler that runs now may move. _since_ms:
    when it began, or its last wait ended; slow_ms: the longest time that a handler took without a
    call of m.
    """

    def __init__(
        self, machine: "Controller", outputs: "dict[str, int]", inputs: "dict[str, int]"
    ) -> None:
        self._machine = machine
        self._state = machine.state
        self._outputs = list(outputs)
        self._inputs = list(inputs)
        self._levels = 0
        self._hz = [0] * len(outputs)
        self._since_ms = 0
        self.slow_ms = 0
        self.may_move = False

    # For the firmware, not for handlers

    def begin_handler(self, may_move: bool) -> bool:
        """Begin a handler. Return whether the handler that it interrupts may move."""
        outer_may_move = self.may_move
        self.may_move = may_move
        self.restart_clock()
        return outer_may_move

    def restart_clock(self) -> None:
        """Restart the count of the handler's own time."""
        self._since_ms = self._machine.port.ticks_ms()

    def check_stopped(self) -> None:
        """Raise Stopped after an alarm or a reset, and note how long the handler has taken."""
        if self._state.pending[st.RESET] or self._state.alarm:
            raise Stopped
        self.slow_ms = max(self.slow_ms, self._machine.port.elapsed_ms(self._since_ms))

    def clear_requests(self) -> None:
        """Note that a reset has switched all outputs off."""
        self._levels = 0

    # Pins

    def out(self, name: str, on: "Any") -> None:
        """Switch an output of the board file on or off (any value is tested for truth). A handler
        that may move waits for the end of its motion first.

        Switching off works also after a reset or an alarm, so use it in `finally`. ValueError for
        an unknown name.
        """
        index = _index(self._outputs, name, "output")
        if self._hz[index]:  # PWM has the pin, and drive() does not affect it
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
        """Make pulses at an output: `share` of the time on (0 to 1), `hz` from 20 to 40000.

        Otherwise as m.out(), with a check for a stop before (_set_level) and after the change.
        ValueError outside these ranges.
        """
        if not (0 <= share <= 1 and _LOWEST_HZ <= hz <= _HIGHEST_HZ):
            raise ValueError("m.pwm: share must be 0 to 1, frequency 20 to 40000 Hz")
        index = _index(self._outputs, name, "output")
        hz = truncate(hz + 0.5)  # a line's numbers are floats; PWM takes int
        self._set_level(index, share > 0)
        self._machine.port.pulse(index, hz, truncate(share * _FULL_DUTY + 0.5))
        self._hz[index] = hz
        self.check_stopped()

    def servo(self, name: str, us: float) -> None:
        """Turn a servo at an output with pulses of `us` microseconds, 50 per second.

        0 ends the pulses. ValueError if `us` is not from 0 to 20000.
        """
        self.pwm(name, us * _SERVO_HZ / 1000000, _SERVO_HZ)

    def _set_level(self, index: int, on: bool) -> None:
        """Wait for the end of the handler's motion, then note an output's level in _levels. index:
        its bit. The caller switches the pin.

        After a reset or an alarm it raises Stopped for `on`, and notes off without a wait.
        """
        if on:
            self.check_stopped()
        if self.may_move and not (self._state.pending[st.RESET] or self._state.alarm):
            self._machine.canon.synchronise()
            self.restart_clock()
        bit = 1 << index
        self._levels = self._levels | bit if on else self._levels & ~bit

    def is_on(self, name: str) -> bool:
        """Return whether an output is switched on. ValueError for an unknown name."""
        return bool(self._levels >> _index(self._outputs, name, "output") & 1)

    def pin(self, name: str) -> bool:
        """Return whether an input is closed (pulled to ground). ValueError for an unknown name."""
        bit = _index(self._inputs, name, "input")
        return not self._machine.port.sense() >> bit & 1  # sense(): bit i is 1 if i is open


def _index(names: "list[str]", name: str, kind: str) -> int:
    """Return a pin's index in names. kind: "output" or "input", for the message of ValueError."""
    if name not in names:
        raise ValueError("the board file has no %s named %s" % (kind, name))
    return names.index(name)
