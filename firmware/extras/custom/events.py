"""Events of custom.py: where they come from, and when their handlers run.

Only what somebody has asked for is put around the machine. An event whose handlers may move waits
until the line that has brought it about is through, or the loop between two lines; what runs
beside motion has its turn wherever the loop waits.
"""

import micropython
from base import errors
from base import state as st
from base.errors import Abort, GrblError
from base.faults import sanitize
from control import coolant
from control import spindle as sp
from language.block_layout import HIGHEST_TOOL, SET_TOOL
from micropython import const

from extras.custom import handlers
from extras.custom.machine_api import STATES
from extras.custom.positions import Position
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

    Handler = tuple[str, Function]  # what it is called, and itself

_INPUT = "input "  # in front of an input's name
_MOST_DUE = const(16)
# So much of the stack may be in use where a handler begins that runs beside motion: interrupts
# and its own calls want the rest.
_STACK_BYTES = const(3712)
_M6 = const(6)
_GREETINGS = ("startup", "after_reset")
# No alarm, or that of a sender who has reset the machine as it moved.
_SENDERS = (0, errors.ALARM_ABORT_CYCLE, errors.ALARM_HOMING_FAIL_RESET)
_SPINDLE = {sp.OFF: "M5", sp.CW: "M3", sp.CCW: "M4"}


def _field(found: "Any") -> str:
    """What a handler of on.report has returned, without what ends a report; nothing where it is
    neither text nor number."""
    if not isinstance(found, (str, int, float)):
        return ""
    return sanitize(str(found)).replace("<", " ").replace(">", " ")


class Events:
    """The events, and who is to hear of each."""

    def __init__(self, cnc: "Cnc", runner: "Runner") -> None:
        self._cnc = cnc
        self._machine = cnc.machine
        self._hooks = cnc.machine.state.hooks
        self._state = cnc.machine.state
        self._runner = runner
        self._handlers: "dict[str, list[Handler]]" = {}
        self._inputs: "dict[str, bool]" = {}  # by name: whether it was closed
        self._timers: "list[list[Any]]" = []  # milliseconds, since when, name, function
        # What has happened and has not been heard of: by those that may move, by the others.
        self._due: "list[tuple[str, tuple[Any, ...]]]" = []
        self._due_during_motion: "list[tuple[str, tuple[Any, ...]]]" = []
        self._is_polling = False
        self._has_started = False
        self._run = cnc.machine.state.run
        self._pause: "Callable[[], None] | None" = None  # a program's, which is due
        self._field = ""
        self._changed = bytearray(1)
        # Who has failed behind a welcome; whether that has brought about the one that comes.
        self._failed: "list[Function]" = []
        self._has_failed = False
        self._synced_words = SyncedWords(cnc.machine, runner)

    def subscribe(self, kind: str, key: "Any", what: str, function: "Function") -> None:
        """Somebody wants to hear of that."""
        if kind == handlers.EVERY:
            self._timers.append([key, self._machine.port.ticks_ms(), what, function])
        elif kind == handlers.INPUT:
            self._inputs[key] = self._runner.machine_api.pin(key)
            self._handlers.setdefault(_INPUT + key, []).append((what, function))
        else:
            self._handlers.setdefault(kind, []).append((what, function))

    def _emit(self, name: str, *values: "Any") -> None:
        if self._state.run != st.CHECK:
            self._queue(name, *values)

    def _queue(self, name: str, *values: "Any") -> None:
        if name not in self._handlers:
            return
        due = self._due if name in handlers.MOVING else self._due_during_motion
        if len(due) < _MOST_DUE:
            due.append((name, values))
        self._state.pending[st.ANY] = 1  # the loop looks at it between two lines

    # Having their turn

    @micropython.native
    def between_lines(self) -> None:
        """The main loop's turn, between two lines."""
        if self._due:
            self._run_due_between()
        if self._runner.has_run:
            self._runner.run_housekeeping()

    def _run_due_between(self) -> None:
        """Nobody waits for an answer; of an alarm the loop tells behind an Abort."""
        try:
            self.run_due()
        except GrblError:
            return  # its handler refuses, and has said why
        if self._state.alarm and not self._state.pending[st.RESET]:
            raise Abort

    def run_due(self) -> None:
        """Those that may move hear of what has happened. Between two lines only."""
        while self._due:
            name, values = self._due.pop(0)
            self._machine.canon.synchronise()
            word: "dict[str, Any] | None" = {} if name == "tool_change" else None  # M6
            for what, function in self._handlers[name]:
                if name in _GREETINGS:
                    self._run_reset_handler(what, function)
                else:
                    self._runner.run(what, function, True, values, word)

    def _run_reset_handler(self, what: str, function: "Function") -> None:
        """Behind a welcome. Who brings another one about is not asked again behind that: there
        would be no end of it, and no way to unlock the machine."""
        if function in self._failed:
            return
        try:
            self._runner.run(what, function, True)
        finally:
            if self._state.alarm not in _SENDERS:
                self._failed.append(function)
                self._has_failed = True

    @micropython.native
    def poll(self) -> None:
        """Those that run beside motion hear of what has happened, where there is room. In check
        mode nobody does; what has changed meanwhile is heard of behind it."""
        run = self._state.run
        if run == st.CHECK:
            return
        if run != self._run or self._changed[0]:
            self._detect_changes()
        if self._is_polling or micropython.stack_use() > _STACK_BYTES:
            return
        self._is_polling = True
        try:
            while self._due_during_motion:
                name, values = self._due_during_motion.pop(0)
                fields = []
                for what, function in self._handlers[name]:
                    found = self._runner.run(what, function, False, values)
                    text = _field(found) if name == handlers.REPORT else ""
                    if text:
                        fields.append(text)
                if name == handlers.REPORT:
                    self._field = "|".join(fields)
            if self._timers:
                self._run_timers()
            if self._synced_words.waiting:
                self._synced_words.run_reached()
        finally:
            self._is_polling = False

    def _run_timers(self) -> None:
        port = self._machine.port
        for timer in self._timers:
            ms, since, what, function = timer
            if port.elapsed_ms(since) >= ms:
                timer[1] = port.ticks_ms()
                self._runner.run(what, function, False)

    def _detect_changes(self) -> None:
        """See what has happened that nobody else tells."""
        run = self._state.run
        if run != self._run:
            self._emit("state_change", STATES[self._run], STATES[run])
            self._run = run
        if self._changed[0]:
            self._changed[0] = 0
            for name, was_closed in self._inputs.items():
                closed = self._runner.machine_api.pin(name)
                if closed != was_closed:
                    self._inputs[name] = closed
                    self._emit(_INPUT + name, closed)

    def defer(self, what: str, function: "Function", given: "dict[str, Any]") -> None:
        """Run the handler when the blocks that wait now have been made. GrblError where it is
        left out."""
        self._runner.refuse_disabled(what, function)
        self._synced_words.add(what, function, given)
        self.poll()

    # Put around the machine

    def attach(self, during_motion: bool) -> None:
        """Put around the machine what somebody wants to hear of. during_motion: there are handlers
        that run beside motion."""
        heard = self._handlers
        if during_motion:
            self._hooks.poll += (self.poll,)
        self._wrap_lines()
        self._cnc.after_reset(self._after_reset)
        if "after_homing" in heard or "after_unlock" in heard:
            self._cnc.after_command(b"H", self._after_homing)
            self._cnc.after_command(b"X", self._after_unlock)
        if "tool_change" in heard:
            self._cnc.add_m(_M6, self._change_tool, "t")
        if "probe_done" in heard:
            self._wrap_probe()
        if "spindle" in heard or "coolant" in heard or "program_done" in heard:
            self._hooks.spun += (self._spun,)
            self._hooks.cooled += (self._cooled,)
            self._cnc.after_program(lambda: self._emit("program_done"))
        if "program_paused" in heard:
            self._hooks.paused += (self._defer_pause,)
        if "alarm" in heard:
            self._cnc.after_alarm(lambda code: self._emit("alarm", code))
        if handlers.REPORT in heard:
            self._cnc.add_field(self._report)
        if self._inputs:
            self._machine.port.watch_pins(self._on_change)

    def _wrap_lines(self) -> None:
        """What a line has brought about is heard of before the next. Lines with words of
        custom.py do not come here: a T there is not the spindle's."""
        hooks, modes = self._hooks, self._machine.modes
        self._machine.interpreter.watch(SET_TOOL)
        usual = hooks.execute

        @micropython.native
        def execute(line: bytearray, length: int) -> None:
            usual(line, length)
            if line.find(b"T", 0, length) >= 0:
                self._select(modes.tool)  # which Grbl forgets with the next line
            if self._due:
                self.run_due()
            if self._pause:
                pause, self._pause = self._pause, None
                pause()

        hooks.execute = execute

    def _select(self, tool: int) -> None:
        """T, on a line of its own or with others."""
        if tool != self._runner.machine_api.tool and self._state.run != st.CHECK:
            self._runner.machine_api.tool = tool
            self._emit("tool_select", tool)

    def _after_reset(self) -> None:
        self._pause = None
        self._due.clear()
        self._synced_words.waiting.clear()
        self._due_during_motion = [each for each in self._due_during_motion if each[0] == "alarm"]
        if not self._has_failed:
            self._failed.clear()
        self._has_failed = False
        # Also where check mode has been left: the reset has taken the tool's length with it.
        self._queue("after_reset" if self._has_started else "startup")
        self._has_started = True

    def _after_homing(self, was: int) -> None:
        if not self._state.alarm:
            self._emit("after_homing")
            self.run_due()

    def _after_unlock(self, was: int) -> None:
        if was == st.ALARM and self._state.run == st.IDLE:
            self._emit("after_unlock")
            self.run_due()

    def _change_tool(self, tool: "float | None") -> None:
        """M6, with T on its line or before it."""
        if tool is not None:
            if not 0 <= tool <= HIGHEST_TOOL:
                raise GrblError(errors.GCODE_MAX_VALUE_EXCEEDED)
            self._select(int(tool))
        self._emit("tool_change", self._runner.machine_api.tool)
        self.run_due()

    def _wrap_probe(self) -> None:
        hooks, state = self._hooks, self._state
        usual = hooks.probe

        def probe(target: "array[float]", move: "Move", away: bool, alarms: bool) -> bool:
            found = usual(target, move, away, alarms)
            self._emit(
                "probe_done", Position(hooks.probed_at()) if state.probe_succeeded else None
            )
            return found

        hooks.probe = probe

    def _spun(self, direction: int, rpm: float) -> None:
        self._emit("spindle", _SPINDLE[direction], rpm if direction else 0.0)

    def _cooled(self, mask: int) -> None:
        self._emit("coolant", bool(mask & coolant.FLOOD), bool(mask & coolant.MIST))

    def _defer_pause(self) -> bool:
        """M0: its handlers come before the machine holds."""
        if self._runner.is_running:
            return False
        self._pause = self._machine.canon.hold_program
        self._emit("program_paused")
        return True

    def _report(self) -> str:
        """The field as its handlers made it last; they make it anew behind the report."""
        self._emit(handlers.REPORT)
        return self._field

    # Inputs

    def _on_change(self) -> None:
        """Interrupt."""
        self._changed[0] = 1
        self._state.pending[st.ANY] = 1
