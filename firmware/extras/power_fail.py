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
_POWER_GOOD = const(0)  # the input is watched
_STOPPING = const(1)  # the tool is off, and motion slows down
_RAISING_Z = const(2)  # a first record is written, and Z goes up
_OVER = const(3)  # the record is written, and the supply may last

# Since when a record may be unread.
_ALL_READ = const(0)  # no record is unread
_SINCE_POWER_UP = const(1)
_SINCE_WRITING = const(2)  # this failure has written one

# A record: flags, number of axes, CRC-32 of the job and its line, or zeros without a job. The
# position follows: single-precision numbers, mm.
_HEAD = "<BBII"  # flags, number of axes, CRC-32, line
_CERTAIN = const(1)  # motion had stopped by itself: no step is lost
_Z_WAS_TO_RISE = const(2)  # written before Z went up: it may be higher than recorded

_QUEUED_MS = const(14)  # ms of motion that the engine has already, see docs/faults.md
_WRITE_MS = const(3)  # ms for writing a page, by the data sheet
# ms before the end at which motion is stopped at once: a turn of the main loop, two pages.
_RESERVE_MS = const(10)
_MS_PER_MINUTE = const(60000)
_LONGEST_STOP_MIN = const(1000)  # minutes; a longer stop is reported as this

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
    """The supply's failure. supply_ms: how long the supply lasts after the edge; up_mm: how far Z
    goes up, 0 if it stays. _since: ticks_ms() at the edge. _phase: _POWER_GOOD to _OVER.
    _unread_since: _ALL_READ to _SINCE_WRITING. _position_mm: where motion stopped, mm of machine
    coordinates; _write() sets it. _steps: scratch for motor positions."""

    def __init__(self, cnc: "Cnc", power: "PowerInput", supply_ms: int, up_mm: int) -> None:
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
        self._supply_ms = supply_ms
        self._up_mm = up_mm
        self._move = plan.Move()
        self._phase = _POWER_GOOD
        self._since = 0
        self._position_mm = vector(machine.planner.axes)
        self._steps = array("i", (0 for _ in range(machine.planner.motors)))
        self._unread_since = _SINCE_POWER_UP
        power.attach(self.on_fail, self._on_fault)

    # The edge

    @micropython.native
    def on_fail(self) -> None:
        """Switch the tool off and slow down. Interrupt, or main loop if no edge was seen.

        Homing stops at once: nothing is known that could be recorded.
        """
        if self._phase == _POWER_GOOD:
            self._port.kill()  # switches the tool off
            if self._state.run == st.HOMING:
                self._engine.stop()
                self._motor_control.note_reset(ALARM_POWER_FAIL)
                self._phase = _OVER
                return
            self._flow[layout.HOLD] = 1  # the engine slows down
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
            self._watch_again()
            if not self._input.is_good():
                self.on_fail()
        return self._phase in (_POWER_GOOD, _RAISING_Z)

    def _watch_again(self) -> None:
        """Watch the input again, after a failure that is over."""
        self._phase = _POWER_GOOD
        self._input.arm()

    # The main loop

    @micropython.native
    def poll(self) -> None:
        """Run one turn of the main loop. While the supply is good: arm the input again, and read a
        record that an earlier failure has left. Else stop, write the record, end with an alarm."""
        if self._phase == _POWER_GOOD:
            if self._input.is_good():
                if not self._input.is_armed:  # interference was over before it was read
                    self._input.arm()
                if self._unread_since == _SINCE_WRITING and self._machine.at_rest():
                    self._report_records()
                return
            self.on_fail()  # no edge was seen
        if self._phase != _OVER:
            self._advance_stop()
        elif self._input.is_good():
            self._watch_again()
        elif self._motor_control.is_on():
            self._end()  # the tool was started after $X

    def _advance_stop(self) -> None:
        """Do the next step after the edge, once motion has stopped or its time is over: write the
        record, raise Z or end with an alarm."""
        stopped_by_itself = self._engine.idle()
        if not stopped_by_itself:
            if self._phase == _STOPPING:
                self._flow[layout.HOLD] = 1  # a start may have come in between
                self._state.holding = True
            if self._time_is_left() or self._phase == _RAISING_Z:
                return
            self._engine.stop()  # at once: steps may be lost
        certain = _CERTAIN if stopped_by_itself else 0
        if self._state.run in (st.ALARM, st.CHECK):
            self._end()  # nothing has moved
        elif self._phase == _STOPPING and stopped_by_itself and self._may_raise_z():
            self._write(certain | _Z_WAS_TO_RISE)  # first, because the supply may end meanwhile
            self._phase = _RAISING_Z
            if not self._start_raising_z():
                self._write(certain)
                self._end()
        else:
            self._write(certain)
            self._end()

    def _time_is_left(self) -> bool:
        """Return whether the supply lasts long enough for more than the record."""
        return self._port.elapsed_ms(self._since) < self._supply_ms - _RESERVE_MS

    def _write(self, flags: int) -> None:
        """Write the record: the present position, job and line. flags: a mask of _CERTAIN and
        _Z_WAS_TO_RISE."""
        job = self._cnc.job
        line, crc = job.line_at_stop(bool(flags & _CERTAIN)) if job else (0, 0)  # zeros: no job
        self._machine.position(self._position_mm)
        self._unread_since = _SINCE_WRITING
        self._pages.write(
            struct.pack(_HEAD, flags, len(self._position_mm), crc, line) + bytes(self._position_mm)
        )

    def _end(self) -> None:
        """Stop the machine with an alarm, which matters if the supply has not failed after all."""
        self._motor_control.reset()
        self._state.alarm = ALARM_POWER_FAIL
        self._phase = _OVER

    # Z up

    def _may_raise_z(self) -> bool:
        """Return whether Z is to go up: the board file asks for it, Z is homed, a program was
        moving (in a jog, in Idle and while parking Z stays), and the supply lasts."""
        run = self._state.run
        homed = self._machine.homing_probing.homed >> Z & 1
        moves = run in (st.RUN, st.HOLD) and not self._state.system_motion
        return bool(self._up_mm and homed and moves and self._time_is_left())

    def _start_raising_z(self) -> bool:
        """Start Z upwards by up_mm or, if that is outside the travel, by a half or a quarter of
        it. Return False if it cannot move."""
        machine, target = self._machine, vector(len(self._position_mm))
        target[:] = self._position_mm
        for part in (1.0, 0.5, 0.25):
            target[Z] = self._position_mm[Z] + self._up_mm * part
            if not machine.canon.outside(target):
                return self._start_move_to(target)
        return False

    def _start_move_to(self, target: "array[float]") -> bool:
        """Start a move to target (mm) outside the planner's ring, at the maximum rate of Z. Return
        False if it has no steps."""
        machine, state = self._machine, self._state
        move = self._move
        move.clear()
        move.feed = machine.settings.max_rate[Z]
        move.flags = layout.SYSTEM_MOTION | layout.NO_FEED_OVERRIDE
        machine.segments.begin_system()  # saves the block that was stopped
        self._engine.position(self._steps)  # where the move starts
        power = 0  # the tool stays off
        if not machine.planner.system_line(target, move, power, self._steps):
            return False
        state.system_motion = True
        self._motor_control.start(state.run)
        state.holding = True  # nothing else may start after it
        return True

    # The next start

    def on_reset(self) -> None:
        """Read the record, after power-up or a reset."""
        if self._phase == _POWER_GOOD and self._unread_since != _ALL_READ:
            self._report_records()

    def _report_records(self) -> None:
        """Report the last record and give its line to the journal. Then erase the pages, so that
        the next record can be written at once."""
        pages = self._pages
        pages.find()  # the calls below need it
        self._unread_since = _ALL_READ
        for record in pages.records():  # the newest comes first
            self._send_record(record)
            break  # older ones have been reported before
        if not (pages.is_fresh() or pages.erase()):
            self._cnc.message("POWER_FAIL: no free page of flash: job lines will not be recorded")

    def _send_record(self, record: bytes) -> None:
        """Send a record as a message, and give its line to the journal if the job is the same."""
        flags, axes, crc, line = struct.unpack(_HEAD, record[: struct.calcsize(_HEAD)])
        position = struct.unpack("<%df" % axes, record[-4 * axes :])  # the record's last bytes
        job = self._cnc.job
        name = job.correct(line, crc) if job and line else ""
        what = _FAILED
        if name:
            what = "Job %s: power failed at line %d" % (name, line)
        sure = "position certain"
        if not flags & _CERTAIN:
            sure = "stopped without braking, position uncertain"
        if flags & _Z_WAS_TO_RISE:
            sure += ", Z perhaps higher"
        positions = ["%s%.3f" % (LETTERS[i], position[i]) for i in range(axes)]
        self._cnc.message("%s, %s: %s" % (what, sure, " ".join(positions)))

    def report_time(self) -> None:
        """Report, with $I, how long a stop takes with the present settings, at most."""
        settings = self._machine.settings
        longest_min = 0.0  # from the maximum rate of an axis to a stop
        for axis in range(self._machine.planner.axes):
            acceleration = settings.acceleration[axis]  # mm/min^2
            rate = settings.max_rate[axis]  # mm/min
            stop_min = rate / acceleration if acceleration else _LONGEST_STOP_MIN
            longest_min = max(longest_min, stop_min)
        stop_ms = int(min(longest_min, _LONGEST_STOP_MIN) * _MS_PER_MINUTE)
        text = "Power fail: a stop takes %d ms; the supply lasts %d ms"
        self._cnc.message(text % (stop_ms + _QUEUED_MS + _WRITE_MS, self._supply_ms))
