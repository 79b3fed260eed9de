"""Handlers: what custom.py imports as ugrbl, decorators that note its functions down.

    from ugrbl import mcode, gcode, on, every

    @mcode(100, "Pq")
    def vacuum(m, P, Q=0): ...

extras/custom/user_modules.py registers the notes when the file has been read.
"""

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    Function = Callable[..., Any]
    # Kind, key within that kind, the letters of a word, whether it waits for motion (see mcode).
    Note = tuple[str, Any, str, bool | None, Function]

# Kinds of notes that are not events.
M = "M"
G = "G"
EVERY = "every"
INPUT = "input"
REPORT = "report"

# Events whose handlers may move the machine. They run when motion has ended.
MOVING = (
    "startup",
    "after_homing",
    "after_reset",
    "after_unlock",
    "tool_select",
    "tool_change",
    "probe_done",
    "spindle",
    "coolant",
    "program_paused",
    "program_done",
)
# Handlers of these run during motion.
DURING_MOTION = ("state_change", "alarm")

_notes: "list[Note]" = []


class Refused(Exception):
    """m.g() was given a line that Grbl refuses. number: Grbl's error number."""

    def __init__(self, number: int, line: str) -> None:
        super().__init__("refused with %d: %s" % (number, line))
        self.number = number


class Refuse(Exception):
    """A handler raises it to refuse its own line. The sender gets the text and error:3."""


def _note(
    kind: str, key: "Any", letters: str, sync: "bool | None"
) -> "Callable[[Function], Function]":
    """Return a decorator that notes its function, and leaves it as it is.

    kind: M, G, EVERY, INPUT or an event's name; key: the number of the word, milliseconds, or a
    name; letters: of a word's parameters, "" for an event; sync: see mcode().
    """
    if sync is not True and sync is not False and sync is not None:  # refuses 0 and 1, too
        raise TypeError("sync must be True, False or None, not %r" % (sync,))

    def note(function: "Function") -> "Function":
        """Note the function, and return it."""
        _notes.append((kind, key, letters, sync, function))
        return function

    return note


def _refuse_bare(argument: "Any", example: str) -> None:
    """Raise TypeError for a decorator without parentheses, because its function would be lost.

    Python then passes the function as the decorator's first argument. example: correct use.
    """
    if callable(argument):
        raise TypeError("write @" + example)


def mcode(
    number: int,
    letters: str = "",
    sync: "bool | None" = True,
) -> "Callable[[Function], Function]":
    """Define an M word. letters: its parameters; upper case is required, lower case optional.

    sync: True runs the handler when motion has ended. False runs it when the blocks planned before
    it have been executed, while motion goes on. None runs it when its line is read, ahead of
    motion: for words that become other G-code, because the lines of its m.g() are planned with the
    rest.
    """
    _refuse_bare(number, "mcode(100)")
    return _note(M, number, letters, sync)


def gcode(
    number: "float | str",
    letters: str = "",
    sync: "bool | None" = True,
) -> "Callable[[Function], Function]":
    """Define a G word. number: 81, 81.1, or with an L that Grbl does not use, "10 L1"; letters and
    sync: as for mcode()."""
    _refuse_bare(number, "gcode(101)")
    return _note(G, number, letters, sync)


def every(ms: int) -> "Callable[[Function], Function]":
    """Call a function repeatedly, at most once in so many milliseconds. ValueError below 1."""
    _refuse_bare(ms, "every(50)")
    if ms < 1:
        raise ValueError("every: %r is not a number of milliseconds" % ms)
    return _note(EVERY, ms, "", False)


class On:
    """Events: on.tool_change and all of MOVING and DURING_MOTION, on.report, on.input(name)."""

    def __getattr__(self, name: str) -> "Callable[[Function], Function]":
        """Return the decorator of an event. AttributeError if there is none of that name. Python
        calls this for on.NAME if NAME is not `input`."""
        if name not in MOVING and name not in DURING_MOTION and name != REPORT:
            raise AttributeError("there is no event on.%s" % name)
        waits_for_motion = name in MOVING
        return _note(name, name, "", waits_for_motion)

    def input(self, name: str) -> "Callable[[Function], Function]":
        """Handle a change of the input that the board file calls `name`."""
        _refuse_bare(name, 'on.input("name")')
        return _note(INPUT, name, "", False)


on = On()


class Api:
    """The object that custom.py imports as ugrbl: these names only."""

    def __init__(self) -> None:
        self.mcode = mcode
        self.gcode = gcode
        self.every = every
        self.on = on
        self.Machine = object  # for editors, which have a stub: def vacuum(m: Machine, P): ...
        self.Refused = Refused  # raised by m.g() and others
        self.Refuse = Refuse  # for handlers to raise


api = Api()


def take_notes() -> "list[Note]":
    """Return the notes and forget them."""
    noted = _notes[:]
    _notes.clear()
    return noted
