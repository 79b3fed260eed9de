"""Motors of a board file: which axis each goes with, and what it is called."""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

AXIS_LETTERS = "XYZABC"


def letters(board: "Any") -> str:
    """The axis of each motor: XYZY."""
    return getattr(board, "MOTORS", "") or AXIS_LETTERS[: len(board.STEP)]


def count_axes(of_motors: str) -> int:
    """How many axes these are; their motors come first."""
    return len(set(of_motors))


def axes_of(board: "Any") -> int:
    """The same of a board file."""
    return count_axes(letters(board))


def names(of_motors: str) -> "tuple[str, ...]":
    """X, Y, Z and, of a second motor, Y2."""
    axes = count_axes(of_motors)
    return tuple([letter if i < axes else letter + "2" for i, letter in enumerate(of_motors)])


def shared(board: "Any") -> str:
    """Axes whose motors move others, too: XY of a CoreXY."""
    if getattr(board, "COREXY", False):
        return "XY"
    words = [word.strip("+-") for word in getattr(board, "MOVES", ())]
    return "".join([a for i, a in enumerate(AXIS_LETTERS) if i < len(words) and words[i] != a])
