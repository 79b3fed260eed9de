"""Reports of grblHAL, for senders that support axes A to C, tools and jobs only with grblHAL.

Only reports differ, and some more real-time bytes work. The machine is the same, and no reported
flag is false. DIALECT = "hal" in the board file selects this; see docs/grblhal.md. The names of
settings, alarms and errors are in flash (FILE, written by `ugrbl build`). They are read line by
line when a sender asks for them, and not kept in memory.
"""

from base import errors
from base import state as st
from base.errors import GrblError
from base.text import text_of
from micropython import const
from talk.digits import END
from talk.lines import READS
from talk.report import BUILD, Report

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType
    from typing import IO

    from control.modes import Modes
    from interfaces import Options
    from talk.controller import Controller

    from extras.api import Cnc

# Each row has a command, the number of its setting, alarm or error, and the line to send.
FILE = "hal.txt"
_SETTING_COMMANDS = b"ES"  # start of the commands about settings

_WELCOME = b"\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n"
_GRBL_LENGTH = const(4)  # length of "Grbl", which "GrblHAL" replaces
_ALARM_LENGTH = const(6)  # length of "<Alarm"
# As grblHAL, because gSender keeps 724 bytes in flight whatever [OPT:] reports.
_RX_BYTES = const(1024)

# Real-time bytes.
_HOLD = const(0x21)
_STOP = const(0x19)
_COMPLETE_REPORT = const(0x87)
_STATUS = const(0x3F)  # ?
_RESUME = const(0x7E)  # ~
# grblHAL's upper bytes, and those of Grbl that do the same.
_GRBLS_BYTE = {0x80: _STATUS, 0x81: _RESUME, 0x82: _HOLD, _COMPLETE_REPORT: _STATUS}

# States in which commands that only read are answered.
_READING_STATES = (st.IDLE, st.ALARM, st.CHECK, st.RUN, st.JOG)


class ReportHal(Report):
    """Reports as grblHAL formats them.

    modal: has the tool; has_jobs: the board runs jobs; axis_letters: of all axes, and more;
    is_complete: the next status report has all fields; _alarm_number: of the last alarm, 0 after a
    reset.
    """

    VERSION = "1.1f"

    modal: "Modes"
    has_jobs = False
    axis_letters = b""
    is_complete = False
    _alarm_number = 0

    def banner(self) -> None:
        """Send the welcome."""
        self._alarm_number = 0
        self._link.write(_WELCOME)

    def alarm(self, code: int) -> None:
        """Report an alarm, and keep its number for the complete status report."""
        self._alarm_number = code
        super().alarm(code)

    def build_info(self, info: str, options: str) -> None:
        """Answer $I, with axes and features. info: the user's text, "" for none; options: letters
        and numbers."""
        axes = self._axes
        name = "GrblHAL" + self.identity[_GRBL_LENGTH:]  # identity: Grbl and more
        self._line("[VER:%s.%s:%s]" % (self.VERSION, BUILD, name + " " + info if info else name))
        self._line("[OPT:%s,%d,0]" % (options, axes))  # 0 tools: there is no tool table
        self._line("[AXS:%d:%s]" % (axes, text_of(self.axis_letters[:axes])))
        home = ",HOME" if self._settings.homing else ""
        self._line("[NEWOPT:ENUMS" + home + (",SD]" if self.has_jobs else "]"))
        self._line("[FIRMWARE:grblHAL]")

    def modes(self, text: str) -> None:
        """Answer $G, with G43.1 or G49 for the tool length offset."""
        length = " G43.1 M" if self._coords.tool_length else " G49 M"
        super().modes(text.replace(" M", length, 1))

    def spindle(self) -> None:
        """Answer $SPINDLESH: one spindle with direction (D), perhaps a laser (L), with variable
        speed (V), and its range in rpm."""
        settings = self._settings
        laser = "L" if settings.laser_mode else ""
        lowest, highest = self.speed(settings.min_rpm), self.speed(settings.max_rpm)
        self._line("[SPINDLE:0|0|0|*D%sV|PWM|%s,%s]" % (laser, lowest, highest))

    def status(self) -> "memoryview":
        """Return the answer to ?. After the byte for a complete report it has all fields."""
        if not self.is_complete:
            return super().status()
        self.is_complete = False
        state = self._state
        # Grbl's report has Ov: or WCO:, never both: the one whose countdown is 0. So here it is
        # made with Ov:, and WCO: is added below.
        state.wco_countdown, state.override_countdown = 1, 0
        text = bytes(super().status())[: -len(">\r\n")]
        state.override_countdown = 0  # next time again: gSender reads Ov: only in normal reports
        if self._alarm_number and state.run == st.ALARM:
            text = b"<Alarm:%d" % self._alarm_number + text[_ALARM_LENGTH:]
        self._ints[END] = 0
        self._write_lengths(b"|WCO:\0", self._work_offset())
        text += bytes(self._text[: self._ints[END]]) + b"|T:%d" % self.modal.tool
        return memoryview(text + (b"|SD:1" if self.has_jobs else b"") + b"|FW:grblHAL>\r\n")


class Bytes:
    """Real-time bytes of grblHAL. Unknown ones are ignored. _reset_after_hold: after a stop byte,
    a hold slows motion down, and a reset follows it. _previous_post: handles Grbl's bytes."""

    def __init__(self, machine: "Controller", report: ReportHal) -> None:
        self._state = machine.state
        self._motor_control = machine.motor_control
        self._report = report
        self._reset_after_hold = False
        self._previous_post = machine.reader.post
        machine.reader.post = self.post
        machine.state.hooks.poll += (self._poll,)
        machine.state.hooks.reset += (self._on_reset,)

    def post(self, byte: int) -> None:
        """Handle a received real-time byte. It may run in an interrupt."""
        if byte == _STOP:
            self._stop()
        else:
            if byte == _COMPLETE_REPORT:
                self._report.is_complete = True
            self._previous_post(_GRBLS_BYTE.get(byte, byte))

    def _stop(self) -> None:
        """Stop motion with a hold; _poll() resets then: the rest is dropped and the position kept.

        An alarm stays. Homing and parking ignore a hold, so they are reset at once, into an alarm.
        """
        state = self._state
        if self._is_moving() and state.run != st.HOMING and not state.system_motion:
            self._previous_post(_HOLD)
            self._reset_after_hold = True
        elif state.run != st.ALARM:
            self._motor_control.reset()

    def _on_reset(self) -> None:
        """Forget a stop that was in progress, because the reset has come; but not one that was
        received since, whose hold is pending."""
        if not self._state.pending[st.FEED_HOLD]:
            self._reset_after_hold = False

    def _poll(self) -> None:
        """Reset when the hold of a stop has ended. Runs at each turn of the main loop."""
        if self._reset_after_hold and not self._is_moving():
            self._motor_control.reset()

    def _is_moving(self) -> bool:
        """Return whether motion, with the idle delay after it, has not ended: a reset would cause
        an alarm."""
        return self._motor_control.moving or self._motor_control.in_idle_delay


def texts() -> "IO[bytes]":
    """Open the rows of FILE. OSError if it is not on the board."""
    return open(FILE, "rb")


def _send_rows(cnc: "Cnc", command: bytes) -> None:
    """Send the texts of a command's rows, such as ES, from FILE. Of settings, send those that this
    machine has.

    GrblError if FILE has no row of that command. Without FILE a message says so.
    """
    try:
        rows = texts()
    except OSError:
        cnc.message(FILE + " is not on the board: ugrbl deploy puts it there")
        return
    prefix = command + b" "
    is_known = False  # FILE has a row of that command
    with rows:
        for row in rows:  # command, number, text
            if row.startswith(prefix):
                is_known = True
                number, _, text = row[len(prefix) :].partition(b" ")
                if command[:2] != _SETTING_COMMANDS or _has_setting(cnc, number):
                    cnc.machine.report.send(text)
                    cnc.service()
    if not is_known:
        raise GrblError(errors.INVALID_STATEMENT)


def _has_setting(cnc: "Cnc", number: bytes) -> bool:
    """Return whether this machine has the setting. number: its decimal digits."""
    try:
        cnc.machine.settings.row(int(number))
    except (GrblError, ValueError):
        return False
    return True


_found: "dict[str, Options]" = {}  # prepare() stores here what install() needs


def prepare(options: "Options", board: "ModuleType") -> None:
    """Select the report class, and let the stop byte act when it arrives."""
    options.report = ReportHal
    options.rx_bytes = max(options.rx_bytes, _RX_BYTES)
    # Upper real-time bytes as in Grbl, one more real-time byte, and too long lines as in Grbl.
    options.reads = (READS[0], _STOP, READS[2])
    _found["options"] = options


def install(cnc: "Cnc") -> None:
    """Add the commands and bytes that grblHAL has and Grbl has not."""
    machine = cnc.machine
    report, commands = machine.report, machine.commands
    assert isinstance(report, ReportHal)
    options = _found.pop("options")
    report.modal, report.has_jobs = machine.modes, options.job_files is not None
    report.axis_letters = options.axis_letters
    Bytes(machine, report)  # the hooks hold it
    link = machine.protocol.link
    if hasattr(link, "welcome"):  # a network link
        link.welcome = _WELCOME
        link.questions = b"?\x80\x87"  # type: ignore[attr-defined]  # ask for a status report
        link.realtime += b"\x19"  # type: ignore[attr-defined]  # stop
        link.stops += b"\x19\x82"  # type: ignore[attr-defined]  # stop, hold
    # $ES, $EA and so on: see FILE.
    cnc.add_command(b"E", lambda rest: _send_rows(cnc, b"E" + rest), _READING_STATES)
    cnc.add_command(b"+", lambda _: commands.show_settings(), _READING_STATES)
    cnc.add_command(b"SPINDLESH", lambda _: report.spindle(), _READING_STATES)
    cnc.add_command(b"HELP", lambda _: report.help(), _READING_STATES)
