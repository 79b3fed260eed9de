"""Motor matrix: motors that move several axes, MOVES = ("X+Z", "Y", "X-Z") in the board file.

The example is a CoreXZ. The words belong to the motors in the order of STEP. The motor X+Z makes
the sum of the steps of X and Z, X-Z their difference. Axes after the last word have a motor each.
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
    """Return for each motor a mask of the axes that move it, as in motion/kinematics.py: bit i if
    axis i turns it forwards, bit i + REVERSE if backwards.

    words: those of MOVES; axes: how many there are. ValueError if a word is wrong, or if the axes'
    positions do not follow from the motors'.
    """
    if len(words) > axes:
        raise ValueError("MOVES has %d entries, but there are %d axes" % (len(words), axes))
    moves = [_motor(word, axes) for word in words] + [1 << i for i in range(len(words), axes)]
    # The columns of the matrix, one per axis, must be orthogonal: then its transpose inverts it.
    for axis in range(axes):
        for other in range(axis + 1):
            product_of_columns = sum([_sign(motor, axis) * _sign(motor, other) for motor in moves])
            if axis == other and not product_of_columns:
                raise ValueError("MOVES: no motor moves %s" % LETTERS[axis])
            if axis != other and product_of_columns:
                pair = LETTERS[other], LETTERS[axis]
                raise ValueError("MOVES: %s and %s cannot be moved independently" % pair)
    return moves


def _motor(word: str, axes: int) -> int:
    """Return a motor's mask for its word, such as X-Z: bit i for +axis i, bit i + REVERSE for
    -axis i. ValueError if the word is wrong."""
    moves = 0
    shift = 0  # added to the next axis' bit number: REVERSE after a minus sign
    for character in word:
        axis = LETTERS[:axes].find(character)  # -1: no axis, or a sign
        if character in "+-":
            shift = REVERSE if character == "-" else 0
        elif axis < 0 or _sign(moves, axis):
            raise ValueError(
                "MOVES: %s in %s is not an axis, or is listed twice" % (character, word)
            )
        else:
            moves |= 1 << axis + shift
            shift = 0
    return moves


def _sign(moves: int, axis: int) -> int:
    """Return the direction in which a motor turns for an axis: 1, -1, or 0 for not at all.

    moves: the motor's mask, as _motor() returns it.
    """
    return (moves >> axis & 1) - (moves >> axis + REVERSE & 1)


def prepare(options: "Options", board: "ModuleType") -> None:
    """Create the kinematics. ValueError if the board file is wrong."""
    if options.kinematics:
        raise ValueError("MOVES and COREXY exclude each other: use one")
    letters: str = board.__dict__.get("MOTORS", "")
    axes = len(set(letters)) or options.axes  # MOTORS repeats a letter for a second motor
    options.kinematics = Kinematics(axes, parse_words(board.__dict__["MOVES"], axes))


def install(cnc: "Cnc") -> None:
    """Do nothing: prepare() has done all."""
