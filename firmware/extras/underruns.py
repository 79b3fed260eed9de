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

_LONGEST_UNDERRUN_MS = const(1000)  # a later start is one after a pause of the sender


class Underruns:
    """Count underruns, by hooks at each stop and start of motion. _ran_out: motion ended without a
    hold, at _since_ms; _stop_was_asked: something waited for the end of motion, so that this is no
    underrun. _board_health: the function whose line $I+ printed before this extra, or None."""

    def __init__(self, cnc: "Cnc") -> None:
        self.count = 0
        machine = cnc.machine
        self._cnc = cnc
        self._state = machine.state
        self._port = machine.port
        self._ran_out = False
        self._since_ms = 0
        self._stop_was_asked = False
        self._board_health = machine.commands.health
        hooks = machine.state.hooks
        hooks.stops += (self._on_stop,)
        hooks.waited += (self._on_wait,)
        self._previous_probe, hooks.probe = hooks.probe, self._probe_and_note

    def _on_stop(self) -> None:
        """Note that the engine has nothing left to do, and whether that is without a hold."""
        state = self._state
        self._ran_out = state.run == st.RUN and not state.holding
        self._since_ms = self._port.ticks_ms()

    def _on_wait(self) -> None:
        """Note that something waited for the end of motion: the stop before, and a start that the
        wait itself has caused, are no underrun."""
        self._stop_was_asked = True

    def _probe_and_note(self, *asked: "Any") -> bool:
        """Probe, as the hook before; note that the move's end was expected. Return its result."""
        result: bool = self._previous_probe(*asked)
        self._stop_was_asked = True
        return result

    def on_start(self) -> None:
        """Count the start of motion as an underrun if the stop before it was not asked for."""
        is_program = self._state.run == st.RUN  # no jog, homing or probe
        was_underrun = self._ran_out and not self._stop_was_asked and is_program
        if was_underrun and self._port.elapsed_ms(self._since_ms) < _LONGEST_UNDERRUN_MS:
            self.count += 1
        self._ran_out = self._stop_was_asked = False

    def on_reset(self) -> None:
        """Forget the last stop, after power-up or a reset."""
        self._ran_out = self._stop_was_asked = False
        commands = self._cnc.machine.commands
        # $I+ prints health()'s line. The board sets it only after this extra was installed.
        if commands.health != self._health_with_underruns:
            self._board_health = commands.health
            commands.health = self._health_with_underruns

    def _health_with_underruns(self) -> str:
        """Return the last line that $I+ adds; if the board has another line, send ours before."""
        underruns = "Drains: %d" % self.count
        if self._board_health is None:
            return underruns
        self._cnc.message(underruns)
        return self._board_health()

    def field(self) -> str:
        """Return the field of the status report, "" without underruns."""
        return "Dr:%d" % self.count if self.count else ""


def install(cnc: "Cnc") -> None:
    """Count underruns from now on."""
    underruns = Underruns(cnc)
    cnc.after_start(underruns.on_start)
    cnc.after_reset(underruns.on_reset)
    cnc.add_field(underruns.field)
