"""The G-code interpreter: words to a checked block to canonical calls.

A block is handled in four steps: start from the modal state, take in the
words (block.py), check everything (checks.py), execute in the order of the
standard (here). Nothing changes until every check has passed. Sole writer of
what is in force (control/modes.py), but for overrides. Order and meaning: NIST
RS274NGC v3, table 8, as Grbl 1.1 reads it.
"""

from array import array

from base import errors
from base import state as st
from base.errors import GrblError
from base.f32 import copy, vector
from base.singles import renew, whole_part
from control.coords import G28, G30
from control.modes import (
    COOLANT,
    FEED,
    INVERSE_TIME,
    MODAL_LENGTH,
    MOTION,
    OVERRIDE_CONTROL,
    PLANE,
    PROGRAM_FLOW,
    RELATIVE,
    RPM,
    SPINDLE,
    SYSTEM,
    TOOL_LENGTH,
)
from micropython import const
from motion import layout
from motion import planner as plan

from language import block as wd
from language import block_layout as b
from language import checks
from language.fast_kernel import JOG_START
from language.fast_path import FastPath
from language.usual import (
    ACCESSORIES,
    COMMAND,
    FLOW,
    MOVE,
    ODD,
    OFFSETS,
    SET_TOOL,
    SPEED,
    plain_jog,
    settle,
    usual,
)

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from base.settings import Settings
    from base.state import State
    from control.coords import Coords
    from control.modes import Modes
    from control.seek import Seek
    from control.spindle import Spindle
    from interfaces import Canon, Voice

    from language.block import Block

# Laser mode: what a block means for the beam, bits beside those of what is left to be done.
_DARK = const(256)  # not a cutting motion
_IN_MOTION = const(512)  # S goes with the motion
_SYNC = const(1024)  # the beam changes though nothing moves

_CUTS = const(1 << b.LINEAR | 1 << b.CW_ARC | 1 << b.CCW_ARC)  # mask of motions

# What go() and _non_modal() are there for: a word that they know nothing of is found here,
# on a desktop; a board has no assertions.
_PROBE = const(38)  # .2 to .5
assert {
    wd.dictionary[row + wd.SETTING]
    for row in range(wd.ROW, len(wd.dictionary), wd.ROW)
    if wd.dictionary[row + wd.GROUP] == b.GROUP_1
} == {
    b.SEEK,
    b.LINEAR,
    b.CW_ARC,
    b.CCW_ARC,
    _PROBE,
    b.NO_MOTION,
}, "a motion without a behaviour"
assert {
    wd.dictionary[row + wd.SETTING]
    for row in range(wd.ROW, len(wd.dictionary), wd.ROW)
    if wd.dictionary[row + wd.GROUP] == b.GROUP_0
} == {
    b.DWELL,
    b.SET_COORDS,
    b.GO_G28,
    b.GO_G30,
    b.ABSOLUTE_OVERRIDE,
    b.SET_G92,
}, "a command without a behaviour"


class Interpreter:
    """The interpreter. line_numbers: N goes with the motion, and into reports."""

    def __init__(
        self,
        modes: "Modes",
        state: "State",
        settings: "Settings",
        coords: "Coords",
        canon: "Canon",
        seek: "Seek",
        spindle: "Spindle",
        voice: "Voice",
        block: "Block",
        line_numbers: bool,
    ) -> None:
        self._modes = modes
        self._coords = coords
        self._state = state
        self._settings = settings
        self._canon = canon
        self._seek = seek
        self._spindle = spindle
        self._voice = voice
        self.block = block
        self._jog_modal = array("i", modes.modal)
        self._move = plan.Move()
        # The numbers that it has: what they are made objects of takes memory.
        self._numbers = vector(2)
        self._rpm = 0.0
        self._line_numbers = line_numbers
        # What usual() works on; to look each up costs 5 us.
        self._memory = (
            block.ints,
            block.singles,
            block.xyz,
            modes.position,
            modes.rates,
            block.axes,
            block.arc.plane,
            block.arc.numbers,
        )
        self.fast = FastPath(modes, coords, state, settings, canon, spindle)

    def execute(self, line: bytearray, length: int) -> None:
        """Interpret line[:length], which a 0 follows. Raises GrblError where it is refused."""
        if self.fast.execute(line, length):
            self._canon.finish()
            self.fast.tell()
            return
        self._read(line, length)
        # Step four, in the standard's order, and here: all that waits is done beneath this frame.
        block = self.block
        left = self._beam(block) if self._spindle.laser else 0
        left = settle(block.ints, block.singles, self._modes.modal, self._modes.rates) | left
        if left & SET_TOOL or self._modes.tool:
            self._modes.tool = whole_part(block.singles, b.T, 0) & 255
        if left & ~(SET_TOOL | MOVE | _DARK | _IN_MOTION):
            self._switch(block, left)
        if left & (COMMAND | MOVE) == MOVE and self.fast.go(block):
            left ^= MOVE
        if left & (COMMAND | MOVE):
            move = self._begin_move(block, layout.INVERSE_TIME if block.ints[INVERSE_TIME] else 0)
            if left & _DARK:
                move.spindle_rpm = 0.0
            if left & COMMAND:
                self._non_modal(block, move)
            if left & MOVE:
                self.go(block, move)
        if left & FLOW:
            self._control_program(block.ints[PROGRAM_FLOW])
        self.fast.forget()
        if left & (COMMAND | MOVE):
            self._canon.finish()

    def _read(self, line: bytearray, length: int) -> None:
        """Steps one to three. Raises GrblError where the line is refused."""
        modal = self._modes.modal
        self.block.read(line, 0, length, modal)
        self.check(modal)

    def jog(self, line: bytearray, length: int) -> None:
        """Interpret a "$J=" line. The modal state stays as it is."""
        if self.fast.jog(line, length):
            self._canon.begin_jog()
            return
        block, modes, modal = self.block, self._modes, self._jog_modal
        copy(modes.modal, modal, MODAL_LENGTH)
        modal[MOTION] = b.LINEAR
        modal[INVERSE_TIME] = 0
        block.read(line, JOG_START, length, modal)
        if plain_jog(block.ints):
            self.check(modal)
        else:
            checks.check(modes, self._coords, block, True)
        if self._canon.outside(block.xyz):
            raise GrblError(errors.TRAVEL_EXCEEDED)
        move = self._begin_move(block, layout.NO_FEED_OVERRIDE)
        self._canon.jog(block.xyz, move)
        copy(block.xyz, modes.position, block.axes)
        self._canon.finish()

    # Step three: checks

    def check(self, modal: "array[int]") -> None:
        """Refuse the block with GrblError, or leave it ready to be executed. modal: in force."""
        block, coords = self.block, self._coords
        wrong = ODD
        if not coords.tool_length:
            zero = self._modes.position  # without places nobody asks for it
            if block.ints[b.WORDS] & b.AXIS_WORDS:
                zero = coords.zero(block.ints[SYSTEM])
            wrong = usual(zero, modal, block.lengths, self._memory)
        if wrong == ODD:
            checks.check(self._modes, coords, block, False)
        elif wrong:
            raise GrblError(wrong)

    # Step four: execution

    def _begin_move(self, block: "Block", flags: int) -> "plan.Move":
        """The move of a block, with its feed rate, and spindle and coolant as they are."""
        move, numbers, modes = self._move, self._numbers, self._modes  # of four a tuple is made
        if renew(numbers, FEED, block.singles, b.F):
            move.feed = block.singles[b.F]
        if block.ints[INVERSE_TIME]:
            numbers[FEED] = -1.0  # an arc shares its time out among its chords
        if renew(numbers, RPM, modes.rates, RPM):
            self._rpm = modes.rates[RPM]
        move.flags = flags | modes.accessory_flags()
        move.spindle_rpm = self._rpm
        move.line_number = whole_part(block.singles, b.N, 0) if self._line_numbers else 0
        return move

    def _switch(self, block: "Block", left: int) -> None:
        """What comes before motion: speed, M words, a dwell, offsets."""
        modes, new = self._modes, block.ints
        if left & (SPEED | _SYNC):
            self._set_speed(block, left)
        if left & ACCESSORIES:
            self._set_accessories(new, 0.0 if left & _DARK else modes.rates[RPM])
        if new[b.NON_MODAL] == b.DWELL:
            self._canon.dwell(block.singles[b.P])
        if left & OFFSETS and self._set_offsets(block):
            self._offsets_changed()

    def _beam(self, block: "Block") -> int:
        """Laser mode: what the block means for the beam."""
        ints, modal = block.ints, self._modes.modal
        beam = 0 if _CUTS >> ints[MOTION] & 1 else _DARK
        if ints[b.WORDS] & b.AXIS_WORDS and ints[b.CLAIM] == b.AXES_MOTION:
            return beam | _IN_MOTION
        if modal[SPINDLE] == plan.SPINDLE_CW:
            was_cutting = _CUTS >> modal[MOTION] & 1
            if bool(was_cutting) == bool(beam & _DARK):
                beam |= _SYNC
        return beam

    def _set_speed(self, block: "Block", beam: int) -> None:
        modes, speed = self._modes, block.singles[b.S]
        if modes.modal[SPINDLE] and not beam & _IN_MOTION:
            self._canon.spin(modes.modal[SPINDLE], 0.0 if beam & _DARK else speed)
        modes.rates[RPM] = speed

    def _set_accessories(self, new: "array[int]", rpm: float) -> None:
        """M words of spindle, coolant and override control."""
        canon, modal = self._canon, self._modes.modal
        if modal[SPINDLE] != new[SPINDLE]:
            canon.spin(new[SPINDLE], rpm)
            modal[SPINDLE] = new[SPINDLE]
        if modal[COOLANT] != new[COOLANT]:
            canon.cool(new[COOLANT])
            modal[COOLANT] = new[COOLANT]
        if modal[OVERRIDE_CONTROL] != new[OVERRIDE_CONTROL]:
            modal[OVERRIDE_CONTROL] = new[OVERRIDE_CONTROL]
            canon.control_overrides(bool(new[OVERRIDE_CONTROL]))

    def _set_offsets(self, block: "Block") -> bool:
        """Returns whether work is somewhere else now."""
        changed = False
        modal, new, coords = self._modes.modal, block.ints, self._coords
        if new[b.CLAIM] == b.AXES_TOOL_LENGTH:
            modal[TOOL_LENGTH] = new[TOOL_LENGTH]
            length = block.xyz[coords.length_axis] if modal[TOOL_LENGTH] else 0.0
            if coords.tool_length != length:
                coords.tool_length = length
                changed = True
        if modal[SYSTEM] != new[SYSTEM]:
            modal[SYSTEM] = coords.active = new[SYSTEM]
            changed = True
        return changed

    def _offsets_changed(self) -> None:
        """The next status report shows WCO:. Reports of motion under way do not jump."""
        self._canon.synchronise()
        self._state.wco_countdown = 0

    def _non_modal(self, block: "Block", move: "plan.Move") -> None:
        command = block.ints[b.NON_MODAL]
        coords, modes = self._coords, self._modes
        if command == b.SET_COORDS:
            self._canon.synchronise()  # what is kept is written at rest only
            coords.write(block.index, block.stored)
            if block.index == modes.modal[SYSTEM]:
                self._offsets_changed()
        elif command in (b.GO_G28, b.GO_G30):
            move.flags |= layout.RAPID_MOTION
            if block.ints[b.CLAIM]:
                self._canon.line(block.xyz, move)
            self._canon.line(block.stored, move)
            copy(block.stored, modes.position, block.axes)
        elif command == b.SET_G28:
            self._canon.synchronise()
            coords.write(G28, modes.position)
        elif command == b.SET_G30:
            self._canon.synchronise()
            coords.write(G30, modes.position)
        elif command == b.SET_G92:
            coords.set_g92(block.xyz)
            self._offsets_changed()
        elif command == b.RESET_G92:
            coords.clear_g92()
            self._offsets_changed()

    def go(self, block: "Block", move: "plan.Move") -> None:
        """Make the motion of a block."""
        modes = self._modes
        motion = modes.modal[MOTION]
        if motion == b.LINEAR:
            self._canon.line(block.xyz, move)
        elif motion == b.SEEK:
            move.flags |= layout.RAPID_MOTION
            self._canon.line(block.xyz, move)
        elif motion in (b.CW_ARC, b.CCW_ARC):
            self._canon.arc(modes.position, block.xyz, block.arc, move)
        elif not self._probe(block, move):
            return  # the position has been seen to, or has not changed
        copy(block.xyz, modes.position, block.axes)

    def _probe(self, block: "Block", move: "plan.Move") -> bool:
        """Search for the probe's contact. Returns whether the target has been reached."""
        motion = self._modes.modal[MOTION]
        move.flags |= layout.NO_FEED_OVERRIDE
        away = motion in (b.PROBE_AWAY, b.PROBE_AWAY_NO_ALARM)
        alarms = motion in (b.PROBE_TOWARD, b.PROBE_AWAY)
        return self._seek.probe(block.xyz, move, away, alarms)

    def _control_program(self, flow: int) -> None:
        """Pause it, or end it."""
        self._canon.synchronise()
        if flow == b.PAUSED:
            self._canon.pause_program()
            return
        modal = self._modes.modal
        modal[MOTION] = b.LINEAR
        modal[PLANE] = modal[RELATIVE] = modal[INVERSE_TIME] = 0
        modal[SYSTEM] = self._coords.active = 0
        modal[SPINDLE] = modal[COOLANT] = 0
        modal[OVERRIDE_CONTROL] = 1
        self._canon.end_program()
        if self._state.run != st.CHECK:
            self._offsets_changed()
        self._voice.message(errors.MSG_PROGRAM_END)
