"""Positions and saved modes: what m returns to handlers of custom.py."""

from array import array

from base import state as st
from control.modes import (
    COOLANT,
    CUTTING,
    FEED,
    INCHES,
    INVERSE_TIME,
    MODAL_LENGTH,
    MOTION,
    OVERRIDE_CONTROL,
    PLANE,
    RELATIVE,
    RPM,
    SPINDLE,
    SYSTEM,
)
from control.spindle import CW
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from talk.controller import Controller

_A = const(3)  # index of axis A
# Modes that stay, because the machine does what they say; S does for the same reason.
_NOT_RESTORED = (SPINDLE, COOLANT, OVERRIDE_CONTROL)
# Modes that m.saved() sets to 0: G17, G90, G94 and G21.
_SET_TO_ZERO = (PLANE, RELATIVE, INVERSE_TIME, INCHES)


class Position:
    """A position in mm: p.x, p.y, p.z and, on a machine with A, p.a; or p[0] and so on."""

    def __init__(self, mm: "array[float]") -> None:
        self._mm = [mm[i] for i in range(len(mm))]

    def __getitem__(self, axis: int) -> float:
        """Return an axis's position by its index."""
        return self._mm[axis]

    def __repr__(self) -> str:
        """Return the position as text, with three decimals."""
        return "(%s)" % ", ".join(["%.3f" % mm for mm in self._mm])

    @property
    def x(self) -> float:
        return self._mm[0]

    @property
    def y(self) -> float:
        return self._mm[1]

    @property
    def z(self) -> float:
        return self._mm[2]

    @property
    def a(self) -> float:
        """Position of axis A. ValueError on a machine without it."""
        if len(self._mm) <= _A:
            raise ValueError("the machine has no axis A")
        return self._mm[_A]


class ModalState:
    """Context manager that restores modes, feed and offsets when its block ends.

    standard: set G17, G21, G90 and G94 at its beginning. Spindle with its S, coolant and M56 stay
    as they are, because they are what the machine does. blocks: the open ones, innermost last.

    Copies from the beginning of the block: modal, the modal state; _feed; _length and _g92, the
    tool length and the G92 offset; _cycles, canned cycles of extras, each with the numbers that
    hold for its next line.
    """

    def __init__(self, machine: "Controller", standard: bool, blocks: "list[ModalState]") -> None:
        self._machine = machine
        self._is_standard = standard
        self._open_blocks = blocks

    def __enter__(self) -> None:
        """Copy what the block may change, then set the standard modes if asked for."""
        modes, coords = self._machine.modes, self._machine.coords
        self.modal = list(modes.modal)
        self._feed = modes.rates[FEED]
        self._length, self._g92 = coords.tool_length, array("f", coords.g92)
        # By endless axis, the degrees subtracted so far from its position and its G92.
        self.unwound = dict(getattr(self._machine.canon, "unwound", ()))
        cycles = self._machine.interpreter.motions.values()
        self._cycles = [(cycle, cycle.kept) for cycle in cycles]
        self._open_blocks.append(self)
        if self._is_standard:
            for i in _SET_TO_ZERO:
                modes.modal[i] = 0

    def keep_length(self) -> None:
        """Let the present tool length stay when the block ends: do not restore the old one."""
        self._length = self._machine.coords.tool_length

    def __exit__(self, *fault: object) -> None:
        """Restore everything copied, unless a reset is pending. An exception is passed on. In an
        alarm the motion mode stays: to restore a cutting one could switch a laser on."""
        machine = self._machine
        modes, coords = machine.modes, machine.coords
        if self in self._open_blocks:
            self._open_blocks.remove(self)
        if machine.state.pending[st.RESET]:
            return  # the reset has set the modes
        in_alarm = machine.state.alarm or machine.state.run == st.ALARM
        cut_in_block = CUTTING >> modes.modal[MOTION] & 1  # CUTTING, bit i: motion mode i cuts
        for i in range(MODAL_LENGTH):
            if i not in _NOT_RESTORED and not (i == MOTION and in_alarm):
                modes.modal[i] = self.modal[i]
        coords.active = modes.modal[SYSTEM]
        for cycle, kept in self._cycles:
            cycle.kept = kept
        modes.rates[FEED] = self._feed
        coords.tool_length = self._length
        for axis, degrees in getattr(machine.canon, "unwound", {}).items():
            self._g92[axis] -= degrees - self.unwound.get(axis, 0.0)  # those of the block
        coords.set_g92(self._g92)
        machine.state.wco_countdown = 0  # the next status report has the offsets
        cuts_now = CUTTING >> modes.modal[MOTION] & 1
        if machine.spindle.laser and modes.modal[SPINDLE] == CW and cuts_now != cut_in_block:
            # In M3 a laser is on only in cutting modes: switch it as a line with G0 or G1 does.
            machine.canon.spin(CW, modes.rates[RPM] if cuts_now else 0.0)
