"""The operator: what a handler of custom.py is handed as m, and may ask of the machine.

Lengths are mm, rates mm/min, times seconds. Whatever waits lets `?`, `!`, `~` and Ctrl-X work. A
handler that runs beside motion may neither move nor wait. Every call looks first whether a reset
has come: a handler that has swallowed it once comes no further.
"""

from base import errors
from base import state as st
from base.errors import GrblError
from base.f32 import vector
from base.faults import harmless
from control.coords import NAMES
from control.modes import MODAL_LENGTH, SPINDLE, SYSTEM
from micropython import const

from extras.handlers import Refused
from extras.keep import Keep

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable
    from typing import Any

    from talk.controller import Controller

_COOLANT = const(SPINDLE + 1)


class Stopped(BaseException):
    """There is an alarm, or a reset: the handler has come to its end. No Exception, for a handler
    that catches those is to end, too."""


class Place:
    """A place: x, y, z and, where there is one, a; or place[0] and so on."""

    def __init__(self, mm: "array[float]") -> None:
        self._mm = [mm[i] for i in range(len(mm))]

    def __getitem__(self, axis: int) -> float:
        return self._mm[axis]

    def __repr__(self) -> str:
        return "(%s)" % ", ".join(["%.3f" % mm for mm in self._mm])

    @property
    def x(self) -> float:
        return self._mm[0]

    @property
    def y(self) -> float:
        return self._mm[1]

    @property
    def z(self) -> float:
        return self._mm[2]

    @property
    def a(self) -> float:
        return self._mm[3]


class Saved:
    """Modes, feed and offsets as they were, behind a with statement. Spindle and coolant are what
    the machine does, and stay."""

    def __init__(self, machine: "Controller") -> None:
        self._machine = machine

    def __enter__(self) -> None:
        modes, coords = self._machine.modes, self._machine.coords
        self._modal = list(modes.modal)
        self._feed, self._rpm = modes.feed, modes.spindle_rpm
        self._length, self._g92 = coords.tool_length, coords.g92[:]

    def __exit__(self, *fault: object) -> None:
        machine = self._machine
        modes, coords = machine.modes, machine.coords
        if machine.state.pending[st.RESET]:
            return  # which has modes of its own
        for i in range(MODAL_LENGTH):
            if i not in (SPINDLE, _COOLANT):
                modes.modal[i] = self._modal[i]
        coords.active = modes.modal[SYSTEM]
        modes.feed, modes.spindle_rpm = self._feed, self._rpm
        coords.tool_length = self._length
        coords.set_g92(self._g92)
        machine.state.wco_countdown = 0
        machine.interpreter.fast.forget()


class Operator:
    """What there is to ask. outputs, inputs: pins by the names of the board file."""

    def __init__(
        self, machine: "Controller", outputs: "dict[str, int]", inputs: "dict[str, int]"
    ) -> None:
        self._machine = machine
        self._state = machine.state
        self._outputs = list(outputs)
        self._inputs = list(inputs)
        self._levels = 0
        self._since_ms = 0
        self.slow_ms = 0  # the longest that a handler has taken without a call of these
        self.may_move = False  # the handler that runs now
        self.tool = 0  # keep-name: custom.py may say m.tool; the one selected last, T
        self.keep = Keep(machine.saves)

    # For custom.py's keeper

    def begin(self, may_move: bool) -> bool:
        """A handler begins. Returns whether the one that it interrupts may move."""
        outer = self.may_move
        self.may_move = may_move
        self.rested()
        return outer

    def rested(self) -> None:
        """From now on time counts as the handler's own."""
        self._since_ms = self._machine.port.ticks_ms()

    def look(self) -> None:
        """See how long a handler has taken, and whether it is to end."""
        self.slow_ms = max(self.slow_ms, self._machine.port.elapsed_ms(self._since_ms))
        if self._state.pending[st.RESET] or self._state.alarm:
            raise Stopped

    def _wait(self) -> None:
        """What follows moves or waits. RuntimeError where the handler may not."""
        if not self.may_move:
            raise RuntimeError("a handler that runs beside motion may neither move nor wait")
        self.look()

    def _end(self) -> None:
        self.rested()  # what was waited for was not the handler's own
        self.look()

    def forget(self) -> None:
        """A reset has set all outputs to rest."""
        self._levels = 0

    # Motion

    def g(self, text: str) -> None:
        """Execute G-code, a line or several. Raises Refused with Grbl's number."""
        for line in text.split("\n"):
            self._wait()
            if self._state.run == st.ALARM:
                raise Refused(errors.SYSTEM_GC_LOCK, line)
            code = _clean(line)
            if len(code) > 1:
                try:
                    self._machine.interpreter.execute(code, len(code) - 1)
                except GrblError as reason:
                    raise Refused(reason.code, line) from reason
            self._end()

    def saved(self) -> Saved:
        """with m.saved(): modes, feed and offsets are put back behind it."""
        return Saved(self._machine)

    def probe(
        self,
        words: str,
        must: bool = True,  # keep-name: custom.py may say must=
    ) -> "Place | None":
        """Move until the probe touches: words as behind G38.2, with G53 in machine coordinates.
        Returns where it touched, in machine coordinates. must: no contact is ALARM:5; otherwise
        None is returned."""
        self._wait()
        with self.saved():
            self.g("G38.%d%s" % (2 if must else 3, self._in_work(words)))
        if not self._state.probe_succeeded:
            return None
        return Place(self._machine.seek.probe_position())

    def _in_work(self, words: str) -> str:
        """The words without a G53: places as they read in work coordinates."""
        text = _clean(words)[:-1].decode()
        if "G53" not in text:
            return text
        machine = self._machine
        self.g("G21G90")
        coords = machine.coords
        zero = list(coords.zero(coords.active))
        zero[coords.length_axis] += coords.tool_length
        found = ""
        for letter, number in _words(text.replace("G53", "")):
            axis = "XYZA".find(letter)
            found += "%s%.4f" % (letter, number if axis < 0 else number - zero[axis])
        return found

    def home(self, axes: str = "") -> None:
        """Home the machine, as $H does; axes: one letter where the board can do that."""
        self._wait()
        self._machine.canon.synchronise()
        line = bytearray(("$H%s\0" % axes).encode())
        length = len(line) - 1
        try:
            self._machine.commands.whose(line, length)(line, length)
        except GrblError as reason:
            raise Refused(reason.code, "$H" + axes) from reason
        self._end()

    def wait_motion(self) -> None:
        """Wait until everything asked for has been done."""
        self._wait()
        self._machine.canon.synchronise()
        self._end()

    def run(self, file: str) -> None:
        """Execute a file of G-code that is on the board."""
        with open(file) as lines:
            for line in lines:
                self.g(line.rstrip())

    # Waiting

    def wait(self, seconds: float) -> None:
        """Let time pass; motion goes on."""
        self._until(lambda: False, seconds)

    def wait_for(
        self,
        name: str,
        closed: bool = True,  # keep-name: custom.py may say closed=
        seconds: "float | None" = None,  # keep-name: custom.py may say seconds=
    ) -> bool:
        """Wait for an input to close, or to open; False where it has not within so long."""
        return self._until(lambda: self.pin(name) == closed, seconds)

    def _until(self, done: "Callable[[], bool]", seconds: "float | None") -> bool:
        self._wait()
        machine = self._machine
        port, service = machine.port, machine.protocol.service
        machine.canon.auto_start()
        since = port.ticks_ms()
        found = done()
        while not found and (seconds is None or port.elapsed_ms(since) < seconds * 1000):
            service()
            found = done()
        self._end()
        return found

    def ask(self, text: str) -> None:
        """Tell the sender something, and hold until cycle start (~)."""
        self._wait()
        self._machine.canon.synchronise()
        self.rested()
        self.message(text)
        self._machine.canon.pause_program()
        self._end()

    # What there is

    def position(self) -> Place:
        """Where the machine is, in machine coordinates."""
        mm = vector(self._machine.planner.axes)
        self._machine.position(mm)
        return Place(mm)

    def work(self) -> Place:
        """The same in work coordinates."""
        machine = self._machine
        coords = machine.coords
        mm = vector(machine.planner.axes)
        machine.position(mm)
        zero = coords.zero(coords.active)
        for i in range(len(mm)):
            mm[i] -= zero[i]
            if i == coords.length_axis:
                mm[i] -= coords.tool_length
        return Place(mm)

    def offset(self, name: str) -> Place:
        """G54 to G59, G28, G30 or G92, in machine coordinates."""
        coords = self._machine.coords
        return Place(coords.g92 if name == "G92" else coords.systems[NAMES.index(name)])

    def modes(self) -> "list[str]":
        """The words that $G says."""
        return self._machine.commands.modes().split(" ")

    # Pins

    def out(self, name: str, on: "Any") -> None:
        """Switch an output that the board file names."""
        bit = 1 << _index(self._outputs, name, "output")
        self.look()
        self._levels = self._levels | bit if on else self._levels & ~bit
        self._machine.port.drive(self._levels)

    def pin(self, name: str) -> bool:
        """Whether an input that the board file names is closed: pulled to ground."""
        bit = _index(self._inputs, name, "input")
        return not self._machine.port.sense() >> bit & 1

    # Words

    def message(self, text: str) -> None:
        """Tell the sender something, as [MSG:text]."""
        self.look()
        self._machine.report.message(harmless(text))


def _clean(line: str) -> bytearray:
    """As lines come from the reader: upper case, no spaces, no comments; a 0 follows."""
    code = ""
    within = False
    for c in line.upper():
        if c == ";":
            break
        if c in "()":
            within = c == "("
        elif c > " " and c != "/" and not within:
            code += c
    return bytearray(code.encode() + b"\0")


def _words(text: str) -> "list[tuple[str, float]]":
    """Letters and numbers. ValueError where there is none."""
    found = []
    start = 0
    for end in range(1, len(text) + 1):
        if end == len(text) or "A" <= text[end] <= "Z":
            found.append((text[start], float(text[start + 1 : end])))
            start = end
    return found


def _index(names: "list[str]", name: str, kind: str) -> int:
    if name not in names:
        raise ValueError("the board file names no %s %s" % (kind, name))
    return names.index(name)
