"""Where our replies differ from real Grbl's on purpose: the whole list.

A row rewrites our line to Grbl's if, and only if, the difference is the one it
names. Whatever is not in this table has to be equal.
"""

import re
from collections.abc import Callable
from typing import NamedTuple


class Difference(NamedTuple):
    """One difference: rewrite(ours, grbls, sent) gives the line Grbl would have sent."""

    name: str
    reason: str
    rewrite: Callable[[str, str, str], str]


_VERSION = re.compile(r"\[VER:1\.1h\.\d{8}:(.*)\]")
_OPTIONS = re.compile(r"\[OPT:([^,]*)(,\d+,\d+)\]")


def _version(ours: str, grbls: str, _sent: str) -> str:
    mine, theirs = _VERSION.fullmatch(ours), _VERSION.fullmatch(grbls)
    return grbls if mine and theirs and theirs[1] in mine[1] else ours


def _options(ours: str, grbls: str, _sent: str) -> str:
    mine, theirs = _OPTIONS.fullmatch(ours), _OPTIONS.fullmatch(grbls)
    same = mine and theirs and mine[2] == theirs[2] and set(theirs[1]) <= set(mine[1])
    return grbls if same else ours


def _homing(ours: str, grbls: str, sent: str) -> str:
    stuck = sent.startswith("$H") and sent != "$H\n" and grbls == "error:8"
    return grbls if stuck and ours == "error:3" else ours


class Quirk(NamedTuple):
    """A recorded case in which Grbl does what nobody wants; only cases tagged `quirk` count."""

    name: str
    reason: str
    case: str


QUIRKS = (
    Quirk(
        "refused homing",
        "$HX is refused with error:3 and leaves the machine as it was; Grbl sticks in Home, "
        "takes moves and never makes them.",
        "$H with an argument leaves the machine in Home state",
    ),
)

# Differences in motion; compare.py knows how to see them.
IDLE_DELAY = (
    "idle delay",
    "Motors are released $1 after motion without stopping the processor for that time; "
    "the enable pin may change one step of a case later.",
)
EXACT_STOP = (
    "exact stop",
    "Where a hold, a jog cancel or a probe's contact comes to rest exactly on a whole step, "
    "Grbl's single-precision distance falls on either side of it: one step of difference.",
)

DIFFERENCES = (
    Difference(
        "version",
        "[VER:] names our own build date and may say who we are before the user's $I= text.",
        _version,
    ),
    Difference(
        "options",
        "[OPT:] may list letters of options that the recorded Grbl was built without.",
        _options,
    ),
    Difference(
        "refused homing again",
        "A second refused $Hx is refused as the first was; Grbl is stuck in Home by then.",
        _homing,
    ),
)
