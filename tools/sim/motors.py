"""Motors of a board file: which axis each goes with, and what it is called."""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_LETTERS = "XYZABC"


def letters(board: "Any") -> str:
    """The axis of each motor: XYZY."""
    return getattr(board, "MOTORS", "") or _LETTERS[: len(board.STEP)]


def axes(board: "Any") -> int:
    """How many axes there are; their motors come first."""
    return len(set(letters(board)))


def names(board: "Any") -> "tuple[str, ...]":
    """X, Y, Z and, of a second motor, Y2."""
    found = letters(board)
    count = axes(board)
    return tuple([found[i] if i < count else found[i] + "2" for i in range(len(found))])
