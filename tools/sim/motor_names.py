"""Motors of a board file: their axes and their names."""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

AXIS_LETTERS = "XYZABC"


def letters(board: "Any") -> str:
    """Return the axis letter of each motor: XYZY."""
    return getattr(board, "MOTORS", "") or AXIS_LETTERS[: len(board.STEP)]


def count_axes(of_motors: str) -> int:
    """Return the number of axes; the first motors are those of the axes."""
    return len(set(of_motors))


def axes_of(board: "Any") -> int:
    """Return the number of axes of a board file."""
    return count_axes(letters(board))


def names(of_motors: str) -> "tuple[str, ...]":
    """Return the names of motors: X, Y, Z and, for a second motor, Y2."""
    axes = count_axes(of_motors)
    return tuple([letter if i < axes else letter + "2" for i, letter in enumerate(of_motors)])


def shared(board: "Any") -> str:
    """Return the axes whose motors also move others: XY of a CoreXY; "" if there are none."""
    if getattr(board, "COREXY", False):
        return "XY"
    # By motor, the axes that it moves, without a sign: X+Z. A motor of one axis has only X.
    moved = [word.strip("+-") for word in getattr(board, "MOVES", ())]
    pairs = zip(AXIS_LETTERS, moved)
    return "".join([letter for letter, axes in pairs if axes != letter])
