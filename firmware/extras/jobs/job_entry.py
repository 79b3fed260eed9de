"""Entry: start a job at a line in its middle.

The lines before it run in check mode, which moves nothing. So modes, offsets, tool, spindle,
coolant and position become what a run of these lines would have left. Stored offsets change in a
copy only. The tool then approaches at a safe height: all off, up, across, tool on, down. After
that the modes are applied, and the line runs as if all lines before it had been executed.
"""

from array import array

from base import state as st
from base.axes import LETTERS
from base.controls import HOLD
from base.errors import GrblError
from base.float32 import f32, truncate
from control.modes import (
    COOLANT,
    FEED,
    INVERSE_TIME,
    MODAL_LENGTH,
    MOTION,
    OVERRIDE_CONTROL,
    RPM,
    SPINDLE,
    SYSTEM,
    TOOL,
)
from language.block_layout import PROBE_TOWARD
from language.words import bare
from micropython import const
from motion.planner import SPINDLE_CW
from talk.lines import LINE, clean, take_bytes

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import IO, Any

    from talk.controller import Controller
    from talk.lines import LineReader

    from extras.api import Cnc

_PIECE_BYTES = const(255)  # of a line, read at once
_LINES_PER_POLL = const(16)  # between two polls for real-time commands
_DOLLAR = const(36)
_ZERO = const(48)
_NINE = const(57)
_HOLD_IN_ACTIVE = const(HOLD << 8)  # a bit of Inputs.active()
_SLOW_MM_MIN = 100.0  # descent to a line that has no feed rate in mm/min
_TOLERANCE = 0.0005  # of settings and offsets, which are shown with three decimals
_SPIN_UP_S = const(4)  # seconds for the spindle to reach its speed
_Z = const(2)
# Indices of program_state()'s result.
_POSITION = const(0)
_MODAL = const(1)
_COOLANTS = ("", "M8", "M7", "M7M8")  # by their mask


def differs(one: float, other: float) -> bool:
    """Return whether two values of a setting or an offset are shown as different ones."""
    return abs(one - other) > _TOLERANCE


class CannotEnter(Exception):
    """The job cannot start at this line. The text says why."""


def program_state(machine: "Controller") -> "list[Any]":
    """Return what a program can have set, for apply_state(): position (mm), modal state, feed and
    rpm, tool, G92 and tool length. It can be stored as JSON."""
    modes, coords = machine.modes, machine.coords
    modal = list(modes.modal[:MODAL_LENGTH])
    position, rates, g92 = list(modes.position), list(modes.rates[:TOOL]), list(coords.g92)
    return [position, modal, rates, modes.tool, g92, coords.tool_length]


def apply_state(machine: "Controller", stored: "list[Any]") -> None:
    """Apply a result of program_state() (stored) to the interpreter's modes and the offsets. The
    outputs of spindle and coolant stay as they are."""
    modes, coords, state = machine.modes, machine.coords, machine.state
    position, modal, rates, tool, g92, coords.tool_length = stored
    modes.position[:] = array("f", position)
    modes.rates[:] = array("f", rates + [tool])  # the tool's number is its last
    for i in range(MODAL_LENGTH):
        modes.modal[i] = modal[i]
    coords.active = modal[SYSTEM]
    coords.set_g92(array("f", g92))
    state.override_control = bool(modal[OVERRIDE_CONTROL])
    state.wco_countdown = 0  # the next status report has the offsets


class Entry:
    """The approach to a line, and the modes that hold there.

    reader: for the lines of the file. _longest_line: in bytes. After rehearse(), _state_at_line is
    program_state() at that line, _offsets_at_line has the stored offsets of each system there, and
    _highest_z is the greatest Z before it, mm in machine coordinates.
    has_ended: the program has ended before the line.
    """

    def __init__(self, cnc: "Cnc", reader: "LineReader") -> None:
        machine = cnc.machine
        self._cnc = cnc
        self._machine = machine
        self._reader = reader
        self._longest_line = len(machine.reader.line) - 1
        self._state_at_line: "list[Any]" = []
        self._offsets_at_line: "list[array[float]]" = []
        self._highest_z = 0.0
        self.has_ended = False

    def rehearse(
        self, file: "IO[bytes]", line: int, start: "list[Any]", systems: "list[array[float]]"
    ) -> None:
        """Run the lines before `line` in check mode, and leave the file at that line.

        start, systems: program_state() and the stored offsets before the first line. The machine's
        own state and offsets are restored. CannotEnter if the state at the line is not certain.
        """
        machine = self._machine
        coords, state = machine.coords, machine.state
        if start[_MODAL][MOTION] in machine.interpreter.motions:
            raise CannotEnter("a canned cycle is still active where the job begins")
        kept = [cycle.kept for cycle in self._cnc.cycles]
        state_before = program_state(machine)
        offsets_before = array("f", coords.offsets)
        for i in range(len(systems)):
            coords.change(i, systems[i])
        hooks = state.hooks
        # The lines change offsets in memory, and store none.
        write_before = hooks.write_offsets
        hooks.write_offsets = coords.change
        self.has_ended = False
        self._highest_z = machine.modes.position[_Z]
        state.enter(st.CHECK)
        try:
            apply_state(machine, start)
            self._check_lines_before(file, line)
            for why_no_entry in self._cnc.entries:  # of other extras; each returns why, or ""
                why = why_no_entry()
                if why:
                    raise CannotEnter(why)
            self._state_at_line = program_state(machine)
            self._offsets_at_line = [array("f", values) for values in coords.systems]
            self._check_homed(state_before[_POSITION])
        finally:
            hooks.write_offsets = write_before
            coords.offsets[:] = offsets_before
            if state.run == st.CHECK:  # no reset has come
                state.enter(st.IDLE)
            apply_state(machine, state_before)
            for cycle, numbers in zip(self._cnc.cycles, kept):
                cycle.kept = numbers
            machine.resync()  # planner and parser go on from the steps executed
        if machine.reader.has_line():
            raise CannotEnter("the sender sent other lines meanwhile")
        if machine.inputs.door_open() or machine.inputs.active() & _HOLD_IN_ACTIVE:
            raise CannotEnter("the hold button or door input is active")

    def _check_lines_before(self, file: "IO[bytes]", line: int) -> None:
        """Execute the lines before `line`, in check mode. CannotEnter if one is missing or what it
        does is not certain."""
        self._reader.clear()
        for number in range(1, line):
            result = self._next_line(file)  # length << 2, and LINE if it is not too long
            if result == 0:
                raise CannotEnter("it has only %d lines" % (number - 1))
            if result & LINE == 0 or result >> 2 > self._longest_line:
                raise CannotEnter("line %d is too long" % number)
            self._check_line(self._reader.line, result >> 2, number)
            if number % _LINES_PER_POLL == 0:
                self.poll_realtime()
        if not file.read(1):  # nothing comes at `line` itself
            raise CannotEnter("it has only %d lines" % (line - 1))
        file.seek(-1, 1)  # back before that byte

    def _next_line(self, file: "IO[bytes]") -> int:
        """Read the next line into the reader. Return clean()'s result: its length << 2, with LINE
        or TOO_LONG; 0 at the end of the file. Read in pieces, because a comment may be longer than
        one."""
        memory = self._reader.memory()
        ring, reader_state, _, kinds = memory
        is_begun = False  # a piece of the line has been read
        result = 0
        while result == 0:  # the line is incomplete
            text = file.readline(_PIECE_BYTES)
            if not text and not is_begun:
                return 0
            is_begun = True
            piece = bytearray(text.replace(b"\r", b" ") or b"\n")  # the last line may lack its LF
            take_bytes(piece, len(piece), ring, reader_state, kinds, _ignore_byte)
            result = clean(*memory)
        return result

    def poll_realtime(self) -> None:
        """Handle real-time commands. CannotEnter for a hold, which check mode would lose."""
        machine = self._machine
        machine.protocol.pump()
        pending = machine.state.pending
        if pending[st.FEED_HOLD] or pending[st.SAFETY_DOOR] or pending[st.SLEEP_REQUEST]:
            raise CannotEnter("the start was interrupted by a hold, door or sleep")
        machine.realtime.handle_events()

    def _check_line(self, line: bytearray, length: int, number: int) -> None:
        """Execute line `number` of the file, in check mode. CannotEnter if what it does is not
        certain: a $ command, an added word, a probe, an error, the program's end."""
        machine = self._machine
        if length == 0:
            return
        if line[0] == _DOLLAR:
            if _ZERO <= line[1] <= _NINE:
                self._check_setting(line, number)
                return
            raise CannotEnter("line %d is a $ command of unknown effect: start before it" % number)
        if self._cnc.has_word(line, length):
            text = "line %d has a custom word of unknown effect: start before it"
            raise CannotEnter(text % number)
        try:
            machine.state.hooks.execute(line, length)
        except GrblError as reason:
            raise CannotEnter("line %d is refused with %d" % (number, reason.code))
        if self.has_ended:
            raise CannotEnter("line %d ends the program" % number)
        modes = machine.modes
        if modes.modal[MOTION] >= PROBE_TOWARD:  # G38.2 to G38.5, the highest modes
            raise CannotEnter("line %d probes, so its end is unknown: start before it" % number)
        if modes.position[_Z] > self._highest_z:
            self._highest_z = modes.position[_Z]

    def _check_setting(self, line: bytearray, number: int) -> None:
        """Check that a setting already has the line's value. It is not written again."""
        equals, setting = bare(line, 1)  # after $: index of the =, and the setting's number
        _, value = bare(line, equals + 1)
        for existing, present_value, _ in self._machine.settings.each():
            if existing == setting and differs(present_value, value):
                text = "line %d sets $%d, which differs now: set it first"
                raise CannotEnter(text % (number, existing))

    def _check_homed(self, here: "list[float]") -> None:
        """Check that axes that are not homed do not have to move.

        here: the position before the approach, in mm. Positions are compared in steps, because a
        difference of less than a step needs no move.
        """
        position = self._state_at_line[_POSITION]  # at the line, mm
        for axis in range(len(here)):
            way_mm = [here[axis], position[axis]]  # its positions on the approach
            if axis == _Z:  # it also moves to the safe height
                way_mm.append(self._highest_z)
            moves = self._in_steps(axis, min(way_mm)) != self._in_steps(axis, max(way_mm))
            if moves and not self._machine.homing_probing.homed >> axis & 1:
                text = "%s would have to move, but is not homed: home it first"
                raise CannotEnter(text % LETTERS[axis])

    # The approach

    def approach_lines(self) -> "list[str]":
        """Return the lines of G-code that move the tool to the start, some of them empty: all off,
        up, across, tool on, down. A laser is switched on last."""
        position, modal, rates, _, _, _ = self._state_at_line
        coolant = _COOLANTS[modal[COOLANT]]
        spindle = ""  # M3 or M4 with its S
        if modal[SPINDLE]:
            spindle = "M%dS%.3f" % (3 if modal[SPINDLE] == SPINDLE_CW else 4, rates[RPM])
        up, down = self._axis_word(_Z, self._highest_z), self._axis_word(_Z, position[_Z])
        across = ""  # words of all other axes
        for axis in range(len(position)):
            if axis != _Z:
                across += self._axis_word(axis, position[axis])
        begin = ["G21G90G94M5M9", "G53G0" + up, "G53G0" + across]
        if self._machine.spindle.laser:  # dark during G0
            return begin + ["G53G0" + down, coolant, spindle]
        feed = _SLOW_MM_MIN if modal[INVERSE_TIME] or rates[FEED] <= 0 else rates[FEED]
        dwell = "G4P%d" % _SPIN_UP_S if spindle else ""
        return begin + [spindle, coolant, dwell, "G53G1%sF%.3f" % (down, feed)]

    def _axis_word(self, axis: int, mm: float) -> str:
        """Return an axis word for a position (mm), rounded to a whole step, so that the machine
        goes to that very step."""
        return "%s%.5f" % (LETTERS[axis], self._in_steps(axis, mm) / self._steps_per_mm(axis))

    def _steps_per_mm(self, axis: int) -> float:
        """Return an axis's steps per mm."""
        return self._machine.planner.steps_per_mm[axis]

    def _in_steps(self, axis: int, mm: float) -> int:
        """Return a position (mm) in steps, rounded as the planner does: halves away from 0."""
        product = f32(mm * self._steps_per_mm(axis))
        return truncate(product + 0.5) if product >= 0 else -truncate(0.5 - product)

    def apply_modes(self) -> None:
        """Apply the modes at the line, and store the offsets that the lines before it have
        changed. CannotEnter if the tool is not at its position."""
        position, here = self._state_at_line[_POSITION], self._machine.modes.position
        for axis in range(len(position)):
            if self._in_steps(axis, here[axis]) != self._in_steps(axis, position[axis]):
                raise CannotEnter("the tool is not where that line begins")
        coords = self._machine.coords
        for i in range(len(self._offsets_at_line)):
            if list(coords.systems[i]) != list(self._offsets_at_line[i]):
                self._machine.state.hooks.write_offsets(i, self._offsets_at_line[i])
        apply_state(self._machine, self._state_at_line)


def _ignore_byte(_byte: int) -> None:
    """Ignore a byte: in a file none is a real-time command."""
