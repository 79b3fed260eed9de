"""Try each handler in the simulator, with a line or an event that triggers it.

Words get the value 1 for each letter, once for the required letters and once for all. An input
that a handler waits for changes after a moment, and so does the probe. Nothing else is like the
real machine: a handler that depends on more may fail here, and the message says where.

A script yields what its sender does next: a line with its number (0: it is not in the program), or
None: it waits until the machine is idle.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from . import machine, watch
from .custom_check import Verdict, called, title
from .machine import Around
from .own_python import OwnPythonError
from .program import ProgramLink, Step

if TYPE_CHECKING:
    from ..sim.rig import Rig

_WAIT_MS = 200  # an input changes after being waited for so long
_MOVE = b"G21 G91 G1 X1 F600"
_PROBE = b"G21 G91 G38.2 Z-5 F200"
_HOMING = (b"$22=1", b"$H")
# More moves than the planner holds, so the machine moves at the reset, which causes an alarm.
_BROKEN_OFF = (*(_MOVE,) * 20, b"\x18")
_SHORT = b"G4 P0.2"  # a short wait, in which events are handled
_PERIODS = 3  # a program for a periodic handler lasts so many periods
_MESSAGE = re.compile(r"\[MSG:(.*)\]")  # a message to the sender
_UNLOCKED = (*_BROKEN_OFF, b"$X", _SHORT)  # a reset during motion, then unlocked
_IN_ALARM = ": in Alarm, after a reset during motion; check m.state before m.g"
# Lines that trigger an event.
LINES: dict[str, tuple[bytes, ...]] = {
    "startup": (_SHORT,),
    "after_homing": _HOMING,
    "after_reset": (b"\x18", _SHORT),
    "after_unlock": _UNLOCKED,
    "state_change": (_MOVE,),
    "tool_select": (b"T1",),
    "tool_change": (b"T1", b"M6"),
    "probe_done": (_PROBE,),
    "spindle": (b"M3 S1000", b"M5"),
    "coolant": (b"M8", b"M9"),
    "program_paused": (b"M0",),
    "program_done": (b"M30",),
    "alarm": (_PROBE, _SHORT),  # with the probe closed before the motion: ALARM:4
    "report": (b"?", _SHORT, b"?", _SHORT),
}


class TryLink(ProgramLink):
    """A link that continues after an alarm, because a test may want one."""

    def stop(self, why: str) -> None:
        """Stop, except for an alarm."""
        if not why.startswith("ALARM:"):
            super().stop(why)


def try_all(notes: Sequence[Any], board: str, around: Around, verdict: Verdict) -> None:
    """Try each handler on a machine of its own, and add the results to the verdict."""
    around = replace(around, others_ms=_WAIT_MS)  # inputs without a rule change, too
    for note in notes:
        words, is_good = _try(note, board, around)
        verdict.tried.append((title(note), words, is_good))


def _try(note: Any, board: str, around: Around) -> tuple[str, bool]:
    """Return the result in words, and whether it is a success; that a handler could not be tried
    is one. note: a registered handler: its kind, the key that triggers it, and letters."""
    kind, key, letters, _, _ = note
    name = called(note)
    programs = (
        _programs_for_word(name, letters) if kind in "MG" else _programs_for_event(kind, key)
    )
    refusal = ""  # the handler refuses its line, which may be right
    for lines in programs:
        rig = _rig(lines, kind, key, board, around)
        try:
            stopped = _run(rig, name)
        except OwnPythonError as error:
            return str(error), False
        faults = [fault for fault in rig.custom_module.faults if fault.startswith(f"{name}: ")]
        if lacks := [fault for fault in faults if fault in rig.custom_module.lacks]:
            return f"not tried: {lacks[0]}: boards have it, the simulator does not", True
        stopped = stopped or rig.link.result.stopped
        if stopped or faults:
            is_in_alarm = lines is _UNLOCKED and kind == "after_reset"
            return (faults or [stopped])[0] + (_IN_ALARM if is_in_alarm else ""), False
        if name not in rig.custom_module.ran:
            return "not tried: the simulator could not cause this event", True
        if refused := [reply for _, reply in rig.link.result.errors]:
            output = [text for _, text in rig.link.result.other_output]
            messages = [match[1] for match in map(_MESSAGE.match, output) if match]
            refusal = f"refuses its line: {messages[-1] if messages else refused[0]}"
    return refusal or "runs", True


def _programs_for_word(word: str, letters: str) -> list[tuple[bytes, ...]]:
    """Return programs for a word: with the required letters, and with all."""
    required = "".join(f" {letter}1" for letter in letters if letter.isupper())
    all_letters = "".join(f" {letter.upper()}1" for letter in letters)
    different = dict.fromkeys((required, all_letters))  # one if they are the same
    lines = [f"{word}{parameters}".encode() for parameters in different]
    return [(line, _SHORT) for line in lines]


def _programs_for_event(kind: str, key: Any) -> list[tuple[bytes, ...]]:
    """Return programs for an event. One for a reset also runs after a reset that causes an
    alarm."""
    if kind == "every":  # key: its period in ms
        return [(f"G4 P{_PERIODS * key / 1000:.3f}".encode(), _SHORT)]
    lines = LINES.get(kind, (_SHORT,))
    return [lines, _UNLOCKED] if kind == "after_reset" else [lines]


def _rig(lines: Sequence[bytes], kind: str, key: Any, board: str, around: Around) -> "Rig":
    """Return a machine whose sender sends the lines. kind, key: of the handler, because some
    events need inputs that change; key is the input's name then."""

    def script(link: ProgramLink) -> Iterator[Step]:
        """Unlock the machine, send the lines, and change an input if the handler is for one."""
        from base import state

        if link.rig.controller.state.run == state.ALARM:
            yield 0, b"$X"
        link.rig.inputs.push("probe", kind == "alarm")  # closed only then: see LINES
        for number, line in enumerate(lines, 1):
            yield number, line
        yield None
        if kind == "input":
            for closed in (True, False):
                link.rig.inputs.push(key, closed)
                yield 1, _SHORT
                yield None

    rig = machine.build(board, lambda rig: TryLink(rig, script), around=around)
    rig.custom_module.on_endless_wait = rig.link.stop
    from ..sim import motor_names, switches

    if kind == "after_homing" and not motor_names.shared(rig.board):  # homing needs them
        switches.fit(rig)
    return rig


def _run(rig: "Rig", name: str) -> str:
    """Run the machine, within the time limit, to try a handler. Returns why it was ended, or
    ""."""
    if watch.is_late(lambda: machine.run(rig)):
        handler = rig.custom_module.interrupted or name
        return f"{handler}: it did not end within {watch.LONGEST_S:g} s"
    return ""
