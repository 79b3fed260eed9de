"""The complete list of intended differences between our replies and real Grbl's.

A row rewrites our line to Grbl's if, and only if, it is the difference that the row names.
Everything that is not in this table must be equal.
"""

import re
from collections.abc import Callable
from typing import Any, NamedTuple


class Difference(NamedTuple):
    """A difference: rewrite(ours, grbls, sent) returns the line that Grbl would have sent."""

    name: str
    reason: str
    rewrite: Callable[[str, str, str], str]


_VERSION = re.compile(r"\[VER:1\.1h\.\d{8}:(.*)\]")
_VERSION_09 = re.compile(r"\[0\.9([ij])\.\d{8}:(.*)\]")
_PROBE_09 = re.compile(r"\[G38\.(254|255|0|1) ")
_HOME_ONE = re.compile(r"\$H[^\n]")
_OPTIONS = re.compile(r"\[OPT:([^,]*)(,\d+,\d+)\]")


# The rewriting functions of DIFFERENCES: each returns Grbl's line if ours differs from it only in
# what the row names, else our own.


def _version(ours: str, grbls: str, _sent: str) -> str:
    """Return Grbl's line if both name the same version, else ours."""
    mine, theirs = _VERSION.fullmatch(ours), _VERSION.fullmatch(grbls)
    return grbls if mine and theirs and theirs[1] in mine[1] else ours


def _version_09(ours: str, grbls: str, _sent: str) -> str:
    """Return Grbl's line if both name the same version 0.9, else ours."""
    mine, theirs = _VERSION_09.fullmatch(ours), _VERSION_09.fullmatch(grbls)
    return grbls if mine and theirs and mine.groups() == theirs.groups() else ours


def _probe_09(ours: str, grbls: str, sent: str) -> str:
    """Return our line with the probing word as Grbl 0.9 writes it."""
    # Grbl 0.9 reports the tenths less 4, as a byte: [G38.254 to [G38.1 for G38.2 to G38.5.
    their_word = _PROBE_09.match(grbls)
    if sent != "$G\n" or their_word is None:
        return ours
    our_word = f"[G38.{(int(their_word[1]) + 4) % 256} "
    return ours.replace(our_word, their_word[0], 1)


def _options(ours: str, grbls: str, _sent: str) -> str:
    """Return Grbl's line if we have its options and perhaps more, else ours."""
    mine, theirs = _OPTIONS.fullmatch(ours), _OPTIONS.fullmatch(grbls)
    same = mine and theirs and mine[2] == theirs[2] and set(theirs[1]) <= set(mine[1])
    return grbls if same else ours


def _homing(ours: str, grbls: str, sent: str) -> str:
    stuck = sent.startswith("$H") and sent != "$H\n" and grbls == "error:8"
    return grbls if stuck and ours == "error:3" else ours


class Quirk(NamedTuple):
    """A fault of Grbl that we do not copy, in cases tagged `quirk`: only the steps before it are
    compared. begins: returns the first step of the fault, if any."""

    name: str
    reason: str
    begins: Callable[[list[dict[str, Any]]], int | None]


def _after_refused_homing(steps: list[dict[str, Any]]) -> int | None:
    """Return the step after the first refused $HX; None if there is none. See QUIRKS."""
    refused = (
        n + 1
        for n, step in enumerate(steps)
        if _HOME_ONE.search(step["send"]) and step["expect"] == ["error:3"]
    )
    return next(refused, None)


def _probes_in_contact(steps: list[dict[str, Any]]) -> int | None:
    """Return the step that probes although the probe is closed, and is answered by an alarm; None
    if there is none. See QUIRKS."""
    closed = False
    for n, step in enumerate(steps):
        level = step.get("pins", {}).get("probe")  # "closed" or "open"; None: unchanged
        closed = closed if level is None else level == "closed"
        if closed and "G38" in step["send"] and step["expect"] == ["ALARM: Probe fail"]:
            return n
    return None


QUIRKS = (
    Quirk(
        "refused homing",
        "$HX is refused with error:3 and leaves the machine as it was; Grbl sticks in Home, "
        "takes moves and never makes them.",
        _after_refused_homing,
    ),
    Quirk(
        "probe in contact",
        "A probe closed at the start of G38.2 raises the alarm and ends the line, as Grbl 1.1 "
        "does; Grbl 0.9 hears nothing from then on until it is reset.",
        _probes_in_contact,
    ),
)

# Differences in motion; compare.py recognises them.
IDLE_DELAY = (
    "idle delay",
    "Motors are released when the time $1 after motion is over, and the processor goes on "
    "meanwhile; Grbl's waits. The enable pin may change one step of a case later. Not with "
    "$1=255.",
)
LATE_ALARM = (
    "late alarm",
    "An alarm is reported at once; Grbl waits for the delay of $1 first: it may be reported one "
    "step of a case later.",
)
HELD_CONTACT = (
    "contact in a hold",
    "If the probe is touched by hand during a hold, the machine does not move when motion is "
    "resumed; Grbl begins to move, sees the contact, and brakes.",
)
HELD = (
    "held in an alarm",
    "With $1=255 motors stay on where a limit switch stops the machine, too; Grbl releases them "
    "until the reset that follows.",
)
EXACT_STOP = (
    "exact stop",
    "Where a hold, a jog cancel or a probe's contact comes to rest exactly on a whole step, "
    "Grbl's single-precision distance falls on either side of it: one step of difference.",
)

STOPPED = (
    "stopped in motion",
    "Where a hold, a jog cancel or an alarm ends a motion, the place of rest depends on the "
    "millisecond: it may be as far from Grbl's as the machine goes in 10 ms, a segment.",
)

SWITCH = (
    "switch of homing",
    "A switch stops its motor within microseconds; Grbl's loop looks at it once in a millisecond, "
    "and the motor is some steps further.",
)
IN_MOTION = (
    "in motion",
    "A position reported in the middle of a motion may differ by one step: our steps are spread "
    "evenly over a segment, Grbl's are placed by the rounding of its timer.",
)
NO_SPEED = (
    "spindle without speed",
    "M3 with S0 leaves the spindle's output off, as Grbl 1.1 does; Grbl 0.9 connects a PWM "
    "without power to the pin.",
)

MOTION = (
    IDLE_DELAY,
    LATE_ALARM,
    HELD,
    EXACT_STOP,
    STOPPED,
    HELD_CONTACT,
    SWITCH,
    IN_MOTION,
    NO_SPEED,
)

DIFFERENCES = (
    Difference(
        "version",
        "[VER:] has the date of our own build, and may have our name before the user's $I= text.",
        _version,
    ),
    Difference(
        "version of 0.9",
        "In the answer to $I of Grbl 0.9, too, the date is that of our own build.",
        _version_09,
    ),
    Difference(
        "probe mode of 0.9",
        "$G says G38.2 to G38.5, as they were sent; Grbl 0.9 counts from 254 by a slip.",
        _probe_09,
    ),
    Difference(
        "options",
        "[OPT:] may list letters of options that the recorded Grbl was built without.",
        _options,
    ),
    Difference(
        "refused homing again",
        "A second $Hx that is refused gets the same answer as the first. Grbl stays in the state "
        "Home after the first.",
        _homing,
    ),
)
