"""Drilling cycles: G73, G81, G82, G83, G85, G89 with G98 and G99, as NIST RS274NGC defines them.

A line with a cycle becomes lines of Grbl's own words, which are checked and executed as if they
had been sent. R, Z, Q and P hold for the following lines, until another motion or cycle, or G80.
They also end with a change of plane, units or distance mode, because they would mean something
else there. In G91, R is relative to the tool's position when the first cycle began, and Z is
relative to R. After G80 the motion mode from before the cycle is active again. Source: NISTIR
6556, 3.5.16; G73, and the retract of G83 to R, are LinuxCNC's.
"""

from base import errors
from base.errors import GrblError
from control.modes import INCHES, INVERSE_TIME, MOTION, PLANE, RELATIVE, SYSTEM
from language import block_layout as b
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from typing import Any

    from talk.controller import Controller

    # Letter, number as it is written, and of a G or M word that number in tenths (else -1).
    Word = tuple[str, str, int]

_PLANES = ((0, 1), (2, 0), (1, 2))  # by modal plane: the axes of G17, G18, G19
_G73 = const(730)
_G83 = const(830)
_G85 = const(850)
_G89 = const(890)
# By number in tenths: required letters in addition to R and Z, and optional ones.
CYCLES = {
    _G73: ("Q", "P"),
    810: ("", ""),
    820: ("P", ""),
    _G83: ("Q", "P"),
    _G85: ("", ""),
    _G89: ("P", ""),
}
MOTIONS = (0, 10, 20, 30, 382, 383, 384, 385)  # G words in tenths: G0 to G3, G38.2 to G38.5
# G words in tenths whose axis words do not ask for a hole; G80 is one of them.
_USE_AXIS_WORDS = MOTIONS + (100, 280, 281, 300, 301, 431, 530, 800, 920, 921)
_AXIS_LETTERS = "XYZ"
_CYCLE_LETTERS = "XYZRQPL"
# A rapid back into the hole stops this far above the last depth, and G73 retracts by it.
_GAP_MM = 0.254
_GAP_INCH = 0.01
_MM_PER_INCH = 25.4
_ABSOLUTE = const(0)  # instead of the number of a hole: G90
_LEAST_Q = 0.001  # mm or inches
# Attributes of Drilling that hold for the next line.
_KEPT = ("cycle", "ends_at_r", "_kept", "_kept_for", "_start_mm", "_motion_before", "_open_before")
_MOST_TIMES = const(65535)  # L
_THINNEST_PECK = 0.0001  # mm or inches: a thinner last one is drilled with the one above it


def has(words: "list[Word]", letter: str, *tenths: int) -> bool:
    """Return whether one of these words is there: `letter`, G or M, with one of these numbers in
    tenths; without numbers, whether the letter is there."""
    for word in words:
        if word[0] == letter and (not tenths or word[2] in tenths):
            return True
    return False


def joined(words: "list[Word]") -> str:
    """Return the words as the text of a line."""
    return "".join([letter + number for letter, number, _ in words])


class Holes:
    """What a line of a cycle asks for, in the program's units. Drilling.plan() sets it.

    Numbers stay text, as the program has them. cycle: its number in tenths. kept: numbers by
    letter. letter: of the drilling axis; position: where that is now. ends_at_r: G99. r, bottom,
    end: the heights of R, of the hole's bottom, and where a hole ends. hole_words: of each hole
    its axis words in the plane, "" to drill where the tool is. gap: how far above the last depth
    a rapid back into the hole stops.
    """

    cycle: int
    kept: "dict[str, str]"  # letters and numbers that hold for the next lines, too
    ends_at_r: bool
    other_words: str  # the line without the words of the cycle
    cycle_words: "list[Word]"  # of the line
    kept_for: "tuple[int, int, int]"  # axis, inches, relative: the kept numbers depend on them
    letter: str  # of the drilling axis
    position: float  # present position of that axis
    start_mm: float  # its position when the first cycle began, in machine coordinates
    r: str
    bottom: str
    end: str  # where a hole ends: at R or the initial height
    gap: float
    hole_words: "Iterator[str]"

    def lines(self) -> "Iterator[str]":
        """Yield the lines for all holes, one hole after the other: up to R if the tool is below,
        across, to R, then the hole."""
        go_to_r = "G0" + self.letter + self.r
        height = self.position  # of the tool, from here on
        if height < float(self.r):
            yield go_to_r
            height = float(self.r)
        for axis_words in self.hole_words:
            if axis_words:
                yield "G0" + axis_words
            if height != float(self.r):
                yield go_to_r
            yield from self._hole()
            height = float(self.end)

    def _hole(self) -> "Iterator[str]":
        """Yield the lines of one hole, from R down to the bottom and up to where it ends."""
        feed, rapid = "G1" + self.letter, "G0" + self.letter
        if self.cycle in (_G73, _G83):
            yield from self._pecks(feed, rapid)
        yield feed + self.bottom
        if "P" in self.kept:
            yield "G4P" + self.kept["P"]
        back = feed if self.cycle in (_G85, _G89) else rapid
        yield back + self.end

    def _pecks(self, feed: str, rapid: str) -> "Iterator[str]":
        """Yield the pecks to all depths except the last, each with its retract to clear chips: to
        R with G83, by `gap` with G73.

        feed, rapid: a move's words up to its number. Q is the depth of one peck.
        """
        top, bottom, peck = float(self.r), float(self.bottom), float(self.kept["Q"])
        count = 1
        height = top - peck  # of the first peck's end
        while height - bottom > _THINNEST_PECK:
            yield feed + _text(height)
            if self.cycle == _G83:
                yield rapid + self.r  # and back into the hole:
            yield rapid + _text(min(top, height + self.gap))
            count += 1
            height = top - count * peck


class Drilling:
    """State of the drilling cycles. cycle: the active one in tenths, or 0. ends_at_r: G99 holds.

    run executes a line. check refuses a line, or leaves it in the interpreter's block. _holes: the
    result of the last plan(). _kept: numbers by letter that hold for the next line of the cycle.
    _motion_before, _open_before: the motion mode and the interpreter's is_open (kernels may
    execute lines) before the cycle. _start_mm: the drilling axis then, in machine coordinates.
    _kept_for: the drilling axis, inches and relative of the last line, on which _kept depends.
    """

    def __init__(
        self, machine: "Controller", run: "Callable[[str], None]", check: "Callable[[str], None]"
    ) -> None:
        self._machine = machine
        self._run = run
        self._check = check
        self._holes = Holes()
        self.cycle = 0
        self._motion_before = 0
        self._start_mm = 0.0
        self._kept_for = (0, 0, 0)
        self._open_before = True
        self.forget()

    def forget(self) -> None:
        """Forget the cycle and G99, as after a reset."""
        self.ends_at_r = False
        self.stop(False)

    @property
    def kept(self) -> "list[Any]":
        """All that holds for the next line; may be set, to undo what lines have changed."""
        return [getattr(self, name) for name in _KEPT] + [self._machine.interpreter.is_open]

    @kept.setter
    def kept(self, values: "list[Any]") -> None:
        for name, value in zip(_KEPT, values):
            setattr(self, name, value)
        self._machine.interpreter.is_open = values[-1]

    def repeats(self, words: "list[Word]") -> bool:
        """Return whether a line with these words repeats the active cycle at a new position: it
        has axis words, and no G word that uses them otherwise."""
        if not self.cycle or has(words, "G", *_USE_AXIS_WORDS) or has(words, "G", *CYCLES):
            return False
        return any(has(words, letter) for letter in _AXIS_LETTERS)

    def stop(self, with_motion: bool) -> None:
        """End the cycle, if there is one. with_motion: restore the motion mode from before it."""
        interpreter = self._machine.interpreter
        if self.cycle:
            interpreter.is_open = self._open_before
            if with_motion:
                self._machine.modes.modal[MOTION] = self._motion_before
        self.cycle = 0
        self._kept: "dict[str, str]" = {}

    def execute(self, holes: Holes) -> None:
        """Execute what plan() has prepared: first the line's other words, then all holes. holes:
        its result. GrblError if a line is refused, Abort after a reset."""
        interpreter, modes = self._machine.interpreter, self._machine.modes
        modal = modes.modal
        position_before = list(modes.position)
        self._run(holes.other_words)
        if list(modes.position) != position_before:  # a handler of another extra has moved
            self.plan(holes.cycle_words, holes.ends_at_r)  # again, into the same `holes`
        if not self.cycle:
            self._motion_before = modal[MOTION]
            self._open_before = interpreter.is_open
            interpreter.is_open = False  # in a cycle a line of axis words only is no move
        self.cycle, self._kept, self.ends_at_r = holes.cycle, holes.kept, holes.ends_at_r
        self._start_mm, self._kept_for = holes.start_mm, holes.kept_for
        relative_before = modal[RELATIVE]
        modal[RELATIVE] = 0  # the lines of holes are absolute
        try:
            for line in holes.lines():
                self._machine.protocol.service()
                try:
                    self._run(line)
                except GrblError:  # out of a kinematics' reach: others were checked by plan()
                    self._machine.canon.stop_with_alarm(errors.ALARM_SOFT_LIMIT)  # raises Abort
        finally:
            modal[RELATIVE] = relative_before

    # Checks

    def plan(self, words: "list[Word]", ends_at_r: bool) -> Holes:
        """Check a line of a cycle and prepare its holes. words: the line's; ends_at_r: G99 holds
        for it. GrblError if it is wrong. The state of the active cycle does not change."""
        holes = self._holes
        holes.ends_at_r = ends_at_r
        holes.cycle, given, others = self._split(words)
        holes.other_words = joined(others)
        holes.cycle_words = [word for word in words if word not in others]
        self._check(holes.other_words)
        self._check_other_words()
        ints = self._machine.interpreter.block.ints  # the line just checked
        plane_axes = _PLANES[ints[PLANE]]
        drill_axis = 0 + 1 + 2 - sum(plane_axes)  # the one that is not in the plane
        holes.letter = _AXIS_LETTERS[drill_axis]
        holes.kept_for = drill_axis, ints[INCHES], ints[RELATIVE]
        is_repeated = holes.cycle == self.cycle and holes.kept_for == self._kept_for
        holes.kept = dict(self._kept) if is_repeated else {}
        for letter in "RQP" + holes.letter:
            if letter in given:
                holes.kept[letter] = given[letter]
        _check_numbers(holes, given)
        self._set_heights(holes, drill_axis)
        in_plane = []
        for axis in plane_axes:
            if _AXIS_LETTERS[axis] in given:
                in_plane.append((given[_AXIS_LETTERS[axis]], self._position(axis), axis))
        times = int(float(given.get("L", "1")))
        holes.hole_words = self._words_of_holes(in_plane, times)
        # A machine may lack the axis (XYUV). Last, because this replaces the checked line.
        self._check("G92" + holes.letter + "0")
        return holes

    def _split(self, words: "list[Word]") -> "tuple[int, dict[str, str], list[Word]]":
        """Return three things: the cycle that the line names, in tenths, or else the active one;
        its numbers by letter (_CYCLE_LETTERS); all other words. GrblError if the line names two
        cycles, repeats a letter or has no axis word.
        """
        cycle = self.cycle
        is_named = False
        given: "dict[str, str]" = {}
        others = []
        for word in words:
            letter, number, tenths = word
            if letter == "G" and tenths in CYCLES:
                if is_named:
                    raise GrblError(errors.GCODE_MODAL_GROUP_VIOLATION)
                cycle, is_named = tenths, True
            elif letter not in _CYCLE_LETTERS:
                others.append(word)
            elif letter in given:
                raise GrblError(errors.GCODE_WORD_REPEATED)
            else:
                given[letter] = number
        if not any(letter in given for letter in _AXIS_LETTERS):
            raise GrblError(errors.GCODE_NO_AXIS_WORDS)
        return cycle, given, others

    def _check_other_words(self) -> None:
        """Check the interpreter's block, which has the line without the words of the cycle: no
        word moves, uses axis words or ends the program, and there is a feed rate in mm/min."""
        block = self._machine.interpreter.block
        if block.ints[b.COMMANDS] & (b.GROUP_0 | b.GROUP_1 | b.GROUP_M4):
            raise GrblError(errors.GCODE_MODAL_GROUP_VIOLATION)
        if block.ints[b.AXIS_USE]:
            raise GrblError(errors.GCODE_AXIS_COMMAND_CONFLICT)
        if block.ints[INVERSE_TIME] or not block.singles[b.F]:
            raise GrblError(errors.GCODE_UNDEFINED_FEED_RATE)

    def _set_heights(self, holes: Holes, axis: int) -> None:
        """Compute the bottom of the holes, R and the height at which each ends. GrblError if the
        bottom is above R.

        axis: the drilling axis. In G91, R is relative to where the cycle began, and the bottom to
        R.
        """
        ints = self._machine.interpreter.block.ints
        holes.gap = _GAP_INCH if ints[INCHES] else _GAP_MM
        has_begun = self.cycle and axis == self._kept_for[0]
        holes.start_mm = self._start_mm if has_begun else self._machine.modes.position[axis]
        holes.position = self._position(axis)
        start = self._in_program_units(axis, holes.start_mm)  # the initial height
        holes.r, holes.bottom = holes.kept["R"], holes.kept[holes.letter]
        if ints[RELATIVE]:
            holes.r = _text(start + float(holes.r))
            holes.bottom = _text(float(holes.r) + float(holes.bottom))
        if float(holes.bottom) > float(holes.r):
            raise GrblError(errors.GCODE_INVALID_TARGET)
        holes.end = holes.r if holes.ends_at_r or start <= float(holes.r) else _text(start)

    def _words_of_holes(
        self, in_plane: "list[tuple[str, float, int]]", times: int
    ) -> "Iterator[str]":
        """Return the axis words of each of so many holes, made when they are drilled.

        in_plane: of each axis with a word, its number as written, its position, and its index. In
        G91 each hole is that far from the one before; in G90 all are at the same place.
        """
        if self._machine.interpreter.block.ints[RELATIVE]:
            return (_axis_words(in_plane, hole) for hole in range(1, times + 1))
        return (_axis_words(in_plane, _ABSOLUTE) for _ in range(times))

    def _position(self, axis: int) -> float:
        """Return an axis's position in the units and work coordinates of the checked line."""
        return self._in_program_units(axis, self._machine.modes.position[axis])

    def _in_program_units(self, axis: int, mm: float) -> float:
        """Convert a position on an axis from machine coordinates to the units and work coordinates
        of the checked line."""
        coords, ints = self._machine.coords, self._machine.interpreter.block.ints
        mm -= coords.work_zero(ints[SYSTEM], axis)
        return mm / _MM_PER_INCH if ints[INCHES] else mm


def _axis_words(in_plane: "list[tuple[str, float, int]]", hole: int) -> str:
    """Return the axis words of a hole. in_plane: see Drilling._words_of_holes().

    hole: _ABSOLUTE if it is at the numbers (G90); in G91 its number, 1 for the first: it is so
    many times the numbers away from the position.
    """
    words = ""
    for number, position, axis in in_plane:
        end = number if hole == _ABSOLUTE else _text(position + hole * float(number))
        words += _AXIS_LETTERS[axis] + end
    return words


def _check_numbers(holes: Holes, given: "dict[str, str]") -> None:
    """Raise GrblError if a number of the cycle is missing or wrong. given: those on the line."""
    needed, optional = CYCLES[holes.cycle]
    kept = holes.kept
    for letter in "R" + holes.letter + needed:
        if letter not in kept:
            raise GrblError(errors.GCODE_VALUE_WORD_MISSING)
    for letter in "QP":
        if letter in given and letter not in needed + optional:
            raise GrblError(errors.GCODE_UNUSED_WORDS)
    times = float(given.get("L", "1"))
    if times > _MOST_TIMES:
        raise GrblError(errors.GCODE_MAX_VALUE_EXCEEDED)
    if times != int(times):
        raise GrblError(errors.GCODE_COMMAND_VALUE_NOT_INTEGER)
    if times < 1 or float(kept.get("Q", "1")) < _LEAST_Q or float(kept.get("P", "0")) < 0:
        raise GrblError(errors.NEGATIVE_VALUE)


def _text(number: float) -> str:
    """Return a coordinate as text for a line, rounded to 1/100000 mm or inch."""
    return ("%.5f" % number).rstrip("0")
