"""API for extras: install(cnc) of each extra gets one Cnc.

Main loop only, never an interrupt. A function registered here may allocate memory and take its
time, if it calls cnc.service() now and then. The machine itself does not know the extras: they
register in base/hooks.py, and on a board without extras those hooks are empty.
"""

import micropython
from base import errors
from base import state as st
from base.errors import GrblError
from control.modes import MOTION
from language import block_layout as b
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from typing import Any

    from base.settings import Rows
    from interfaces import Job
    from talk.controller import Controller

    from extras.custom_codes import CustomCodes
    from extras.cycles import Step

_END_OF_CYCLES = const(100)  # canned cycles are G81 to G99, after NO_MOTION (G80)
_FIRST_UPPER_BYTE = const(0x80)  # real-time bytes above ASCII begin here

# In the names of methods that extras call in install() only: parts.py frees them afterwards.
MAKERS = ("add_", "before_", "after_", "check_", "remove_")

# Old names of Cnc's methods. They work for one release, and a message reports the new name.
_RENAMED = {
    "tell": "write_line",
    "without_commands": "remove_commands",
    "behind_command": "after_command",
    "behind_start": "after_start",
    "behind_stop": "after_stop",
    "behind_line": "after_line",
    "behind_program": "after_program",
    "behind_spindle": "after_spindle",
    "behind_controls": "after_controls",
    "behind_alarm": "after_alarm",
    "behind_reset": "after_reset",
}


class Cnc:
    """The machine, as an extra sees it. Units are Grbl's: mm, mm/min, rpm. entries: each returns
    why a program cannot be entered at a line in its middle now, or "". cycles: each has an
    attribute `kept`, what holds for its next line; job_entry.py restores it. job: the JobRun of a
    board with JOBS, also while no job runs; else None. _words: see _codes()."""

    def __init__(self, machine: "Controller") -> None:
        self._machine = machine
        self._hooks = machine.state.hooks
        self._words: "CustomCodes | None" = None
        self.entries: "list[Callable[[], str]]" = []
        self.cycles: "list[Any]" = []
        self.job: "Job | None" = None

    # Parts and answers

    @property
    def machine(self) -> "Controller":
        """Return the controller, for everything that the methods here do not do."""
        return self._machine

    def service(self) -> None:
        """Run one turn of the main loop while the caller waits.

        Raises Abort after a reset: do not catch it.
        """
        self._machine.protocol.service()

    def write_line(self, line: bytes) -> None:
        """Send a line to the sender as it is; CR LF is added."""
        self._machine.report.send(line + b"\r\n")

    def message(self, text: str) -> None:
        """Send [MSG:text] to the sender."""
        self._machine.report.message(text)

    def refusal(self, number: int) -> GrblError:
        """Return the exception to raise to refuse a line. number: see base/errors.py."""
        return GrblError(number)

    # Additions

    def add_settings(
        self,
        rows: "Rows",
        without: "tuple[int, ...]" = (),
        file: str = "",
        words: "dict[int, str] | None" = None,
    ) -> None:
        """Add settings, as in base/settings.py: number, attribute, kind, default, unit.

        without: numbers of settings to remove; their attributes keep the default. file: the name
        under which all settings are stored, "" for the name as it is. words: the descriptions of
        the new ones in the $$ of Grbl 0.9, by number.
        """
        settings = self._machine.settings
        for number, attribute, _, default, _ in settings.rows:
            if number in without:
                setattr(settings, attribute, default)
        remaining = [row for row in settings.rows if row[0] not in without]  # row[0]: its number
        settings.rows = tuple(sorted(remaining + list(rows)))  # by number
        settings.file = file or settings.file
        descriptions = getattr(self._machine.report, "words", None)  # only in 0.9's reports
        if descriptions is not None and words:
            descriptions.update(words)

    def check_setting(self, number: int, check: "Callable[[float], object]") -> None:
        """Register a check of a setting's new value: check(value) raises GrblError to refuse it.
        number: the setting's."""
        settings = self._machine.settings

        def check_one(changed: int, value: float) -> None:
            """Check the value if it is that setting's. changed: the number of the one to set."""
            if changed == number:
                check(value)

        settings.checks += (check_one,)

    def add_alarms(self, words: "dict[int, str]") -> None:
        """Add the texts by which Grbl 0.9 reports alarms, by number; without effect in other
        dialects."""
        texts = getattr(self._machine.report, "alarms", None)  # only in 0.9's reports
        if texts is not None:
            texts.update(words)

    def add_m(
        self, number: int, call: "Callable[..., object]", letters: str = "", sync: bool = True
    ) -> None:
        """Add an M word, on a line of its own. ValueError if the word is taken.

        call gets the numbers of `letters`, in that order. A lower-case letter may be missing on
        the line, and is None then. call runs when motion has ended, or with sync=False at once,
        also during motion. In check mode it is not called.
        """
        self._codes().add("M", number, call, letters, sync)

    def add_g(
        self,
        number: "float | str",
        call: "Callable[..., object]",
        letters: str = "",
        sync: bool = True,
    ) -> None:
        """Add a G word. number: 81, 81.1, or with an L that Grbl does not use, "10 L1"; the other
        arguments are those of add_m()."""
        self._codes().add("G", number, call, letters, sync)

    def add_cycle(
        self, number: int, plan: "Callable[..., Iterable[Step]]", letters: str = "R"
    ) -> None:
        """Add a canned cycle such as G81: a motion mode whose lines are several moves each.

        plan(here, target, ...) gets the line's start and target, each a list of mm in machine
        coordinates, and the numbers of `letters` (of I J K L P R) in that order; R is a height, as
        Z is. It raises refusal() if the line is wrong, before anything has changed; a generator
        would raise it too late. It returns the moves: each one's target, and if it is a rapid.

        Z and the numbers hold for the following lines. Each must have been given once, except
        lower-case letters, which may be None. number: 81 to 99. ValueError if it is taken.
        """
        if not b.NO_MOTION < number < _END_OF_CYCLES or self.is_taken("G", number):
            raise ValueError("G%d is already in use" % number)
        from extras.cycles import Cycle

        machine = self._machine
        cycle = Cycle(machine, plan, letters)
        machine.interpreter.add_motion(number, cycle)
        self.cycles.append(cycle)
        self.entries.append(
            lambda: (
                "the line is inside a canned cycle: start before it"
                if machine.modes.modal[MOTION] == number
                else ""
            )
        )

    def is_taken(self, letter: str, number: "float | str") -> bool:
        """Return whether Grbl or an extra already has that G or M word. number: as for add_g()."""
        return self._codes().is_taken(letter, number)

    def has_word(self, line: bytearray, length: int) -> bool:
        """Return whether a line has a word added here. line[length] is 0."""
        return self._words is not None and self._words.find(line, length) is not None

    def _codes(self) -> "CustomCodes":
        """Return the words added here. Imported only for an extra with words: it takes 2 kB."""
        if self._words is None:
            from extras.custom_codes import CustomCodes

            self._words = CustomCodes(self._machine)
        return self._words

    def remove_commands(self, letters: bytes) -> None:
        """Remove the $ commands with these letters."""
        self._machine.commands.remove_commands(letters)

    def add_command(
        self,
        name: bytes,
        call: "Callable[[bytes], object]",
        states: "tuple[int, ...]" = (st.IDLE, st.ALARM),
    ) -> None:
        """Add a $ command. call gets the text after `name`; GrblError refuses the line.

        name: the text after the $. states: of base/state.py, in which the command is accepted.
        """
        state, hooks = self._machine.state, self._hooks
        previous_find = hooks.find_command

        def execute(line: bytearray, length: int) -> None:
            """Execute a line with our command."""
            call(bytes(line[1 + len(name) : length]))  # without $ and the name

        def find(line: bytearray, length: int) -> "Callable[[bytearray, int], None]":
            """Return what executes a $ line: ours for this name, else Grbl's. GrblError if the
            state does not allow it."""
            if bytes(line[1 : 1 + len(name)]) != name:
                return previous_find(line, length)
            if state.run not in states:
                raise GrblError(errors.IDLE_ERROR)
            return execute

        hooks.find_command = find

    def after_command(self, name: bytes, call: "Callable[[int], object]") -> None:
        """Register a function for after a $ command that begins with `name` (without the $).

        call gets the state before the command (base/state.py).
        """
        state, hooks = self._machine.state, self._hooks
        previous_find = hooks.find_command

        def find(line: bytearray, length: int) -> "Callable[[bytearray, int], None]":
            """Return what executes a $ line; for this name, it also calls the function."""
            execute = previous_find(line, length)
            if bytes(line[1 : 1 + len(name)]) != name:
                return execute
            state_before = state.run

            def execute_and_call(line: bytearray, length: int) -> None:
                """Execute the line; then call the function, unless that has raised."""
                execute(line, length)
                call(state_before)

            return execute_and_call

        hooks.find_command = find

    def add_field(self, field: "Callable[[], str]") -> None:
        """Add a status report field. `field` returns its text, such as `Xx:1`, or "" for none."""
        self._hooks.fields += (field,)

    def add_byte(self, byte: int, call: "Callable[[], object]") -> None:
        """Add a real-time byte, 0x80 to 0xFF; call runs in the next turn of the main loop.

        ValueError if Grbl uses that byte.
        """
        is_override = st.FIRST_OVERRIDE_BYTE <= byte <= st.LAST_OVERRIDE_BYTE
        if byte < _FIRST_UPPER_BYTE or byte in st.EVENTS or is_override:
            raise ValueError("real-time byte 0x%X is already in use" % byte)
        reader = self._machine.reader
        previous_post = reader.post
        is_received = bytearray(1)  # a flag: post() may run in an interrupt and must not allocate

        def post(received: int) -> None:
            """Note this real-time byte, or pass another one on to Grbl."""
            if received == byte:
                is_received[0] = 1
            else:
                previous_post(received)

        def call_if_received() -> None:
            """Call the function if the byte was received since the last turn of the loop."""
            if is_received[0]:
                is_received[0] = 0
                call()

        reader.post = post
        self._hooks.poll += (call_if_received,)

    # Events

    def before_motion(self, may_start: "Callable[[], bool]") -> None:
        """Register a function that runs before the machine moves. False prevents the start."""
        self._hooks.may_start += (may_start,)

    def after_start(self, call: "Callable[[], object]") -> None:
        """Register a function for each start of motion: jogs, homing, probes and parking, too."""
        self._hooks.started += (call,)

    def after_stop(self, call: "Callable[[], object]") -> None:
        """Register a function for when the engine has executed everything, or has been stopped.

        It is called in a hold, too, some milliseconds before the machine is Idle, and now and then
        while idle. Motion may go on at once; after_start() reports that.
        """
        self._hooks.stops += (call,)

    def after_line(self, call: "Callable[[], object]") -> None:
        """Register a function for after a line with a motion of G0 to G3 has been planned."""
        self._hooks.moved += (call,)
        self._machine.interpreter.watch(b.MOVE)

    def before_lines(self, call: "Callable[[], object]") -> None:
        """Register a function that the main loop calls between two lines.

        The next line may have been received already.
        """
        self._hooks.between_lines += (call,)

    def after_program(self, call: "Callable[[], object]") -> None:
        """Register a function for after M2 or M30 has ended a program."""
        self._hooks.ended += (call,)

    def after_spindle(self, call: "Callable[[int, float], object]") -> None:
        """Register a function for after a program has switched the spindle.

        It gets the direction (0: off) and the speed in rpm. Other stops, by a reset,
        homing, parking or 0x9E, are not reported: cnc.machine.spindle.direction() returns whether
        the spindle turns now.
        """
        self._hooks.spun += (call,)

    def after_controls(self, call: "Callable[[int], object]") -> None:
        """Register a function for changed control inputs. It gets the mask of those that are
        active (base/controls.py).

        It runs in an interrupt: it must not allocate, and has almost no stack.
        """
        port = self._machine.port
        previous = port.after_controls

        if previous is None:
            port.after_controls = call
            return

        @micropython.native
        def call_both(active: int) -> None:
            """Call the functions registered before, then this one. Interrupt."""
            previous(active)
            call(active)

        port.after_controls = call_both

    def after_alarm(self, call: "Callable[[int], object]") -> None:
        """Register a function for reported alarms. It gets the number. Nothing moves then."""
        previous = self._hooks.alarm

        def alarm(code: int) -> None:
            """Report an alarm, then call the function."""
            previous(code)
            call(code)

        self._hooks.alarm = alarm

    def after_reset(self, call: "Callable[[], object]") -> None:
        """Register a function for after the welcome, at power-up and after every reset."""
        self._hooks.reset += (call,)

    if not TYPE_CHECKING:

        def __getattr__(self, name):
            """Return a method by its old name (_RENAMED), and report that after each reset."""
            if name not in _RENAMED:
                raise AttributeError(name)
            new = _RENAMED[name]
            self.after_reset(lambda: self.message("cnc.%s is now cnc.%s" % (name, new)))
            return getattr(self, new)
