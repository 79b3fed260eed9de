"""Entry: going on at a line in the middle of a job.

The lines before it are run in check mode, which moves nothing, so modes, offsets, tool, spindle,
coolant and position come to be what a whole run would have left. The way there is at a safe
height: all off, up, across, tool on, down; then modes and position are put in force, and the line
comes as if all before it had been done.
"""

from array import array

from base import state as st
from base.errors import GrblError
from base.f32 import copy, f32, vector, whole
from control.modes import (
    COOLANT,
    FEED,
    INVERSE_TIME,
    MODAL_LENGTH,
    MOTION,
    RPM,
    SPINDLE,
    SYSTEM,
)
from language.block import PROBE_TOWARD
from micropython import const
from motion.planner import SPINDLE_CW
from talk.lines import LINE, clean, feed

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import IO

    from talk.lines import LineReader

    from extras.api import Cnc

_PIECE = const(255)
_LINES = const(16)  # between two looks at real-time commands
_DOLLAR = const(36)
_SLOW_MM_MIN = 100.0
_SPIN_UP_S = const(4)
_Z = const(2)
_LETTERS = "XYZA"
_COOLANTS = ("", "M8", "M7", "M7M8")  # by their mask


class NoWay(Exception):
    """A line that nobody can begin with; its text says why."""


class Entry:
    """The way to one line, and what is in force there."""

    def __init__(self, cnc: "Cnc", reader: "LineReader") -> None:
        machine = cnc.machine
        self._cnc = cnc
        self._machine = machine
        self._reader = reader
        self._longest = len(machine.reader.line) - 1
        self._place = vector(machine.planner.axes)
        self._modal = array("i", bytes(4 * MODAL_LENGTH))
        self._rates = vector(2)
        self._g92 = vector(machine.planner.axes)
        self._tool = 0
        self._length = 0.0
        self._highest = 0.0
        self.has_ended = False  # the program, in front of the line

    def find(self, file: "IO[bytes]", line: int, start: "list[float] | None") -> None:
        """Run what is before the line in check mode; the file is left at that line. start: where
        the tool was before the first, else where it is. NoWay where it cannot be known."""
        machine = self._machine
        coords, modes, state = machine.coords, machine.modes, machine.state
        write, coords.write = coords.write, _leave  # type: ignore[assignment,method-assign]
        self.has_ended = False
        here = modes.position[_Z]
        if start:
            modes.position[:] = array("f", start)
        state.enter(st.CHECK)
        try:
            self._highest = here
            self._rehearse(file, line)
            self._take()
        finally:
            coords.write = write  # type: ignore[method-assign]
            if state.run == st.CHECK:
                state.enter(st.IDLE)
            modes.reset()
            coords.active = 0
            state.wco_countdown = 0
            machine.resync()
            machine.interpreter.fast.forget()

    def _rehearse(self, file: "IO[bytes]", line: int) -> None:
        self._reader.clear()
        for number in range(1, line):
            found = self._next_line(file)
            if found == 0:
                raise NoWay("there are only %d lines" % (number - 1))
            if found & LINE == 0 or found >> 2 > self._longest:
                raise NoWay("line %d is too long" % number)
            self._do(self._reader.line, found >> 2, number)
            if number % _LINES == 0:
                self._cnc.service()
        if not file.read(1):
            raise NoWay("there are only %d lines" % (line - 1))
        file.seek(-1, 1)

    def _next_line(self, file: "IO[bytes]") -> int:
        """What clean() finds of the next line, however long its comments are; 0 at the end."""
        memory = self._reader.memory()
        ring, at, _, kinds = memory
        found, is_begun = 0, False
        while found == 0:
            text = file.readline(_PIECE)
            if not text and not is_begun:
                return 0
            is_begun = True
            piece = bytearray(text.replace(b"\r", b" ") or b"\n")
            feed(piece, len(piece), ring, at, kinds, _pass_over)
            found = clean(*memory)
        return found

    def _do(self, line: bytearray, length: int, number: int) -> None:
        machine = self._machine
        if length == 0 or line[0] == _DOLLAR:
            return
        if self._cnc.has_word(line, length):
            raise NoWay("line %d has a word of another kind: what it does is not known" % number)
        try:
            machine.interpreter.execute(line, length)
        except GrblError as reason:
            raise NoWay("line %d is refused with %d" % (number, reason.code))
        if self.has_ended:
            raise NoWay("line %d ends the program" % number)
        modes = machine.modes
        if modes.modal[MOTION] >= PROBE_TOWARD:
            raise NoWay("line %d probes: where that ended is not known" % number)
        if modes.position[_Z] > self._highest:
            self._highest = modes.position[_Z]

    def _take(self) -> None:
        """Note what is in force now."""
        for why in self._cnc.entries:
            if why():
                raise NoWay(why())
        modes, coords = self._machine.modes, self._machine.coords
        copy(modes.position, self._place, len(self._place))
        copy(modes.rates, self._rates, 2)
        copy(coords.g92, self._g92, len(self._g92))
        for i in range(MODAL_LENGTH):
            self._modal[i] = modes.modal[i]
        self._tool = modes.tool
        self._length = coords.tool_length

    # The way there

    def way(self) -> "list[str]":
        """Lines that lead there."""
        spindle, coolant = self._modal[SPINDLE], _COOLANTS[self._modal[COOLANT]]
        turn = ""
        if spindle:
            turn = "M%dS%.3f" % (3 if spindle == SPINDLE_CW else 4, self._rates[RPM])
        up, across = self._go("G0", _Z, self._highest), "G53G0"
        for axis in range(len(self._place)):
            if axis != _Z:
                across += self._word(axis, self._place[axis])
        if self._machine.spindle.laser:  # stays dark behind G0
            return ["G21G90G94M5M9", up, across, self._go("G0", _Z), coolant, turn]
        dwell = "G4P%d" % _SPIN_UP_S if turn else ""
        return ["G21G90G94M5M9", up, across, turn, coolant, dwell, self._go("G1", _Z)]

    def _go(self, motion: str, axis: int, mm: "float | None" = None) -> str:
        feed = self._rates[FEED]
        if self._modal[INVERSE_TIME] or feed <= 0:
            feed = _SLOW_MM_MIN
        word = self._word(axis, self._place[axis] if mm is None else mm)
        return "G53" + motion + word + ("F%.3f" % feed if motion == "G1" else "")

    def _word(self, axis: int, mm: float) -> str:
        """The middle of the step that the place is rounded to, so that it is this one exactly."""
        return "%s%.5f" % (_LETTERS[axis], self._steps(axis, mm) / self._resolution(axis))

    def _resolution(self, axis: int) -> float:
        return self._machine.planner.steps_per_mm[axis]

    def _steps(self, axis: int, mm: float) -> int:
        product = f32(mm * self._resolution(axis))
        return whole(product + 0.5) if product >= 0 else -whole(0.5 - product)

    def arrive(self) -> None:
        """The tool is there: put in force what is. NoWay where it is not."""
        machine = self._machine
        modes, coords = machine.modes, machine.coords
        for axis in range(len(self._place)):
            if self._steps(axis, modes.position[axis]) != self._steps(axis, self._place[axis]):
                raise NoWay("the way has not led there")
        copy(self._place, modes.position, len(self._place))
        copy(self._rates, modes.rates, 2)
        for i in range(MODAL_LENGTH):
            modes.modal[i] = self._modal[i]
        modes.tool = self._tool
        coords.active = self._modal[SYSTEM]
        coords.tool_length = self._length
        coords.set_g92(self._g92)
        machine.state.wco_countdown = 0
        machine.interpreter.fast.forget()


def _pass_over(_byte: int) -> None:
    """In the file no byte is a real-time command."""


def _leave(_index: int, _values: object) -> None:
    """What G10, G28.1 and G30.1 have written when they were done is there."""
