"""Power fail: what a machine does in the last tenth of a second after its supply has failed.

At the edge of POWER_FAIL, in the interrupt, the tool goes off and motion begins to slow down. When
it has stopped, position and the job's line are written into a page of flash that was erased
beforehand; nothing is written while a step may come. Where the board file says so, Z then goes up,
and the new position is written. If motion has not stopped in time, it is stopped at once: steps
may be lost, and the record says so. Then comes an alarm, for a supply that has not failed after
all. At the next start a message reports the record, and the job's journal gets the exact line.

POWER_FAIL in the board file, a pin, selects this; see docs/jobs.md. POWER_FAIL_MS is the time for
which the supply lasts, POWER_FAIL_UP_MM how far Z goes up.
"""

import struct
from array import array

import micropython
from base import state as st
from base.axes import LETTERS, Z
from base.float32 import vector
from micropython import const
from motion import layout
from motion import planner as plan

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

    from interfaces import Options, PowerInput

    from extras.api import Cnc

PINS = ("POWER_FAIL",)

# The supply has failed, or the wire of POWER_FAIL is cut: the machine has slowed down and stopped.
# A message then reports whether its position is certain. Not one of Grbl's.
ALARM_POWER_FAIL = const(36)

# Phases.
_GOOD = const(0)
_STOPPING = const(1)
_RISING = const(2)  # Z goes up
_OVER = const(3)  # the record is written, and the supply may last

# Whether a record may be unread: since power-up, since it was written.
_AT_START = const(1)
_WRITTEN = const(2)

# A record: flags, number of axes, CRC-32 of the job and its line, or zeros without a job. The
# position follows: single-precision numbers, mm.
_HEAD = "<BBII"
_CERTAIN = const(1)  # motion had stopped by itself: no step is lost
_LIFT = const(2)  # Z was about to go up

# ms: motion that the engine has already, see docs/faults.md; writing a page, by the data sheet.
_QUEUE_MS = const(14)
_PAGE_MS = const(3)
# ms before the end at which motion is stopped at once: a turn of the main loop, two pages.
_LAST_MS = const(10)
_MS_PER_MINUTE = const(60000)
_LONGEST_MIN = const(1000)  # time of a stop that is reported, at most

_FAILED = "Power failed"

_found: "dict[str, Any]" = {}


def prepare(options: "Options", board: "ModuleType") -> None:
    """Note the input and the options of the board."""
    option = board.__dict__.get
    _found["input"] = options.power_input
    _found["ms"] = option("POWER_FAIL_MS", 100)
    _found["up"] = option("POWER_FAIL_UP_MM", 0)


def install(cnc: "Cnc") -> None:
    """Watch the supply from now on."""
    fail = PowerFail(cnc, _found["input"], _found["ms"], _found["up"])
    cnc.add_alarms({ALARM_POWER_FAIL: _FAILED})
    cnc.before_motion(fail.may_start)
    hooks = cnc.machine.state.hooks
    hooks.poll += (fail.poll,)
    hooks.reset = (fail.on_reset,) + hooks.reset  # first: jobs then report the exact line
    hooks.build_info += (fail.report_time,)


class PowerFail:
    """The supply's failure. lasts_ms: how long the supply lasts after the edge; up_mm: how far Z
    goes up, 0 if it stays. _since: ticks_ms() at the edge. _phase: _GOOD to _OVER. _unread: why a
    record may be unread, 0 for none. _here: position in mm, scratch."""

    def __init__(self, cnc: "Cnc", power: "PowerInput", lasts_ms: int, up_mm: int) -> None:
        machine = cnc.machine
        self._cnc = cnc
        self._machine = machine
        self._input = power
        self._pages = power.pages
        self._state = machine.state
        self._engine = machine.engine
        self._motor_control = machine.motor_control
        self._port = machine.port
        self._flow = machine.planner.flow
        self._lasts_ms = lasts_ms
        self._up_mm = up_mm
        self._move = plan.Move()
        self._phase = _GOOD
        self._since = 0
        self._here = vector(machine.planner.axes)
        self._steps = array("i", (0 for _ in range(machine.planner.motors)))
        self._unread = _AT_START
        power.attach(self.on_fail, self._on_fault)

    # The edge

    @micropython.native
    def on_fail(self) -> None:
        """Switch the tool off and slow down. Interrupt.

        Homing stops at once: nothing is known that could be recorded.
        """
        if self._phase == _GOOD:
            self._port.kill()
            if self._state.run == st.HOMING:
                self._engine.stop()
                self._motor_control.note_reset(ALARM_POWER_FAIL)
                self._phase = _OVER
                return
            self._flow[layout.HOLD] = 1
            self._state.holding = True
            self._since = self._port.ticks_ms()
            self._phase = _STOPPING

    def _on_fault(self) -> None:
        """Stop everything with an internal alarm, because on_fail() has raised. Interrupt."""
        self._port.fault = "POWER_FAIL: its callback has failed"
        self._port.kill()
        self._motor_control.on_fault()

    def may_start(self) -> bool:
        """Return whether motion may start: not while the supply fails, except Z upwards. After a
        failure that was only short, the start watches the supply again."""
        if self._phase == _OVER:
            self._begin()
            if not self._input.is_good():
                self.on_fail()
        return self._phase in (_GOOD, _RISING)

    def _begin(self) -> None:
        """Watch the input again, after a failure that is over."""
        self._phase = _GOOD
        self._input.arm()

    # The main loop

    @micropython.native
    def poll(self) -> None:
        """Run one turn of the main loop. While the supply is good: arm the input again, and read a
        record that an earlier failure has left. Else stop, write the record, end with an alarm."""
        if self._phase == _GOOD:
            if self._input.is_good():
                if not self._input.is_armed:  # interference was over before it was read
                    self._input.arm()
                if self._unread == _WRITTEN and self._machine.at_rest():
                    self._read()
                return
            self.on_fail()
        if self._phase != _OVER:
            self._go_on()
        elif self._input.is_good():
            self._begin()
        elif self._motor_control.is_on():
            self._end()  # the tool was started after $X

    def _go_on(self) -> None:
        """Do the next step after the edge, once motion has stopped or its time is over: write the
        record, raise Z or end with an alarm."""
        flags = _CERTAIN
        if not self._engine.idle():
            if self._phase == _STOPPING:
                self._flow[layout.HOLD] = 1  # a start may have come in between
                self._state.holding = True
            if self._is_early() or self._phase == _RISING:
                return
            self._engine.stop()
            flags = 0  # steps may be lost
        if self._state.run in (st.ALARM, st.CHECK):
            self._end()  # nothing has moved
        elif self._phase == _STOPPING and flags and self._lifts():
            self._write(flags | _LIFT)
            self._phase = _RISING
            if not self._lift():
                self._write(flags)
                self._end()
        else:
            self._write(flags)
            self._end()

    def _is_early(self) -> bool:
        """Return whether the supply lasts long enough for more than the record."""
        return self._port.elapsed_ms(self._since) < self._lasts_ms - _LAST_MS

    def _write(self, flags: int) -> None:
        """Write the record: position, job and line. flags: _CERTAIN, _LIFT."""
        job = self._cnc.job
        line, crc = job.line_at_stop(bool(flags & _CERTAIN)) if job else (0, 0)
        self._machine.position(self._here)
        self._unread = _WRITTEN
        self._pages.write(
            struct.pack(_HEAD, flags, len(self._here), crc, line) + bytes(self._here)
        )

    def _end(self) -> None:
        """Stop the machine with an alarm, for a supply that has not failed after all."""
        self._motor_control.reset()
        self._state.alarm = ALARM_POWER_FAIL
        self._phase = _OVER

    # Z up

    def _lifts(self) -> bool:
        """Return whether Z is to go up: the board file asks for it, Z is homed, a program was
        moving (in a jog, in Idle and while parking Z stays), and the supply lasts."""
        run = self._state.run
        homed = self._machine.homing_probing.homed >> Z & 1
        moves = run in (st.RUN, st.HOLD) and not self._state.system_motion
        return bool(self._up_mm and homed and moves and self._is_early())

    def _lift(self) -> bool:
        """Start Z upwards by up_mm or, if that is outside the travel, by a half or a quarter of
        it. False if it cannot move."""
        machine, target = self._machine, vector(len(self._here))
        target[:] = self._here
        for part in (1.0, 0.5, 0.25):  # of up_mm
            target[Z] = self._here[Z] + self._up_mm * part
            if not machine.canon.outside(target):
                return self._start_up(target)
        return False

    def _start_up(self, target: "array[float]") -> bool:
        """Start a move to target (mm) outside the planner's ring, at the maximum rate of Z. False
        if it has no steps."""
        machine, state = self._machine, self._state
        move = self._move
        move.clear()
        move.feed = machine.settings.max_rate[Z]
        move.flags = layout.SYSTEM_MOTION | layout.NO_FEED_OVERRIDE
        machine.segments.begin_system()
        self._engine.position(self._steps)
        if not machine.planner.system_line(target, move, 0, self._steps):
            return False
        state.system_motion = True
        self._motor_control.start(state.run)
        state.holding = True  # nothing else may start after it
        return True

    # The next start

    def on_reset(self) -> None:
        """Read the record, after power-up or a reset."""
        if self._phase == _GOOD and self._unread:
            self._read()

    def _read(self) -> None:
        """Report the last record and give its line to the journal. Then erase the pages."""
        pages = self._pages
        pages.find()
        self._unread = 0
        for record in pages.records():
            self._report(record)
            break
        if not (pages.is_fresh() or pages.erase()):
            self._cnc.message("POWER_FAIL: flash has no page for it: no line will be recorded")

    def _report(self, record: bytes) -> None:
        """Send a record as a message, and give its line to the journal if the job is the same."""
        flags, axes, crc, line = struct.unpack(_HEAD, record[: struct.calcsize(_HEAD)])
        here = struct.unpack("<%df" % axes, record[-4 * axes :])
        job = self._cnc.job
        name = job.correct(line, crc) if job and line else ""
        what = _FAILED
        if name:
            what = "Job %s: power failed at line %d" % (name, line)
        sure = "position certain" if flags & _CERTAIN else "stopped at speed, position not certain"
        if flags & _LIFT:
            sure += ", Z perhaps higher"
        positions = ["%s%.3f" % (LETTERS[i], here[i]) for i in range(axes)]
        self._cnc.message("%s, %s: %s" % (what, sure, " ".join(positions)))

    def report_time(self) -> None:
        """Report, with $I, how long a stop takes with the present settings, at most."""
        settings = self._machine.settings
        slow = 0.0  # in minutes
        for axis in range(self._machine.planner.axes):
            per_min = settings.acceleration[axis]
            slow = max(slow, settings.max_rate[axis] / per_min if per_min else _LONGEST_MIN)
        ms = int(min(slow, _LONGEST_MIN) * _MS_PER_MINUTE) + _QUEUE_MS + _PAGE_MS
        self._cnc.message("Power fail: stops in %d ms, of %d" % (ms, self._lasts_ms))
