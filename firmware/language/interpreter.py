"""The G-code interpreter: words to a checked block to canonical calls.

A block is handled in four steps: start from the modal state, take in the
words (block.py), check everything (checks.py), execute in the order of the
standard (here). Nothing changes until every check has passed. Sole owner of
the modal state and of the parser's position (mm, single precision). Order and
meaning: NIST RS274NGC v3, table 8, as Grbl 1.1 reads it.
"""

from base import errors
from base import state as st
from base.errors import GrblError
from base.f32 import vector
from control.coords import G28, G30
from language import block as b
from language import checks
from language.block import Block, Modal
from language.fast_path import Plain
from language.words import Words
from micropython import const
from motion import planner as plan
from motion.arcs import Arc

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from base.settings import Settings
    from base.state import State
    from control.canon import Motion
    from control.coords import Coords
    from control.seek import Cycles
    from control.spindle import Spindle
    from talk.report import Report

_JOG_START = const(3)  # behind "$J="

# Laser mode: what a block means for the beam (mask).
_DARK = const(1)  # not a cutting motion
_IN_MOTION = const(2)  # S goes with the motion
_SYNC = const(4)  # the beam changes though nothing moves


class Gcode:
    """The interpreter. line_numbers: N goes with the motion, and into reports."""

    def __init__(
        self,
        axes: int,
        state: "State",
        settings: "Settings",
        coords: "Coords",
        motion: "Motion",
        cycles: "Cycles",
        spindle: "Spindle",
        report: "Report",
        block: "Block",
        line_numbers: bool,
        has_override_control: bool,
    ) -> None:
        self._has_override_control = has_override_control
        self.axes = axes
        self.coords = coords
        self.modal = Modal()
        self.position = vector(axes)
        self.stored = vector(axes)  # G10, G28, G30: what the block found or is to keep
        self.arc = Arc()
        self._state = state
        self._settings = settings
        self._motion = motion
        self._cycles = cycles
        self._spindle = spindle
        self._report = report
        self._block = block
        self._words = Words()
        self._move = plan.Move()
        self._line_numbers = line_numbers
        self.plain = Plain(self, state, settings, motion, spindle)
        self.reset()

    def reset(self) -> None:
        """Modal state of a fresh start."""
        self.modal.copy(Modal())
        self.feed = 0.0
        self.spindle_rpm = 0.0
        self.tool = 0
        self.plain.forget()

    @property
    def spindle(self) -> int:
        """Modal spindle state: spindle.OFF, CW or CCW."""
        return self.modal.spindle

    @property
    def coolant(self) -> int:
        """Modal coolant state, a mask."""
        return self.modal.coolant

    @coolant.setter
    def coolant(self, mask: int) -> None:
        self.modal.coolant = mask
        self.plain.forget()

    def accessory_flags(self) -> int:
        """Spindle and coolant as flags of a planner block."""
        return self.modal.spindle | self.modal.coolant << plan.COOLANT_SHIFT

    def execute(self, line: bytearray, length: int) -> None:
        """Interpret line[:length], which a 0 follows. Raises GrblError where it is refused."""
        if not self.plain.execute(line, length):
            block = self._block
            self._words.read(line, 0, length)
            block.begin(self.modal)
            block.take(self._words)
            checks.check(self, block, False)
            self._apply(block)
            self.plain.look()
        self._motion.finish()
        self.plain.tell()

    def jog(self, line: bytearray, length: int) -> None:
        """Interpret a "$J=" line. The modal state stays as it is."""
        block = self._block
        self._words.read(line, _JOG_START, length)
        block.begin(self.modal)
        block.modal.motion = b.LINEAR
        block.modal.inverse_time = 0
        block.take(self._words)
        checks.check(self, block, True)
        if self._settings.soft_limits and self._motion.outside(block.xyz):
            raise GrblError(errors.TRAVEL_EXCEEDED)
        move = self._begin_move(block)
        move.feed = block.f
        move.flags = plan.NO_FEED_OVERRIDE | self.accessory_flags()
        move.spindle_rpm = self.spindle_rpm
        self._motion.jog(block.xyz, move)
        self.position[:] = block.xyz
        self._motion.finish()

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
        modal = self.modal
        move = self._begin_move(block)
        beam = self._beam(block)
        modal.inverse_time = new.inverse_time
        if new.inverse_time:
            move.flags |= plan.INVERSE_TIME
        self.feed = move.feed = block.f
        self._set_speed(block, beam)
        if not beam & _DARK:
            move.spindle_rpm = self.spindle_rpm
        self.tool = block.t
        if modal.spindle != new.spindle:
            self._motion.spin(new.spindle, move.spindle_rpm)
            modal.spindle = new.spindle
        if modal.coolant != new.coolant:
            self._motion.cool(new.coolant)
            modal.coolant = new.coolant
        move.flags |= self.accessory_flags()
        if modal.override_control != new.override_control:
            modal.override_control = new.override_control
            self._motion.control_overrides(bool(new.override_control))
        if block.non_modal == b.DWELL:
            self._motion.dwell(block.p)
        modal.plane = new.plane
        modal.inches = new.inches
        if self._set_offsets(block):
            self._offsets_changed()
        modal.relative = new.relative
        if block.non_modal != b.NO_ACTION:
            self._non_modal(block, move)
        modal.motion = new.motion
        if block.claim == b.AXES_MOTION and modal.motion != b.NO_MOTION:
            self._go(block, move)
        self._flow(new.flow)

    def _beam(self, block: "Block") -> int:
        """Laser mode: what the block means for the beam."""
        if not self._spindle.laser:
            return 0
        beam = 0 if block.modal.motion in b.CUTTING else _DARK
        if block.values & b.AXIS_WORDS and block.claim == b.AXES_MOTION:
            return beam | _IN_MOTION
        if self.modal.spindle == plan.SPINDLE_CW:
            was_cutting = self.modal.motion in b.CUTTING
            if was_cutting == bool(beam & _DARK):
                beam |= _SYNC
        return beam

    def _set_speed(self, block: "Block", beam: int) -> None:
        if self.spindle_rpm == block.s and not beam & _SYNC:
            return
        if self.modal.spindle and not beam & _IN_MOTION:
            self._motion.spin(self.modal.spindle, 0.0 if beam & _DARK else block.s)
        self.spindle_rpm = block.s

    def _set_offsets(self, block: "Block") -> bool:
        """Returns whether work is somewhere else now."""
        changed = False
        modal = self.modal
        coords = self.coords
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
        self._motion.synchronise()
        self._state.wco_countdown = 0

    def _non_modal(self, block: "Block", move: "plan.Move") -> None:
        command = block.non_modal
        coords = self.coords
        if command == b.SET_COORDS:
            index = int(block.p)
            self._motion.synchronise()  # what is kept is written at rest only
            coords.write(index, self.stored)
            if index == self.modal.system:
                self._offsets_changed()
        elif command in (b.GO_G28, b.GO_G30):
            move.flags |= plan.RAPID
            if block.claim:
                self._motion.line(block.xyz, move)
            self._motion.line(self.stored, move)
            self.position[:] = self.stored
        elif command == b.SET_G28:
            self._motion.synchronise()
            coords.write(G28, self.position)
        elif command == b.SET_G30:
            self._motion.synchronise()
            coords.write(G30, self.position)
        elif command == b.SET_G92:
            coords.g92[:] = block.xyz
            self._offsets_changed()
        elif command == b.RESET_G92:
            for i in range(self.axes):
                coords.g92[i] = 0.0
            self._offsets_changed()

    def _go(self, block: "Block", move: "plan.Move") -> None:
        motion = self.modal.motion
        if motion == b.LINEAR:
            self._motion.line(block.xyz, move)
        elif motion == b.SEEK:
            move.flags |= plan.RAPID
            self._motion.line(block.xyz, move)
        elif motion in (b.CW_ARC, b.CCW_ARC):
            self._motion.arc(self.position, block.xyz, self.arc, move)
        else:
            move.flags |= plan.NO_FEED_OVERRIDE
            away = motion in (b.PROBE_AWAY, b.PROBE_AWAY_NO_ALARM)
            alarms = motion in (b.PROBE_TOWARD, b.PROBE_AWAY)
            if not self._cycles.probe(block.xyz, move, away, alarms):
                return  # the position has been seen to, or has not changed
        self.position[:] = block.xyz

    def _flow(self, flow: int) -> None:
        if flow == b.RUNNING:
            return
        self._motion.synchronise()
        if flow == b.PAUSED:
            self._motion.pause_program()
            return
        modal = self.modal
        modal.motion = b.LINEAR
        modal.plane = modal.relative = modal.inverse_time = 0
        modal.system = self.coords.active = 0
        modal.spindle = modal.coolant = 0
        modal.override_control = 1
        self._motion.end_program()
        if self._state.run != st.CHECK:
            self._offsets_changed()
        self._report.message(errors.MSG_PROGRAM_END)

    # Reports

    def modes(self) -> str:
        """The modal state as $G shows it."""
        modal = self.modal
        motion = modal.motion
        words = ["G%d" % motion if motion <= b.NO_MOTION else "G38.%d" % ((motion - 138) // 10)]
        words.append("G%d" % (54 + modal.system))
        words.append("G%d" % (17 + modal.plane))
        words.append("G%d" % (20 if modal.inches else 21))
        words.append("G%d" % (91 if modal.relative else 90))
        words.append("G%d" % (93 if modal.inverse_time else 94))
        numbers = [(5, 3, 4)[modal.spindle >> 4]]
        if modal.coolant & 2:
            numbers.append(7)
        if modal.coolant & 1:
            numbers.append(8)
        if not modal.coolant:
            numbers.append(9)
        if self._has_override_control and self._state.override_control:
            numbers.append(56)
        words += ["M%d" % number for number in numbers]
        feed, rpm = self._report.rate(self.feed), self._report.speed(self.spindle_rpm)
        return "%s T%d F%s S%s" % (" ".join(words), self.tool, feed, rpm)
