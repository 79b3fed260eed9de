"""Underruns: how often motion stopped in the middle of a program for lack of lines.

A stop counts where motion goes on within a second, and nobody has asked for it: no hold, no dwell,
no word that waits for motion to end. `$I+` tells the number since power-up, and status reports do
as soon as there is one: `Dr:2`. A board asks for it with COUNT_DRAINS = True.
"""

from base import state as st
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import Any

    from extras.api import Cnc

_AGAIN_MS = const(1000)  # who goes on later has had something else to do


class Underruns:
    """Counts them, put around the machine's stops and starts."""

    def __init__(self, cnc: "Cnc") -> None:
        self.count = 0
        machine = cnc.machine
        self._cnc = cnc
        self._state = machine.state
        self._port = machine.port
        self._stopped = False  # motion has come to its end, nobody had held it,
        self._since_ms = 0  # and that was then
        self._asked = False  # somebody waits for its end
        self._health = machine.commands.health
        hooks = machine.state.hooks
        hooks.stops += (self._stops,)
        hooks.waited += (self._waited,)
        self._probe, hooks.probe = hooks.probe, self._probes

    def _stops(self) -> None:
        """The engine has nothing left to do."""
        state = self._state
        self._stopped = state.run == st.RUN and not state.holding
        self._since_ms = self._port.ticks_ms()

    def _waited(self) -> None:
        """Somebody has waited for the end of motion, which may have been started for that."""
        self._asked = True

    def _probes(self, *asked: "Any") -> bool:
        """Stand in for Seek.probe, whose motion ends by itself."""
        found: bool = self._probe(*asked)
        self._asked = True
        return found

    def on_start(self) -> None:
        """The machine has been set in motion."""
        again = self._stopped and not self._asked and self._state.run == st.RUN
        if again and self._port.elapsed_ms(self._since_ms) < _AGAIN_MS:
            self.count += 1
        self._stopped = self._asked = False

    def on_reset(self) -> None:
        """Power-up or a reset: what stopped has been forgotten."""
        self._stopped = self._asked = False
        commands = self._cnc.machine.commands
        if commands.health != self._report:  # power-up has given it to the commands, at last
            self._health = commands.health
            commands.health = self._report

    def _report(self) -> str:
        """What $I+ says besides."""
        underruns = "Drains: %d" % self.count
        if self._health is None:
            return underruns
        self._cnc.message(underruns)
        return self._health()

    def field(self) -> str:
        """A status report's."""
        return "Dr:%d" % self.count if self.count else ""


def install(cnc: "Cnc") -> None:
    """Have them counted."""
    underruns = Underruns(cnc)
    cnc.after_start(underruns.on_start)
    cnc.after_reset(underruns.on_reset)
    cnc.add_field(underruns.field)
