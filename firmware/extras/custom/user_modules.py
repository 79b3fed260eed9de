"""Custom: the user's own Python on the board, custom.py or the modules of the folder custom.

It is read at start, as source, and notes its handlers down (handlers.py). They run in the main
loop only. Handlers that may move run between two lines, when motion has ended. The others run
during motion, wherever the main loop waits and the stack has space. Interrupts never call them.

runner.py calls the handlers, events.py has the sources of events, machine_api.py has the API.
"""

import gc
import sys

from base.text import sanitize, trace
from micropython import const

from extras.custom import handlers
from extras.custom.events import Events
from extras.custom.machine_api import MachineApi
from extras.custom.runner import MAY_MOVE, TRACE, Runner
from extras.custom_codes import key_of

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

    from interfaces import Options

    from extras.api import Cnc
    from extras.custom.handlers import Function, Note
    from extras.custom_codes import Key

_API = "ugrbl"  # custom.py imports handlers.py under this name


_found: "dict[str, Any]" = {}  # prepare() stores here what install() needs


def prepare(options: "Options", board: "ModuleType") -> None:
    """Note the modules to read and the pins of the board file."""
    option = board.__dict__.get
    _found["modules"] = options.custom
    _found["outputs"], _found["inputs"] = option("OUTPUTS", {}), option("INPUTS", {})


def install(cnc: "Cnc") -> None:
    """Read the user's modules and register their handlers.

    If that fails, the machine works without them, and reports why after its welcome.
    """
    port = cnc.machine.port
    outputs, inputs = _found["outputs"], _found["inputs"]
    if outputs or inputs:
        port.add_pins(tuple(outputs.values()), tuple(inputs.values()))
        port.rest(0)  # the levels after a reset: all these outputs off
    api = MachineApi(cnc.machine, outputs, inputs)
    runner = Runner(cnc, api, _found["modules"])
    custom = Custom(cnc, runner, Events(cnc, runner))
    try:
        custom.register(_read(_found["modules"]))
    except KeyboardInterrupt:
        custom.leave_out(RuntimeError("Ctrl-C came while it was read, so it was not loaded"))
    except BaseException as fault:  # sys.exit(), too
        custom.leave_out(fault)


def _read(modules: "tuple[str, ...]") -> "list[Note]":
    """Import the user's modules. Return the handlers that they have noted.

    While they are read, `import ugrbl` gives handlers.api.
    """
    earlier_module = sys.modules.get(_API)
    sys.modules[_API] = handlers.api  # type: ignore[assignment]
    handlers.take_notes()
    try:
        for name in modules:
            sys.modules.pop(name, None)
        for name in modules:  # they may import one another
            gc.collect()  # compiling needs much memory, and fragments it
            __import__(name)
    finally:
        sys.modules.pop(_API)
        if earlier_module:
            sys.modules[_API] = earlier_module
    return handlers.take_notes()


def title(kind: str, key: "Any") -> str:
    """Return a handler's name in messages, from its note's kind and key: M100, on.spindle,
    on.input(door), every 50."""
    if kind in (handlers.M, handlers.G):
        return "%s%s" % (kind, key)
    if kind == handlers.EVERY:
        return "every %d" % key
    return "on.input(%s)" % key if kind == handlers.INPUT else "on." + kind


class Custom:
    """Registers the noted handlers, or leaves them all out."""

    def __init__(self, cnc: "Cnc", runner: Runner, events: Events) -> None:
        self._cnc = cnc
        self._events = events
        self._machine = cnc.machine
        self._runner = runner

    def register(self, notes: "list[Note]") -> None:
        """Register all handlers, or none: everything is checked before the machine is changed.

        ValueError if a word is taken or an input unknown, TypeError if letters are not text.
        """
        word_kinds = (handlers.M, handlers.G)
        words = [note for note in notes if note[0] in word_kinds]  # note[0]: its kind
        events = [note for note in notes if note[0] not in word_kinds]
        new_words = [(kind, number, letters) for kind, number, letters, _, _ in words]
        if "tool_change" in [kind for kind, _, _, _, _ in events]:
            new_words.insert(0, ("M", 6, "t"))  # Events.attach() adds M6
        seen: "list[Key]" = []
        for kind, number, letters in new_words:
            word_key = key_of(kind, number)
            if word_key in seen or self._cnc.is_taken(kind, number):
                raise ValueError("%s%s is already in use" % (kind, number))
            if not isinstance(letters, str):
                raise TypeError("%s%s: its letters must be a text" % (kind, number))
            seen.append(word_key)
        for kind, key, _, _, _ in events:
            if kind == handlers.INPUT:
                self._runner.machine_api.pin(key)  # raises ValueError if there is none
        for kind, key, _, _, function in events:
            self._events.subscribe(kind, key, title(kind, key), function)
        some_run_during_motion = any(sync is False for _, _, _, sync, _ in notes)
        self._events.attach(some_run_during_motion)
        for kind, number, letters, sync, function in words:
            call = self._call_for_word(title(kind, number), letters, sync, function)
            add = self._cnc.add_m if kind == handlers.M else self._cnc.add_g
            add(number, call, letters, sync=sync is True)  # False, None: not at the end of motion
        names = [title(kind, key) for kind, key, _, _, _ in notes]
        self._cnc.after_reset(self._runner.machine_api.clear_requests)
        self._cnc.before_lines(self._events.between_lines)
        self._add_build_info(sanitize("Custom: " + ", ".join(names)))

    def leave_out(self, fault: BaseException) -> None:
        """Leave all handlers out, and report why (fault) after each welcome and in $I."""
        handlers.take_notes()  # forgets the handlers that were noted before the fault
        text = sanitize("Custom left out: " + self._runner.reason(trace(fault)))
        self._cnc.after_reset(lambda: self._cnc.message(text))
        self._add_build_info(text)

    def _add_build_info(self, text: str) -> None:
        """Add a line to $I, and the last stored traceback to $I+."""
        self._machine.state.hooks.build_info += (lambda: self._cnc.message(text),)
        self._cnc.after_command(b"I+", self._report_trace)

    def _report_trace(self, state_before: int) -> None:
        """Report the last stored traceback at the end of $I+, for `ugrbl doctor`."""
        for text in self._machine.saves.load(TRACE) or ():
            self._machine.report.message("Trace: " + sanitize(text))

    def _call_for_word(
        self, what: str, letters: str, sync: "bool | None", function: "Function"
    ) -> "Function":
        """Return the function that the interpreter calls for a word, with the numbers of
        `letters`, None for one that is not on the line. It calls the handler with those that are
        on it, by letter.

        sync: False: when the blocks planned before it have been executed; else at once, which with
        True is at rest: the interpreter has waited. what: the handler's name in messages.
        """
        names = [letter.upper() for letter in letters]

        def call(*numbers: "float | None") -> None:
            """Call the handler with the numbers that the line has."""
            given = {name: number for name, number in zip(names, numbers) if number is not None}
            if sync is False:
                self._events.defer(what, function, given)
            else:
                self._runner.run(what, function, MAY_MOVE, given=given)

        return call
