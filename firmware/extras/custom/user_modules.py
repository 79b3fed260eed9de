"""Custom: the user's own Python on the board, custom.py or the modules of the folder custom.

It is read at start, as source, and notes its handlers down (handlers.py). They run in the main
loop only: those that may move where motion has come to its end, between two lines; the others
beside motion, wherever the loop waits and the stack has room. Interrupts know nothing of them.

How one is run, and what becomes of it, stands in runner.py; where events come from, in
events.py; what a handler is handed, in machine_api.py.
"""

import gc
import sys

from base.faults import sanitize, trace
from micropython import const

from extras.custom import handlers
from extras.custom.events import Events
from extras.custom.machine_api import MachineApi
from extras.custom.runner import TRACE, Runner
from extras.custom_codes import word_of

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

    from interfaces import Options

    from extras.api import Cnc
    from extras.custom.handlers import Function, Note
    from extras.custom_codes import Key

_API = "ugrbl"  # the name by which custom.py knows handlers.py

_found: "dict[str, Any]" = {}


def prepare(options: "Options", board: "ModuleType") -> None:
    """What there is to read, and what the board file calls pins."""
    option = board.__dict__.get
    _found["modules"] = options.custom
    _found["outputs"], _found["inputs"] = option("OUTPUTS", {}), option("INPUTS", {})


def install(cnc: "Cnc") -> None:
    """Read the user's modules, and put their handlers around the machine. Where that cannot be
    the machine is the plain one, and says why behind its welcome."""
    port = cnc.machine.port
    outputs, inputs = _found["outputs"], _found["inputs"]
    if outputs or inputs:
        port.add_pins(tuple(outputs.values()), tuple(inputs.values()))
        port.rest(0)
    api = MachineApi(cnc.machine, outputs, inputs)
    runner = Runner(cnc, api, _found["modules"])
    custom = Custom(cnc, runner, Events(cnc, runner))
    try:
        custom.register(_read(_found["modules"]))
    except KeyboardInterrupt:
        custom.leave_out(RuntimeError("Ctrl-C while it was read"))
    except BaseException as fault:  # sys.exit(), too
        custom.leave_out(fault)


def _read(modules: "tuple[str, ...]") -> "list[Note]":
    """Import the user's modules; returns what they have noted down."""
    there = sys.modules.get(_API)
    sys.modules[_API] = handlers.api  # type: ignore[assignment]
    handlers.take_notes()
    try:
        for name in modules:
            sys.modules.pop(name, None)
        for name in modules:  # they may import one another
            gc.collect()  # a compiler takes much, and what it leaves stays where it is
            __import__(name)
    finally:
        sys.modules.pop(_API)
        if there:
            sys.modules[_API] = there
    return handlers.take_notes()


def title(kind: str, key: "Any") -> str:
    """What a handler is called in messages: M100, on.spindle, on.input(door), every 50."""
    if kind in (handlers.M, handlers.G):
        return "%s%s" % (kind, key)
    if kind == handlers.EVERY:
        return "every %d" % key
    return "on.input(%s)" % key if kind == handlers.INPUT else "on." + kind


class Custom:
    """What the user's modules have noted down, taken up or left out."""

    def __init__(self, cnc: "Cnc", runner: Runner, events: Events) -> None:
        self._cnc = cnc
        self._events = events
        self._machine = cnc.machine
        self._runner = runner

    def register(self, notes: "list[Note]") -> None:
        """Take up what has been noted, all or nothing: what is wrong is found before anything is
        put around the machine. ValueError where something is taken, TypeError for letters that
        are no text."""
        kinds = (handlers.M, handlers.G)
        words = [note for note in notes if note[0] in kinds]
        events = [note for note in notes if note[0] not in kinds]
        changes = [("M", 6, "t")] if "tool_change" in [note[0] for note in events] else []
        seen: "list[Key]" = []
        for kind, key, letters in changes + [note[:3] for note in words]:
            if word_of(kind, key) in seen or self._cnc.is_taken(kind, key):
                raise ValueError("%s%s is taken" % (kind, key))
            if not isinstance(letters, str):
                raise TypeError("%s%s: its letters are no text" % (kind, key))
            seen.append(word_of(kind, key))
        for kind, key, _, _, _ in events:
            if kind == handlers.INPUT:
                self._runner.machine_api.pin(key)  # which says that there is none
        for kind, key, _, _, function in events:
            self._events.subscribe(kind, key, title(kind, key), function)
        self._events.attach(any(note[3] is False for note in notes))
        for kind, key, letters, sync, function in words:
            call = self._word(title(kind, key), letters, sync, function)
            add = self._cnc.add_m if kind == handlers.M else self._cnc.add_g
            add(key, call, letters, bool(sync))
        names = [title(note[0], note[1]) for note in notes]
        self._cnc.after_reset(self._runner.machine_api.clear_requests)
        self._cnc.before_lines(self._events.between_lines)
        self._add_build_info(sanitize("Custom: " + ", ".join(names)))

    def leave_out(self, fault: BaseException) -> None:
        """The machine is the plain one."""
        handlers.take_notes()
        text = sanitize("Custom left out: " + self._runner.text(trace(fault)))
        self._cnc.after_reset(lambda: self._cnc.message(text))
        self._add_build_info(text)

    def _add_build_info(self, text: str) -> None:
        """$I says it."""
        self._machine.state.hooks.build_info += (lambda: self._cnc.message(text),)
        self._cnc.after_command(b"I+", self._report_trace)

    def _report_trace(self, was: int) -> None:
        """$I+ ends with the last traceback that was kept, for `ugrbl doctor`."""
        for text in self._machine.saves.load(TRACE) or ():
            self._machine.report.message("Trace: " + sanitize(text))

    def _word(
        self, what: str, letters: str, sync: "bool | None", function: "Function"
    ) -> "Function":
        names = [c.upper() for c in letters]

        def call(*numbers: "float | None") -> None:
            given = {n: x for n, x in zip(names, numbers) if x is not None}
            if sync is False:
                self._events.defer(what, function, given)
            else:
                self._runner.run(what, function, True, (), given)

        return call
