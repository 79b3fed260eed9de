"""The G-code interpreter: from words to a checked block to calls of the canon.

A block is handled in four steps: copy the modal state, store the words (block.py), check
everything (checks.py), execute in the order of the standard (here). Nothing changes until every
check has passed. Except for overrides, only the interpreter writes the modal state
(control/modes.py). Order and meaning: NIST RS274NGC v3, table 8, as Grbl 1.1 reads it.
"""

from array import array

from base import errors
from base import state as st
from base.errors import GrblError
from base.float32 import copy, for_kernels, vector
from base.float32_math import store_if_changed, whole_part
from base.hooks import call_all
from control import modes as mode
from control.coords import G28, G30
from micropython import const
from motion import layout
from motion import planner as plan

from language import block_layout as b
from language.line import PLAIN, check_line, commit_modal, run_move

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import Any

    from interfaces import Machine, Motion

    from language.block import Block

JOG_START = const(3)  # the length of "$J="
# Requests for which _switch() has something to do; a dwell is a COMMAND.
_SWITCHES = const(b.SPEED | b.BEAM_SWITCHES | b.ACCESSORIES | b.OFFSETS | b.COMMAND)


class Interpreter:
    """The interpreter. line_numbers: N is stored with the motion, and reported. _voice: sends
    messages. The requests of a block, `asked`, are a mask of bits of block_layout.py."""

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
        # Bits of the floats in _move and _rpm, so that only a changed one takes new memory.
        self._numbers = vector(2)
        self._rpm = 0.0
        self._line_numbers = line_numbers
        self.motions: "dict[int, Motion]" = {}  # motion modes of extras, by G number
        self.line = bytearray(1)  # the loop sets its own
        self.machine = array("i", (0 for _ in range(b.MACHINE_LENGTH)))
        self.machine[b.AXES] = block.axes
        self.machine[b.LENGTHS] = (1 << block.axes) - 1
        self.machine[b.LENGTH_AXIS] = machine.coords.length_axis
        self.machine[b.IS_OPEN] = 1
        # The part of memory() that stays the same, in the order in which line.py unpacks it. The
        # arrays have other owners; Planner.move_hook needs xyz as an array.
        self._kept = (
            for_kernels(block.ints),
            for_kernels(block.singles),
            block.xyz,
            for_kernels(machine.modes.rates),
            for_kernels(machine.modes.position),
            for_kernels(machine.coords.offsets),
            for_kernels(self.machine),
            for_kernels(machine.state.spindle),
            (
                for_kernels(block.stored),
                for_kernels(block.arc.plane),
                for_kernels(block.arc.numbers),
            ),
        )
        self.memory()  # sets _memory

    def memory(self) -> "tuple[array[int], array[int], tuple[Any, ...]]":
        """Return what kernels work on: the modal state, `machine`, and a tuple of everything else.

        It is one tuple, because each attribute look-up costs 5 us. Call it again after extras are
        installed.
        """
        planner = self._canon.planner
        plans = (
            for_kernels(self._canon.travel),
            for_kernels(planner.table),
            for_kernels(planner.ring),
            for_kernels(planner.flow),
            for_kernels(planner.speeds),
            for_kernels(self._state.running),
            planner.move_hook,
            for_kernels(planner.steps_per_mm),
            for_kernels(self._canon.course),
        )
        self._memory = self.block.words, self._kept, plans
        return self._modes.modal, self.machine, self._memory

    @property
    def is_open(self) -> bool:
        """Whether kernels alone may execute move-only lines."""
        return bool(self.machine[b.IS_OPEN])

    @is_open.setter
    def is_open(self, may: bool) -> None:
        self.machine[b.IS_OPEN] = may

    def watches(self) -> bool:
        """Return whether some lines must not be executed by kernels alone."""
        return self.machine[b.WATCHED] != 0 or not self.is_open

    def watch(self, asked: int) -> None:
        """Pass lines with any of these requests (bits of block_layout.py) to execute(), instead of
        letting kernels execute them."""
        self.machine[b.WATCHED] |= asked

    def add_motion(self, number: int, motion: "Motion") -> None:
        """Add a motion mode, by a G number between 80 and 100. Call it before memory()."""
        self.block.add_motion(number)
        self.motions[number] = motion

    def execute(self, line: bytearray, length: int) -> None:
        """Interpret line[:length]; line[length] is 0. Raises GrblError if it is refused."""
        modal, machine = self._modes.modal, self.machine
        # Requests of the line, if the loop has checked it already; minus an error number; or 0.
        asked = machine[b.ASKED] if line is self.line else 0
        machine[b.ASKED] = 0
        if asked == 0:
            asked = self.check_line(line, length << 8, modal, jog=0)
        elif asked < 0:
            raise GrblError(-asked)
        # What no kernel may execute: all but PLAIN, and motion that an extra watches.
        python_only = ~PLAIN | machine[b.WATCHED] & (b.MOVE | b.NOT_STRAIGHT)
        # A move-only line: wait for a free row of the ring, then a kernel executes it.
        if not asked & python_only:
            if asked & b.MOVE and self._state.run != st.CHECK:
                machine[b.ASKED] = asked
                self._canon.make_room()
                # Lines that were executed during the wait have replaced the block, and this value.
                if machine[b.ASKED] != asked:
                    asked = self.check_line(line, length << 8, modal, jog=0)
                machine[b.ASKED] = 0
            if run_move(asked, modal, self._memory):
                return  # executed
        self._execute(asked)
        if asked & (b.COMMAND | b.MOVE):
            self._canon.finish()

    def check_line(self, line: bytearray, span: int, modal: "array[int]", jog: int) -> int:
        """Steps one to three: read and check line[start:end] into the block. Returns its requests,
        bits of block_layout.py. Raises GrblError if the line is refused.

        span: end << 8 | start; modal: the modal state that the line starts from; jog: 1 for a $J=
        line, else 0.
        """
        asked = check_line(line, span, modal, jog, self._memory)
        if asked < 0:
            raise GrblError(-asked)
        if not jog:
            call_all(self._state.hooks.checked)
        return asked

    def jog(self, line: bytearray, length: int) -> None:
        """Interpret a "$J=" line, line[:length]. Raises GrblError. The line is read with a copy of
        the modal state, in which motion is G1 and feed mode G94: the state does not change."""
        block, modes, modal = self.block, self._modes, self._jog_modal
        copy(modes.modal, modal, mode.MODAL_LENGTH)
        modal[mode.MOTION] = b.LINEAR
        modal[mode.INVERSE_TIME] = 0
        self.check_line(line, length << 8 | JOG_START, modal, jog=1)
        if self._canon.outside(block.xyz):
            raise GrblError(errors.TRAVEL_EXCEEDED)
        move = self._begin_move(block, layout.NO_FEED_OVERRIDE)
        if self._spindle.laser and not mode.CUTTING >> modes.modal[mode.MOTION] & 1:
            move.spindle_rpm = 0.0  # a beam that the program's motion mode keeps dark stays dark
        self._canon.jog(block.xyz, move)
        copy(block.xyz, modes.position, block.axes)
        self._canon.finish()

    # Step four

    def _execute(self, asked: int) -> None:
        """Execute the checked block, whose requests are `asked`, in the standard's order. Moves
        are only requested here: execute() then calls Canon.finish(), with less on the stack."""
        block, modes = self.block, self._modes
        motion = block.ints[mode.MOTION]
        if asked & b.NOT_STRAIGHT and motion in self.motions:  # an extra's
            self.motions[motion].check(block)  # may refuse the block
        commit_modal(block.ints, block.singles, modes.modal, modes.rates)
        modes.rates[mode.TOOL] = block.singles[b.T]
        if asked & _SWITCHES:
            self._switch(block, asked)
        if asked & (b.COMMAND | b.MOVE):
            move = self._begin_move(
                block, layout.INVERSE_TIME if block.ints[mode.INVERSE_TIME] else 0
            )
            if asked & b.BEAM_OFF:
                move.spindle_rpm = 0.0  # laser mode, and the motion does not cut; S stays
            if asked & b.COMMAND:
                self._non_modal(block, move)
            if asked & b.MOVE:
                self.run_move(block, move)
        if asked & b.FLOW:
            self._control_program(block.ints[mode.PROGRAM_FLOW])

    def _begin_move(self, block: "Block", flags: int) -> "plan.Move":
        """Return the move of a block, with its feed rate and the active spindle and coolant.
        flags: further ones of motion/layout.py."""
        # No more than three at once: these would allocate a tuple.
        move, numbers, modes = self._move, self._numbers, self._modes
        # Read a float as an object only if its bits have changed: each reading takes memory.
        if store_if_changed(numbers, mode.FEED, block.singles, b.F):
            move.feed = block.singles[b.F]
        if block.ints[mode.INVERSE_TIME]:
            numbers[mode.FEED] = -1.0  # an arc changes move.feed: set it again next time
        if store_if_changed(numbers, mode.RPM, modes.rates, mode.RPM):
            self._rpm = modes.rates[mode.RPM]
        move.flags = flags | modes.accessory_flags()
        move.spindle_rpm = self._rpm
        move.line_number = whole_part(block.singles, b.N, 0) if self._line_numbers else 0
        return move

    def _switch(self, block: "Block", asked: int) -> None:
        """Execute what precedes motion: speed, M words, a dwell, offsets. asked: requests.

        Two are of laser mode. BEAM_SWITCHES: the beam goes on or off although S is the same, so
        the speed is set once more. BEAM_OFF: the beam's power is 0 in this line; S stays.
        """
        modes, new = self._modes, block.ints
        if asked & (b.SPEED | b.BEAM_SWITCHES):
            self._set_speed(block, asked)
        if asked & b.ACCESSORIES:
            rpm = 0.0 if asked & b.BEAM_OFF else modes.rates[mode.RPM]
            self._set_accessories(new, rpm)
        if new[b.NON_MODAL] == b.DWELL:
            self._canon.dwell(block.singles[b.P])
        if asked & b.OFFSETS and self._set_offsets(block):
            self._offsets_changed()

    def _set_speed(self, block: "Block", asked: int) -> None:
        """Set S, after all motion. It is only stored if the spindle is off, or if it is a laser's
        S that the motion of this line will set. asked: the block's requests."""
        modes, speed = self._modes, block.singles[b.S]
        direction = modes.modal[mode.SPINDLE]  # 0: off
        if direction and not asked & b.S_IN_MOTION:
            self._canon.spin(direction, 0.0 if asked & b.BEAM_OFF else speed)
        modes.rates[mode.RPM] = speed

    def _set_accessories(self, new: "array[int]", rpm: float) -> None:
        """Execute M words of spindle, coolant and override control. new: the block's integers, the
        modal state after it; rpm: the spindle's speed."""
        canon, modal = self._canon, self._modes.modal
        if modal[mode.SPINDLE] != new[mode.SPINDLE]:
            canon.spin(new[mode.SPINDLE], rpm)
            modal[mode.SPINDLE] = new[mode.SPINDLE]
        if modal[mode.COOLANT] != new[mode.COOLANT]:
            canon.cool(new[mode.COOLANT])
            modal[mode.COOLANT] = new[mode.COOLANT]
        if modal[mode.OVERRIDE_CONTROL] != new[mode.OVERRIDE_CONTROL]:
            modal[mode.OVERRIDE_CONTROL] = new[mode.OVERRIDE_CONTROL]
            canon.control_overrides(bool(new[mode.OVERRIDE_CONTROL]))

    def _set_offsets(self, block: "Block") -> bool:
        """Set tool length and coordinate system. Returns whether the work zero has changed."""
        changed = False
        modal, new, coords = self._modes.modal, block.ints, self._coords
        if new[b.AXIS_USE] == b.AXES_FOR_LENGTH:
            modal[mode.TOOL_LENGTH] = new[mode.TOOL_LENGTH]
            length = block.xyz[coords.length_axis] if modal[mode.TOOL_LENGTH] else 0.0
            if coords.tool_length != length:
                coords.tool_length = length
                changed = True
        if modal[mode.SYSTEM] != new[mode.SYSTEM]:
            modal[mode.SYSTEM] = coords.active = new[mode.SYSTEM]
            changed = True
        return changed

    def _offsets_changed(self) -> None:
        """Show the work offset (WCO:) in the next status report, once all motion has ended, so
        that positions in reports do not jump."""
        self._canon.synchronise()
        self._state.wco_countdown = 0

    def _non_modal(self, block: "Block", move: "plan.Move") -> None:
        """Execute G10, G28, G30, G92 and those with decimals; the block has their values. move:
        how to move for G28 and G30."""
        command = block.ints[b.NON_MODAL]
        coords, modes = self._coords, self._modes
        if command == b.SET_COORDS:
            self._canon.synchronise()  # stored values are written only while idle
            self._state.hooks.write_offsets(block.ints[b.INDEX], block.stored)
            if block.ints[b.INDEX] == modes.modal[mode.SYSTEM]:
                self._offsets_changed()
        elif command in (b.GO_G28, b.GO_G30):
            move.flags |= layout.RAPID_MOTION
            if block.ints[b.AXIS_USE]:  # axis words: first to that point
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

    def run_move(self, block: "Block", move: "plan.Move") -> None:
        """Request the motion of a block from the canon, and set the parser's position to its
        target. move: how to move."""
        modes = self._modes
        motion = modes.modal[mode.MOTION]
        if motion == b.LINEAR:
            self._canon.line(block.xyz, move)
        elif motion == b.SEEK:
            move.flags |= layout.RAPID_MOTION
            self._canon.line(block.xyz, move)
        elif motion in (b.CW_ARC, b.CCW_ARC):
            self._canon.arc(modes.position, block.xyz, block.arc, move)
        elif motion in self.motions:
            self.motions[motion].make(block, move)  # sets the position, too
            return
        elif not self._probe(block, move):
            return  # position: _probe() has set it, or it must not change
        copy(block.xyz, modes.position, block.axes)
        if motion <= b.CCW_ARC and self._state.hooks.moved:
            self._canon.finish()
            call_all(self._state.hooks.moved)

    def _probe(self, block: "Block", move: "plan.Move") -> bool:
        """Execute a probe cycle to the block's target. Returns whether the parser's position is
        now that target; if not, it has been set already, or must not change."""
        motion = self._modes.modal[mode.MOTION]
        move.flags |= layout.NO_FEED_OVERRIDE
        away = motion in (b.PROBE_AWAY, b.PROBE_AWAY_NO_ALARM)
        alarms = motion in (b.PROBE_TOWARD, b.PROBE_AWAY)
        return self._state.hooks.probe(block.xyz, move, away, alarms)

    def _control_program(self, flow: int) -> None:
        """Pause the program (flow: PAUSED), or end it and reset the modes as M2 and M30 do."""
        self._canon.synchronise()
        if flow == b.PAUSED:
            self._canon.pause_program()
            return
        modal = self._modes.modal
        modal[mode.MOTION] = b.LINEAR
        modal[mode.PLANE] = modal[mode.RELATIVE] = modal[mode.INVERSE_TIME] = 0
        modal[mode.SYSTEM] = self._coords.active = 0
        modal[mode.SPINDLE] = modal[mode.COOLANT] = 0
        self._canon.end_program()
        if self._state.run != st.CHECK:
            self._offsets_changed()
        self._voice.message(errors.MSG_PROGRAM_END)
