"""Machine API:m, the argument of each handler of custom.py.

Lengths are mm, rates mm/min, times seconds. Whatever waits lets `?`, `!`, `~` and Ctrl-X work. A
handler that runs beside motion may neither move nor wait. Every call looks first whether a reset
has come: a handler that has swallowed it once comes no further.
"""

import micropython
from base import errors
from base import state as st
from base.axes import LETTERS
from base.errors import GrblError
from base.faults import sanitize
from base.float32 import vector
from base.text import text_of
from control.coords import NAMES
from control.modes import INCHES
from micropython import const

from extras.custom.handlers import Refused
from extras.custom.persistent import PersistentValues
from extras.custom.pin_api import PinApi, Stopped
from extras.custom.positions import ModalState, Position
from extras.gcode_text import clean, code_of, words_of

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable

    from talk.controller import Controller

STATES = {
    st.IDLE: "Idle",
    st.ALARM: "Alarm",
    st.CHECK: "Check",
    st.HOMING: "Home",
    st.RUN: "Run",
    st.HOLD: "Hold",
    st.JOG: "Jog",
    st.DOOR: "Door",
    st.SLEEP: "Sleep",
}
_MM_PER_INCH = 25.4
_MOST_JOGS = const(4)  # asked for and not begun


def _never() -> bool:
    return False


class MachineApi(PinApi):
    """What there is to ask. outputs, inputs: pins by the names of the board file."""

    def __init__(
        self, machine: "Controller", outputs: "dict[str, int]", inputs: "dict[str, int]"
    ) -> None:
        super().__init__(machine, outputs, inputs)
        self.tool = 0  # the one selected last, T
        self.keep = PersistentValues(machine.saves)
        self._open: "list[ModalState]" = []  # what is to be put back
        self._jogs: "list[str]" = []  # asked for and not begun

    # For custom.py's keeper

    def _check_may_wait(self) -> None:
        """What follows moves or waits. RuntimeError where the handler may not."""
        if not self.may_move:
            raise RuntimeError("a handler that runs beside motion may neither move nor wait")
        self.check_stopped()

    def _finish_wait(self) -> None:
        self.restart_clock()  # what was waited for was not the handler's own
        self.check_stopped()

    def clear_requests(self) -> None:
        """A reset has ended all that was asked for."""
        super().clear_requests()
        self._open.clear()
        self._jogs.clear()

    def has_jogs(self) -> bool:
        """Jogs have been asked for that have not begun."""
        return bool(self._jogs)

    def start_jogs(self) -> None:
        """Begin the jogs that have been asked for. Between two lines only. A line that has come
        goes first: in Jog it would be refused; and behind it nobody wants them any more."""
        machine, state = self._machine, self._state
        if self._jogs and machine.reader.has_line():
            self._jogs.clear()
        while self._jogs:
            if state.run == st.IDLE and not machine.planner.empty():
                return  # a line that has not begun
            code = self._jogs.pop(0).encode()
            if state.run in (st.IDLE, st.JOG):
                try:
                    machine.interpreter.jog(bytearray(code + b"\0"), len(code))
                except GrblError as reason:
                    self.message("The jog is refused with %d" % reason.code)

    # Motion

    def g(self, text: str) -> None:
        """Execute G-code, a line or several, in the modes in force. Raises Refused with Grbl's
        number."""
        for line in text.split("\n"):
            self._line(line, line)

    def _line(self, line: str, told: str) -> None:
        """Execute a line. told: what it is called where it is refused."""
        machine = self._machine
        self._check_may_wait()
        if self._state.run == st.ALARM:
            raise Refused(errors.SYSTEM_GC_LOCK, told)
        code = clean(line)
        if len(code) > len(machine.reader.line):
            raise Refused(errors.OVERFLOW, told)
        if len(code) > 1:
            try:
                machine.state.hooks.execute(code, len(code) - 1)
            except GrblError as reason:
                self.restart_clock()
                raise Refused(reason.code, told) from reason
        self._finish_wait()

    def saved(self) -> ModalState:
        """with m.saved(): millimetres, absolute, XY plane and mm/min within it (G21 G90 G17 G94);
        modes, feed and offsets are put back behind it."""
        return ModalState(self._machine, True, self._open)

    def probe(
        self,
        words: str,
        must: bool = True,
    ) -> "Position | None":
        """Move until the probe touches: words as behind G38.2, with G53 mm in machine coordinates.
        Returns where it touched, in machine coordinates. must: no contact is ALARM:5; otherwise
        None is returned. One that touches already is ALARM:4, before anything moves."""
        self._check_may_wait()
        with ModalState(self._machine, False, self._open):
            self.g("G38.%d%s" % (2 if must else 3, self._in_work(words)))
        if not self._state.probe_succeeded:
            return None
        return Position(self._machine.state.hooks.probed_at())

    def _in_work(self, words: str) -> str:
        """The words without a G53: places as they read in work coordinates."""
        text = code_of(words)
        if "G53" not in text:
            return text
        self.g("G21G90")
        found = ""
        for letter, number in words_of(text.replace("G53", "")):
            axis = LETTERS.find(letter)
            if axis < 0 and letter != "F":
                raise ValueError("m.probe: only axes and F go with G53, not %s" % letter)
            found += "%s%.4f" % (letter, number if axis < 0 else number - self._zero(axis))
        return found

    def _zero(self, axis: int) -> float:
        """Where work begins, in machine coordinates, tool length included."""
        coords = self._machine.coords
        return coords.work_zero(coords.active, axis)

    def touches(self) -> bool:
        """Whether the probe touches now."""
        return self._machine.inputs.probe()

    def probing(self) -> bool:
        """Whether a probing move is under way."""
        return self._machine.motor_control.touches is not None

    def set_work(self, at: Position, words: str) -> None:
        """From now on that place is called so in work coordinates: "Z0", "X-3 Y-3", mm. Kept, as
        G10 L2 does it."""
        coords = self._machine.coords
        axes = ""
        for letter, number in words_of(code_of(words)):
            axis = LETTERS.index(letter)
            beyond = self._zero(axis) - coords.systems[coords.active][axis]
            axes += "%s%.4f" % (letter, at[axis] - number - beyond)
        with self.saved():
            self.g("G10L2P0" + axes)

    def set_length(self, mm: float) -> None:
        """The tool is so long, as G43.1 says it; holds until a reset, or G49."""
        with self.saved():
            self.g("G43.1%s%.4f" % (LETTERS[self._machine.coords.length_axis], mm))
            for saved in self._open:
                saved.keep_length()

    def home(self, axes: str = "") -> None:
        """Home the machine, as $H does; axes: one letter where the board can do that."""
        self._check_may_wait()
        self._machine.canon.synchronise()
        line = bytearray(("$H%s\0" % axes).encode())
        length = len(line) - 1
        try:
            self._machine.state.hooks.find_command(line, length)(line, length)
        except GrblError as reason:
            raise Refused(reason.code, "$H" + axes) from reason
        self._finish_wait()

    def wait_motion(self) -> None:
        """Wait until everything asked for has been done."""
        self._check_may_wait()
        self._machine.canon.synchronise()
        self._finish_wait()

    def run(self, file: str) -> None:
        """Execute a file of G-code that is on the board."""
        with open(file, "rb") as lines:
            for number, read in enumerate(lines, 1):
                line = text_of(read.rstrip())
                self._line(line, "%s:%d: %s" % (file, number, line))

    # Motion that is asked for, also beside other motion

    def jog(self, axis: str, mm: float, rate: float) -> bool:
        """Jog an axis by so many mm, at mm/min. False, and nothing, where the machine neither
        stands still nor jogs, or has enough to do, or a line waits or, beside motion, is being
        executed. A line that comes before the jog begins goes first, and the jog is forgotten."""
        self.check_stopped()
        reader = self._machine.reader
        is_late = reader.waiting() if self.may_move else reader.has_line()
        if is_late or self._state.run not in (st.IDLE, st.JOG) or len(self._jogs) >= _MOST_JOGS:
            return False
        self._jogs.append("$J=G21G91%s%.4fF%.1f" % (axis.upper(), mm, rate))
        self._state.pending[st.ANY] = 1
        return True

    def end_jog(self) -> None:
        """Come to rest, and forget what was asked for."""
        self._jogs.clear()
        if self._state.run == st.JOG:
            self._state.post(st.CANCEL_MOTION)

    def hold(self) -> None:
        """Come to rest, as with `!`; `~` goes on."""
        self.check_stopped()
        self._state.post(st.FEED_HOLD)

    def stop(self, text: str) -> None:
        """Say why; come to rest where the position is certain; all off, and ALARM:34. The handler
        ends here. In alarm it only does that."""
        if self._state.run == st.ALARM:
            raise Stopped
        self.message(text)
        self.halt()

    def halt(self) -> None:
        """Come to rest, wherever the loop waits now; all off, and the alarm. Raises Abort."""
        machine, state = self._machine, self._state
        while state.run == st.HOLD and state.holding:
            machine.motor_control.pump()
            machine.realtime.handle_events()
        machine.canon.stop_with_alarm(errors.ALARM_HANDLER)

    # Waiting

    @micropython.native  # a handler that runs beside it wants stack
    def wait(self, seconds: float) -> None:
        """Let time pass; motion goes on."""
        self._until(_never, seconds)

    def wait_for(
        self,
        name: str,
        closed: bool = True,
        seconds: "float | None" = None,
    ) -> bool:
        """Wait for an input to close, or to open; False where it has not within so long."""
        return self._until(lambda: self.pin(name) == closed, seconds)

    @micropython.native
    def _until(self, done: "Callable[[], bool]", seconds: "float | None") -> bool:
        self._check_may_wait()
        machine = self._machine
        port, service = machine.port, machine.protocol.service
        machine.canon.auto_start()
        since = port.ticks_ms()
        found = done()
        while not found and (seconds is None or port.elapsed_ms(since) < seconds * 1000):
            service()
            found = done()
        self._finish_wait()
        return found

    def ask(self, text: str) -> None:
        """Tell the sender something, and hold until cycle start (~)."""
        self._check_may_wait()
        self._machine.canon.synchronise()
        self.restart_clock()
        self.message(text)
        self._machine.canon.pause_program()
        self._finish_wait()

    # What there is

    def position(self) -> Position:
        """Where the machine is, in machine coordinates."""
        mm = vector(self._machine.planner.axes)
        self._machine.position(mm)
        return Position(mm)

    def work(self) -> Position:
        """The same in work coordinates."""
        return self._of_work(self.position())

    def target(self) -> Position:
        """Where the lines read so far lead to, in work coordinates."""
        return self._of_work(self._machine.modes.position)

    def _of_work(self, mm: "Position | array[float]") -> Position:
        place = vector(self._machine.planner.axes)
        for i in range(len(place)):
            place[i] = mm[i] - self._zero(i)
        return Position(place)

    def mm(self, length: float) -> float:
        """A length as the program has it, in inches where G20 holds, in mm."""
        modal = self._open[0].modal if self._open else self._machine.modes.modal
        return length * _MM_PER_INCH if modal[INCHES] else length

    def offset(self, name: str) -> Position:
        """G54 to G59, G28, G30 or G92, in machine coordinates."""
        coords = self._machine.coords
        return Position(coords.g92 if name == "G92" else coords.systems[NAMES.index(name)])

    def modes(self) -> "list[str]":
        """The words that $G says."""
        return self._machine.commands.modes().split(" ")

    @property
    def state(self) -> str:
        """What `?` says first: Idle, Run, Hold, Alarm and so on."""
        return STATES[self._state.run]

    @property
    def is_laser(self) -> bool:
        """Laser mode, $32."""
        return self._machine.spindle.laser

    # Words

    def message(self, text: str) -> None:
        """Tell the sender something, as [MSG:text]."""
        self.check_stopped()
        self._machine.report.message(sanitize(text))
