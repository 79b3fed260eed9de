"""Reports: every byte that leaves the machine as text.

Formats are Grbl 1.1h's to the byte. Answers are constant bytes; a status
report is put together from parts.
"""

import errors
import lines
import state as st
from axes import LETTERS
from coords import NAMES
from digits import number
from f32 import INCH_PER_MM, f32, vector
from inputs import DOOR, HOLD, RESET, START
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable
    from typing import Any

    from coolant import Coolant
    from coords import Coords
    from inputs import Inputs
    from interfaces import Link, StepEngine
    from planner import Planner
    from segments import Segments
    from settings import Settings
    from spindle import Spindle
    from state import State

# Date of this firmware's behaviour, in Grbl's place for it, and who we are. Senders look for
# "Grbl" here, and must not find another firmware's name.
VERSION = "1.1h"
BUILD = "20261121"

_OK = b"ok\r\n"
_ERRORS = tuple(b"error:%d\r\n" % code for code in range(39))
_HELP = b"[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]\r\n"
_BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"

_STATES = {
    st.IDLE: "Idle",
    st.RUN: "Run",
    st.JOG: "Jog",
    st.HOMING: "Home",
    st.ALARM: "Alarm",
    st.CHECK: "Check",
    st.SLEEP: "Sleep",
}
_REPORT_MPOS = const(1)
_REPORT_BUFFERS = const(2)
# Reports from one showing of WCO: or Ov: to the next, at rest and in motion.
_WCO_IDLE = const(10)
_WCO_BUSY = const(30)
_OVERRIDE_IDLE = const(10)
_OVERRIDE_BUSY = const(20)
_MOVING = const(0x7C)  # HOMING | RUN | HOLD | JOG | DOOR


class Report:
    """Puts words to what the others know, and writes it to the link.

    The constants say what this dialect of Grbl has; report_09.py has others.
    """

    READS = lines.READS
    HIGHEST_TOOL = 255
    # Letters of commands that are not there.
    NO_COMMANDS = b""
    # What Settings is to be told besides: numbers that are not there, rows that are.
    SETTINGS: "tuple[Any, ...]" = ()
    # Who we are, in the answer to $I; senders look for this word.
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
        self._state = state
        self._settings = settings
        self._coords = coords
        self._axes = axes
        self._line_numbers = line_numbers
        self._mm = vector(axes)

    def connect(
        self,
        engine: "StepEngine",
        planner: "Planner",
        segments: "Segments",
        inputs: "Inputs",
        spindle: "Spindle",
        coolant: "Coolant",
        rx_free: "Callable[[], int]",
        position: "Callable[[array[float]], None]",
    ) -> None:
        """Say whom a status report is to ask. position: copies the machine position in mm."""
        self._engine = engine
        self._planner = planner
        self._segments = segments
        self._inputs = inputs
        self._spindle = spindle
        self._coolant = coolant
        self._rx_free = rx_free
        self._position = position

    # Answers

    def ok(self) -> None:
        """The line was accepted."""
        self._link.write(_OK)

    def error(self, code: int) -> None:
        """The line was refused."""
        self._link.write(_ERRORS[code])

    def alarm(self, code: int) -> None:
        """The machine had to stop."""
        self._line("ALARM:%d" % code)

    def message(self, text: str) -> None:
        """Something a person should know."""
        self._line("[MSG:" + text + "]")

    def banner(self) -> None:
        """The machine has started."""
        self._link.write(_BANNER)

    def help(self) -> None:
        """The answer to $."""
        self._link.write(_HELP)

    def echo(self, line: bytes) -> None:
        """The line as it was understood."""
        self._line("[echo: " + line.decode() + "]")

    def setting(self, key: int, value: float, decimals: int) -> None:
        """One line of $$."""
        self._line("$%d=%s" % (key, number(value, decimals)))

    def startup_line(self, index: int, text: str) -> None:
        """One line of $N."""
        self._line("$N%d=%s" % (index, text))

    def startup_run(self, text: str) -> None:
        """A startup line about to be executed; its answer follows on the same line."""
        self._link.write((">" + text + ":").encode())

    def startup_lost(self) -> None:
        """Nothing valid is kept in the place of a startup line."""
        self.startup_run("")
        self.error(errors.SETTING_READ_FAIL)

    def build_info(self, info: str, options: str) -> None:
        """The answer to $I."""
        name = self.identity + " " + info if info else self.identity
        self._line("[VER:%s.%s:%s]" % (VERSION, BUILD, name))
        self._line("[OPT:" + options + "]")

    def modes(self, text: str) -> None:
        """The answer to $G."""
        self._line("[GC:" + text + "]")

    def offsets(self, probe: "array[float]") -> None:
        """The answer to $#: every offset and the last probe."""
        coords = self._coords
        for i in range(len(coords.systems)):
            self._line("[%s:%s]" % (NAMES[i], self.vector(coords.systems[i])))
        self._line("[G92:%s]" % self.vector(coords.g92))
        self._line("[TLO:%s]" % self._length(coords.tool_length))
        self.probe(probe)

    def probe(self, probe: "array[float]") -> None:
        """Where the probe touched last, and whether it did."""
        succeeded = 1 if self._state.probe_succeeded else 0
        self._line("[PRB:%s:%d]" % (self.vector(probe), succeeded))

    # Parts

    def vector(self, mm: "array[float]") -> str:
        """Axis values in the units of reports."""
        return ",".join([self._length(x) for x in mm])

    def _length(self, mm: float) -> str:
        if self._settings.report_inches:
            return number(f32(mm * INCH_PER_MM), 4)
        return number(mm, 3)

    def rate(self, mm_min: float) -> str:
        """A feed rate in the units of reports."""
        if self._settings.report_inches:
            return number(f32(mm_min * INCH_PER_MM), 1)
        return number(mm_min, 0)

    def speed(self, rpm: float) -> str:
        """A spindle speed."""
        return number(rpm, 0)

    def _line(self, text: str) -> None:
        self._link.write((text + "\r\n").encode())

    # The status report

    def status(self) -> None:
        """The answer to ?."""
        settings = self._settings
        mm = self._mm
        self._position(mm)
        name = "MPos:"
        if not settings.report_mask & _REPORT_MPOS:
            name = "WPos:"
            for i in range(self._axes):
                mm[i] = f32(mm[i] - self._coords.work_offset(i))
        parts = ["<" + self._state_name(), name + self.vector(mm)]
        if settings.report_mask & _REPORT_BUFFERS:
            parts.append("Bf:%d,%d" % (self._planner.free(), self._rx_free()))
        if self._line_numbers:
            line = self._planner.line_number()
            if line:
                parts.append("Ln:%d" % line)
        parts.append("FS:%s,%s" % (self.rate(self._rate()), number(self._rpm(), 0)))
        pins = self._pins()
        if pins:
            parts.append("Pn:" + pins)
        self._extras(parts)
        self._line("|".join(parts) + ">")

    def _state_name(self) -> str:
        state = self._state
        if state.run == st.HOLD:
            # A jog being cancelled goes on as one.
            return "Hold:0" if state.suspend & st.HOLD_COMPLETE else "Hold:1"
        if state.run == st.DOOR:
            return "Door:" + self._door_phase()
        return _STATES[state.run]

    def _door_phase(self) -> str:
        suspend = self._state.suspend
        if suspend & st.INITIATE_RESTORE:
            return "3"
        if suspend & st.RETRACT_COMPLETE:
            return "1" if suspend & st.DOOR_AJAR else "0"
        return "2"

    def _rate(self) -> float:
        return self._segments.rate_mm_min() if self._state.run & _MOVING else 0.0

    def _rpm(self) -> float:
        if self._state.run & _MOVING:
            rpm = self._segments.dynamic_rpm()
            if rpm is not None:
                return rpm
        return self._state.spindle_rpm

    def _pins(self) -> str:
        inputs = self._inputs
        pins = "P" if inputs.probe() else ""
        limits = inputs.limits()
        if limits:
            for i in range(self._axes):
                if limits >> i & 1:
                    pins += LETTERS[i]
        controls = inputs.controls()
        if controls:
            for bit, letter in ((DOOR, "D"), (RESET, "R"), (HOLD, "H"), (START, "S")):
                if controls & bit:
                    pins += letter
        return pins

    def _extras(self, parts: "list[str]") -> None:
        """WCO: now and then, Ov: and A: now and then but not with it."""
        state = self._state
        busy = state.run & _MOVING
        if state.wco_countdown > 0:
            state.wco_countdown -= 1
        else:
            state.wco_countdown = (_WCO_BUSY if busy else _WCO_IDLE) - 1
            if state.override_countdown == 0:
                state.override_countdown = 1
            offsets = self._mm
            for i in range(self._axes):
                offsets[i] = self._coords.work_offset(i)
            parts.append("WCO:" + self.vector(offsets))
        if state.override_countdown > 0:
            state.override_countdown -= 1
            return
        state.override_countdown = (_OVERRIDE_BUSY if busy else _OVERRIDE_IDLE) - 1
        parts.append(
            "Ov:%d,%d,%d" % (state.feed_override, state.rapid_override, state.spindle_override)
        )
        accessories = self._accessories()
        if accessories:
            parts.append("A:" + accessories)

    def _accessories(self) -> str:
        text = ("", "S", "C")[self._spindle.direction() >> 4]
        coolant = self._coolant.mask
        if coolant & 1:
            text += "F"
        if coolant & 2:
            text += "M"
        return text
