"""Handlers: what custom.py imports by the name of ugrbl, decorators that note its functions down.

    from ugrbl import mcode, gcode, on, every

    @mcode(100, "Pq")
    def vacuum(m, P, Q=0): ...

What is noted is for extras/custom/user_modules.py, which takes it up when the file has been read.
"""

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    Function = Callable[..., Any]
    # Kind, what of that kind, the letters of a word, whether it waits for motion (see mcode).
    Note = tuple[str, Any, str, bool | None, Function]

# Kinds of notes that are no events.
M = "M"
G = "G"
EVERY = "every"
INPUT = "input"
REPORT = "report"

# Events whose handlers may move the machine: they run where motion has come to its end.
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
# The others run beside motion.
DURING_MOTION = ("state_change", "alarm")

_notes: "list[Note]" = []


class Refused(Exception):
    """A line of G-code that m.g() was given is refused. number: what Grbl's answer would be."""

    def __init__(self, number: int, line: str) -> None:
        super().__init__("refused with %d: %s" % (number, line))
        self.number = number


class Refuse(Exception):
    """Raised by a handler: its own line is not to be; the sender is told the text, and refused."""


def _note(
    kind: str, key: "Any", letters: str, sync: "bool | None"
) -> "Callable[[Function], Function]":
    if sync is not True and sync is not False and sync is not None:
        raise TypeError("sync is True, False or None, not %r" % (sync,))

    def note(function: "Function") -> "Function":
        _notes.append((kind, key, letters, sync, function))
        return function

    return note


def _refuse_bare(argument: "Any", example: str) -> None:
    """A decorator without parentheses gets the function, which would vanish."""
    if callable(argument):
        raise TypeError("write @" + example)


def mcode(
    number: int,
    letters: str = "",
    sync: "bool | None" = True,
) -> "Callable[[Function], Function]":
    """An M word. letters: its parameters by name; upper case has to be there, lower case may be.
    sync: the handler runs when motion has come to its end; False: when the blocks planned before
    it have, and motion goes on; None: as its line is read, ahead of motion, for words that become
    other G-code: what it has m.g() plan joins what is planned."""
    _refuse_bare(number, "mcode(100)")
    return _note(M, number, letters, sync)


def gcode(
    number: "float | str",
    letters: str = "",
    sync: "bool | None" = True,
) -> "Callable[[Function], Function]":
    """The same for a G word: 81, 81.1, or with an L that Grbl has no use for, "10 L1"."""
    _refuse_bare(number, "gcode(101)")
    return _note(G, number, letters, sync)


def every(ms: int) -> "Callable[[Function], Function]":
    """Called again and again, not more often than once in so many milliseconds."""
    _refuse_bare(ms, "every(50)")
    if ms < 1:
        raise ValueError("every: %r is no number of milliseconds" % ms)
    return _note(EVERY, ms, "", False)


class On:
    """Events: on.tool_change and the others of MOVING and DURING_MOTION; on.report;
    on.input(name)."""

    def __getattr__(self, name: str) -> "Callable[[Function], Function]":
        if name not in MOVING and name not in DURING_MOTION and name != REPORT:
            raise AttributeError("there is no event on.%s" % name)
        return _note(name, name, "", name in MOVING)

    def input(self, name: str) -> "Callable[[Function], Function]":
        """The input that the board file calls so has changed."""
        _refuse_bare(name, 'on.input("name")')
        return _note(INPUT, name, "", False)


on = On()


class Api:
    """What custom.py imports from: an object with these names, and no others."""

    def __init__(self) -> None:
        self.mcode = mcode
        self.gcode = gcode
        self.every = every
        self.on = on
        self.Refused = Refused
        self.Refuse = Refuse


api = Api()


def take_notes() -> "list[Note]":
    """What has been noted; it is not any more."""
    noted = _notes[:]
    _notes.clear()
    return noted
