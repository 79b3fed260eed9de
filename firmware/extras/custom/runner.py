"""Runner: runs a handler of custom.py, and sees to what becomes of it.

A handler that raises stops the machine. Motion comes to its end, or to rest where the handler ran
beside it; then all is off, as after a reset, and the machine is in alarm.
"""

import gc

import micropython
from base import errors
from base import state as st
from base.errors import Abort, GrblError
from base.faults import sanitize, trace
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

TRACE = "custom"  # under which the end of the last traceback is kept
_TRACE_LINES = const(12)  # of one that has filled the stack there are many, all alike
# A handler that takes so long without service is told of, be it that garbage is collected in it.
_SLOW_MS = const(20)
# That comes after so many handlers, where as many blocks wait, or none.
_CALLS = const(64)
_BLOCKS = const(8)


class Runner:
    """Runs handlers. api: what they are handed; modules: the user's, by name."""

    def __init__(self, cnc: "Cnc", api: "MachineApi", modules: "tuple[str, ...]") -> None:
        self._cnc = cnc
        self._machine = cnc.machine
        self.machine_api = api
        self._modules = [module.replace(".", "/") for module in modules]
        self.is_running = False  # a handler
        self._slow: "list[str]" = []  # who has been told of
        # Failed beside motion: it would again, at every turn.
        self._disabled: "list[Function]" = []
        self._calls = 0
        self.has_run = False  # there may be something to do for run_housekeeping()

    @micropython.native  # needs half the stack
    def run(
        self,
        what: str,
        function: "Function",
        may_move: bool,
        values: "tuple[Any, ...]" = (),
        given: "dict[str, Any] | None" = None,
    ) -> "Any":
        """Run a handler; returns what it returns. given: of a word, its parameters. Raises
        GrblError where that refuses its line, and Abort where the machine has been stopped."""
        api, state = self.machine_api, self._machine.state
        if function in self._disabled and not may_move:
            return None
        outer = api.begin_handler(may_move)
        was_running, self.is_running = self.is_running, True
        try:
            found = function(api, *values, **(given or {}))
            api.check_stopped()
            return found
        except Stopped:
            if state.pending[st.RESET]:
                raise Abort
            return None  # the line's end tells of the alarm
        except KeyboardInterrupt as stop:
            raise stop  # native code wants the name
        except BaseException as fault:  # sys.exit() is no way out of the machine
            if isinstance(fault, Abort) or state.pending[st.RESET]:
                raise Abort
            if isinstance(fault, handlers.Refuse) and given is not None and may_move:
                self._cnc.message(sanitize(str(fault)))
                raise GrblError(errors.INVALID_STATEMENT)
            if not may_move:
                self._disabled.append(function)
            self._fail(what, fault, may_move)
        finally:
            api.may_move = outer
            self.is_running = was_running
            api.restart_clock()
            self._calls += 1
            self.has_run = True
            self._report_slow(what)
        return None

    def _report_slow(self, what: str) -> None:
        slow_ms, self.machine_api.slow_ms = self.machine_api.slow_ms, 0
        if slow_ms >= _SLOW_MS and what not in self._slow:
            self._slow.append(what)
            self._cnc.message("%s: %d ms without a call of m" % (what, slow_ms))

    # Failing

    def text(self, lines: "list[str]") -> str:
        """Of a traceback: the last line of the user's own, and what has happened there."""
        place = ""
        for line in [line.strip() for line in lines]:
            if line.startswith('File "') and self._is_own(line[6:].split('"')[0]):
                place = line.replace("\\", "/").split('"')[1].split("/")[-1]
                place += line.split('"')[2] + ": "
        return place + lines[-1]

    def _is_own(self, file: str) -> bool:
        name = file.replace("\\", "/").rsplit(".", 1)[0]
        return any((name == module or name.endswith("/" + module)) for module in self._modules)

    def _fail(self, what: str, fault: BaseException, may_move: bool) -> None:
        """A handler has failed: say so, and stop the machine."""
        machine = self._machine
        # An interrupt that has come upon a full stack is taken away by MicroPython.
        machine.port.attach(machine.motor_control)
        machine.port.enable_limits(bool(machine.settings.hard_limits))
        lines = trace(fault)
        text = sanitize("%s: %s" % (what, self.text(lines)))
        machine.commands.fault = text
        machine.saves.save(TRACE, lines[-_TRACE_LINES:])
        machine.report.message(text)
        if may_move:
            machine.canon.synchronise()
        else:
            self._report_disabled(what)
        self.machine_api.halt()

    def _report_disabled(self, what: str) -> None:
        self._cnc.message(what + " is left out until power-up")

    def refuse_disabled(self, what: str, function: "Function") -> None:
        """GrblError where a word's handler beside motion is left out: the sender would take its
        line as done."""
        if function in self._disabled:
            self._report_disabled(what)
            raise GrblError(errors.INVALID_STATEMENT)

    # The main loop's turn, between two lines

    def run_housekeeping(self) -> None:
        """Write what is to be kept; make room; begin jogs that have been asked for."""
        machine, api = self._machine, self.machine_api
        keep = api.keep
        if keep.is_due and machine.at_rest() and not machine.reader.has_line():
            keep.write()
            machine.save_due()
        if self._calls >= _CALLS:
            flow = machine.planner.flow
            if machine.at_rest() or (flow[HEAD] - flow[TAIL]) % flow[ROWS] >= _BLOCKS:
                self._calls = 0
                gc.collect()
        api.start_jogs()
        self.has_run = keep.is_due or self._calls >= _CALLS or api.has_jogs()
