"""Overrides by real-time bytes: feed, rapids and spindle in percent, spindle stop, coolant."""

from base import state as st
from micropython import const

from control.coolant import FLOOD, MIST
from control.modes import COOLANT, CUTTING, MOTION, RPM, SPINDLE
from control.spindle import CW, OFF

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from base.state import State
    from motion.planner import Planner

    from control.coolant import Coolant
    from control.modes import Modes
    from control.spindle import Spindle

# Override bytes, from 0x90: which override, and its change in percent; 0 restores 100 %. Rapids
# have no changes but values.
_FEED = const(0)
_RAPID = const(1)
_SPINDLE = const(2)
_OVERRIDES = {
    0x90: (_FEED, 0),
    0x91: (_FEED, 10),
    0x92: (_FEED, -10),
    0x93: (_FEED, 1),
    0x94: (_FEED, -1),
    0x95: (_RAPID, 100),
    0x96: (_RAPID, 50),
    0x97: (_RAPID, 25),
    0x99: (_SPINDLE, 0),
    0x9A: (_SPINDLE, 10),
    0x9B: (_SPINDLE, -10),
    0x9C: (_SPINDLE, 1),
    0x9D: (_SPINDLE, -1),
}
_SPINDLE_STOP = const(0x9E)  # real-time bytes
_FLOOD_TOGGLE = const(0xA0)
_MIST_TOGGLE = const(0xA1)
_LOWEST = const(10)  # percent, of feed and spindle
_HIGHEST = const(200)

# States in which blocks are executed, or wait for it.
_MOTION = const(st.RUN | st.HOLD | st.JOG)  # run states


class Overrides:
    """Applies overrides to planner, spindle and coolant. has_mist: there is a mist output."""

    def __init__(
        self,
        state: "State",
        planner: "Planner",
        spindle: "Spindle",
        coolant: "Coolant",
        modes: "Modes",
        has_mist: bool,
    ) -> None:
        self._state = state
        self._planner = planner
        self._spindle = spindle
        self._coolant = coolant
        self._modes = modes
        self._has_mist = has_mist

    def apply_requests(self) -> None:
        """Apply the override bytes received. Those of one kind are applied together, so that their
        order of arrival is lost; blocks are planned again once."""
        state = self._state
        # In percent, by _FEED, _RAPID and _SPINDLE.
        new = [state.feed_override, state.rapid_override, state.spindle_override]
        for byte in range(st.FIRST_OVERRIDE_BYTE, _SPINDLE_STOP):  # in Grbl's order
            times = self._asked(byte)
            if times and byte in _OVERRIDES:
                # Change in percent, 0 restores 100 %; of rapids the new value.
                which, change = _OVERRIDES[byte]
                if which == _RAPID or change == 0:
                    new[which] = change or 100
                else:
                    new[which] = min(max(new[which] + times * change, _LOWEST), _HIGHEST)
        if new[_FEED] != state.feed_override or new[_RAPID] != state.rapid_override:
            state.feed_override, state.rapid_override = new[_FEED], new[_RAPID]
            state.override_countdown = 0  # the next status report shows it
            self._planner.override()
        if new[_SPINDLE] != state.spindle_override:
            state.override_spindle(new[_SPINDLE])
            state.override_countdown = 0
            self.override_spindle()
        self._accessory_overrides()

    def _asked(self, byte: int) -> int:
        """Return how often that override byte was received since the last call."""
        return self._state.take_event(st.OVERRIDES + byte - st.FIRST_OVERRIDE_BYTE)

    def override_spindle(self) -> None:
        """Apply a changed spindle override. In Idle and Alarm without planned blocks: at once, to
        a tool that is on. Else to all planned blocks, and once more when motion starts, is held,
        resumes or ends."""
        state, spindle = self._state, self._spindle
        state.invalidate_lines()
        nothing_moves = state.run in (st.IDLE, st.ALARM) and self._planner.empty()
        state.update_spindle = not nothing_moves
        if nothing_moves:
            if spindle.is_on():
                spindle.restore(self._modes.modal[SPINDLE], self._modes.rates[RPM])
            return
        reported = state.spindle[st.RPM]  # each_power() changes it
        self._planner.each_power(spindle.block_power)
        # Until motion resumes, the tool is as it was, off or being restored.
        if not state.run & _MOTION or state.stop_override & st.STOP_ENABLED:
            state.spindle[st.RPM] = reported

    def _accessory_overrides(self) -> None:
        """Apply the toggles of spindle stop, flood and mist. Two toggles of a coolant cancel each
        other out; several of the spindle stop count as one. Coolant only in Idle and motion."""
        state = self._state
        if self._asked(_SPINDLE_STOP):
            self.stop_spindle()
        flood, mist = self._asked(_FLOOD_TOGGLE), self._asked(_MIST_TOGGLE)
        toggled = (FLOOD if flood & 1 else 0) | (MIST if mist & 1 and self._has_mist else 0)
        if not toggled or state.run not in (st.IDLE, st.RUN, st.HOLD, st.JOG):
            return
        self._modes.modal[COOLANT] ^= toggled
        state.invalidate_lines()
        self._coolant.set(self._modes.modal[COOLANT])

    def hold(self) -> None:
        """Handle a hold that has cancelled a cycle start: a laser, which may have been switched on
        for that start, is stopped again."""
        state = self._state
        if self._spindle.laser and not state.stop_override:
            self.stop_spindle()

    def darken(self) -> None:
        """Switch off a laser that the modes keep dark while idle (M4, or no G1, G2 or G3), and
        report one that is off as such. Called when the blocks that would do it are dropped."""
        modal, spindle = self._modes.modal, self._spindle
        if spindle.laser and modal[SPINDLE]:
            cuts = modal[SPINDLE] == CW and CUTTING >> modal[MOTION] & 1
            lit = cuts and spindle.direction() != OFF
            spindle.restore(modal[SPINDLE], self._modes.rates[RPM] if lit else 0.0)

    def stop_spindle(self) -> None:
        """Request that a hold stops the spindle or, if this override has stopped it, starts it
        again (Suspension does it); ignored except in a hold."""
        state = self._state
        if state.run == st.HOLD:
            if not state.stop_override:
                state.stop_override = st.STOP_INITIATE
            elif state.stop_override & st.STOP_ENABLED:
                state.stop_override |= st.STOP_RESTORE
