"""Cycles: motion modes of extras whose lines are several moves each (NIST RS274NGC 3.5.16)."""

from base import errors
from base.axes import Z
from base.errors import GrblError
from control.modes import INCHES, INVERSE_TIME, MOTION, PLANE, RELATIVE, SYSTEM
from language import block_layout as b
from micropython import const
from motion import layout

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from language.block import Block
    from motion.planner import Move
    from talk.controller import Controller

    # The target, in mm of machine coordinates, and whether the move is a rapid.
    Step = tuple[list[float], bool]

# The bit of a letter in the block's words, and the index of its number.
_LETTERS = {
    "I": (b.WORD_I, b.I),
    "J": (b.WORD_I << 1, b.I + 1),
    "K": (b.WORD_I << 2, b.I + 2),
    "L": (b.WORD_L, b.L),
    "P": (b.WORD_P, b.P),
    "R": (b.WORD_R, b.R),
}


class Cycle:
    """A cycle in the XY plane, with absolute coordinates (G90). plan, letters: see
    Cnc.add_cycle(). kept: the last line's numbers, which hold for the next one: that of Z first,
    then those of letters, None for one that has not been given; [] before the first line.
    _numbers: in the same order, those of the line checked last; moves: its moves. _allowed_words:
    mask of the words that a line may have, bits as in the block's words (b.WORDS)."""

    def __init__(
        self, machine: "Controller", plan: "Callable[..., Iterable[Step]]", letters: str
    ) -> None:
        self._modes, self._coords, self._canon = machine.modes, machine.coords, machine.canon
        self._plan = plan
        self._letters = letters
        self._allowed_words = 0
        for letter in letters.upper():
            bit, _ = _LETTERS[letter]
            self._allowed_words |= bit
        self.kept: "list[float | None]" = []
        self._numbers: "list[float | None]" = []
        self.moves: "Iterable[Step]" = ()

    def check(self, block: "Block") -> None:
        """Refuse a wrong line by GrblError, or compute its moves. The machine does not change.
        block: the line's modes (ints), axis targets in mm (xyz) and numbers (singles)."""
        ints, modes = block.ints, self._modes
        if ints[PLANE] or ints[RELATIVE] or ints[INVERSE_TIME]:  # not G17 with G90 and G94
            raise GrblError(errors.GCODE_UNSUPPORTED_COMMAND)
        if ints[b.WORDS] & b.MOTION_WORDS & ~self._allowed_words:
            raise GrblError(errors.GCODE_UNUSED_WORDS)
        kept: "list[float | None]" = [None] * (1 + len(self._letters))
        if self.kept and modes.modal[MOTION] == ints[MOTION]:  # the cycle goes on
            kept = self.kept
        has_z = (ints[b.WORDS] >> Z) & 1  # the lowest bits are those of the axes
        depth = block.xyz[Z] if has_z else kept[0]  # mm, machine coordinates
        numbers = [depth]
        for i, letter in enumerate(self._letters):
            number = self._number_of(block, letter.upper())
            numbers.append(kept[1 + i] if number is None else number)  # kept[0] is Z
        for letter, number in zip("Z" + self._letters, numbers):
            if number is None and letter.isupper():  # lower-case ones are optional
                raise GrblError(errors.GCODE_VALUE_WORD_MISSING)
        target = list(block.xyz)
        target[Z] = depth  # type: ignore[assignment]  # not None, which was refused above
        self.moves = self._plan(list(modes.position), target, *numbers[1:])
        self._numbers = numbers

    def _number_of(self, block: "Block", letter: str) -> "float | None":
        """Return a letter's number, or None if the line does not have it: lengths in mm, R as a
        height in machine coordinates, L and P as written."""
        bit, index = _LETTERS[letter]
        if not block.ints[b.WORDS] & bit:
            return None
        number = block.singles[index]
        if block.ints[INCHES] and letter not in "LP":
            number *= block.singles[b.INCH_MM]
        if letter == "R":
            number += self._coords.work_zero(block.ints[SYSTEM], Z)
        return number

    def make(self, block: "Block", move: "Move") -> None:
        """Plan the moves that check() has computed: rapids, or with the line's feed.

        move: the line's, of which only the rapid flag changes from move to move.
        """
        self.kept = self._numbers
        xyz = block.xyz  # becomes each target in turn
        for target, is_rapid in self.moves:
            for axis in range(block.axes):
                xyz[axis] = target[axis]
            move.flags &= ~layout.RAPID_MOTION
            if is_rapid:
                move.flags |= layout.RAPID_MOTION
            self._canon.line(xyz, move)
            self._canon.finish()  # plan it now: line() only requests it
            self._modes.position[:] = xyz
