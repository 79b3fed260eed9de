"""Custom: the user's own Python on the board, custom.py or the modules of the folder custom.

It is read at start, as source, and notes its handlers down (handlers.py). They run in the main
loop only: those that may move where motion has come to its end, between two lines; the others
beside motion, wherever the loop waits and the stack has room. Interrupts know nothing of them.
What a handler is handed is an Operator; where events come from stands in happenings.py.

A handler that raises stops the machine. Motion comes to its end, or to rest where the handler ran
beside it; then all is off, as after a reset, and the machine is in alarm.
"""

import gc
import sys

import micropython
from base import errors
from base import state as st
from base.errors import Abort, GrblError
from base.faults import harmless, trace
from micropython import const
from motion.layout import HEAD, ROWS, TAIL

from extras import handlers
from extras.happenings import Happenings
from extras.operator import Operator, Stopped

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

    from interfaces import Options

    from extras.api import Cnc
    from extras.handlers import Function, Note

PINS = ("OUTPUTS", "INPUTS")
_API = "ugrbl"  # the name by which custom.py knows handlers.py
_TRACE = "custom"  # under which the last traceback is kept
_SLOW_MS = const(20)  # a handler that takes longer without service is told of
# So much of the stack may be in use where a handler begins that runs beside motion: interrupts
# and its own calls want the rest.
_STACK_BYTES = const(3072)
# A collection takes 30 ms: it comes after so many handlers, where as many blocks wait, or none.
_CALLS = const(32)
_BLOCKS = const(8)

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
    custom = Custom(cnc, Operator(cnc.machine, outputs, inputs))
    try:
        custom.take(_read(_found["modules"]))
    except Exception as fault:
        custom.drop(fault)
    except KeyboardInterrupt:
        custom.drop(RuntimeError("Ctrl-C while it was read"))


def _read(modules: "tuple[str, ...]") -> "list[Note]":
    """Import the user's modules; returns what they have noted down."""
    there = sys.modules.get(_API)
    sys.modules[_API] = handlers
    handlers.take()
    try:
        for name in modules:
            sys.modules.pop(name, None)
            __import__(name)
    finally:
        sys.modules.pop(_API)
        if there:
            sys.modules[_API] = there
    return handlers.take()


def _title(kind: str, key: "Any") -> str:
    """What a handler is called in messages: M100, on.spindle, on.input(door), every 50."""
    if kind in (handlers.M, handlers.G):
        return "%s%s" % (kind, key)
    if kind == handlers.EVERY:
        return "every %d" % key
    return "on.input(%s)" % key if kind == handlers.INPUT else "on." + kind


class Custom:
    """The handlers, and how each is run. operator: what they are handed."""

    def __init__(self, cnc: "Cnc", operator: Operator) -> None:
        self._cnc = cnc
        self._machine = cnc.machine
        self.operator = operator
        self.is_running = False  # a handler
        self._words: "list[str]" = []  # what there is, for $I
        self._slow: "list[str]" = []  # who has been told of
        self._fault = ""  # of a handler beside motion: the machine is to stop
        self._calls = 0

    def take(self, notes: "list[Note]") -> None:
        """Take up what has been noted, all or nothing. ValueError where something is taken."""
        seen: "list[tuple[str, Any]]" = []
        for kind, key, _, _, _ in notes:
            if kind in (handlers.M, handlers.G):
                if (kind, key) in seen or self._cnc.is_taken(kind, key):
                    raise ValueError("%s%s is taken" % (kind, key))
                seen.append((kind, key))
            elif kind == handlers.INPUT:
                self.operator.pin(key)  # which says that there is none
        happenings = Happenings(self._cnc, self)
        for kind, key, letters, sync, function in notes:
            what = _title(kind, key)
            if kind in (handlers.M, handlers.G):
                call = self._word(what, letters, sync, function, happenings)
                add = self._cnc.add_m if kind == handlers.M else self._cnc.add_g
                add(key, call, letters, sync)
            else:
                happenings.add(kind, key, what, function)
            self._words.append(what)
        happenings.connect()
        self._cnc.behind_reset(self._begin)
        self._cnc.before_lines(self.turn)
        self._tell_build("Custom: " + ", ".join(self._words))

    def drop(self, fault: Exception) -> None:
        """The machine is the plain one."""
        handlers.take()
        text = "Custom left out: " + self._text(fault)
        self._cnc.behind_reset(lambda: self._cnc.message(text))
        self._tell_build(text)

    def _tell_build(self, text: str) -> None:
        """$I says it."""
        report = self._machine.report
        usual = report.build_info

        def build_info(info: str, options: str) -> None:
            usual(info, options)
            report.message(harmless(text))

        report.build_info = build_info  # type: ignore[method-assign]

    def _begin(self) -> None:
        """Power-up or a reset."""
        self._fault = ""
        self.operator.forget()

    # Running a handler

    def _word(
        self, what: str, letters: str, sync: bool, function: "Function", happenings: Happenings
    ) -> "Function":
        names = [c.upper() for c in letters]

        def call(*numbers: "float | None") -> None:
            given = {n: x for n, x in zip(names, numbers) if x is not None}
            if sync:
                self.run(what, function, True, (), given)
            else:
                happenings.defer(what, function, given)

        return call

    def run(
        self,
        what: str,
        function: "Function",
        may_move: bool,
        values: "tuple[Any, ...]" = (),
        given: "dict[str, Any] | None" = None,
    ) -> "Any":
        """Run a handler; returns what it returns. Raises GrblError where it refuses its line, and
        Abort where the machine has been stopped."""
        operator, state = self.operator, self._machine.state
        outer = operator.begin(may_move)
        was_running, self.is_running = self.is_running, True
        try:
            found = function(operator, *values, **(given or {}))
            operator.look()
            return found
        except Abort:
            raise
        except Stopped:
            return None  # the line's end tells of the alarm
        except handlers.Refuse as reason:
            self._cnc.message(harmless(str(reason)))
            raise GrblError(errors.INVALID_STATEMENT)
        except Exception as fault:
            if state.pending[st.RESET]:
                raise Abort
            self._fail(what, fault, may_move)
        finally:
            operator.may_move = outer
            self.is_running = was_running
            operator.rested()
            self._calls += 1
            self._tell_slow(what)
        return None

    def _tell_slow(self, what: str) -> None:
        slow_ms, self.operator.slow_ms = self.operator.slow_ms, 0
        if slow_ms > _SLOW_MS and what not in self._slow:
            self._slow.append(what)
            self._cnc.message("%s took %d ms: nothing else was heard" % (what, slow_ms))

    def has_room(self) -> bool:
        """The stack has room for a handler beside motion."""
        return micropython.stack_use() < _STACK_BYTES

    # Failing

    def _text(self, fault: BaseException) -> str:
        """The last line of the user's own, and what has happened there."""
        lines = trace(fault)
        place = ""
        for line in [line.strip() for line in lines]:
            if line.startswith('File "') and self._is_own(line[6:].split('"')[0]):
                place = line.replace("\\", "/").split('"')[1].split("/")[-1]
                place += line.split('"')[2] + ": "
        return place + lines[-1]

    def _is_own(self, file: str) -> bool:
        name = file.replace("\\", "/").rsplit(".", 1)[0]
        return any(
            (name == module or name.endswith("/" + module))
            for module in [m.replace(".", "/") for m in _found["modules"]]
        )

    def _fail(self, what: str, fault: Exception, may_move: bool) -> None:
        """A handler has failed: say so, and stop the machine."""
        machine = self._machine
        text = harmless("%s: %s" % (what, self._text(fault)))
        machine.commands.fault = text
        machine.saves.save(_TRACE, trace(fault))
        machine.report.message(text)
        if may_move:
            machine.canon.synchronise()
            machine.canon.give_up(errors.ALARM_CUSTOM)
        self._fault = text
        machine.state.pending[st.ANY] = 1  # the loop sees to it between two lines

    # The main loop's turn, between two lines

    def turn(self) -> None:
        """Stop the machine if something has failed; write what is to be kept; make room."""
        machine = self._machine
        if self._fault:
            machine.canon.give_up(errors.ALARM_CUSTOM)
        at_rest = machine.at_rest()
        if self.operator.keep.is_due and at_rest and not machine.reader.waiting():
            self.operator.keep.write()
            machine.keep()
        if self._calls >= _CALLS:
            flow = machine.planner.flow
            if at_rest or (flow[HEAD] - flow[TAIL]) % flow[ROWS] >= _BLOCKS:
                self._calls = 0
                gc.collect()
