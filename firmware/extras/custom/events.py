"""Events of custom.py: where they come from, and when their handlers run.

Only events with a handler hook into the machine. Handlers that may move run after the line that
has caused the event, or between two lines. Handlers that run during motion are called wherever the
main loop waits.
"""

import micropython
from base import errors
from base import state as st
from base.errors import Abort, GrblError
from base.text import sanitize
from control import coolant
from control import spindle as sp
from language.block_layout import HIGHEST_TOOL, SET_TOOL
from micropython import const

from extras.custom import handlers
from extras.custom.machine_api import STATES
from extras.custom.positions import Position
from extras.custom.runner import MAY_MOVE
from extras.custom.synced_words import SyncedWords

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable
    from typing import Any

    from motion.planner import Move

    from extras.api import Cnc
    from extras.custom.handlers import Function
    from extras.custom.runner import Runner

    Handler = tuple[str, Function]  # its name in messages, and itself

_INPUT = "input "  # before an input's name
_LONGEST_QUEUE = const(16)  # events waiting for their handlers; later ones are dropped
# Bytes of stack that may be in use when a handler during motion starts. Its own calls and
# interrupts need the rest.
_STACK_BYTES = const(3712)  # in use at most
_M6 = const(6)
_WELCOME_EVENTS = ("startup", "after_reset")  # the welcome of power-up, and of each reset
# Alarms that no handler has caused: none, or the sender has reset a moving machine.
_NOT_BY_HANDLER = (0, errors.ALARM_ABORT_CYCLE, errors.ALARM_HOMING_FAIL_RESET)  # alarms; 0: none
_SPINDLE = {sp.OFF: "M5", sp.CW: "M3", sp.CCW: "M4"}


def _text(result: "Any") -> str:
    """Return the result of a handler of on.report as text, without characters that end a report.

    "" if it is neither text nor number.
    """
    if not isinstance(result, (str, int, float)):
        return ""
    return sanitize(str(result)).replace("<", " ").replace(">", " ")


class Events:
    """The events, and the handlers of each. _handlers: a list of them by the event's name.

    Queues of events, each its name and the handlers' arguments: _due for handlers that may move,
    _due_during_motion for the others. _timers: of each its period and the time of the last call
    in ms, its name in messages, and the function. _inputs: by name, whether it was closed at the
    last look. _changed[0]: 1 if an interrupt has seen an input change since. _last_run_state: at
    the last poll. _failed: handlers that failed after a welcome; _failure_causes_welcome: such a
    failure causes the next welcome. _hold: executes M0's hold, None if none waits.
    """

    def __init__(self, cnc: "Cnc", runner: "Runner") -> None:
        self._cnc = cnc
        self._machine = cnc.machine
        self._hooks = cnc.machine.state.hooks
        self._state = cnc.machine.state
        self._runner = runner
        self._handlers: "dict[str, list[Handler]]" = {}
        self._inputs: "dict[str, bool]" = {}
        self._timers: "list[list[Any]]" = []
        self._due: "list[tuple[str, tuple[Any, ...]]]" = []
        self._due_during_motion: "list[tuple[str, tuple[Any, ...]]]" = []
        self._has_homed = False  # a command has, since the last after_homing
        self._is_polling = False  # poll() is running: a handler's wait calls it again
        self._has_started = False  # the welcome of power-up is over
        self._last_run_state = cnc.machine.state.run
        self._hold: "Callable[[], None] | None" = None
        self._report_field = ""  # the status report's field, as on.report made it last
        self._changed = bytearray(1)
        self._failed: "list[Function]" = []
        self._failure_causes_welcome = False
        self._synced_words = SyncedWords(cnc.machine, runner)

    def subscribe(self, kind: str, key: "Any", what: str, function: "Function") -> None:
        """Register a handler for an event. kind: an event's name, EVERY or INPUT.

        key: of an input its name, of a timer milliseconds. what: the handler's name in messages.
        """
        if kind == handlers.EVERY:
            self._timers.append([key, self._machine.port.ticks_ms(), what, function])
        elif kind == handlers.INPUT:
            self._inputs[key] = self._runner.machine_api.pin(key)
            self._handlers.setdefault(_INPUT + key, []).append((what, function))
        else:
            self._handlers.setdefault(kind, []).append((what, function))

    def _emit(self, name: str, *values: "Any") -> None:
        """Queue an event for its handlers, except in check mode. values: their arguments."""
        if self._state.run != st.CHECK:
            self._queue(name, *values)

    def _queue(self, name: str, *values: "Any") -> None:
        """Queue an event for its handlers. It is dropped without any, or if the queue is full."""
        if name not in self._handlers:
            return
        due = self._due if name in handlers.MOVING else self._due_during_motion
        if len(due) < _LONGEST_QUEUE:
            due.append((name, values))
        self._state.pending[st.ANY] = 1  # so that the loop handles it between two lines

    # Running handlers

    @micropython.native
    def between_lines(self) -> None:
        """Run due events and housekeeping. The main loop calls it between two lines."""
        if self._due:
            self._run_due_between()
        if self._runner.has_run:
            self._runner.run_housekeeping()

    def _run_due_between(self) -> None:
        """Run due events between two lines, where no line waits for them. Raises Abort after an
        alarm: the main loop reports that."""
        try:
            self.run_due()
        except GrblError:
            return  # the handler has refused, and reported why
        if self._state.alarm and not self._state.pending[st.RESET]:  # else the reset raises it
            raise Abort

    def run_due(self) -> None:
        """Run the handlers that may move. Call it only between two lines."""
        while self._due:
            name, values = self._due.pop(0)
            self._machine.canon.synchronise()
            # Only the handler of a word may refuse its line: here of M6, which has no parameters.
            # None instead of {} marks an event, whose handler may not.
            parameters: "dict[str, Any] | None" = {} if name == "tool_change" else None
            for what, function in self._handlers[name]:
                if name in _WELCOME_EVENTS:
                    self._run_reset_handler(what, function)
                else:
                    self._runner.run(what, function, MAY_MOVE, values, parameters)

    def _run_reset_handler(self, what: str, function: "Function") -> None:
        """Run a handler after a welcome.

        If it causes an alarm, it is not run after that alarm's welcome. Otherwise the welcomes
        would never end, and the machine could not be unlocked. what: its name in messages.
        """
        if function in self._failed:
            return
        try:
            self._runner.run(what, function, MAY_MOVE)
        finally:
            if self._state.alarm not in _NOT_BY_HANDLER:
                self._failed.append(function)
                self._failure_causes_welcome = True

    @micropython.native
    def poll(self) -> None:
        """Run the handlers that run during motion, if the stack has space: those of due events and
        timers, and words whose blocks have been executed. Called wherever the main loop waits.

        In check mode none runs; changes in that time are reported after it.
        """
        run = self._state.run
        if run == st.CHECK:
            return
        if run != self._last_run_state or self._changed[0]:
            self._detect_changes()
        if self._is_polling or micropython.stack_use() > _STACK_BYTES:
            return
        self._is_polling = True
        try:
            while self._due_during_motion:
                name, values = self._due_during_motion.pop(0)
                is_report = name == handlers.REPORT  # of other handlers no result is used
                fields = []
                for what, function in self._handlers[name]:
                    result = self._runner.run(what, function, not MAY_MOVE, values)
                    text = _text(result) if is_report else ""
                    if text:
                        fields.append(text)
                if is_report:
                    self._report_field = "|".join(fields)
            if self._timers:
                self._run_timers()
            if self._synced_words.waiting:
                self._synced_words.run_reached()
        finally:
            self._is_polling = False

    def _run_timers(self) -> None:
        """Run the handlers of @every whose time has come."""
        port = self._machine.port
        for timer in self._timers:
            period_ms, last_call, what, function = timer
            if port.elapsed_ms(last_call) >= period_ms:
                timer[1] = port.ticks_ms()  # last_call
                self._runner.run(what, function, not MAY_MOVE)

    def _detect_changes(self) -> None:
        """Find changes of state and inputs, and emit their events: the machine has no hooks for
        these."""
        run = self._state.run
        if run != self._last_run_state:
            self._emit("state_change", STATES[self._last_run_state], STATES[run])
            self._last_run_state = run
        if self._changed[0]:
            self._changed[0] = 0
            for name, was_closed in self._inputs.items():
                closed = self._runner.machine_api.pin(name)
                if closed != was_closed:
                    self._inputs[name] = closed
                    self._emit(_INPUT + name, closed)

    def defer(self, what: str, function: "Function", given: "dict[str, Any]") -> None:
        """Run a word's handler when the blocks planned so far have been executed.

        given: the word's parameters, by letter. GrblError if the handler has failed before, and
        is disabled.
        """
        self._runner.refuse_disabled(what, function)
        self._synced_words.add(what, function, given)
        self.poll()  # runs it at once if nothing moves

    # Hooks

    def attach(self, during_motion: bool) -> None:
        """Hook the events that have handlers into the machine.

        during_motion: some handlers run during motion.
        """
        handled = self._handlers  # its keys are the events that have a handler
        # Hooks may emit events without a handler, too: _queue() drops these.
        if during_motion:
            self._hooks.poll += (self.poll,)
        self._wrap_lines()
        self._cnc.after_reset(self._after_reset)
        if "after_homing" in handled or "after_unlock" in handled:
            self._wrap_homing()
            self._cnc.after_command(b"H", self._after_homing)
            self._cnc.after_command(b"X", self._after_unlock)
        if "tool_change" in handled:
            self._cnc.add_m(_M6, self._change_tool, "t")
        if "probe_done" in handled:
            self._wrap_probe()
        if "spindle" in handled or "coolant" in handled or "program_done" in handled:
            self._hooks.spun += (self._spun,)
            self._hooks.cooled += (self._cooled,)
            self._cnc.after_program(lambda: self._emit("program_done"))
        if "program_paused" in handled:
            self._hooks.paused += (self._defer_pause,)
        if "alarm" in handled:
            self._cnc.after_alarm(lambda code: self._emit("alarm", code))
        if handlers.REPORT in handled:
            self._cnc.add_field(self._report)
        if self._inputs:
            self._machine.port.watch_pins(self._on_change)

    def _wrap_lines(self) -> None:
        """Handle a line's events before the next line.

        Lines with words of custom.py do not come here: CustomCodes executes them. A T on these is
        a parameter, and no tool.
        """
        hooks, modes = self._hooks, self._machine.modes
        self._machine.interpreter.watch(SET_TOOL)  # so that kernels leave lines with a T to us
        previous = hooks.execute

        @micropython.native
        def execute(line: bytearray, length: int) -> None:
            """Execute a line, then what was waiting for its end: events and a pause."""
            previous(line, length)
            if line.find(b"T", 0, length) >= 0:
                self._select_tool(modes.tool)  # Grbl's parser clears it with the next line
            if self._due:
                self.run_due()
            if self._hold:
                hold, self._hold = self._hold, None
                hold()

        hooks.execute = execute

    def _select_tool(self, tool: int) -> None:
        """Handle a T on the line just executed (its number): a new tool is an event, except in
        check mode."""
        if tool != self._runner.machine_api.tool and self._state.run != st.CHECK:
            self._runner.machine_api.tool = tool
            self._emit("tool_select", tool)

    def _after_reset(self) -> None:
        """Drop what waits, except alarms to report, and emit the event of this welcome."""
        self._hold = None
        self._due.clear()
        self._synced_words.waiting.clear()
        alarms = [event for event in self._due_during_motion if event[0] == "alarm"]
        self._due_during_motion = alarms
        if not self._failure_causes_welcome:  # the sender's reset: try all handlers again
            self._failed.clear()
        self._failure_causes_welcome = False
        # _emit() drops events in check mode. This one is due even then, because the reset that
        # ends check mode clears the tool length offset.
        self._queue("after_reset" if self._has_started else "startup")
        self._has_started = True

    def _after_homing(self, state_before: int) -> None:
        """Emit after_homing when $H has been executed without an alarm."""
        if self._has_homed and not self._state.alarm:
            self._has_homed = False
            self._emit("after_homing")
            self.run_due()

    def _after_unlock(self, state_before: int) -> None:
        """Emit after_unlock when $X has ended an alarm."""
        if state_before == st.ALARM and self._state.run == st.IDLE:
            self._emit("after_unlock")
            self.run_due()

    def _change_tool(self, tool: "float | None") -> None:
        """Execute M6, with T on its line or before it. tool: the number of the T on its line, or
        None. If a handler refuses the line, the tool is the one before."""
        api = self._runner.machine_api
        tool_before = api.tool
        try:
            if tool is not None:
                if not 0 <= tool <= HIGHEST_TOOL:
                    raise GrblError(errors.GCODE_MAX_VALUE_EXCEEDED)
                self._select_tool(int(tool))
            self._emit("tool_change", api.tool)
            self.run_due()
        except GrblError:
            api.tool = tool_before
            raise

    def _wrap_homing(self) -> None:
        """Note whether a command has homed the machine: others begin with H, too."""
        previous = self._hooks.home

        def home(axes: int) -> bool:
            self._has_homed = False  # if it raises
            self._has_homed = previous(axes)
            return self._has_homed

        self._hooks.home = home

    def _wrap_probe(self) -> None:
        """Report each probing cycle as probe_done: with the contact position, or None."""
        hooks, state = self._hooks, self._state
        previous = hooks.probe

        def probe(target: "array[float]", move: "Move", away: bool, alarms: bool) -> bool:
            """Probe as before, with the same arguments and result; then emit probe_done."""
            result = previous(target, move, away, alarms)
            contact = Position(hooks.probed_at()) if state.probe_succeeded else None
            self._emit("probe_done", contact)
            return result

        hooks.probe = probe

    def _spun(self, direction: int, rpm: float) -> None:
        """Emit the event of a spindle switched by the program. direction: of spindle.py."""
        self._emit("spindle", _SPINDLE[direction], rpm if direction else 0.0)

    def _cooled(self, mask: int) -> None:
        """Emit the event of coolant switched by the program. mask: of coolant.py."""
        self._emit("coolant", bool(mask & coolant.FLOOD), bool(mask & coolant.MIST))

    def _defer_pause(self) -> bool:
        """Delay the hold of M0 until its handlers have run, after the line. Return True.

        Return False if a handler runs already: M0 then holds at once.
        """
        if self._runner.is_running:
            return False
        self._hold = self._machine.canon.hold_program
        self._emit("program_paused")
        return True

    def _report(self) -> str:
        """Return the field that its handlers made last. They run again after the report."""
        self._emit(handlers.REPORT)
        return self._report_field

    # Inputs

    def _on_change(self) -> None:
        """Note that an input has changed. Called in an interrupt."""
        self._changed[0] = 1
        self._state.pending[st.ANY] = 1
