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
from base.hooks import tell
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
    TOOL,
    TOOL_LENGTH,
)
from micropython import const
from motion import layout
from motion import planner as plan

from language import block as wd
from language import block_layout as b
from language import line as ln
from language.checks import (
    ACCESSORIES,
    COMMAND,
    DARK,
    FLOW,
    IN_MOTION,
    MOVE,
    OFFSETS,
    SPECIAL,
    SPEED,
    SYNC,
)

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import Any

    from interfaces import Machine, Motion

    from language.block import Block

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


JOG_START = const(3)  # behind "$J="
_SWITCHES = const(SPEED | SYNC | ACCESSORIES | OFFSETS | COMMAND)


class Interpreter:
    """The interpreter. line_numbers: N goes with the motion, and into reports."""

    def __init__(self, machine: "Machine", block: "Block", line_numbers: bool) -> None:
        self._modes = machine.modes
        self._coords = machine.coords
        self._state = machine.state
        self._settings = machine.settings
        self._canon = machine.canon
        self._spindle = machine.spindle
        self._voice = machine.report
        self.block = block
        self._jog_modal = array("i", machine.modes.modal)
        self._move = plan.Move()
        # The numbers that it has: what they are made objects of takes memory.
        self._numbers = vector(2)
        self._rpm = 0.0
        self._line_numbers = line_numbers
        self.motions: "dict[int, Motion]" = {}  # of extras
        self.line = bytearray(1)  # the loop's
        self.machine = array("i", (0 for _ in range(b.MACHINE_LENGTH)))
        self.machine[b.AXES] = block.axes
        self.machine[b.LENGTHS] = (1 << block.axes) - 1
        self.machine[b.LENGTH_AXIS] = machine.coords.length_axis
        self.machine[b.IS_OPEN] = 1
        self._kept = (
            block.ints,
            block.singles,
            block.xyz,
            machine.modes.rates,
            machine.modes.position,
            machine.coords.offsets,
            self.machine,
            machine.state.spindle,
            (block.stored, block.arc.plane, block.arc.numbers),
        )
        self.memory()

    def memory(self) -> "tuple[array[int], array[int], tuple[Any, ...]]":
        """What kernels work on; to look each up costs 5 us. Once extras are there."""
        planner = self._canon.planner
        plans = (
            self._canon.travel,
            planner.table,
            planner.ring,
            planner.flow,
            planner.speeds,
            self._state.running,
            planner.move_hook,
            planner.steps_per_mm,
            self._canon.course,
        )
        self._memory = self.block.words, self._kept, plans
        return self._modes.modal, self.machine, self._memory

    @property
    def is_open(self) -> bool:
        """Lines that do no more than move may be executed by kernels alone."""
        return bool(self.machine[b.IS_OPEN])

    @is_open.setter
    def is_open(self, may: bool) -> None:
        self.machine[b.IS_OPEN] = may

    def watches(self) -> bool:
        """Some lines are not to be executed by kernels alone."""
        return self.machine[b.WATCHED] != 0 or not self.is_open

    def watch(self, asked: int) -> None:
        """Have lines that ask for one of these (bits, language/checks.py) come to execute()."""
        self.machine[b.WATCHED] |= asked

    def add_motion(self, number: int, motion: "Motion") -> None:
        """Add a motion mode, by a G number between 80 and 100. Before memory() is asked for."""
        self.block.add_motion(number)
        self.motions[number] = motion

    def execute(self, line: bytearray, length: int) -> None:
        """Interpret line[:length], which a 0 follows. Raises GrblError where it is refused."""
        modal, ints = self._modes.modal, self.block.ints
        asked = ints[b.ASKED] if line is self.line else 0  # the loop has looked at it
        ints[b.ASKED] = 0
        if asked == 0:
            asked = self.look(line, length << 8, modal, 0)
        elif asked < 0:
            raise GrblError(-asked)
        if not asked & (~ln.PLAIN | self.machine[b.WATCHED] & (MOVE | SPECIAL)):
            if asked & MOVE and self._state.run != st.CHECK:
                ints[b.ASKED] = asked
                self._canon.make_room()
                if ints[b.ASKED] != asked:  # lines have been executed while this one waited
                    asked = self.look(line, length << 8, modal, 0)
                ints[b.ASKED] = 0
            if ln.go(asked, modal, self._memory):
                return
        self._execute(asked)
        if asked & (COMMAND | MOVE):
            self._canon.finish()

    def look(self, line: bytearray, span: int, modal: "array[int]", jog: int) -> int:
        """Steps one to three: see line.look(). Raises GrblError where the line is refused."""
        asked = ln.look(line, span, modal, jog, self._memory)
        if asked < 0:
            raise GrblError(-asked)
        if not jog:
            tell(self._state.hooks.checked)
        return asked

    def jog(self, line: bytearray, length: int) -> None:
        """Interpret a "$J=" line. The modal state stays as it is."""
        block, modes, modal = self.block, self._modes, self._jog_modal
        copy(modes.modal, modal, MODAL_LENGTH)
        modal[MOTION] = b.LINEAR
        modal[INVERSE_TIME] = 0
        self.look(line, length << 8 | JOG_START, modal, 1)
        if self._canon.outside(block.xyz):
            raise GrblError(errors.TRAVEL_EXCEEDED)
        move = self._begin_move(block, layout.NO_FEED_OVERRIDE)
        self._canon.jog(block.xyz, move)
        copy(block.xyz, modes.position, block.axes)
        self._canon.finish()

    # Step four

    def _execute(self, asked: int) -> None:
        """What a checked block asks for, in the standard's order. What waits is done beneath."""
        block, modes = self.block, self._modes
        if asked & SPECIAL and block.ints[MOTION] in self.motions:
            self.motions[block.ints[MOTION]].check(block)
        ln.put_in_force(block.ints, block.singles, modes.modal, modes.rates)
        modes.rates[TOOL] = block.singles[b.T]
        if asked & _SWITCHES:
            self._switch(block, asked)
        if asked & (COMMAND | MOVE):
            move = self._begin_move(block, layout.INVERSE_TIME if block.ints[INVERSE_TIME] else 0)
            if asked & DARK:
                move.spindle_rpm = 0.0
            if asked & COMMAND:
                self._non_modal(block, move)
            if asked & MOVE:
                self.go(block, move)
        if asked & FLOW:
            self._control_program(block.ints[PROGRAM_FLOW])

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
        if left & (SPEED | SYNC):
            self._set_speed(block, left)
        if left & ACCESSORIES:
            self._set_accessories(new, 0.0 if left & DARK else modes.rates[RPM])
        if new[b.NON_MODAL] == b.DWELL:
            self._canon.dwell(block.singles[b.P])
        if left & OFFSETS and self._set_offsets(block):
            self._offsets_changed()

    def _set_speed(self, block: "Block", beam: int) -> None:
        modes, speed = self._modes, block.singles[b.S]
        if modes.modal[SPINDLE] and not beam & IN_MOTION:
            self._canon.spin(modes.modal[SPINDLE], 0.0 if beam & DARK else speed)
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
            self._state.hooks.write_offsets(block.ints[b.INDEX], block.stored)
            if block.ints[b.INDEX] == modes.modal[SYSTEM]:
                self._offsets_changed()
        elif command in (b.GO_G28, b.GO_G30):
            move.flags |= layout.RAPID_MOTION
            if block.ints[b.CLAIM]:
                self._canon.line(block.xyz, move)
            self._canon.line(block.stored, move)
            copy(block.stored, modes.position, block.axes)
        elif command == b.SET_G28:
            self._canon.synchronise()
            self._state.hooks.write_offsets(G28, modes.position)
        elif command == b.SET_G30:
            self._canon.synchronise()
            self._state.hooks.write_offsets(G30, modes.position)
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
        elif motion in self.motions:
            self.motions[motion].make(block, move)
            return
        elif not self._probe(block, move):
            return  # the position has been seen to, or has not changed
        copy(block.xyz, modes.position, block.axes)
        if motion <= b.CCW_ARC and self._state.hooks.moved:
            self._canon.finish()
            tell(self._state.hooks.moved)

    def _probe(self, block: "Block", move: "plan.Move") -> bool:
        """Search for the probe's contact. Returns whether the target has been reached."""
        motion = self._modes.modal[MOTION]
        move.flags |= layout.NO_FEED_OVERRIDE
        away = motion in (b.PROBE_AWAY, b.PROBE_AWAY_NO_ALARM)
        alarms = motion in (b.PROBE_TOWARD, b.PROBE_AWAY)
        return self._state.hooks.probe(block.xyz, move, away, alarms)

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
