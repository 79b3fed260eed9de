"""Runner: calls the handlers of custom.py, and stops the machine if one fails.

If a handler that may move raises, planned motion is executed first. If a handler during motion
raises, the machine slows to a stop. Then all is switched off, as after a reset, and the machine is
in alarm.
"""

import gc

import micropython
from base import errors
from base import state as st
from base.errors import Abort, GrblError
from base.text import sanitize, trace
from micropython import const
from motion.layout import HEAD, ROWS, TAIL

from extras.custom import handlers
from extras.custom.pin_api import Stopped

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import Any

    from extras.api import Cnc
    from extras.custom.handlers import Function
    from extras.custom.machine_api import MachineApi

MAY_MOVE = const(True)  # of a handler; the others run during motion
TRACE = "custom"  # the name under which the last traceback's end is stored
_TRACE_LINES = const(12)  # a recursion that fills the stack has many equal lines
# A handler that takes so long without a call of m is reported, also if it is garbage collection.
_SLOW_MS = const(20)
# Garbage is collected after so many handlers, when _ENOUGH_BLOCKS are planned or the machine is
# idle: then motion does not run out of blocks meanwhile.
_RUNS_TO_COLLECT = const(64)  # handlers run until garbage is collected
_ENOUGH_BLOCKS = const(8)  # planned ones, which last longer than a collection


class Runner:
    """Calls handlers. machine_api: their argument m; modules: the names of the user's modules.
    is_running: a handler is running. has_run: one has run, so that run_housekeeping() may have
    work. _uncollected_runs: handlers run since the last garbage collection. _reported_slow: names
    of handlers reported as slow. _disabled: handlers that failed during motion: they would fail
    again at every turn of the loop."""

    def __init__(self, cnc: "Cnc", api: "MachineApi", modules: "tuple[str, ...]") -> None:
        self._cnc = cnc
        self._machine = cnc.machine
        self.machine_api = api
        self._modules = [module.replace(".", "/") for module in modules]
        self.is_running = False
        self._reported_slow: "list[str]" = []
        self._disabled: "list[Function]" = []
        self._uncollected_runs = 0
        self.has_run = False

    @micropython.native  # takes half the stack of bytecode
    def run(
        self,
        what: str,
        function: "Function",
        may_move: bool,
        values: "tuple[Any, ...]" = (),
        given: "dict[str, Any] | None" = None,
    ) -> "Any":
        """Call a handler and return its result: None if it was stopped, or is disabled.

        what: its name in messages. may_move: it may move and wait; else it runs during motion.
        values: an event's arguments. given: the parameters of a word by letter, None for an event.
        Raises GrblError if the handler refuses its line, and Abort if the machine has been
        stopped, also because the handler has failed.
        """
        api, state = self.machine_api, self._machine.state
        if function in self._disabled and not may_move:
            return None
        outer_may_move = api.begin_handler(may_move)
        was_running, self.is_running = self.is_running, True
        try:
            result = function(api, *values, **(given or {}))
            api.check_stopped()
            return result
        except Stopped:
            if state.pending[st.RESET]:
                raise Abort
            return None  # the alarm is reported at the end of the line
        except KeyboardInterrupt as stop:
            raise stop  # native code has no bare raise
        except BaseException as fault:  # sys.exit(), too, must not end the firmware
            if isinstance(fault, Abort) or state.pending[st.RESET]:
                raise Abort
            if isinstance(fault, handlers.Refuse) and given is not None and may_move:
                self._cnc.message(sanitize(str(fault)))
                raise GrblError(errors.INVALID_STATEMENT)
            if not may_move:
                self._disabled.append(function)
            self._fail(what, fault, may_move)
        finally:
            api.may_move = outer_may_move
            self.is_running = was_running
            api.restart_clock()
            self._uncollected_runs += 1
            self.has_run = True
            self._report_slow(what)
        return None

    def _report_slow(self, what: str) -> None:
        """Report a handler, once, that took _SLOW_MS or longer without a call of m."""
        slow_ms, self.machine_api.slow_ms = self.machine_api.slow_ms, 0
        if slow_ms >= _SLOW_MS and what not in self._reported_slow:
            self._reported_slow.append(what)
            self._cnc.message("%s ran for %d ms without calling a method of m" % (what, slow_ms))

    # Failing

    def reason(self, lines: "list[str]") -> str:
        """Return from a traceback the last place in the user's own files, and the exception, such
        as `custom.py, line 7, in probe: ValueError: ...`.

        A traceback's lines are `File "custom.py", line 7, in probe`; the last is the exception.
        """
        place = ""
        for line in [line.strip() for line in lines]:
            if line.startswith('File "'):
                parts = line.split('"')
                path = parts[1]
                if self._is_of_user(path):
                    name = path.replace("\\", "/").split("/")[-1]
                    place = name + parts[2] + ": "  # parts[2]: line and function
        return place + lines[-1]

    def _is_of_user(self, file: str) -> bool:
        """Return whether a file, from a traceback, is one of the user's modules."""
        name = file.replace("\\", "/").rsplit(".", 1)[0]
        return any((name == module or name.endswith("/" + module)) for module in self._modules)

    def _fail(self, what: str, fault: BaseException, may_move: bool) -> None:
        """Report that a handler has failed, store the traceback's end for $I+, and stop the
        machine. what: the handler's name in messages. Raises Abort."""
        machine = self._machine
        # MicroPython removes an interrupt handler that found the stack full. Attach it again.
        machine.port.attach(machine.motor_control)
        machine.port.enable_limits(bool(machine.settings.hard_limits))
        lines = trace(fault)  # of the traceback
        text = sanitize("%s: %s" % (what, self.reason(lines)))
        machine.commands.fault = text  # $I+ shows it
        machine.saves.save(TRACE, lines[-_TRACE_LINES:])
        machine.report.message(text)
        if may_move:
            machine.canon.synchronise()
        else:
            self._report_disabled(what)
        self.machine_api.halt()

    def _report_disabled(self, what: str) -> None:
        """Report that a handler, by its name in messages, is disabled."""
        self._cnc.message(what + " is disabled until power-up")

    def refuse_disabled(self, what: str, function: "Function") -> None:
        """Report it and raise GrblError if the handler of a word is disabled. what: its name in
        messages. Otherwise the sender would take the word's line as done.
        """
        if function in self._disabled:
            self._report_disabled(what)
            raise GrblError(errors.INVALID_STATEMENT)

    # Between two lines

    def run_housekeeping(self) -> None:
        """Write values that are due, collect garbage, and start requested jogs."""
        machine, api = self._machine, self.machine_api
        keep = api.keep
        if keep.is_due and machine.at_rest() and not machine.reader.has_line():
            keep.write()
            machine.save_due()
        if self._uncollected_runs >= _RUNS_TO_COLLECT:
            flow = machine.planner.flow  # the planner's ring: indices of its ends, and its size
            planned_blocks = (flow[HEAD] - flow[TAIL]) % flow[ROWS]
            if machine.at_rest() or planned_blocks >= _ENOUGH_BLOCKS:
                self._uncollected_runs = 0
                gc.collect()
        api.start_jogs()
        self.has_run = keep.is_due or self._uncollected_runs >= _RUNS_TO_COLLECT or api.has_jogs()
