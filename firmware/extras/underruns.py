"""Underruns: how often motion stopped in the middle of a program because no line had arrived.

A stop counts if motion goes on within a second, and nothing asked for the stop: no hold, no dwell,
no word that waits for motion to end. `$I+` reports the number since power-up. Status reports have
a field `Dr:2` if it is not 0. COUNT_DRAINS = True in the board file selects this.
"""

from base import state as st
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import Any

    from extras.api import Cnc

_AGAIN_MS = const(1000)  # a later start follows a pause of the sender


class Underruns:
    """Count underruns, by hooks at each stop and start of motion. _stopped: motion ended without a
    hold, at _since_ms; _asked: something waited for the end of motion. _health: the function whose
    line $I+ printed before this extra."""

    def __init__(self, cnc: "Cnc") -> None:
        self.count = 0
        machine = cnc.machine
        self._cnc = cnc
        self._state = machine.state
        self._port = machine.port
        self._stopped = False
        self._since_ms = 0
        self._asked = False
        self._health = machine.commands.health
        hooks = machine.state.hooks
        hooks.stops += (self._stops,)
        hooks.waited += (self._waited,)
        self._probe, hooks.probe = hooks.probe, self._probes

    def _stops(self) -> None:
        """Note that the engine has nothing left to do, and whether that is without a hold."""
        state = self._state
        self._stopped = state.run == st.RUN and not state.holding
        self._since_ms = self._port.ticks_ms()

    def _waited(self) -> None:
        """Note that something waited for the end of motion: the stop before, and a start that the
        wait itself has caused, are no underrun."""
        self._asked = True

    def _probes(self, *asked: "Any") -> bool:
        """Probe, as the hook before; note that the move's end was expected. Return its result."""
        result: bool = self._probe(*asked)
        self._asked = True
        return result

    def on_start(self) -> None:
        """Count the start if it ends an underrun."""
        # Motion of a program goes on after a stop that nothing asked for.
        again = self._stopped and not self._asked and self._state.run == st.RUN
        if again and self._port.elapsed_ms(self._since_ms) < _AGAIN_MS:
            self.count += 1
        self._stopped = self._asked = False

    def on_reset(self) -> None:
        """Forget the last stop, after power-up or a reset."""
        self._stopped = self._asked = False
        commands = self._cnc.machine.commands
        if commands.health != self._report:  # at power-up it is set only after this extra
            self._health = commands.health
            commands.health = self._report

    def _report(self) -> str:
        """Return the last line that $I+ adds; if the board has another line, send ours before."""
        underruns = "Drains: %d" % self.count
        if self._health is None:
            return underruns
        self._cnc.message(underruns)
        return self._health()

    def field(self) -> str:
        """Return the field of the status report, "" without underruns."""
        return "Dr:%d" % self.count if self.count else ""


def install(cnc: "Cnc") -> None:
    """Count underruns from now on."""
    underruns = Underruns(cnc)
    cnc.after_start(underruns.on_start)
    cnc.after_reset(underruns.on_reset)
    cnc.add_field(underruns.field)
