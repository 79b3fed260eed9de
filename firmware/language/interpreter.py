"""The G-code interpreter: words to a checked block to canonical calls.

A block is handled in four steps: start from the modal state, take in the
words (block.py), check everything (checks.py), execute in the order of the
standard (here). Nothing changes until every check has passed. Sole writer of
what is in force (control/modes.py), but for overrides. Order and meaning: NIST
RS274NGC v3, table 8, as Grbl 1.1 reads it.
"""

from base import errors
from base import state as st
from base.errors import GrblError
from control.coords import G28, G30
from micropython import const
from motion import layout
from motion import planner as plan

from language import block as b
from language import checks
from language.fast_path import FastPath
from language.words import Words

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

_JOG_START = const(3)  # behind "$J="

# Laser mode: what a block means for the beam (mask).
_DARK = const(1)  # not a cutting motion
_IN_MOTION = const(2)  # S goes with the motion
_SYNC = const(4)  # the beam changes though nothing moves

# What go() and _non_modal() are there for: a row that they know nothing of is found here,
# on a desktop; a board has no assertions.
_PROBE = const(38)  # .2 to .5
assert {row[2] for row in b.G_WORDS.values() if row[0] == b.GROUP_1} == {
    b.SEEK,
    b.LINEAR,
    b.CW_ARC,
    b.CCW_ARC,
    _PROBE,
    b.NO_MOTION,
}, "a motion without a behaviour"
assert {row[2] for row in b.G_WORDS.values() if row[0] == b.GROUP_0} == {
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
        self._block = block
        self._words = Words()
        self._move = plan.Move()
        self._line_numbers = line_numbers
        self.fast = FastPath(modes, coords, state, settings, canon, spindle)

    def execute(self, line: bytearray, length: int) -> None:
        """Interpret line[:length], which a 0 follows. Raises GrblError where it is refused."""
        if not self.fast.execute(line, length):
            block = self._block
            self._words.read(line, 0, length)
            block.begin(self._modes.modal)
            block.take(self._words)
            checks.check(self._modes, self._coords, block, False)
            self._apply(block)
            self.fast.look()
        self._canon.finish()
        self.fast.tell()

    def jog(self, line: bytearray, length: int) -> None:
        """Interpret a "$J=" line. The modal state stays as it is."""
        block = self._block
        self._words.read(line, _JOG_START, length)
        block.begin(self._modes.modal)
        block.modal.motion = b.LINEAR
        block.modal.inverse_time = 0
        block.take(self._words)
        checks.check(self._modes, self._coords, block, True)
        if self._settings.soft_limits and self._canon.outside(block.xyz):
            raise GrblError(errors.TRAVEL_EXCEEDED)
        move = self._begin_move(block)
        move.feed = block.f
        move.flags = layout.NO_FEED_OVERRIDE | self._modes.accessory_flags()
        move.spindle_rpm = self._modes.spindle_rpm
        self._canon.jog(block.xyz, move)
        self._modes.position[:] = block.xyz
        self._canon.finish()

    # Step four: execution

    def _begin_move(self, block: "Block") -> "plan.Move":
        move = self._move
        move.clear()
        if self._line_numbers:
            move.line_number = block.n
        return move

    def _apply(self, block: "Block") -> None:
        """Execute a checked block, in the standard's order."""
        new = block.modal
        modal = self._modes.modal
        move = self._begin_move(block)
        beam = self._beam(block)
        modal.inverse_time = new.inverse_time
        if new.inverse_time:
            move.flags |= layout.INVERSE_TIME
        self._modes.feed = move.feed = block.f
        self._set_speed(block, beam)
        if not beam & _DARK:
            move.spindle_rpm = self._modes.spindle_rpm
        self._modes.tool = block.t
        if modal.spindle != new.spindle:
            self._canon.spin(new.spindle, move.spindle_rpm)
            modal.spindle = new.spindle
        if modal.coolant != new.coolant:
            self._canon.cool(new.coolant)
            modal.coolant = new.coolant
        move.flags |= self._modes.accessory_flags()
        if modal.override_control != new.override_control:
            modal.override_control = new.override_control
            self._canon.control_overrides(bool(new.override_control))
        if block.non_modal == b.DWELL:
            self._canon.dwell(block.p)
        modal.plane = new.plane
        modal.inches = new.inches
        if self._set_offsets(block):
            self._offsets_changed()
        modal.relative = new.relative
        if block.non_modal != b.NO_ACTION:
            self._non_modal(block, move)
        modal.motion = new.motion
        if block.claim == b.AXES_MOTION and modal.motion != b.NO_MOTION:
            self.go(block, move)
        self._control_program(new.program_flow)

    def _beam(self, block: "Block") -> int:
        """Laser mode: what the block means for the beam."""
        if not self._spindle.laser:
            return 0
        beam = 0 if block.modal.motion in b.CUTTING else _DARK
        if block.values & b.AXIS_WORDS and block.claim == b.AXES_MOTION:
            return beam | _IN_MOTION
        if self._modes.modal.spindle == plan.SPINDLE_CW:
            was_cutting = self._modes.modal.motion in b.CUTTING
            if was_cutting == bool(beam & _DARK):
                beam |= _SYNC
        return beam

    def _set_speed(self, block: "Block", beam: int) -> None:
        if self._modes.spindle_rpm == block.s and not beam & _SYNC:
            return
        if self._modes.modal.spindle and not beam & _IN_MOTION:
            self._canon.spin(self._modes.modal.spindle, 0.0 if beam & _DARK else block.s)
        self._modes.spindle_rpm = block.s

    def _set_offsets(self, block: "Block") -> bool:
        """Returns whether work is somewhere else now."""
        changed = False
        modal = self._modes.modal
        coords = self._coords
        if block.claim == b.AXES_TOOL_LENGTH:
            modal.tool_length = block.modal.tool_length
            length = block.xyz[coords.length_axis] if modal.tool_length else 0.0
            if coords.tool_length != length:
                coords.tool_length = length
                changed = True
        if modal.system != block.modal.system:
            modal.system = coords.active = block.modal.system
            changed = True
        return changed

    def _offsets_changed(self) -> None:
        """The next status report shows WCO:. Reports of motion under way do not jump."""
        self._canon.synchronise()
        self._state.wco_countdown = 0

    def _non_modal(self, block: "Block", move: "plan.Move") -> None:
        command = block.non_modal
        coords = self._coords
        if command == b.SET_COORDS:
            index = int(block.p)
            self._canon.synchronise()  # what is kept is written at rest only
            coords.write(index, self._block.stored)
            if index == self._modes.modal.system:
                self._offsets_changed()
        elif command in (b.GO_G28, b.GO_G30):
            move.flags |= layout.RAPID_MOTION
            if block.claim:
                self._canon.line(block.xyz, move)
            self._canon.line(self._block.stored, move)
            self._modes.position[:] = self._block.stored
        elif command == b.SET_G28:
            self._canon.synchronise()
            coords.write(G28, self._modes.position)
        elif command == b.SET_G30:
            self._canon.synchronise()
            coords.write(G30, self._modes.position)
        elif command == b.SET_G92:
            coords.g92[:] = block.xyz
            self._offsets_changed()
        elif command == b.RESET_G92:
            for i in range(len(coords.g92)):
                coords.g92[i] = 0.0
            self._offsets_changed()

    def go(self, block: "Block", move: "plan.Move") -> None:
        """Make the motion of a block."""
        motion = self._modes.modal.motion
        if motion == b.LINEAR:
            self._canon.line(block.xyz, move)
        elif motion == b.SEEK:
            move.flags |= layout.RAPID_MOTION
            self._canon.line(block.xyz, move)
        elif motion in (b.CW_ARC, b.CCW_ARC):
            self._canon.arc(self._modes.position, block.xyz, self._block.arc, move)
        else:
            move.flags |= layout.NO_FEED_OVERRIDE
            away = motion in (b.PROBE_AWAY, b.PROBE_AWAY_NO_ALARM)
            alarms = motion in (b.PROBE_TOWARD, b.PROBE_AWAY)
            if not self._seek.probe(block.xyz, move, away, alarms):
                return  # the position has been seen to, or has not changed
        self._modes.position[:] = block.xyz

    def _control_program(self, flow: int) -> None:
        """Let it go on, pause it, or end it."""
        if flow == b.RUNNING:
            return
        self._canon.synchronise()
        if flow == b.PAUSED:
            self._canon.pause_program()
            return
        modal = self._modes.modal
        modal.motion = b.LINEAR
        modal.plane = modal.relative = modal.inverse_time = 0
        modal.system = self._coords.active = 0
        modal.spindle = modal.coolant = 0
        modal.override_control = 1
        self._canon.end_program()
        if self._state.run != st.CHECK:
            self._offsets_changed()
        self._voice.message(errors.MSG_PROGRAM_END)
