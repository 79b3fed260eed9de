"""Reports: all text that the machine sends, in the formats of Grbl 1.1h, byte for byte.

A status report, which is requested during motion, is written into a buffer of its own and
allocates nothing. It and the answers to $$ and $# are written from forms, texts that a 0 ends, by
digits.write(text, ints, mm): % is the next integer of ints, which begin at VALUES; #3 the next
float of mm, with 3 decimals; ?P is a P if the lowest bit of the next integer is set, which is then
shifted right for the next letter.
"""

from array import array

from base import errors
from base import state as st
from base.float32 import INCH_PER_MM, copy, f32, vector
from base.float32_math import MINUS, add, add_single
from control.coords import NAMES
from control.spindle import in_range
from micropython import const
from motion import minifloat
from motion.layout import LIMITS, RESOLUTION

from talk.digits import END, VALUES, number, write
from talk.fields import MOVING, begin, write_common
from talk.lines import free_space

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from base.settings import Settings
    from base.state import State
    from control.coords import Coords
    from interfaces import Link, Machine

# Date of this firmware's behaviour, in the place of Grbl's build date. Senders look for "Grbl"
# here and must not find another firmware's name.
VERSION = "1.1h"
BUILD = "20261121"

OK = b"ok\r\n"
_ERROR = b"error:%d\r\n"
_HELP = b"[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]\r\n"
_BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"

_STATES = {
    st.IDLE: b"<Idle\0",
    st.RUN: b"<Run\0",
    st.JOG: b"<Jog\0",
    st.HOMING: b"<Home\0",
    st.ALARM: b"<Alarm\0",
    st.CHECK: b"<Check\0",
    st.SLEEP: b"<Sleep\0",
}
_REPORT_MPOS = const(1)  # bits of $10: machine position, else work position,
_REPORT_BUFFERS = const(2)  # and free planner blocks and bytes
_WCO_IDLE = const(10)  # reports from one WCO: field to the next while idle,
_WCO_BUSY = const(30)  # and during motion
_OVERRIDE_IDLE = const(10)  # from one Ov: field to the next while idle,
_OVERRIDE_BUSY = const(20)  # and during motion
# Bytes of a status report: 12 of them scratch for write(); per axis a position and an offset.
_LONGEST = const(112)  # bytes of a report without what depends on axes, with scratch
_PER_AXIS = const(26)  # bytes per axis
_MOST_VALUES = const(3)  # integers in one form, at most


class Report:
    """Format the state of other objects as text and write it to the link.

    An extra may replace this class: Options.report. axes: their number; line_numbers: a board
    option, to report N.

    Forms: _axes_form has the axis values, _position_form a position with its name and free space
    in buffers, _speed_form the speeds. _text: the status report; _ints and _mm: the integers and
    the floats that are filled into its forms, _mm position and then spindle speed. _shown: scratch
    of the same size, for values converted before they are reported. turning: mask of axes in
    degrees. _is_common: without rare fields a kernel can write the whole report, with
    _common_args. _last_report, _last_length: the last one and its length. _reader: the array for
    lines.free_space().
    """

    # Name of the firmware in the answer to $I; senders look for this word.
    identity = "Grbl"

    def __init__(
        self,
        link: "Link",
        state: "State",
        settings: "Settings",
        coords: "Coords",
        axes: int,
        line_numbers: bool,
    ) -> None:
        self._link = link
        self.send = link.write
        self._state = state
        self._settings = settings
        self._coords = coords
        self._axes = axes
        self._line_numbers = line_numbers
        self._text = bytearray(_LONGEST + _PER_AXIS * axes)
        self._last_length = 0
        self._last_report = memoryview(self._text)
        self._ints = array("i", bytes(4 * (VALUES + _MOST_VALUES)))
        self._mm = vector(axes + 1)
        self._shown = vector(axes + 1)
        self.turning = 0

    def connect(self, machine: "Machine") -> None:
        """Store the objects that a status report reads, and the arguments of the kernels begin()
        and write_common(). Called once all of the machine exists."""
        self._planner = machine.planner
        self._segments = machine.segments
        self._inputs = machine.inputs
        self._spindle = machine.spindle
        self._coolant = machine.coolant
        self._reader = machine.reader.memory()[1]  # the array that lines.free_space() reads
        self._steps = array("i", bytes(4 * machine.planner.motors))
        # Tuples, because each look-up of an attribute costs 5 us.
        self._write_args = self._text, self._ints, self._mm, self._axes
        x_resolution_at = LIMITS + RESOLUTION * self._axes  # index in table: steps per mm of X
        self._begin_args = self._write_args + (self._steps, machine.planner.table, x_resolution_at)
        self._read_steps = machine.engine.position
        self._kinematics = machine.planner.kinematics

    def configure(self) -> None:
        """Apply $10, $13 and $32: build the forms of the status report."""
        settings = self._settings
        self._axes_form = (b",#3" * self._axes)[1:] + b"\0"  # without the first comma
        self._speed_form = b"|FS:#0,#0\0"  # feed rate and spindle speed
        if settings.report_inches:  # one more decimal
            self._axes_form = self._axes_form.replace(b"3", b"4")
            self._speed_form = b"|FS:#1,#0\0"
        position_name = b"|MPos:" if settings.report_mask & _REPORT_MPOS else b"|WPos:"
        self._position_form = position_name + self._axes_form
        has_buffers = settings.report_mask & _REPORT_BUFFERS
        if has_buffers:  # [:-1] drops the 0 at the end
            self._position_form = self._position_form[:-1] + b"|Bf:%,%\0"
        self._is_laser = settings.laser_mode
        # The common report is written by one kernel, if it needs no other field.
        rest_form = self._position_form[:-1] + b"|FS:%,#0>\r\n\0"  # all after the state's name
        sources = self._planner.flow, self._planner.ring, self._reader, has_buffers
        self._common_args = (rest_form, self._begin_args) + self._write_args + sources
        # With work position, inches or line numbers a report is not the common one.
        in_mm = settings.report_mask & _REPORT_MPOS and not settings.report_inches
        self._is_common = bool(in_mm and not self._line_numbers)

    # Answers

    def error(self, code: int) -> None:
        """Send error:n."""
        self._link.write(_ERROR % code)

    def alarm(self, code: int) -> None:
        """Send ALARM:n."""
        self._link.write(b"ALARM:%d\r\n" % code)

    def message(self, text: str) -> None:
        """Send [MSG:...], a text for the user."""
        self._link.write(("[MSG:" + text + "]\r\n").encode())

    def banner(self) -> None:
        """Send the banner of power-up and reset."""
        self._link.write(_BANNER)

    def help(self) -> None:
        """Answer $."""
        self._link.write(_HELP)

    def echo(self, line: bytes) -> None:
        """Send the line as the parser reads it."""
        self._link.write(b"[echo: " + line + b"]\r\n")

    def setting(self, key: int, value: float, decimals: int) -> None:
        """Send one line of $$. key: the setting's number; decimals: those of its value, 0 or 3."""
        self._ints[END] = 0
        self._ints[VALUES] = key
        self._shown[0] = value
        self._send(b"$%=#3\r\n\0" if decimals else b"$%=#0\r\n\0")

    def startup_line(self, index: int, text: str) -> None:
        """Send one line of $N."""
        self._line("$N%d=%s" % (index, text))

    def startup_run(self, text: str) -> bytes:
        """Return the text in front of the answer to a startup line."""
        return (">" + text + ":").encode()

    def startup_lost(self) -> None:
        """Report a startup line whose stored text is invalid."""
        self._link.write(self.startup_run(""))
        self.error(errors.SETTING_READ_FAIL)

    def build_info(self, info: str, options: str) -> None:
        """Answer $I. info: the user's text, "" for none; options: letters and numbers."""
        name = self.identity + " " + info if info else self.identity
        self._line("[VER:%s.%s:%s]" % (VERSION, BUILD, name))
        self._line("[OPT:" + options + "]")

    def modes(self, text: str) -> None:
        """Answer $G with the words of the modal state."""
        self._line("[GC:" + text + "]")

    def offsets(self, probe: "array[float]") -> None:
        """Answer $#: all offsets and the last probe position (mm of machine coordinates)."""
        coords = self._coords
        for i in range(len(coords.systems)):
            self._send_lengths("[" + NAMES[i] + ":\0", coords.systems[i])
        self._send_lengths("[G92:\0", coords.g92)
        length, decimals = coords.tool_length, 3
        if self._settings.report_inches:
            length, decimals = f32(length * INCH_PER_MM), 4
        self._line("[TLO:%s]" % number(length, decimals))
        self.probe(probe)

    def probe(self, probe: "array[float]") -> None:
        """Send the position of the last probe contact (mm of machine coordinates), and whether the
        probe succeeded."""
        self._ints[VALUES] = 1 if self._state.probe_succeeded else 0
        self._send_lengths("[PRB:\0", probe, b":%]\r\n\0")

    # Parts

    def rate(self, mm_min: float) -> str:
        """Return a feed rate as text, in the units of reports."""
        if self._settings.report_inches:
            return number(f32(mm_min * INCH_PER_MM), 1)
        return number(mm_min, 0)

    def speed(self, rpm: float) -> str:
        """Return a spindle speed as text."""
        return number(rpm, 0)

    def _line(self, text: str) -> None:
        """Send the text as a line."""
        self._link.write((text + "\r\n").encode())

    def _send_lengths(self, name: str, mm: "array[float]", end: bytes = b"]\r\n\0") -> None:
        """Send a line of axis values (mm), in the units of reports. name, end: forms."""
        self._ints[END] = 0
        self._write_lengths(name.encode(), mm)
        self._send(end)

    def _send(self, form: bytes) -> None:
        """Write the form after the text, and send the whole text."""
        length = write(form, self._text, self._ints, self._shown)
        self._link.write(memoryview(self._text)[:length])

    # The status report

    def status(self) -> "memoryview":
        """Return the answer to ?. The buffer is reused: send it before the next call. If no rare
        field is due, one kernel writes it all.

        The countdowns count reports until the fields WCO: and Ov: are due; 0 is due.
        """
        state = self._state
        self._read_steps(self._steps)
        if self._kinematics:
            self._kinematics.to_axes(self._steps)
        state_form = _STATES.get(state.run) or self._suspended()
        active = self._inputs.active()  # mask of active inputs
        if active or not (self._is_common and state.wco_countdown and state.override_countdown):
            length = self._write_long(state_form, active)
        else:
            state.wco_countdown -= 1
            state.override_countdown -= 1
            spindle = state.spindle
            if self._is_laser and state.run & MOVING:
                spindle = self._laser_speed()
            length = write_common(state_form, self._common_args, spindle, state.run)
        if length != self._last_length:
            # A slice allocates an object; most reports are as long as the one before.
            self._last_length = length
            self._last_report = memoryview(self._text)[:length]
        return self._last_report

    # Its parts. Each call costs 40 us.

    def _write_long(self, name: bytes, active: int) -> int:
        """Write a report that is not the common one. Returns its length in bytes.

        name: the state, a form that begins the report; active: mask of active inputs.
        """
        begin(name, self._begin_args)  # writes the name; puts the machine position into mm
        text, ints, mm = self._text, self._ints, self._mm
        self._write_fields(text, ints, mm, active)
        return write(b">\r\n\0", text, ints, mm)

    def _write_fields(
        self, text: bytearray, ints: "array[int]", mm: "array[float]", active: int
    ) -> None:
        """Write all fields after the state.

        text: the report; mm: machine position, not written yet; unless $10 requests MPos:, it
        becomes work position in place. ints: from VALUES on, the integers of the form that is
        written next. active: mask of active inputs.
        """
        state, planner, settings = self._state, self._planner, self._settings
        report_mask, inches = settings.report_mask, settings.report_inches
        if not report_mask & _REPORT_MPOS:
            add(self._work_offset(), MINUS, mm, self._axes)  # mm -= offset
        if report_mask & _REPORT_BUFFERS:
            ints[VALUES] = planner.free()
            ints[VALUES + 1] = free_space(self._reader)
        write(self._position_form, text, ints, self.in_inches(mm) if inches else mm)
        if self._line_numbers:
            ints[VALUES] = planner.line_number()
            if ints[VALUES]:  # 0: a line without a number, or none
                write(b"|Ln:%\0", text, ints, mm)
        self._write_speeds(text, ints, state.run & MOVING, inches)
        if active:
            ints[VALUES] = active  # bit 0 is P, the probe, and so on: see Inputs.active()
            write(b"|Pn:?P?X?Y?Z?A?B?C?D?R?H?S\0", text, ints, mm)
        if state.wco_countdown and state.override_countdown:  # neither WCO: nor Ov: is due
            state.wco_countdown -= 1
            state.override_countdown -= 1
        else:
            self._write_rare(text, ints)

    def _write_speeds(self, text: bytearray, ints: "array[int]", moves: int, inches: int) -> None:
        """Write feed rate and spindle speed. text, ints: as in _write_fields(); moves: not 0 in a
        state that has a feed rate; inches: not 0 for inches per minute."""
        shown = self._shown
        rate = self._segments.rate() if moves else 0  # mm/s, in minifloat's integer format
        spindle = self._laser_speed() if moves and self._is_laser else self._state.spindle
        copy(spindle, shown, 2)  # RPM is index 1; index 0 is overwritten by the feed rate
        if inches:
            shown[0] = minifloat.value(rate) * 60 * INCH_PER_MM
        else:
            shown[0] = minifloat.per_minute(rate)  # whole mm/min
        write(self._speed_form, text, ints, shown)

    def _laser_speed(self) -> "array[float]":
        """Return the array that has, at RPM, the spindle speed to report for a laser in motion:
        that of the block that segments are made of; without one, the state's."""
        state, rpm = self._state, self._segments.beam_rpm()
        spindle = state.spindle
        if rpm is None or state.suspend & st.HOLD_COMPLETE:
            return spindle
        self._shown[st.RPM] = in_range(spindle, rpm) if rpm else 0.0  # with override and limits
        return self._shown

    def _write_lengths(self, name: bytes, mm: "array[float]") -> None:
        """Write a field of axis values (mm), in the units of reports. name: a form that begins
        it."""
        text, ints = self._text, self._ints
        write(name, text, ints, mm)
        if self._settings.report_inches:
            mm = self.in_inches(mm)
        write(self._axes_form, text, ints, mm)

    def in_inches(self, mm: "array[float]") -> "array[float]":
        """Convert axis values to inches, except those of axes in degrees. Returns the one scratch
        array, which the next call overwrites."""
        for i in range(self._axes):
            self._shown[i] = mm[i] if self.turning >> i & 1 else mm[i] * INCH_PER_MM
        return self._shown

    def _suspended(self) -> bytes:
        """Return the form of a state that is not in _STATES: Hold or Door, with its phase. Grbl's
        Hold:0 is complete, Hold:1 still in motion."""
        state = self._state
        if state.run == st.HOLD:
            # A jog that is being cancelled stays in the state Jog.
            return b"<Hold:0\0" if state.suspend & st.HOLD_COMPLETE else b"<Hold:1\0"
        self._ints[VALUES] = self._door_phase()  # replaces the % when the form is written
        return b"<Door:%\0"

    def _door_phase(self) -> int:
        """Return Grbl's number: 0 door closed, 1 still open, 2 retracting, 3 restoring."""
        suspend = self._state.suspend
        if suspend & st.INITIATE_RESTORE:
            return 3
        if suspend & st.RETRACT_COMPLETE:
            return 1 if suspend & st.DOOR_AJAR else 0
        return 2

    def _work_offset(self) -> "array[float]":
        """Return machine position minus work position, mm per axis, in the scratch array."""
        coords, offset = self._coords, self._shown
        copy(coords.zero(coords.active), offset, self._axes)  # G54…G59 and G92
        if coords.length_axis < self._axes:  # the tool length is the last of the offsets
            add_single(coords.offsets, len(coords.offsets) - 1, offset, coords.length_axis)
        return offset

    def _write_rare(self, text: bytearray, ints: "array[int]") -> None:
        """Write WCO: if it is due; Ov: and A: if they are due, but not in a report with WCO:. Each
        is due again after a number of reports, which is greater during motion."""
        state = self._state
        is_busy = state.run & MOVING
        if state.wco_countdown > 0:
            state.wco_countdown -= 1
        else:
            state.wco_countdown = (_WCO_BUSY if is_busy else _WCO_IDLE) - 1
            if state.override_countdown == 0:  # due too: in the next report
                state.override_countdown = 1
            self._write_lengths(b"|WCO:\0", self._work_offset())
        if state.override_countdown > 0:
            state.override_countdown -= 1
            return
        state.override_countdown = (_OVERRIDE_BUSY if is_busy else _OVERRIDE_IDLE) - 1
        ints[VALUES] = state.feed_override
        ints[VALUES + 1] = state.rapid_override
        ints[VALUES + 2] = state.spindle_override
        write(b"|Ov:%,%,%\0", text, ints, self._mm)
        # direction() is 0, 0x10 or 0x20. Bits 0 and 1: clockwise, counterclockwise; 2 and 3: flood
        # and mist.
        accessories = self._spindle.direction() >> 4 | self._coolant.mask << 2
        if accessories:
            ints[VALUES] = accessories
            write(b"|A:?S?C?F?M\0", text, ints, self._mm)
