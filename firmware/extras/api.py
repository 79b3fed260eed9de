"""What an extra may ask of the machine: its install(cnc) gets one of these.

Main loop only, never an interrupt: what is hooked in here may take memory and its time, as long as
it lets cnc.service() have a turn now and then. The machine itself knows nothing of extras: where
they come in stands in base/hooks.py, and a board without any has nobody there.
"""

import micropython
from base import errors
from base import state as st
from base.errors import GrblError
from control.modes import MOTION
from language import block_layout as b
from micropython import const

from extras.custom_codes import CustomCodes

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from base.settings import Rows
    from talk.controller import Controller

    from extras.cycles import Step

_CYCLES_END = const(100)

# Methods of Cnc by their old names: they work for one release, and a message tells the new one.
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
    """The machine, for an extra. Numbers are those of Grbl: mm, mm/min, rpm."""

    def __init__(self, machine: "Controller") -> None:
        self._machine = machine
        self._hooks = machine.state.hooks
        self._words = CustomCodes(machine)
        # Whoever knows why a program cannot be entered in its middle now says it; "" where it can.
        self.entries: "list[Callable[[], str]]" = []

    # What there is

    @property
    def machine(self) -> "Controller":
        """All parts, for what the methods here do not do."""
        return self._machine

    def service(self) -> None:
        """One turn of whoever waits. Raises Abort after a reset: let it pass."""
        self._machine.protocol.service()

    def write_line(self, line: bytes) -> None:
        """Tell the sender something in a form of its own."""
        self._machine.report.send(line + b"\r\n")

    def message(self, text: str) -> None:
        """Tell the sender something, as [MSG:text]."""
        self._machine.report.message(text)

    def refusal(self, number: int) -> GrblError:
        """To be raised where a line is refused. number: see base/errors.py."""
        return GrblError(number)

    # What can be added

    def add_settings(
        self,
        rows: "Rows",
        without: "tuple[int, ...]" = (),
        file: str = "",
        words: "dict[int, str] | None" = None,
    ) -> None:
        """Settings besides Grbl's, as in base/settings.py: number, attribute, kind, default, unit.

        without: numbers that are not there any more; their attributes keep what is usual. file:
        the name they are all kept under. words: what Grbl 0.9 says of each in $$.
        """
        settings = self._machine.settings
        for row in settings.rows:
            if row[0] in without:
                setattr(settings, row[1], row[3])
        left = [row for row in settings.rows if row[0] not in without]
        settings.rows = tuple(sorted(left + list(rows)))
        settings.file = file or settings.file
        told = getattr(self._machine.report, "words", None)
        if told is not None and words:
            told.update(words)

    def check_setting(self, number: int, check: "Callable[[float], object]") -> None:
        """Called with what the setting is to be, before it is: GrblError refuses it."""
        settings = self._machine.settings

        def check_one(which: int, amount: float) -> None:
            if which == number:
                check(amount)

        settings.checks += (check_one,)

    def add_alarms(self, words: "dict[int, str]") -> None:
        """What Grbl 0.9, which has no numbers for them, says of alarms."""
        told = getattr(self._machine.report, "alarms", None)
        if told is not None:
            told.update(words)

    def add_m(
        self, number: int, call: "Callable[..., object]", letters: str = "", sync: bool = True
    ) -> None:
        """An M word, on a line of its own: call gets the numbers behind the letters, in the order
        of `letters`; lower case may be missing, and is None then. It runs when motion has come to
        its end, or with sync=False while it goes on; in check mode not at all. ValueError where
        the word is taken."""
        self._words.add("M", number, call, letters, sync)

    def add_g(
        self,
        number: "float | str",
        call: "Callable[..., object]",
        letters: str = "",
        sync: bool = True,
    ) -> None:
        """The same for a G word: 81, 81.1, or with an L that Grbl has no use for, "10 L1"."""
        self._words.add("G", number, call, letters, sync)

    def add_cycle(
        self, number: int, plan: "Callable[..., Iterable[Step]]", letters: str = "R"
    ) -> None:
        """A canned cycle, G81 say: a motion mode, each line of which is several moves.

        plan(here, target, ...) gets two places, a list of mm in machine coordinates each, and the
        numbers behind the letters (of I J K L P R), in their order; R is a height, as Z is. It
        raises refusal() where the line is wrong: nothing has changed yet. (A generator would be
        too late with that.) It returns the moves, one by one: where to, and whether as a rapid. Z
        and those numbers hold for the lines that follow; all have to be there once, but those in
        lower case, which may be None.

        number: between 80 and 100. ValueError where it is taken.
        """
        if not b.NO_MOTION < number < _CYCLES_END or self.is_taken("G", number):
            raise ValueError("G%d is taken" % number)
        from extras.cycles import Cycle

        machine = self._machine
        machine.interpreter.add_motion(number, Cycle(machine, plan, letters))
        self.entries.append(
            lambda: "it goes on with a cycle" if machine.modes.modal[MOTION] == number else ""
        )

    def is_taken(self, letter: str, number: "float | str") -> bool:
        """Whether Grbl, or somebody else, has that G or M word."""
        return self._words.is_taken(letter, number)

    def has_word(self, line: bytearray, length: int) -> bool:
        """Whether a line, which a 0 follows, has a word that was added."""
        return self._words.find(line, length) is not None

    def remove_commands(self, letters: bytes) -> None:
        """$ commands with these letters are not there any more."""
        self._machine.commands.remove_commands(letters)

    def add_command(
        self,
        name: bytes,
        call: "Callable[[bytes], object]",
        states: "tuple[int, ...]" = (st.IDLE, st.ALARM),
    ) -> None:
        """A $ command, by what stands behind the $; call gets what follows. It is taken in these
        states. GrblError refuses the line."""
        state, hooks = self._machine.state, self._hooks
        usual = hooks.find_command

        def execute(line: bytearray, length: int) -> None:
            call(bytes(line[1 + len(name) : length]))

        def whose(line: bytearray, length: int) -> "Callable[[bytearray, int], None]":
            if bytes(line[1 : 1 + len(name)]) != name:
                return usual(line, length)
            if state.run not in states:
                raise GrblError(errors.IDLE_ERROR)
            return execute

        hooks.find_command = whose

    def after_command(self, name: bytes, call: "Callable[[int], object]") -> None:
        """Called when a $ command with this behind the $ has been executed, with the state that
        the machine was in before (base/state.py)."""
        state, hooks = self._machine.state, self._hooks
        usual = hooks.find_command

        def whose(line: bytearray, length: int) -> "Callable[[bytearray, int], None]":
            execute = usual(line, length)
            if bytes(line[1 : 1 + len(name)]) != name:
                return execute
            was = state.run

            def execute_and_tell(line: bytearray, length: int) -> None:
                execute(line, length)
                call(was)

            return execute_and_tell

        hooks.find_command = whose

    def add_field(self, field: "Callable[[], str]") -> None:
        """A field of the status report: what it returns, `Xx:1` say, or an empty text."""
        self._hooks.fields += (field,)

    def add_byte(self, byte: int, call: "Callable[[], object]") -> None:
        """A real-time byte, 0x80 to 0xFF, that Grbl has no use for; call at the next turn."""
        if byte < 0x80 or byte in st.EVENTS or 0x90 <= byte <= 0xA1:
            raise ValueError("byte 0x%X is taken" % byte)
        reader = self._machine.reader
        usual = reader.post
        asked = bytearray(1)

        def post(received: int) -> None:
            if received == byte:
                asked[0] = 1
            else:
                usual(received)

        def turn() -> None:
            if asked[0]:
                asked[0] = 0
                call()

        reader.post = post
        self._hooks.poll += (turn,)

    # What can be heard of

    def before_motion(self, may_start: "Callable[[], bool]") -> None:
        """Called before the machine is set in motion; False keeps it where it is."""
        self._hooks.may_start += (may_start,)

    def after_start(self, call: "Callable[[], object]") -> None:
        """Called when the machine has been set in motion; by a jog, homing, a probe and parking,
        too."""
        self._hooks.started += (call,)

    def after_stop(self, call: "Callable[[], object]") -> None:
        """Called when the engine has made all that there was to make, in a hold too, some
        milliseconds before the machine is Idle, and when it has been stopped; at rest, too, now
        and then. More may come at once: after_start() tells."""
        self._hooks.stops += (call,)

    def after_line(self, call: "Callable[[], object]") -> None:
        """Called when a line has asked for a motion of G0 to G3, and it has been planned."""
        self._hooks.moved += (call,)
        self._machine.interpreter.watch(b.MOVE)

    def before_lines(self, call: "Callable[[], object]") -> None:
        """Called at the loop's turns, between two lines; the next may have been found already."""
        self._hooks.between_lines += (call,)

    def after_program(self, call: "Callable[[], object]") -> None:
        """Called when M2 or M30 has ended a program."""
        self._hooks.ended += (call,)

    def after_spindle(self, call: "Callable[[int, float], object]") -> None:
        """Called when a program has turned the spindle, with its direction, 0 where it stops, and
        its speed. What else stops it, a reset, homing, parking, 0x9E, is not told:
        cnc.machine.spindle.direction() says whether it turns now."""
        self._hooks.spun += (call,)

    def after_controls(self, call: "Callable[[int], object]") -> None:
        """Called when a control input has changed, with the mask of base/controls.py. Interrupt:
        no memory, and next to no stack."""
        port = self._machine.port
        usual = port.after_controls

        if usual is None:
            port.after_controls = call
            return

        @micropython.native
        def both(active: int) -> None:
            usual(active)
            call(active)

        port.after_controls = both

    def after_alarm(self, call: "Callable[[int], object]") -> None:
        """Called with its number when an alarm has been told. Nothing moves."""
        usual = self._hooks.alarm

        def alarm(code: int) -> None:
            usual(code)
            call(code)

        self._hooks.alarm = alarm

    def after_reset(self, call: "Callable[[], object]") -> None:
        """Called behind the welcome, after power-up and every reset."""
        self._hooks.reset += (call,)

    if not TYPE_CHECKING:

        def __getattr__(self, name):
            """A method by its old name (_RENAMED); reported after each reset."""
            if name not in _RENAMED:
                raise AttributeError(name)
            new = _RENAMED[name]
            self.after_reset(lambda: self.message("cnc.%s is now cnc.%s" % (name, new)))
            return getattr(self, new)
