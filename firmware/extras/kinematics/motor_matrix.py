"""Motor matrix: motors that move axes together, MOVES = ("X+Z", "Y", "X-Z") in the board file, a
CoreXZ.

Each word is a motor's, in the order of STEP: X+Z makes the steps of X and of Z, X-Z those of X
less those of Z. Axes behind the last word have a motor each.
"""

from base.axes import LETTERS
from micropython import const
from motion.kinematics import Kinematics
from motion.layout import REVERSE

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import ModuleType

    from interfaces import Options

    from extras.api import Cnc


def parse_words(words: "Sequence[str]", axes: int) -> "list[int]":
    """What each motor does, as in motion/kinematics.py. ValueError where a word is none, or where
    motors do not tell where each axis is."""
    if len(words) > axes:
        raise ValueError("MOVES has %d words, and there are %d axes" % (len(words), axes))
    moves = [_motor(word, axes) for word in words] + [1 << i for i in range(len(words), axes)]
    for axis in range(axes):
        for other in range(axis + 1):
            together = sum([_sign(motor, axis) * _sign(motor, other) for motor in moves])
            if axis == other and not together:
                raise ValueError("MOVES: no motor moves %s" % LETTERS[axis])
            if axis != other and together:
                pair = LETTERS[other], LETTERS[axis]
                raise ValueError("MOVES: %s and %s cannot move alone" % pair)
    return moves


def _motor(word: str, axes: int) -> int:
    """The number of a motor's word."""
    moves = 0
    shift = 0
    for sign in word:
        axis = LETTERS[:axes].find(sign)
        if sign in "+-":
            shift = REVERSE if sign == "-" else 0
        elif axis < 0 or (moves | moves >> REVERSE) >> axis & 1:
            raise ValueError("MOVES: %s in %s is no axis, or there twice" % (sign, word))
        else:
            moves |= 1 << axis + shift
            shift = 0
    return moves


def _sign(moves: int, axis: int) -> int:
    """Which way a motor goes for an axis; 0: it stays."""
    return (moves >> axis & 1) - (moves >> axis + REVERSE & 1)


def prepare(options: "Options", board: "ModuleType") -> None:
    """Give the planner its table. ValueError where that cannot be."""
    if options.kinematics:
        raise ValueError("MOVES says what COREXY does: write one of them")
    letters: str = board.__dict__.get("MOTORS", "")
    axes = len(set(letters)) or options.axes
    options.kinematics = Kinematics(axes, parse_words(board.__dict__["MOVES"], axes))


def install(cnc: "Cnc") -> None:
    """The table is all."""
